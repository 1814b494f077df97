"""Whether the car would obey, by what its arbiters say."""
from collections import namedtuple
from types import SimpleNamespace

import pytest

from car_interface.common import causes
from car_interface.common.sources import LOCKED, NEUTRAL, NO_HUMAN, PLANNER, TELEOP
from car_interface.common.units import NS_PER_S
from car_interface.tools.calibration.drive.grant import Grant

# Fields of SteeringState and ThrottleState.
Steering = namedtuple("Steering", "source cause reason")
Throttle = namedtuple("Throttle", (*Steering._fields, "mode", "esc", "esc_reason"))
IDLE_STEERING = Steering(NEUTRAL, causes.NO_REQUEST, "nothing asks")
IDLE_THROTTLE = Throttle(NEUTRAL, causes.NO_REQUEST, "nothing asks", "autonomous", "NEUTRAL", "neutral is asked for")


def decided(steering=IDLE_STEERING, throttle=IDLE_THROTTLE, planner="speed", after_s=0.0):
    grant = Grant()
    grant.update("turn_arb", steering, 0)
    grant.update("throttle_arb", throttle, 0)
    grant.update("planner_interface", SimpleNamespace(source=planner), 0)
    return grant.trouble(round(after_s * NS_PER_S))


@pytest.mark.parametrize("steering", [
    IDLE_STEERING, Steering(NEUTRAL, causes.PLANNER_STALE, "silent"), Steering(PLANNER, causes.PLANNER, "it steers"),
    Steering(NEUTRAL, causes.NO_RADIUS, "0")])
@pytest.mark.parametrize("throttle", [
    IDLE_THROTTLE, IDLE_THROTTLE._replace(cause=causes.PLANNER_STALE),
    IDLE_THROTTLE._replace(cause=causes.COMMAND_STALE),
    IDLE_THROTTLE._replace(source=PLANNER, cause=causes.PLANNER), IDLE_THROTTLE._replace(mode="")])
def test_held_autonomous_deadman_grants_whether_or_not_something_is_asked_for(steering, throttle):
    assert decided(steering, throttle) == ""


@pytest.mark.parametrize(("steering", "throttle", "reason"), [
    (Steering(NO_HUMAN, causes.HUMAN_ABSENT, "human_in_loop is false: no deadman is held"), IDLE_THROTTLE,
     "no deadman is held"),
    (Steering(LOCKED, causes.E_STOP, "e_stop is on"), IDLE_THROTTLE, "e_stop is on"),
    (Steering(TELEOP, causes.TELEOP, "tele_steer_req is 0.002"), IDLE_THROTTLE,
     "the gamepad steers (tele_steer_req is 0.002)"),
    (Steering(NEUTRAL, causes.TELEOP_STALE, "tele_steer_req silent"), IDLE_THROTTLE, "tele_steer_req silent"),
    (Steering(NEUTRAL, causes.TWO_REQUESTS, "both are published"), IDLE_THROTTLE, "both are published"),
    (IDLE_STEERING, IDLE_THROTTLE._replace(source=NO_HUMAN, reason="not re-armed"), "not re-armed"),
    (IDLE_STEERING, IDLE_THROTTLE._replace(source=LOCKED, reason="e_stop silent"), "e_stop silent"),
    (IDLE_STEERING, IDLE_THROTTLE._replace(source=TELEOP, reason="tele_throt_req is 0.3"),
     "the gamepad drives (tele_throt_req is 0.3)"),
    (IDLE_STEERING, IDLE_THROTTLE._replace(mode="human_throttle"),
     "the deadman that is held is the one for human_throttle, not the autonomous one"),
    (IDLE_STEERING, IDLE_THROTTLE._replace(esc="ARMING", esc_reason="arming for 0.4 s more"), "arming for 0.4 s more"),
    (IDLE_STEERING, IDLE_THROTTLE._replace(cause=causes.ODOMETRY_STALE, reason="odometry silent for 0.7 s"),
     "odometry silent for 0.7 s"),
    (IDLE_STEERING, IDLE_THROTTLE._replace(cause=causes.STEERING_STALE, reason="turn_arb's state silent"),
     "turn_arb's state silent"),
])
def test_anything_else_refuses_in_the_arbiters_own_words(steering, throttle, reason):
    assert decided(steering, throttle) == reason


@pytest.mark.parametrize(("steering", "throttle", "is_slowed"), [
    (NEUTRAL, NEUTRAL, False), (PLANNER, PLANNER, False), (NO_HUMAN, NO_HUMAN, False), (TELEOP, NEUTRAL, True),
    (NEUTRAL, TELEOP, True)])
def test_car_that_a_person_drives_with_the_manual_deadman_does_not_stop_by_itself(steering, throttle, is_slowed):
    grant = Grant()
    assert not grant.is_slowed
    grant.update("turn_arb", IDLE_STEERING._replace(source=steering), 0)
    assert grant.is_slowed is (steering == TELEOP)
    grant.update("throttle_arb", IDLE_THROTTLE._replace(source=throttle), 0)
    assert grant.is_slowed is is_slowed


@pytest.mark.parametrize(("esc", "is_slowed"), [("NEUTRAL", False), ("FORWARD", False), ("BRAKING", True),
                                                ("HOLD", True), ("REVERSE", True)])
def test_car_whose_esc_brakes_does_not_stop_by_itself(esc, is_slowed):
    grant = Grant()
    grant.update("throttle_arb", IDLE_THROTTLE._replace(source=NO_HUMAN, esc=esc), 0)
    assert grant.is_slowed is is_slowed


def test_state_that_was_never_heard_or_is_old_or_of_another_source_refuses():
    assert decided(planner="drive") == "planner_interface obeys drive"
    grant = Grant()
    assert grant.trouble(0) == "turn_arb's state was never heard"
    grant.update("turn_arb", IDLE_STEERING, 0)
    assert grant.trouble(0) == "throttle_arb's state was never heard"
    grant.update("throttle_arb", IDLE_THROTTLE, 0)
    assert grant.trouble(0) == "planner_interface's state was never heard"
    assert decided(after_s=0.5) == ""
    assert decided(after_s=0.51) == "turn_arb's state silent for 0.51 s"


def test_other_program_that_asks_refuses_for_a_second():
    grant = Grant()
    for now_ns in (0, NS_PER_S, 3 * NS_PER_S):
        grant.update("turn_arb", IDLE_STEERING, now_ns)
        grant.update("throttle_arb", IDLE_THROTTLE, now_ns)
        grant.update("planner_interface", SimpleNamespace(source="speed"), now_ns)
        if not now_ns:
            grant.update_other("/av_turnrad_req", "/my_planner", now_ns)
        reason = "/my_planner publishes /av_turnrad_req, too: end it" if now_ns <= NS_PER_S else ""
        assert grant.trouble(now_ns) == reason
        assert grant.others(now_ns) == ([reason] if reason else [])


@pytest.mark.parametrize(("steering", "granted"), [
    (Steering(TELEOP, causes.TELEOP, "tele_steer_req is 0.2"), ""),
    (Steering(NO_HUMAN, causes.HUMAN_ABSENT, "human_in_loop is false: no deadman is held"),
     "no deadman is held"),
    (Steering(NO_HUMAN, causes.HUMAN_ABSENT, "human_in_loop is false"), "human_in_loop is false"),
    (Steering(LOCKED, causes.E_STOP, "e_stop is on"), "e_stop is on"),
    (Steering(PLANNER, causes.PLANNER, "av_steer_req is 0.2"), "av_steer_req is 0.2")])
def test_person_s_stick_is_granted_by_turn_arb_alone(steering, granted):
    grant = Grant(by_stick=True)
    assert grant.trouble(0) == "turn_arb's state was never heard"
    grant.update("turn_arb", steering, 0)
    assert grant.trouble(0) == granted
    assert grant.trouble(NS_PER_S) == "turn_arb's state silent for 1.00 s"


def ready(by_stick, steering=IDLE_STEERING, throttle=IDLE_THROTTLE, planner="speed", calibrates_esc=False, sonars=(),
          other=None, **seen):
    """What a car that has all of it gave, but for what is named."""
    grant = Grant(by_stick, calibrates_esc, sonars)
    for name, state in (("turn_arb", steering), ("throttle_arb", throttle),
                        ("planner_interface", planner and SimpleNamespace(source=planner)),
                        ("teleop_logi", SimpleNamespace(cause=causes.NO_DEADMAN, reason="none is held"))):
        if state is not None:
            grant.update(name, state, 0)
    if other is not None:
        grant.update_other("/av_turnrad_req", other, 0)
    for name, value in {"has_odom": True, "duty": 5100, **seen}.items():
        setattr(grant, name, value)
    return grant


@pytest.mark.parametrize("by_stick", [False, True])
def test_car_that_has_all_of_it_is_ready(by_stick):
    assert [*ready(by_stick).missing(0), *ready(by_stick).missing_gamepad()] == []


@pytest.mark.parametrize(("lacks", "sentence", "by_stick"), [
    ({"steering": None}, "turn_arb isn't heard: is the car launched, and in this namespace? roslaunch", True),
    ({"duty": None}, "/servo/output isn't heard: is pca9685 running?", True),
    ({"duty": 0}, "the servo board gives no pulse on the steering's channel: rosrun car_interface doctor", True),
    ({"duty": -1}, "the servo board gives no pulse on the steering's channel", True),
    ({"has_odom": False}, "there is no odometry on odom: is teensy_sensor_hub running, and the", True),
    ({"throttle": None}, "throttle_arb isn't heard, which drives the ESC: launch with throttle:=true", False),
    ({"calibrates_esc": True}, "throttle_arb was launched with calibration_drive:=true, which is for", False),
    ({"planner": None}, "planner_interface isn't heard: launch with planner:=speed", False),
    ({"planner": "drive"}, "planner_interface obeys drive, not speeds: launch with planner:=speed", False),
    ({"sonars": ("front_left", "rear_left")}, "no range of the sonars front_left, rear_left is heard: a sonar", False),
    ({"other": "/other"}, "/other publishes /av_turnrad_req, too: end it", False),
])
def test_what_a_program_that_drives_needs_and_what_a_person_with_the_stick_does_too(lacks, sentence, by_stick):
    assert [said.startswith(sentence) for said in ready(False, **lacks).missing(0)] == [True]
    assert [said.startswith(sentence) for said in ready(True, **lacks).missing(0)] == [True] * by_stick
