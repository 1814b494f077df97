"""car_sim: the hub against the virtual Teensy, which answers as the firmware does, and the car that it moves."""
import math
from functools import partial
from types import SimpleNamespace

import pytest
from car_interface.msg import LinkStatus
from car_interface.srv import SetSonarSequenceRequest, SetSonarWaitRequest
from std_msgs.msg import Int32MultiArray
from std_srvs.srv import TriggerRequest

from car import Pins
from car_interface.common.vehicle_geometry import SONARS as SONAR_NAMES
from car_interface.nodes.car_sim.node import RETRY_NS, CarSim, ChipFollower, room_markers
from car_interface.nodes.pca9685.virtual_board import chip_path
from car_interface.sim.world import Box, Post, WorldConfig

LINK, PONGS, SONARS = "/teensy_sensor_hub/link", "/teensy_pong", "/teensy_distance"
CENTER, LEFT, GENTLE, FAST, NEUTRAL = 5100, 3835, 5700, 6500, 4915
ALL = set(range(6))


class Simulated:
    """A virtual car without a servo board, and a hub."""

    def __init__(self, car, hub=None, **sim):
        self.graph, self.car = car.graph, car
        self.graph.record(LINK, PONGS, SONARS, "/car_sim/collisions", "/car_sim/rollovers")
        self.sim = car.sim(follows_board=False, **sim)
        car.hub(**(hub or {}))

    def call(self, name, request=None):
        answer = self.graph.call(f"/teensy_sensor_hub/{name}", request or TriggerRequest())
        assert answer.success, answer.message

    def drive(self, esc, steering=CENTER):
        self.graph.publish("/servo/output", Int32MultiArray(data=[steering, esc] + 14 * [-1]))

    def sonars(self, duration_s=2.0):
        since_ns = self.graph.now_ns
        self.graph.run(duration_s)
        return [report.sensor for report in self.graph.messages(SONARS, since_ns)]

    @property
    def link(self):
        return self.graph.newest(LINK)


def test_room_is_drawn_where_the_sonars_see_it(car):
    car.graph.record("/car_sim/room")
    simulated = Simulated(car, start=[-5.0, 0.0, math.pi])
    (walls,) = car.graph.messages("/car_sim/room")
    first = min((marker for marker in walls.markers if marker.scale.x < 0.1), key=lambda marker: marker.pose.position.x)
    simulated.sonars()
    echo_m = min(report.distance for report in car.graph.messages(SONARS) if report.sensor == 1) * 343.4e-6 / 2
    assert -5.0 - 0.42 - echo_m == pytest.approx(first.pose.position.x, abs=0.02)  # its front sonar is 0.42 m ahead
    assert {marker.header.frame_id for marker in walls.markers} == {"odom"} and len(walls.markers) == 4 + 2 + 7


def test_who_comes_later_gets_the_room_and_the_counts_too(car):
    Simulated(car)
    for name in ("room", "collisions", "rollovers"):
        (publisher,) = car.graph.publishers[f"/car_sim/{name}"]
        assert publisher.latch


@pytest.mark.parametrize("steering", [{}, {"steering_duties": [4000, 5000, 6000], "steering_curvatures": [1, 0, -1]}])
def test_steering_of_another_car_is_told(car, steering):
    Simulated(car, **steering)
    assert any("is another one than turn_arb's file says, on purpose" in line
               for line in car.graph.lines("/car_sim")) == bool(steering)


@pytest.mark.parametrize("given, path", [({}, chip_path("/pca9685")), ({"virtual_chip": "/a/chip"}, "/a/chip")])
def test_servo_board_is_the_one_of_this_namespace_unless_a_parameter_says_another(car, given, path):
    paths = []

    def make_chip(path, inbox):
        paths.append(path)
        return Pins(None)
    line = SimpleNamespace(step=lambda now_ns: None, close=lambda: None)
    car.graph.add(partial(CarSim, make_chip=make_chip, make_line=lambda *_: line), "car_sim", given)
    assert paths == [path]


def test_walls_are_drawn_low_from_corner_to_corner_and_things_high_where_they_stand():
    room = WorldConfig(walls=Box(1.0, 2.0, 4.0, 8.0), boxes=(), posts=(Post(0.5, 0.7, 0.1),))
    drawn = [(each.pose.position, each.scale) for each in room_markers(room, "odom").markers]
    assert [(at.x, at.y, at.z, size.x, size.y, size.z) for at, size in drawn] == [pytest.approx(each) for each in (
        (1.0, -2.0, 0.06, 4.0, 0.04, 0.12), (1.0, 6.0, 0.06, 4.0, 0.04, 0.12), (-1.0, 2.0, 0.06, 0.04, 8.0, 0.12),
        (3.0, 2.0, 0.06, 0.04, 8.0, 0.12), (0.5, 0.7, 0.125, 0.2, 0.2, 0.25))]


def test_a_virtual_servo_board_is_looked_for_again_after_a_pause_and_not_while_it_is_there(tmp_path):
    follower, opened, is_there = ChipFollower(str(tmp_path / "none"), SimpleNamespace(watch={}.__setitem__)), [], []

    def open_link():
        opened.append(True)
        if not is_there:
            raise OSError("no such file")
    follower._link = SimpleNamespace(open=open_link, observe=lambda: 5, changes=list, close=dict)
    for now_ns, count in ((0, 1), (RETRY_NS - 1, 1), (RETRY_NS, 2)):
        follower.step(now_ns)
        assert len(opened) == count
    is_there.append(True)
    for periods in (2, 3, 4):
        follower.step(periods * RETRY_NS)
    assert len(opened) == 3


def test_sonars_fire_as_they_are_commanded_without_one_that_is_missing(car):
    simulated = Simulated(car)
    assert set(simulated.sonars()) == ALL
    for fault, firing in (("sonar_missing", ALL - {3}), ("sonar_fine", ALL)):
        car.inject(fault, 3)
        simulated.sonars(0.2)
        assert set(simulated.sonars()) == firing
    simulated.call("set_sonar_sequence", SetSonarSequenceRequest([0, 1, 5]))
    simulated.sonars(0.2)
    assert set(simulated.sonars()) == {0, 1, 5}
    simulated.call("sonar_stop")
    simulated.sonars(0.2)
    assert simulated.sonars(10) == []  # the hub knows that they were stopped
    simulated.call("sonar_start")
    assert set(simulated.sonars()) == {0, 1, 5}
    simulated.call("set_sonar_wait", SetSonarWaitRequest(400))
    simulated.sonars(0.5)
    since_ns = car.graph.now_ns
    assert len(simulated.sonars(4.0)) >= 8
    times_ms = [report.when for report in car.graph.messages(SONARS, since_ns)]
    assert all(400 <= after - before < 450 for before, after in zip(times_ms, times_ms[1:]))


def test_stuck_sonar_that_silences_all_others_is_named_and_left_out_and_they_report_again(car):
    """A Teensy that has run for long waits for such a sonar for ever."""
    simulated = Simulated(car, clock_start_ms=200_000)
    assert set(simulated.sonars()) == ALL
    car.inject("sonar_stuck", 2)
    car.graph.run_until(lambda: "front_left" in simulated.link.words, 10.0)
    link = simulated.link
    assert (link.state, link.level) == ("sonar fault", LinkStatus.WARN) and "Check its echo wire" in link.next_step
    car.graph.run_until(lambda: simulated.link.dropped_sonars, 6.0)
    assert list(simulated.link.dropped_sonars) == [2] and simulated.link.sonar_starts == 2
    simulated.sonars(3.5)  # after three more seconds of silence they are started again
    assert set(simulated.sonars()) == ALL - {2}
    assert [line for line in car.graph.lines("/teensy_sensor_hub", level=30) if "front_left" in line]


def test_pin_that_blinks_and_a_clone_make_no_false_range_and_are_told(car):
    simulated = Simulated(car, hub={"max_range": 4.0}, clock_start_ms=20_000)
    topics = [f"/sonar/{name}" for name in SONAR_NAMES]
    car.graph.record(*topics)
    simulated.sonars()
    true_m = {topic: {round(message.range, 1) for message in car.graph.messages(topic)} for topic in topics}
    assert true_m["/sonar/front_middle"] == {math.inf}
    for fault, sensor in (("sonar_blink", 1), ("sonar_blink", 4), ("sonar_clone", 1), ("sonar_clone", 5)):
        car.inject(fault, sensor)
        simulated.sonars(5.0)
        if fault == "sonar_blink":
            assert f"{SONAR_NAMES[sensor]}'s echo pin was high for over a second" in simulated.link.words
    for topic in topics:
        assert {round(message.range, 1) for message in car.graph.messages(topic)} == true_m[topic]
    assert any("front_middle's echo pin was high for over a second" in line.text for line in car.graph.log)
    link = simulated.link
    assert (link.state, link.words) == (
        "sonar fault", "front_middle is a clone that holds its pulse for 200 ms without an echo: its ranges are right")
    assert "~no_echo_timeouts/front_middle to 200" in link.next_step


def test_hub_finds_out_that_the_receiver_was_repaired_and_the_clock_may_wrap(car):
    simulated = Simulated(car, corrected_checksum=True, clock_start_ms=4294965000)
    car.graph.run_until(lambda: car.graph.recorded[LINK] and simulated.link.pongs > 2, 5.0)
    assert simulated.link.firmware_checksum == "corrected"
    assert car.graph.lines("/teensy_sensor_hub", level=30)[-1] == (
        "no ping is answered: trying the checksum of a corrected firmware")
    car.graph.run(3.0)
    assert car.graph.newest(PONGS).timestamp2 < 10_000
    assert simulated.link.bad_frames + simulated.link.malformed_frames == 0


# --- the car ---

def test_car_follows_the_servo_output_and_truth_comes_fifty_times_a_second(car):
    simulated = Simulated(car, collisions=False)
    simulated.drive(GENTLE, LEFT)
    car.graph.run(3.0)
    assert len(car.graph.messages("/car_sim/truth")) == 150
    truth = car.truth()
    assert (truth.header.frame_id, truth.child_frame_id) == ("odom", "base_link")
    assert truth.twist.twist.linear.x > 0.5 and truth.twist.twist.angular.z > 0.3
    assert truth.pose.pose.orientation.z > 0.1
    simulated.graph.publish("/servo/output", Int32MultiArray(data=[0] * 15))
    car.graph.run(0.5)
    assert car.speed_mps > 0.5
    assert car.graph.lines("/car_sim", level=30) == ["/servo/output has 15 values, not 16: ignored"]


def test_car_that_would_have_tipped_over_counts_it(car):
    simulated = Simulated(car, collisions=False, rollover=2.0, grip=9.0)
    simulated.drive(FAST)
    car.graph.run(4.0)
    simulated.drive(FAST, LEFT)
    car.graph.run(1.0)
    assert car.graph.newest("/car_sim/rollovers").data >= 1
    assert car.graph.lines("/car_sim", level=30)[0].startswith("the car would have tipped over: ")


def test_simulator_that_stood_still_goes_on_from_now(car):
    simulated = Simulated(car, collisions=False)
    simulated.drive(GENTLE)
    car.graph.run(3.0)
    before = car.truth().pose.pose.position.x
    simulated.sim.stall(5.0)
    car.graph.run(5.1)
    assert car.truth().pose.pose.position.x - before < 0.2 * car.speed_mps + 0.05
