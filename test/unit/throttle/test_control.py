"""The throttle as a whole: arbiter, limits, the ESC's rules, and the duty. Time is passed in."""

import math

import pytest
from many_drives import THROTTLE, S

from car_interface.common import causes
from car_interface.common.sources import NEUTRAL, PLANNER, TELEOP
from car_interface.interlock.motion_interlock import InterlockConfig
from car_interface.throttle.arbiter import ThrottleArbiterConfig
from car_interface.throttle.board_watch import BoardConfig
from car_interface.throttle.calibration import trimmed
from car_interface.throttle.control import ThrottleControl
from car_interface.throttle.esc_config import BRAKE_THEN_REVERSE, DIRECT_REVERSE, UNVERIFIED, EscConfig
from car_interface.throttle.limits import DriveLimits, ThrottleLimits
from car_interface.throttle.obstacle_stop import Mount, ObstacleConfig
from car_interface.throttle.stick import StickConfig
from car_interface.throttle.value_map import ValueMap

TICK = S // 50
LINEAR = StickConfig(deadband=0.05, human_scale=0.3, brake_scale=1.0)
FULL_FORWARD, NEUTRAL_DUTY = 6554, 4915
BY_HAND, REVERSE_BY_HAND = 5407, 4424  # 0.3 of each side
SONAR = ObstacleConfig({"front_middle": Mount(0.42, 0.0, 0.0)})


class Rig:
    """A throttle whose inputs are repeated 50 times a second (not an empty mode or gear), and a board that obeys."""

    def __init__(self, profile=UNVERIFIED, mode="", limits=None, obstacles=None, board=None, **esc):
        self.control = ThrottleControl(
            THROTTLE, ThrottleArbiterConfig(stick=LINEAR, interlock=InterlockConfig(e_stop_timeout_s=0.0), board=board),
            EscConfig(profile=profile, **esc), limits, obstacles)
        self.now_ns = 1000 * S
        self.human, self.stick, self.value, self.speed = False, 0.0, None, 0.0
        self.noise = 1e-9
        self.mode, self.gear, self.range_m = mode, "", 1.5  # of the sonar in front
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
            arbiter.update_steering_command(0, 5000, self.now_ns)
            arbiter.update_teleop(self.stick, self.now_ns)
            if self.mode:
                arbiter.update_mode(self.mode, self.now_ns)
            if self.gear:
                arbiter.update_planner_state(self.gear, None, self.now_ns)
            if self.value is not None:
                self.control.update_planner(self.value, self.now_ns)
            self.noise = -self.noise  # no two speeds of a car that rolls are the same
            self.control.update_odometry(self.speed + self.noise, self.now_ns, 0)
            if self.range_m is not None:
                self.control.update_range("front_middle", self.range_m, self.now_ns)
            self.decision = self.control.decide(self.now_ns)
            self.duties.append(self.decision.duty)
            self.control.update_output([5000, self.decision.duty, *[-1] * 14], self.now_ns + TICK // 10)
        return self.decision

    def pull(self, *sticks):
        """Have the stick at (value, for seconds), and return the last decision."""
        for self.stick, seconds in sticks:
            self.run(seconds)
        return self.decision


def test_human_drives_by_the_scale_once_the_esc_is_armed():
    rig = Rig()
    assert set(rig.duties) == {NEUTRAL_DUTY} and rig.decision.esc.state == "NEUTRAL"
    decision = rig.pull((1.0, 0.1))
    assert (decision.duty, rig.control.esc_config.profile) == (BY_HAND, "unverified")
    assert decision.kind == (TELEOP, causes.TELEOP, decision.esc.state, causes.DRIVING)


def test_planner_drives_by_the_duty_table_up_to_the_acceleration_s_limit():
    value_map = ValueMap([-5.0, 0.0, 3.0], [0.0, 10.0], [[-10.0, -10.0], [0.0, 0.0], [6.0, 6.0]])
    rig = Rig(limits=ThrottleLimits(planner=DriveLimits(max_acceleration_mps2=3.0), value_map=value_map))
    for rig.value in (1.5, 3.0):
        decision = rig.run(0.1)
        assert (decision.duty, decision.arbitration.source) == (5735, PLANNER)


@pytest.mark.parametrize("profile", [DIRECT_REVERSE, UNVERIFIED, BRAKE_THEN_REVERSE])
def test_reverse_has_the_scale_of_driving_and_never_that_of_the_brake_not_even_for_a_moment(profile):
    rig = Rig(profile)
    decision = rig.pull((-1.0, 0.5), (0.0, 1.0), (-1.0, 0.5), (0.0, 0.2), (-1.0, 3.0))
    assert (decision.duty, decision.esc.state) == (REVERSE_BY_HAND, "REVERSE")
    assert min(rig.duties) == REVERSE_BY_HAND


def test_forward_from_reverse_brakes_by_brake_scale_and_then_drives_by_human_scale():
    rig = Rig(DIRECT_REVERSE)
    rig.pull((-1.0, 0.5), (0.0, 1.0), (-1.0, 1.0))
    rig.speed = -2.0
    assert rig.run(1.0).esc.state == "REVERSE"
    decision = rig.pull((1.0, 0.2))
    assert (decision.duty, decision.esc.state) == (FULL_FORWARD, "BRAKING")
    rig.speed, rig.duties = 0.0, []
    decision = rig.run(0.2)
    assert (decision.duty, decision.esc.state) == (BY_HAND, "FORWARD")
    assert max(rig.duties) == BY_HAND


def test_calibration_drive_has_the_scale_of_driving_for_brakes_too_so_that_a_pull_stays_the_same_at_standstill():
    rig = Rig(calibration_drive=True)
    rig.speed = 2.0
    rig.pull((1.0, 0.5))
    rig.stick, rig.duties = -1.0, []
    for rig.speed in (1.0, 0.0, -1.0):
        rig.run(0.8)
    assert (set(rig.duties), rig.pull((1.0, 0.1)).duty) == ({REVERSE_BY_HAND}, BY_HAND)
    rig.human = False
    assert rig.run(0.1).duty == NEUTRAL_DUTY


def test_stick_that_reverse_s_scale_makes_too_small_drives_nothing():
    """0.2 of the stick brakes, but 0.3 of that is in the ESC's dead band; nor does the state change all the time."""
    rig = Rig(DIRECT_REVERSE)
    for stick in [-0.2] * 25 + [0.0] * 50 + [-0.2] * 50:
        assert rig.pull((stick, 0.02)).esc.state == "NEUTRAL"
    assert set(rig.duties) == {NEUTRAL_DUTY}


def test_stick_that_the_scale_makes_too_small_for_a_push_still_brakes():
    rig = Rig(BRAKE_THEN_REVERSE)
    rig.speed = 2.0
    decision = rig.pull((1.0, 1.0), (-0.2, 0.3))
    assert decision.esc.state == "BRAKING" and decision.duty < NEUTRAL_DUTY
    rig = Rig(DIRECT_REVERSE)
    rig.speed = 2.0
    rig.pull((0.2, 0.5))
    rig.speed = -2.0
    rig.pull((0.2, 0.3))
    assert set(rig.duties) == {NEUTRAL_DUTY}  # a push: only in REVERSE would it be a brake


def test_board_that_reports_no_pulse_has_the_esc_armed_again():
    rig = Rig()
    rig.control.update_output([5000, -1, *[-1] * 14], rig.now_ns)
    assert rig.run(0.02).esc.state == "ARMING"


def test_calibration_that_is_tuned_holds_from_then_on():
    rig = Rig()
    rig.control.calibration = trimmed(THROTTLE, NEUTRAL_DUTY + 50)
    assert rig.run(0.02).duty == NEUTRAL_DUTY + 50
    assert rig.pull((1.0, 0.1)).duty == BY_HAND + 50


def test_after_dropped_messages_nothing_brakes_and_a_board_that_is_checked_must_agree_again():
    rig = Rig(BRAKE_THEN_REVERSE, board=BoardConfig())
    rig.speed = 4.0
    assert rig.pull((1.0, 1.0)).duty == BY_HAND
    rig.control.mark_stale(rig.now_ns)
    assert rig.control.limiter.speed.is_stale(rig.now_ns)
    decision = rig.control.decide(rig.now_ns)
    assert (decision.duty, decision.arbitration.is_stop) == (NEUTRAL_DUTY, True)
    rig.human = False
    rig.run(0.02)
    rig.human = True
    assert rig.run(0.02).arbitration.cause == causes.STEERING_NOT_HELD
    assert rig.run(1.0).arbitration.cause == causes.TELEOP


def test_what_differs_is_duty_source_cause_esc_mode_and_scale_but_no_number_in_a_reason():
    rig = Rig()
    first = rig.run(0.1)
    assert first.differs_by == rig.run(0.1).differs_by
    rig.human = False
    assert rig.run(0.02).differs_by != first.differs_by
    assert first.arbitration.source == NEUTRAL and math.isfinite(first.scale)
    assert set(rig.control.arbiter.ages_s(0)) == {"e_stop", "human_in_loop", "turn_arb's state", "mode",
                                                  "tele_throt_req", "the planner's value", "odometry", "/servo/output"}
    assert rig.control.arbiter.ages_s(rig.now_ns)["/servo/output"] == 0.0


@pytest.mark.parametrize("max_mps, cause", [(0.5, causes.CURVE_SLOWED), (0.0, ""), (-1.0, ""), (math.nan, ""),
                                            (math.inf, "")])
def test_planner_keeps_to_the_speed_of_its_turn_while_turn_arb_names_one(max_mps, cause):
    rig = Rig()
    rig.value, rig.speed = 1.5, 4.0
    rig.control.update_turn(5.0, max_mps)
    limited = rig.run(0.1).limited
    assert (limited.cause, limited.max_speed_mps) == (cause, 0.5 if cause else 0.0)
    assert rig.control.limiter.cuts == (len(cause) > 0)


def test_max_speed_holds_backward_while_the_esc_reverses():
    rig = Rig(DIRECT_REVERSE, limits=ThrottleLimits(planner=DriveLimits(max_speed_mps=1.0)))
    rig.value, rig.gear = -2.0, "reverse"
    assert rig.run(1.0).limited.cause == ""
    rig.speed = 0.9  # that of a car which odometry takes to roll forward, slowly
    assert rig.run(0.02).limited.cause == causes.SPEED_LIMITED


@pytest.mark.parametrize("radius_m, max_mps", [(math.inf, 1.668), (0.0, 1.668), (math.nan, 1.668), (3.0, 1.214),
                                               (-3.0, 1.214), (0.4, 0.3)])  # which leaves the cone: a creep
def test_obstacles_bound_the_speed_on_the_arc_that_is_steered(radius_m, max_mps):
    rig = Rig(BRAKE_THEN_REVERSE, obstacles=SONAR, profile_measured=True)
    rig.pull((1.0, 1.0))
    rig.control.update_turn(radius_m, 0.0)
    rig.speed = 0.2
    assert rig.run(0.06).limited.max_speed_mps == pytest.approx(max_mps, abs=0.01)


def test_speed_counts_for_the_ground_s_slope_when_it_was_measured():
    rig = Rig(obstacles=SONAR)
    for report in range(10):
        age_ns = report % 2 * S // 100
        rig.control.update_odometry(2.0 * (report * TICK - age_ns) / S, rig.now_ns + report * TICK, age_ns)
    assert rig.control._guard.slope.acceleration_mps2 == pytest.approx(2.0)


def test_speed_that_comes_without_its_deviation_is_known_at_once_after_a_silence():
    rig = Rig(BRAKE_THEN_REVERSE, profile_measured=True)
    rig.now_ns += S
    rig.speed = 2.0
    assert rig.run(0.5).esc.state == "BRAKING"


def test_sonar_that_was_dropped_with_other_messages_lets_nobody_drive_towards_it():
    rig = Rig(BRAKE_THEN_REVERSE, obstacles=SONAR)
    assert NEUTRAL_DUTY < rig.pull((1.0, 0.1)).duty <= BY_HAND
    rig.control.mark_stale(rig.now_ns)
    rig.human, rig.range_m = False, None
    rig.run(0.02)
    rig.human = True
    assert rig.run(0.02).limited.cause == causes.SONAR_SILENT


@pytest.mark.once
@pytest.mark.parametrize("profile", [DIRECT_REVERSE, UNVERIFIED, BRAKE_THEN_REVERSE])
def test_pull_that_is_held_when_the_human_takes_over_counts_for_nothing_and_reverse_takes_two_after_it(profile):
    rig = Rig(profile, mode="autonomous")
    rig.pull((-1.0, 0.4), (0.0, 0.4), (-1.0, 0.4))
    rig.mode = "manual"
    assert rig.pull((-1.0, 3.0), (0.0, 3.0), (-1.0, 3.0)).esc.state != "REVERSE"
    if profile != BRAKE_THEN_REVERSE:  # which takes the first one for a brake
        assert min(rig.duties) == NEUTRAL_DUTY
    decision = rig.pull((0.0, 3.0), (-1.0, 3.0))
    assert (decision.esc.state, decision.duty) == ("REVERSE", REVERSE_BY_HAND)


def test_calibration_drive_hands_over_the_stick_once_it_was_let_go():
    rig = Rig(mode="autonomous", calibration_drive=True)
    rig.pull((-1.0, 0.5))
    rig.mode = "manual"
    rig.pull((-1.0, 3.0))
    assert min(rig.duties) == NEUTRAL_DUTY
    assert rig.pull((0.0, 0.1), (-1.0, 0.1)).duty == REVERSE_BY_HAND
