"""The black box: which stops have a recording written, and what is in it."""
import errno
import math
import os
import time

import pytest
from car_interface.msg import SteeringState, TeleopState, ThrottleState
from geometry_msgs.msg import Twist
from rosgraph_msgs.msg import Log
from sensor_msgs.msg import BatteryState, Joy
from std_msgs.msg import Float32
from tf2_msgs.msg import TFMessage

from car_interface.common import causes
from car_interface.nodes.black_box import BlackBox
from car_interface.tools.report.summary import summarize
from graph import NS_PER_S

rosbag = pytest.importorskip("rosbag")  # Debian's is for Debian's Python


@pytest.fixture
def folder(tmp_path):
    return tmp_path / "black_box"


@pytest.fixture(autouse=True)
def _time_by_the_graph(monkeypatch, graph):
    """A recording's name carries the graph's time."""
    monkeypatch.setattr("graph.NodeClocks.local_time", lambda self, form: time.strftime(
        form, time.gmtime(self.ros_now().to_sec())))


def black_box(graph, folder):
    return graph.add(BlackBox, "black_box", {"folder": str(folder)})


def names(folder):
    """Return what each recording is of."""
    return [name[len("2023-11-14_22-30-00_"):] for name in sorted(os.listdir(folder))] if folder.exists() else []


def steering(source=SteeringState.PLANNER, cause=causes.PLANNER, **fields):
    return SteeringState(source=source, cause=cause, speed=1.0, **fields)


def throttle(source=ThrottleState.PLANNER, cause=causes.PLANNER, granted=0.3, **fields):
    return ThrottleState(source=source, cause=cause, granted=granted, speed=1.0, **fields)


def drive(graph):
    """Have the arbiters say that the planner has the car, and a hand hold the deadman."""
    graph.hold("/turn_arb/state", steering(), 20)
    graph.hold("/throttle_arb/state", throttle(), 10)
    graph.hold("/teleop_logi/state", TeleopState(human_in_loop=True, cause=causes.AUTONOMOUS), 10)
    graph.run(1.0)


ARBITERS = (("/turn_arb/state", steering), ("/throttle_arb/state", throttle))


@pytest.mark.parametrize("cause, topic, state", [
    (cause, *ARBITERS[index % 2]) for index, cause in enumerate(sorted(causes.LOSSES - {causes.ESC_MOTION}))])
def test_stop_by_a_loss_is_recorded_under_its_name(graph, folder, cause, topic, state):
    black_box(graph, folder)
    drive(graph)
    graph.hold(topic, state(SteeringState.NEUTRAL, cause), 10)
    graph.run(4.9)
    assert names(folder) == []  # it waits for how it ends
    graph.run(0.3)
    assert names(folder) == [cause.replace(" ", "_").replace("-", "_") + ".bag"]


@pytest.mark.parametrize("source, cause", [
    (SteeringState.NO_HUMAN, causes.HUMAN_ABSENT), (SteeringState.LOCKED, causes.E_STOP),
    (SteeringState.NEUTRAL, causes.NO_RADIUS), (SteeringState.NEUTRAL, causes.REQUEST_REFUSED),
    (SteeringState.NEUTRAL, causes.STEERING_STOPPED), (SteeringState.NO_HUMAN, causes.STARTING)])
def test_stop_that_was_asked_for_is_not(graph, folder, source, cause):
    black_box(graph, folder)
    drive(graph)
    graph.hold("/turn_arb/state", steering(source, cause), 20)
    graph.hold("/throttle_arb/state", throttle(source, cause, 0.0), 10)
    graph.run(1.0)
    # What falls silent after it has stopped nothing.
    graph.hold("/turn_arb/state", steering(source, causes.HUMAN_STALE), 20)
    graph.hold("/throttle_arb/state", throttle(source, causes.PLANNER_STALE, 0.0), 10)
    graph.hold("/teleop_logi/state", TeleopState(human_in_loop=False, cause=causes.NO_DEADMAN), 10)
    graph.run(10.0)
    assert names(folder) == []


def test_throttle_s_esc_that_moved_against_its_state_is_one_too(graph, folder):
    black_box(graph, folder)
    drive(graph)
    graph.hold("/throttle_arb/state", throttle(esc_cause=causes.ESC_MOTION, esc_reason="it rolls"), 10)
    graph.run(6.0)
    assert names(folder) == ["esc_motion.bag"]


def test_gamepad_that_was_lost_is_one_although_the_arbiters_see_a_released_deadman(graph, folder):
    black_box(graph, folder)
    drive(graph)
    graph.hold("/teleop_logi/state", TeleopState(cause=causes.JOY_STALE, reason="joy silent for 0.27 s"), 10)
    graph.hold("/turn_arb/state", steering(SteeringState.NO_HUMAN, causes.HUMAN_ABSENT), 20)
    graph.run(6.0)
    assert names(folder) == ["joy_silent.bag"]


@pytest.mark.parametrize("topic, node", [("/turn_arb/state", "turn_arb"), ("/throttle_arb/state", "throttle_arb")])
def test_arbiter_whose_states_end_while_the_car_drives_is_one(graph, folder, topic, node):
    black_box(graph, folder)
    drive(graph)
    graph.silence(topic)
    graph.run(8.0)
    assert names(folder) == [f"{node}_silent.bag"]


def test_arbiter_whose_states_end_while_the_car_stands_is_none(graph, folder):
    black_box(graph, folder)
    graph.hold("/throttle_arb/state", ThrottleState(source=ThrottleState.PLANNER), 10)
    graph.hold("/turn_arb/state", SteeringState(source=SteeringState.PLANNER), 20)
    graph.run(3.0)
    graph.silence("/turn_arb/state", "/throttle_arb/state")
    graph.run(8.0)
    assert names(folder) == []


def test_car_that_stood_or_whose_speed_nobody_knows_while_throttle_arb_gives_none_was_not_driven(graph, folder):
    black_box(graph, folder)
    graph.hold("/throttle_arb/state", ThrottleState(source=ThrottleState.PLANNER, speed=math.nan), 10)
    graph.hold("/turn_arb/state", SteeringState(source=SteeringState.PLANNER, speed=math.nan), 20)
    graph.run(3.0)
    graph.hold("/turn_arb/state", SteeringState(source=SteeringState.NEUTRAL, cause=causes.PLANNER_STALE), 20)
    graph.run(6.0)
    assert names(folder) == []


def test_steering_alone_counts_as_driven_while_the_speed_is_unknown(graph, folder):
    black_box(graph, folder)
    graph.hold("/turn_arb/state", SteeringState(source=SteeringState.TELEOP, speed=math.nan), 20)
    graph.run(3.0)
    graph.hold("/turn_arb/state", SteeringState(source=SteeringState.NO_HUMAN, cause=causes.HUMAN_STALE), 20)
    graph.run(6.0)
    assert names(folder) == ["human_silent.bag"]


def test_second_stop_within_half_a_minute_makes_no_second_recording(graph, folder):
    black_box(graph, folder)
    for recorded in (1, 1, 2):
        drive(graph)
        graph.hold("/throttle_arb/state", throttle(ThrottleState.NEUTRAL, causes.ODOMETRY_STALE), 10)
        graph.run(14.5)
        assert len(names(folder)) == recorded


def test_recording_has_the_last_minute_and_how_it_ended_and_the_latched_messages_from_before(graph, folder):
    black_box(graph, folder)
    latched = graph.nodes["/black_box"].inbox.graph.publisher("/tf_static", TFMessage, 1, True)
    latched.publish(TFMessage())
    graph.hold("/joy", Joy(axes=[0.5]), 50)
    graph.publish("/drive", Twist())  # of whatever type
    graph.run(70.0)
    drive(graph)
    graph.publish("/rosout", Log(msg="x" * 20_000))  # a picture, or the like
    stopped_s = (graph.now_ns + graph.ros_ahead_ns) / NS_PER_S
    graph.hold("/throttle_arb/state", throttle(ThrottleState.NEUTRAL, causes.ODOMETRY_STALE), 10)
    graph.run(6.0)
    with rosbag.Bag(str(next(folder.iterdir()))) as bag:
        found = bag.get_type_and_topic_info()[1]
        times = [at.to_sec() for _, _, at in bag.read_messages()]
        joy = next(message for _, message, _ in bag.read_messages(["/joy"]))
    assert joy.axes == (0.5,)
    assert found["/joy"].message_count == pytest.approx(60 * 50, abs=5)
    assert found["/tf_static"].message_count == 1
    assert not {"/drive", "/rosout"} & set(found)
    assert times == sorted(times)
    assert (times[0] - stopped_s, times[-1] - stopped_s) == (pytest.approx(-55, abs=0.1), pytest.approx(5, abs=0.1))


def test_topic_of_two_types_is_recorded_with_the_newest_and_a_state_of_another_type_is_no_state(graph, folder):
    black_box(graph, folder)
    drive(graph)
    graph.publish("/drive", Twist(), sender="/old")
    graph.publish("/drive", Float32(1.0))
    graph.publish("/turn_arb/state", Float32(1.0), sender="/other")
    graph.hold("/turn_arb/state", steering(SteeringState.NEUTRAL, causes.PLANNER_STALE), 20)
    graph.run(6.0)
    with rosbag.Bag(str(next(folder.iterdir()))) as bag:
        found = bag.get_type_and_topic_info()[1]
    assert found["/drive"][:2] == ("std_msgs/Float32", 1)
    assert found["/turn_arb/state"].msg_type == "car_interface/SteeringState"


def test_recording_of_a_stop_by_the_battery_has_its_voltage(graph, folder):
    black_box(graph, folder)
    graph.hold("/battery_state", BatteryState(voltage=6.1), 5)
    drive(graph)
    graph.hold("/throttle_arb/state", throttle(ThrottleState.NEUTRAL, causes.BATTERY_EMPTY), 10)
    graph.run(6.0)
    with rosbag.Bag(str(next(folder.iterdir()))) as bag:
        voltages = {round(message.voltage, 1) for _, message, _ in bag.read_messages(["/battery_state"])}
    assert voltages == {6.1}


def test_recording_that_is_due_is_written_when_the_node_ends(graph, folder):
    node = black_box(graph, folder)
    drive(graph)
    graph.hold("/throttle_arb/state", throttle(ThrottleState.NEUTRAL, causes.ODOMETRY_STALE), 10)
    graph.run(1.0)
    node.end()
    assert names(folder) == ["odometry_silent.bag"] and not node.fault


def test_clock_that_was_set_is_told_and_the_recording_s_times_rise(graph, folder):
    black_box(graph, folder)
    drive(graph)
    graph.ros_ahead_ns -= 3600 * NS_PER_S
    graph.run(0.3)
    graph.hold("/throttle_arb/state", throttle(ThrottleState.NEUTRAL, causes.ODOMETRY_STALE), 10)
    graph.run(6.0)
    with rosbag.Bag(str(next(folder.iterdir()))) as bag:
        assert bag.get_end_time() - bag.get_start_time() == pytest.approx(6.3, abs=0.2)
    assert any(line.startswith("the clock of this computer was set") for line in graph.lines("/black_box"))


def test_full_disk_is_told_and_the_next_recording_is_written(graph, folder, monkeypatch):
    black_box(graph, folder)
    graph.record("/diagnostics")

    def fail(*arguments, **keywords):
        raise OSError(errno.ENOSPC, "No space left on device")
    with monkeypatch.context() as patch:
        patch.setattr("car_interface.common.atomic_file.replace", fail)
        drive(graph)
        graph.hold("/throttle_arb/state", throttle(ThrottleState.NEUTRAL, causes.ODOMETRY_STALE), 10)
        graph.run(6.0)
    assert any("No space left on device" in line for line in graph.lines("/black_box"))
    report = graph.report("black_box: black box")
    assert (report.level, report.message) == (1, "the last recording couldn't be written: No space left on device")
    graph.run(30.0)
    drive(graph)
    graph.hold("/throttle_arb/state", throttle(ThrottleState.NEUTRAL, causes.MODE_STALE), 10)
    graph.run(7.0)
    assert names(folder) == ["mode_silent.bag"]
    report = graph.report("black_box: black box")
    assert report.level == 0 and report.values["newest recording"].endswith("_mode_silent.bag")


def test_whole_car_s_black_box_tells_bag_report_why_it_stopped(car, folder):
    graph = car.whole("speed").graph
    black_box(graph, folder)
    graph.hold("/av_turnrad_req", Float32(2.0), 20, sender="/planner")
    graph.hold("/av_speed_req", Float32(1.0), 20, sender="/planner")
    graph.run(2.5)
    car.pad(autonomous=True)
    graph.run_until(lambda: car.speed_mps > 0.9)
    car.pad()  # a hand stops it
    graph.run(6.0)
    assert names(folder) == []
    car.pad(autonomous=True)
    graph.run_until(lambda: car.speed_mps > 0.9)
    graph.nodes["/teensy_sensor_hub"].kill()
    graph.run(6.5)
    assert names(folder) == ["odometry_silent.bag"]
    drive = summarize(str(next(folder.iterdir())))
    assert [stop.cause for stop in drive.throttle.losses()] == [causes.ODOMETRY_STALE]
