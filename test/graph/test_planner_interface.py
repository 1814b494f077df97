"""planner_interface by its messages, with the shipped parameters: one source at a time. The wheelbase is 0.324 m."""
from __future__ import annotations

import math
from typing import Any

import pytest
from car_interface.msg import PlannerState, SteeringState, ThrottleState
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import Twist, TwistStamped
from std_msgs.msg import Bool, Float32, UInt8

from car import AUTOWARE, CONTROL, GEAR, Car
from car_interface.common import causes
from car_interface.nodes.planner_interface.ackermann_messages import ackermann_drive_class
from car_interface.ros.inbox import INBOX_LIMIT
from graph import NS_PER_S, Graph
from inputs import control, odometry

NAN, INF = math.nan, math.inf
HALF = math.atan(0.5)  # a radius of two wheelbases
RADIUS = pytest.approx(0.648)
TOPICS = {"drive": "/drive", "cmd_vel": "/cmd_vel", "autoware": AUTOWARE, "speed": "/av_speed_req"}
RADII, CONTROLS, STATES = "/av_turnrad_req", CONTROL, "/planner_interface/state"
Drive = ackermann_drive_class()


def drive(angle=0.0, speed=0.0, stamp=None):
    message = Drive()
    message.drive.steering_angle, message.drive.speed = angle, speed
    if stamp is not None:
        message.header.stamp = stamp
    return message


def twist(linear=0.0, angular=0.0):
    message = Twist()
    message.linear.x, message.angular.z = linear, angular
    return message


class Interface:
    """The node for one source, with a planner at 20 Hz and odometry at 50 Hz. The car stands."""

    def __init__(self, source: str, **parameters: Any):
        self.graph = graph = Graph()
        self.topic = TOPICS[source]
        graph.record(RADII, CONTROLS, STATES, "/diagnostics")
        self.node = Car(graph).planner_interface(source, **parameters)
        self.speed_mps = 0.0
        self.end_odometry = graph.repeat("/odom", lambda: odometry(self.speed_mps), 50, sender="/hub")
        self.end_planner = lambda: None
        graph.run(0.101)  # at no tick of the node

    def ask(self, message: Any, rate_hz: float = 20) -> PlannerState:
        """Send a command from now on; return the state after 0.2 s."""
        self.end_planner()
        self.end_planner = self.graph.repeat(self.topic, message, rate_hz, sender="/planner")
        self.graph.run(0.2)
        return self.state

    def hold(self, topic: str, message: Any) -> None:
        self.graph.repeat(topic, message, 20, sender="/others")
        self.graph.run(0.2)

    @property
    def state(self) -> PlannerState:
        return self.graph.newest(STATES)

    @property
    def radius(self) -> float:
        return self.graph.newest(RADII).data

    @property
    def acceleration(self) -> float:
        return self.graph.newest(CONTROLS).longitudinal.acceleration

    def diagnosis(self, name: str) -> DiagnosticStatus:
        """Run for 1.5 s; return the newest status of that name."""
        self.graph.run(1.5)
        return [status for array in self.graph.messages("/diagnostics") for status in array.status
                if status.name == f"planner_interface: {name}"][-1]


def test_ackermann_class_has_the_md5_of_its_package():
    assert (Drive._type, Drive._md5sum) == ("ackermann_msgs/AckermannDriveStamped", "1fd5d7f58889cefd44d29f6653240d0c")


@pytest.mark.parametrize("angle, radius", [(HALF, 0.648), (-HALF, -0.648), (0.0, INF)])
def test_drive_becomes_a_radius_and_an_acceleration_50_times_and_a_state_10_times_a_second(angle, radius):
    car = Interface("drive")
    state = car.ask(drive(angle, 1.0))
    assert (state.source, state.cause, state.gear, state.speed) == ("drive", "planner", "drive", 1.0)
    assert state.turn_radius == pytest.approx(radius)
    begun_ns = car.graph.now_ns
    car.graph.run(1.0)
    assert car.radius == pytest.approx(radius)
    counts = [len(car.graph.messages(topic, begun_ns + 1)) for topic in (RADII, CONTROLS, STATES)]
    assert counts == [50, 50, 10]
    command = car.graph.newest(CONTROLS)
    assert command.lateral.steering_tire_angle == pytest.approx(angle)
    assert command.longitudinal.velocity == pytest.approx(1.0)
    assert 1.0 < command.longitudinal.acceleration <= 2.0 and command.longitudinal.is_defined_acceleration
    stamps = {command.stamp, command.control_time, command.lateral.stamp, command.longitudinal.stamp}
    assert [stamp.to_nsec() for stamp in stamps] == [car.graph.recorded[CONTROLS][-1].at_ns + car.graph.ros_ahead_ns]


def test_new_angle_leaves_at_once_and_a_repeated_one_with_the_timer():
    car = Interface("drive")
    car.ask(drive(HALF, 1.0))
    car.graph.run(0.0123)
    at_ns = car.graph.now_ns
    car.graph.publish("/drive", drive(-HALF, 1.0), "/planner")
    car.graph.publish("/drive", drive(-HALF, 1.0), "/planner")
    car.graph.run(0.001)
    assert [message.data for message in car.graph.messages(RADII, at_ns)] == [pytest.approx(-0.648)]


@pytest.mark.parametrize("speed, brake, phase_s", [(1.0, -3.0, 0.0), (-1.0, 3.0, 0.0033), (1.0, -3.0, 0.01),
                                                   (-1.0, 3.0, 0.0199999)])
def test_silence_is_a_radius_of_0_and_a_full_brake_at_its_timeout_and_then_nothing(speed, brake, phase_s):
    car = Interface("drive")
    graph = car.graph
    graph.link("/drive", delay_s=0.02)
    graph.run(phase_s)
    car.ask(drive(HALF, speed))
    car.end_planner()
    last_ns = graph.now_ns
    graph.publish("/drive", drive(HALF, speed), "/planner")
    graph.run(0.019)
    arrived_ns = last_ns + 20_000_000
    graph.run(2.0)
    due_ns = arrived_ns + NS_PER_S // 2 + 1
    state = graph.messages(STATES, due_ns)[0]
    assert (state.cause, state.reason, state.turn_radius) == (causes.PLANNER_STALE, "drive silent for 0.50 s", 0.0)
    (at_ns,) = [record.at_ns for record in graph.recorded[STATES] if record.message == state]
    assert 0 <= at_ns - due_ns <= 1000  # ns
    for topic, value in ((RADII, 0.0), (CONTROLS, brake)):
        before, (last,) = ([each for each in graph.recorded[topic] if arrived_ns < each.at_ns < due_ns],
                           [each for each in graph.recorded[topic] if each.at_ns >= due_ns])
        found = last.message.data if topic == RADII else last.message.longitudinal.acceleration
        assert len(before) in (24, 25) and (last.at_ns, found) == (at_ns, value)
    assert len(graph.messages(STATES, at_ns + 1)) == 15 and car.state.source_age > 1.4
    assert len(graph.lines("/planner_interface", due_ns)) == 1
    assert car.ask(drive(HALF, speed)).cause == "planner"


@pytest.mark.parametrize("message, cause, reason", [
    (drive(NAN, 1.0), causes.REQUEST_NOT_FINITE, "drive: drive.steering_angle is nan, no number to act on"),
    (drive(0.1, INF), causes.REQUEST_NOT_FINITE, "drive: drive.speed is inf, no number to act on"),
    (drive(20.0, 1.0), causes.REQUEST_REFUSED, (
        "drive: drive.steering_angle of 20 rad (degrees?): no wheel turns so far; refused until it was sane for 2 s")),
])
def test_what_cannot_be_obeyed_stops_at_once_and_says_why(message, cause, reason):
    car = Interface("drive")
    car.ask(drive(HALF, 1.0))
    car.end_planner()
    car.graph.run(0.007)
    at_ns = car.graph.now_ns
    car.graph.publish("/drive", message, "/planner")
    car.graph.run(0.001)
    (radius,), (brake,), (state,) = (car.graph.messages(topic, at_ns) for topic in (RADII, CONTROLS, STATES))
    assert (radius.data, brake.longitudinal.velocity, brake.longitudinal.acceleration) == (0.0, 0.0, -3.0)
    assert (state.cause, state.reason, state.turn_radius, state.speed) == (cause, reason, 0.0, 0.0)
    assert (state.acceleration, state.reference_speed, state.refused) == (0.0, 0.0, 1)
    car.graph.run(0.4)
    assert len(car.graph.messages(RADII, at_ns)) == 1
    assert car.graph.lines("/planner_interface", at_ns, level=30) == [reason]


def test_without_odometry_the_steering_goes_on_and_the_state_is_a_stop_at_its_timeout():
    car = Interface("drive")
    car.ask(drive(HALF, 1.0))
    car.end_odometry()
    last_ns = car.graph.now_ns
    stopped_ns = car.graph.run_until(lambda: car.state.cause == causes.ODOMETRY_STALE, 1.0)
    assert 0.48e9 <= stopped_ns - last_ns <= 0.52e9
    assert car.state.reason.startswith("drive asks for 1.00 m/s, a radius of 0.65 m; odometry silent for 0.5")
    assert (car.acceleration, car.radius, car.state.gear) == (-3.0, RADIUS, "drive")
    car.graph.run(0.2)
    assert car.state.odometry_age > 0.6 and car.radius == RADIUS


@pytest.mark.parametrize("source, message", [("drive", drive(HALF, 1.0)),
                                             ("cmd_vel", TwistStamped(twist=twist(1.0, 1 / 0.648))),
                                             ("autoware", control(0.5, HALF, 1.0))])
def test_odd_stamp_is_told_and_obeyed(source, message):
    car = Interface(source)
    stamp = car.node.inbox.clocks.ros_now()
    stamp.secs += 1000
    getattr(message, "header", message).stamp = stamp
    car.graph.publish(GEAR, UInt8(2))
    state = car.ask(message)
    assert (state.cause, state.turn_radius) == ("planner", RADIUS)
    name = "control_cmd" if source == "autoware" else source
    assert (f"the stamp of {name} is 1000 s in the future; it's obeyed all the same"
            in car.graph.lines("/planner_interface", level=30)[0])
    keys = {value.key: value.value for value in car.diagnosis("planner").values}
    assert int(keys[f"{name} stamp"]) > 20  # each message counts


def test_other_sources_are_counted_and_named_and_not_obeyed():
    car = Interface("drive")
    for _ in range(3):
        car.graph.publish("/cmd_vel", twist(2.0), "/move_base")
    car.graph.run(0.2)
    assert (car.state.cause, car.state.reason) == (
        causes.NO_REQUEST, "drive was never heard; not obeyed: cmd_vel: 3 messages, the last from /move_base")
    car.graph.publish("/av_speed_req", Float32(2.0), "/network")
    state = car.ask(drive(HALF, 1.0))
    assert state.others == "cmd_vel: 3 messages, the last from /move_base; speed: 1 message, the last from /network"
    assert (state.speed, state.turn_radius) == (1.0, RADIUS)
    keys = {value.key: value.value for value in car.diagnosis("planner").values}
    assert keys["not obeyed"] == state.others


def test_turn_that_is_too_tight_for_turn_arb_is_told_and_stays_on_diagnostics_for_a_while():
    car = Interface("drive")
    state = SteeringState(limit=causes.TOO_TIGHT, limit_reason="a radius of 0.50 m is tighter than the wheels turn")
    car.hold("/turn_arb/state", lambda: state)
    assert car.ask(drive(HALF, 1.0)).reason.endswith(f"a radius of 0.65 m; {state.limit_reason}")
    status = car.diagnosis("planner")
    assert (status.level, status.message) == (DiagnosticStatus.WARN, car.state.reason)
    reason, state.limit = state.limit_reason, ""
    car.graph.run(0.2)
    assert car.state.reason == "drive asks for 1.00 m/s, a radius of 0.65 m"
    status = car.diagnosis("planner")
    assert (status.level, status.message) == (DiagnosticStatus.WARN, f"{car.state.reason}; {reason}")
    assert any(value.key == "remedy" and value.value for value in status.values)
    car.graph.run(60.0)
    assert car.diagnosis("planner").level == DiagnosticStatus.OK


def test_what_turn_arb_said_of_a_turn_counts_for_half_a_second():
    car = Interface("drive")
    car.ask(drive(HALF, 1.0))
    said = SteeringState(limit=causes.TOO_TIGHT, limit_reason="too tight")
    end = car.graph.repeat("/turn_arb/state", said, 20)
    car.graph.run(0.42)
    end()
    for run_s, is_told in ((0.45, True), (0.15, False)):
        car.graph.run(run_s)
        assert car.state.reason.endswith("; too tight") == is_told


def test_while_a_human_drives_it_begins_anew_at_the_measured_speed():
    car = Interface("drive")
    state = ThrottleState(source=ThrottleState.TELEOP, asked=1.0, granted=1.0)
    car.hold("/throttle_arb/state", lambda: state)
    car.speed_mps = 1.5
    assert car.ask(drive(0.0, 0.5)).reference_speed == pytest.approx(1.5, abs=0.06)
    state.source = ThrottleState.PLANNER
    car.graph.run(2.0)
    assert car.state.reference_speed == pytest.approx(0.5)


def test_car_that_shall_turn_on_the_spot_is_refused_and_warned_of_until_it_asks_for_something_else():
    car = Interface("cmd_vel")
    state = car.ask(twist(0.0, 0.5))
    assert (state.cause, state.reason) == (
        causes.REQUEST_REFUSED, "cmd_vel: angular.z is 0.5 rad/s at linear.x 0 m/s: a car can't turn on the spot")
    status = car.diagnosis("planner")
    assert (status.level, status.message) == (DiagnosticStatus.WARN, state.reason)
    car.ask(twist(1.0, 0.5))
    assert car.diagnosis("planner").level == DiagnosticStatus.OK
    car.ask(twist())
    assert car.state.reason == "cmd_vel asks for 0.00 m/s, a radius of 2.00 m"  # the arc that it stops on


def test_second_publisher_and_one_of_another_type_are_named():
    car = Interface("cmd_vel")
    car.ask(twist(1.0, 0.5))
    car.graph.publish("/cmd_vel", TwistStamped(), "/second")  # a type that it takes
    assert car.diagnosis("command topics").message.startswith(
        "2 nodes publish on /cmd_vel, /planner on 127.0.0.1 and /second on 127.0.0.1: ")
    car = Interface("cmd_vel")
    assert car.ask(Bool(True)).cause == causes.NO_REQUEST
    assert car.diagnosis("command topics").level == DiagnosticStatus.ERROR
    car = Interface("drive")  # the others may have any number
    for sender in ("/one", "/two"):
        car.graph.repeat("/cmd_vel", twist(), 20, sender)
    assert car.diagnosis("command topics").level == DiagnosticStatus.OK


def test_gear_of_autoware_says_which_way_and_its_acceleration_is_the_gear_s():
    car = Interface("autoware")
    number = UInt8(2)
    car.hold(GEAR, lambda: number)
    assert car.ask(control(0.5, HALF, 1.0)).reason == "autoware asks for 1.00 m/s, a radius of 0.65 m, gear DRIVE"
    assert car.acceleration > 0.1
    number.data = 20
    assert car.ask(control(0.5, HALF, 1.0)).reason == "autoware: longitudinal.velocity is 1 m/s in gear REVERSE"
    state = car.ask(control(0.5, HALF, -1.0))
    assert (state.reason, state.gear) == ("autoware asks for -1.00 m/s, a radius of 0.65 m, gear REVERSE", "reverse")
    assert car.acceleration < -0.1


def test_speed_alone_leaves_the_steering_to_others():
    car = Interface("speed")
    state = car.ask(Float32(1.0))
    assert (state.reason, state.turn_radius, state.cause) == ("speed asks for 1.00 m/s", 0.0, "planner")
    assert car.acceleration > 0.5
    assert RADII not in {topic for topic, publishers in car.graph.publishers.items() if publishers}
    assert car.ask(Float32(NAN)).reason == "speed: av_speed_req is nan, no number to act on"


def test_what_a_planner_sent_while_the_node_was_frozen_is_not_obeyed_later():
    car = Interface("drive")
    car.ask(drive(HALF, 1.0))
    car.node.stall(1.0, frozen=True)
    car.graph.run(0.9)
    car.end_planner()  # it dies before the node wakes
    at_ns = car.graph.now_ns
    car.graph.run(2.0)
    assert {state.cause for state in car.graph.messages(STATES, at_ns)} == {causes.PLANNER_STALE}
    assert car.state.source_age > 2.8
    (line,) = [line for line in car.graph.lines("/planner_interface", at_ns) if "stood still" in line]
    assert line.endswith("what was sent meanwhile is dropped; what is sent from now on counts")
    assert car.ask(drive(HALF, 1.0)).cause == "planner"


def test_overflow_is_a_loss_of_everything_until_the_next_messages():
    car = Interface("drive")
    car.ask(drive(HALF, 1.0))
    at_ns = car.graph.now_ns
    car.graph.flood("/cmd_vel", twist(), INBOX_LIMIT + 1)  # which wakes nobody
    car.graph.run(0.021)
    state = car.graph.messages(STATES, at_ns)[0]
    assert state.cause == causes.PLANNER_STALE
    assert next(message.data for message in car.graph.messages(RADII, at_ns)) == 0.0
    car.graph.run(0.2)
    assert car.state.cause == "planner"


def test_end_of_the_node_is_a_stop_in_its_state():
    car = Interface("drive")
    car.ask(drive(HALF, 1.0))
    at_ns = car.graph.now_ns
    car.node.end()
    (radius,), (brake,), (state,) = (car.graph.messages(topic, at_ns) for topic in (RADII, CONTROLS, STATES))
    assert (radius.data, brake.longitudinal.acceleration) == (0.0, -3.0)
    assert (state.cause, state.reason, state.turn_radius) == (causes.NO_REQUEST, "planner_interface has ended", 0.0)
