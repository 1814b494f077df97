"""The throttle as a whole: arbiter, the ESC's rules, and the duty. Time is passed in."""
from __future__ import annotations

import math

import pytest

from car_interface.interlock.motion_interlock import InterlockConfig
from car_interface.steering.arbiter import NEUTRAL, NO_HUMAN, PLANNER, TELEOP
from car_interface.throttle.arbiter import ArbiterConfig
from car_interface.throttle.calibration import ThrottleCalibration, trimmed
from car_interface.throttle.control import ThrottleControl
from car_interface.throttle.esc_config import (
    BRAKE_THEN_REVERSE,
    DIRECT_REVERSE,
    FORWARD_ONLY,
    PROFILES,
    UNVERIFIED,
    EscConfig,
)
from car_interface.throttle.stick import StickConfig

S = 1_000_000_000
TICK = S // 50
SHIPPED = ThrottleCalibration(channel=1, value_axis=[-5.0, 0.0, 3.0], duty_table=[3277, 4915, 6554], neutral=4915)
LINEAR = StickConfig(deadband=0.05, human_scale=0.3, brake_scale=1.0)
FULL_FORWARD, FULL_BRAKE, NEUTRAL_DUTY = 6554, 3277, 4915
BY_HAND, REVERSE_BY_HAND = 5407, 4424  # 0.3 of each side


class Rig:
    """A throttle whose inputs are repeated 50 times a second, with a board that holds what it is given."""

    def __init__(self, profile=UNVERIFIED, **esc):
        self.control = ThrottleControl(
            SHIPPED, ArbiterConfig(stick=LINEAR, interlock=InterlockConfig(grant_at_start=True)),
            EscConfig(profile=profile, **esc))
        self.now_ns = 1000 * S
        self.human, self.stick, self.value, self.speed = False, 0.0, None, 0.0
        self.decision = None
        self.duties = []
        self.run(1.5)  # arming
        self.human = True

    def run(self, seconds):
        arbiter = self.control.arbiter
        for _ in range(round(seconds * 50)):
            self.now_ns += TICK
            arbiter.update_human(self.human, self.now_ns)
            arbiter.update_steering(TELEOP, "", self.now_ns)
            arbiter.update_teleop(self.stick, self.now_ns)
            if self.value is not None:
                self.control.update_planner(self.value, self.now_ns)
            if self.speed is not None:
                self.control.update_odometry(self.speed, self.now_ns)
            self.decision = self.control.decide(self.now_ns)
            self.duties.append(self.decision.duty)
            self.control.update_output([-1, self.decision.duty, *[-1] * 14], self.now_ns + TICK // 10)
        return self.decision


def test_esc_is_armed_before_anything_else():
    rig = Rig()
    assert set(rig.duties) == {NEUTRAL_DUTY}
    assert rig.decision.esc.state_name == "NEUTRAL"


def test_human_drives_by_the_scale():
    rig = Rig()
    rig.stick = 1.0
    decision = rig.run(0.1)
    assert (decision.duty, decision.arbitration.source, decision.esc.state_name) == (BY_HAND, TELEOP, "FORWARD")


def test_planner_drives_by_the_duty_table():
    rig = Rig()
    rig.value = 1.5
    decision = rig.run(0.1)
    assert (decision.duty, decision.arbitration.source) == (5735, PLANNER)


def test_release_stops_at_once_without_a_brake_while_the_esc_is_unverified():
    rig = Rig()
    rig.stick, rig.speed = 1.0, 4.0
    rig.run(1.0)
    rig.human, rig.duties = False, []
    decision = rig.run(0.5)
    assert set(rig.duties) == {NEUTRAL_DUTY}
    assert (decision.arbitration.source, decision.arbitration.cause, decision.esc.state_name) == (
        NO_HUMAN, "human absent", "NEUTRAL")


def test_release_brakes_where_the_esc_is_known_to_brake():
    rig = Rig(BRAKE_THEN_REVERSE)
    rig.stick, rig.speed = 1.0, 4.0
    rig.run(1.0)
    rig.human = False
    decision = rig.run(0.02)
    assert (decision.duty, decision.esc.state_name) == (4096, "BRAKING")  # half of the brake


def test_human_brakes_by_brake_scale_and_reverses_by_human_scale():
    rig = Rig(BRAKE_THEN_REVERSE)
    rig.stick, rig.speed = 1.0, 4.0
    rig.run(1.0)
    rig.stick, rig.duties = -1.0, []
    assert rig.run(0.5).duty == FULL_BRAKE
    rig.speed = 0.0
    rig.run(2.0)
    rig.stick = 0.0
    rig.run(1.0)
    rig.stick, rig.duties = -1.0, []
    decision = rig.run(2.0)
    assert (decision.duty, decision.esc.state_name) == (REVERSE_BY_HAND, "REVERSE")
    assert min(rig.duties) == REVERSE_BY_HAND


@pytest.mark.parametrize("profile", [DIRECT_REVERSE, UNVERIFIED, BRAKE_THEN_REVERSE])
def test_reverse_never_gets_the_scale_of_the_brake_not_even_for_a_moment(profile):
    rig = Rig(profile)
    for stick, seconds in ((-1.0, 0.5), (0.0, 1.0), (-1.0, 0.5), (0.0, 0.2), (-1.0, 3.0)):
        rig.stick = stick
        rig.run(seconds)
    assert rig.decision.esc.state_name == "REVERSE"
    assert min(rig.duties) == REVERSE_BY_HAND


def test_forward_from_reverse_brakes_by_brake_scale_and_then_drives_by_human_scale():
    rig = Rig(DIRECT_REVERSE)
    for stick, seconds in ((-1.0, 0.5), (0.0, 1.0), (-1.0, 1.0)):
        rig.stick = stick
        rig.run(seconds)
    rig.speed = -2.0
    rig.run(1.0)
    assert rig.decision.esc.state_name == "REVERSE"
    rig.stick = 1.0
    decision = rig.run(0.2)
    assert (decision.duty, decision.esc.state_name) == (FULL_FORWARD, "BRAKING")
    rig.speed, rig.duties = 0.0, []
    decision = rig.run(0.2)
    assert (decision.duty, decision.esc.state_name) == (BY_HAND, "FORWARD")
    assert max(rig.duties) == BY_HAND


def test_calibration_drive_has_the_scale_of_driving_for_brakes_too_so_that_a_pull_stays_the_same_at_standstill():
    rig = Rig(calibration_drive=True)
    rig.stick, rig.speed = 1.0, 2.0
    rig.run(0.5)
    rig.stick, rig.duties = -1.0, []
    for rig.speed in (1.0, 0.0, -1.0):
        rig.run(0.8)
    rig.stick = 1.0
    assert (set(rig.duties), rig.run(0.1).duty) == ({REVERSE_BY_HAND}, BY_HAND)
    rig.human = False
    assert rig.run(0.1).duty == NEUTRAL_DUTY


def test_stick_that_reverse_s_scale_makes_too_small_drives_nothing():
    """0.2 of the stick brakes, but 0.3 of that is in the ESC's dead band; nor does the state change all the time."""
    rig = Rig(DIRECT_REVERSE)
    for stick, seconds in ((-0.2, 0.5), (0.0, 1.0), (-0.2, 1.0)):
        rig.stick = stick
        states = {rig.run(0.02).esc.state_name for _ in range(round(seconds * 50))}
        assert states == {"NEUTRAL"}
    assert set(rig.duties) == {NEUTRAL_DUTY}


def test_planner_s_brake_at_standstill_never_becomes_reverse():
    """Autoware holds a stopped car with −1.5 m/s²; the deadman is let go and held again meanwhile."""
    rig = Rig(BRAKE_THEN_REVERSE)
    rig.value, rig.speed = 1.0, 2.0
    rig.run(1.0)
    rig.value = -1.5
    rig.run(0.5)
    rig.speed = 0.0
    for _ in range(3):
        rig.human = True
        rig.run(2.0)
        assert rig.decision.esc.state_name != "REVERSE"
        rig.human = False
        rig.run(2.0)
    assert "REVERSE" not in rig.decision.esc.state_name


def test_planner_reverses_by_its_gear_and_brakes_forward_without_it():
    rig = Rig(BRAKE_THEN_REVERSE)
    rig.value, rig.speed = -2.0, 0.0
    rig.run(1.0)
    assert set(rig.duties) == {NEUTRAL_DUTY}
    for _ in range(200):  # 4 s: a brake, neutral, and then reverse
        rig.control.arbiter.update_planner_state("reverse", None, rig.now_ns)
        rig.run(0.02)
    assert (rig.decision.esc.state_name, rig.decision.duty) == ("REVERSE", 4260)  # 4915 − 2 / 5 · 1638


def test_neutral_that_is_tuned_moves_requests_and_what_the_board_holds():
    rig = Rig()
    rig.control.calibrate(trimmed(SHIPPED, 4935))
    rig.stick = 1.0
    assert rig.run(0.1).duty == 4935 + 492


def test_board_without_pulses_takes_arming_again():
    rig = Rig()
    rig.stick = 1.0
    rig.run(0.1)
    rig.control.update_output([0] * 16, rig.now_ns)
    decision = rig.control.decide(rig.now_ns)
    assert (decision.duty, decision.esc.state_name) == (NEUTRAL_DUTY, "ARMING")


def test_dropped_messages_stop_it():
    rig = Rig(BRAKE_THEN_REVERSE)
    rig.stick, rig.speed = 1.0, 4.0
    rig.run(1.0)
    rig.control.mark_stale(rig.now_ns)
    decision = rig.control.decide(rig.now_ns)
    assert (decision.duty, decision.arbitration.is_stop) == (NEUTRAL_DUTY, True)


def test_what_differs_is_duty_source_cause_esc_mode_and_scale_but_no_number_in_a_reason():
    rig = Rig()
    first = rig.run(0.1)
    assert first.differs_by == rig.run(0.1).differs_by
    rig.human = False
    assert rig.run(0.02).differs_by != first.differs_by
    assert first.arbitration.source == NEUTRAL and math.isfinite(first.scale)


def test_ages_are_those_of_every_input():
    assert set(Rig().control.ages_s(0)) == {"e_stop", "human_in_loop", "turn_arb's state", "mode", "tele_throt_req",
                                            "the planner's value", "odometry", "/servo/output"}


# --- a stick under a planner's deadman ---

def autonomous(profile, **esc):
    """A rig under the autonomous deadman."""
    rig = Rig(profile, **esc)
    run = rig.run

    def run_in_mode(seconds):
        for _ in range(round(seconds * 50)):
            rig.control.arbiter.update_mode(rig.mode, rig.now_ns)
            if rig.gear:
                rig.control.arbiter.update_planner_state(rig.gear, None, rig.now_ns)
            run(0.02)
        return rig.decision
    rig.mode, rig.gear, rig.run = "autonomous", "", run_in_mode
    rig.run(0.1)
    return rig


def test_pull_under_a_planner_s_deadman_brakes_fully():
    rig = autonomous(BRAKE_THEN_REVERSE)
    rig.value, rig.speed = 2.0, 3.0
    rig.run(1.0)
    rig.stick = -1.0
    decision = rig.run(0.1)
    assert (decision.duty, decision.arbitration.source, decision.esc.state_name) == (FULL_BRAKE, TELEOP, "BRAKING")
    rig.stick = 0.0
    assert rig.run(0.4).duty == NEUTRAL_DUTY
    assert rig.run(0.2).duty > NEUTRAL_DUTY  # the planner's


@pytest.mark.parametrize("profile, esc", [*((profile, {}) for profile in PROFILES),
                                          (UNVERIFIED, {"calibration_drive": True})])
def test_pull_under_a_planner_s_deadman_never_becomes_reverse_however_often(profile, esc):
    rig = autonomous(profile, **esc)
    rig.speed = 0.0
    for _ in range(6):
        rig.stick = -1.0
        rig.run(0.6)
        assert rig.decision.esc.state_name != "REVERSE"
        rig.stick = 0.0
        rig.run(0.3)
    if profile not in (BRAKE_THEN_REVERSE, FORWARD_ONLY):
        assert min(rig.duties) == NEUTRAL_DUTY


@pytest.mark.parametrize("profile", [DIRECT_REVERSE, UNVERIFIED, BRAKE_THEN_REVERSE])
def test_pull_that_is_held_when_the_human_takes_over_counts_for_nothing_and_reverse_takes_two_after_it(profile):
    rig = autonomous(profile)
    rig.speed = 0.0
    for rig.stick in (-1.0, 0.0, -1.0):
        rig.run(0.4)
    rig.mode = "manual"
    rig.run(3.0)
    for rig.stick in (0.0, -1.0):
        rig.run(3.0)
    if profile != BRAKE_THEN_REVERSE:  # which takes the first one for a brake
        assert min(rig.duties) == NEUTRAL_DUTY
    assert rig.decision.esc.state_name != "REVERSE"
    for rig.stick in (0.0, -1.0):
        rig.run(3.0)
    assert (rig.decision.esc.state_name, rig.decision.duty) == ("REVERSE", REVERSE_BY_HAND)


@pytest.mark.parametrize("late_s", [0.02, 0.12, 0.4])
@pytest.mark.parametrize("profile", [DIRECT_REVERSE, UNVERIFIED, BRAKE_THEN_REVERSE])
def test_pulls_of_the_planner_s_deadman_that_arrive_after_the_human_s_mode_are_none_towards_reverse(profile, late_s):
    """The stick's topic is later than the mode's: the last 'late_s' of it are read under the new mode."""
    rig = autonomous(profile)
    rig.speed, rig.mode = 0.0, "manual"
    for rig.stick in (-1.0, 0.0, -1.0):
        rig.run(late_s / 3)
        assert rig.decision.esc.state_name != "REVERSE"
    for _ in range(150):
        assert rig.run(0.02).esc.state_name != "REVERSE"


@pytest.mark.parametrize("released_s", [0.02, 0.3, 1.0])
@pytest.mark.parametrize("profile, esc", [(DIRECT_REVERSE, {}), (UNVERIFIED, {}),
                                          (UNVERIFIED, {"calibration_drive": True})])
def test_pull_that_is_held_through_a_release_to_the_human_s_deadman_never_drives(profile, esc, released_s):
    """Without a deadman teleop_logi sends 0; human_in_loop is later than that, by up to 0.4 s."""
    rig = autonomous(profile, **esc)
    rig.speed, rig.stick = 0.0, -1.0
    rig.run(0.5)
    rig.mode, rig.stick = "manual", 0.0
    rig.run(min(0.4, released_s))
    rig.human = False
    rig.run(max(0.0, released_s - 0.4))
    rig.stick = -1.0
    rig.run(min(0.4, released_s))
    rig.human = True
    rig.run(3.0)
    assert min(rig.duties) == NEUTRAL_DUTY


def test_calibration_drive_hands_over_the_stick_once_it_was_let_go():
    rig = autonomous(UNVERIFIED, calibration_drive=True)
    rig.speed, rig.stick = 0.0, -1.0
    rig.run(0.5)
    rig.mode = "manual"
    rig.run(3.0)
    assert min(rig.duties) == NEUTRAL_DUTY
    for rig.stick in (0.0, -1.0):
        rig.run(0.1)
    assert rig.decision.duty == REVERSE_BY_HAND


def reversing(speed=-2.0):
    """A car that its planner drives backward."""
    rig = autonomous(DIRECT_REVERSE)
    rig.gear, rig.value, rig.speed = "reverse", -2.0, 0.0
    rig.run(1.0)
    assert rig.decision.esc.state_name == "REVERSE"
    rig.speed = speed
    rig.run(0.5)
    return rig


def test_pull_brakes_a_car_that_its_planner_drives_backward_until_it_is_slow():
    rig = reversing()
    rig.stick, rig.duties = -1.0, []
    decision = rig.run(0.2)
    assert (decision.duty, decision.esc.state_name) == (FULL_FORWARD, "BRAKING")
    assert min(rig.duties) >= NEUTRAL_DUTY
    rig.speed = -0.4
    rig.run(0.1)
    assert rig.run(0.1).duty == NEUTRAL_DUTY
    rig.speed, rig.duties = 0.0, []
    rig.run(3.0)
    assert set(rig.duties) == {NEUTRAL_DUTY}


def test_push_drives_a_car_forward_that_its_planner_drives_backward():
    rig = reversing()
    rig.stick = 1.0
    assert rig.run(0.2).esc.state_name == "BRAKING"
    rig.speed = 0.0
    decision = rig.run(0.2)
    assert (decision.duty, decision.esc.state_name) == (BY_HAND, "FORWARD")
