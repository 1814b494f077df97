"""The rules by which an ESC is driven, as a table of what is asked, what is known, and what it gets.

Here the servo board holds at once what it is sent and the speed is what the test says; test_adversary.py has the
virtual ESCs and all that goes wrong.
"""

import math

import pytest

from car_interface.common import causes
from car_interface.throttle.esc import ARMING, BRAKING, FORWARD, HOLD, NEUTRAL, REVERSE, Esc, EscConfig, Request
from car_interface.throttle.esc_intention import AUTO, DRIVE, REVERSE_GEAR

MS = 1_000_000
KNOWN = "brake_then_reverse", "brake_becomes_reverse", "direct_reverse", "forward_only"
SEQUENCE, TURNS, DIRECT, NO_REVERSE = KNOWN
UNSURE = (TURNS, DIRECT, "unverified")


class Car:
    """An ESC's rules in steps of 20 ms; ``speed`` is what odometry says meanwhile, None = nothing."""

    def __init__(self, profile=SEQUENCE, armed=True, **changes):
        self.esc = Esc(EscConfig(profile=profile, **{"dwell_s": 0.3, **changes}))
        self.now_ns, self.board_says = 0, True
        self.decision = None
        self.noise, self.age_ms = 1e-9, 0
        if armed:
            self.stop(1.1)
            assert self.decision.state == NEUTRAL

    def ask(self, request, seconds=0.02, speed=None):
        for _ in range(max(1, round(seconds / 0.02))):
            self.now_ns += 20 * MS
            if speed is not None:
                self.measure(speed, self.age_ms * MS)
            self.decision = self.esc.step(request, self.now_ns)
            assert self.esc.state == self.decision.state
            if self.board_says:
                self.esc.update_held(self.decision.fraction, self.now_ns)
        return self.decision

    def measure(self, speed_mps, age_ns=0):
        """No two speeds of a car that rolls are the same."""
        self.noise = -self.noise
        self.esc.update_speed(speed_mps + self.noise, self.now_ns, age_ns)

    def stick(self, value, seconds=0.02, speed=None):
        return self.ask(Request(value, AUTO, is_human=True, is_centered=value == 0), seconds, speed)

    def planner(self, value, seconds=0.02, speed=None, gear=DRIVE):
        return self.ask(Request(value, gear, is_centered=True), seconds, speed)

    def stop(self, seconds=0.02, speed=None):
        return self.ask(Request(is_stop=True, is_released=True, is_centered=True), seconds, speed)

    def drive_and_brake_to_standstill(self, planner=False):
        ask = self.planner if planner else self.stick
        ask(0.5, 0.5, speed=2.0)
        ask(-0.5, 0.3, speed=1.0)
        return ask(-0.5, 0.8, speed=0.0)


    def slow(self, value, from_mps, to_mps, by_mps2):
        """Hold the stick while the car slows evenly down to a speed, and return the last decision."""
        for step in range(1, round((from_mps - to_mps) / by_mps2 / 0.02) + 1):
            self.stick(value, speed=from_mps - by_mps2 * step * 0.02)
        return self.decision


def test_esc_starts_in_arming_and_says_what_is_missing():
    car = Car(armed=False)
    decision = car.stick(0.5, 0.02)
    assert (decision.fraction, decision.state, decision.cause) == (0.0, ARMING, "esc arming")
    assert decision.reason == ("this node has just started; let go of the deadman, center the stick, 1.0 s of neutral "
                               "to go")
    assert car.stick(0.5, 3.0).reason == "this node has just started; let go of the deadman, center the stick"
    assert car.stick(0.0).reason == "this node has just started; let go of the deadman"
    assert car.stop().state == NEUTRAL
    assert (car.stick(0.5).state, car.decision.fraction) == (FORWARD, 0.5)


def test_arming_takes_neutral_at_the_chip_and_forgets_pulls_from_before():
    car = Car(armed=False)
    car.board_says = False
    car.esc.update_held(0.4, 0)
    assert car.stop(0.9).state == ARMING
    car.esc.update_held(0.0, car.now_ns)
    car.stick(-0.5, 0.2, speed=0.0)
    assert car.stick(0.0, 0.7, speed=0.0).state == ARMING
    car.board_says = True
    assert car.stick(0.0, 0.2, speed=0.0).state == NEUTRAL
    assert car.stick(-0.5, 2.0, speed=0.0)[:2] == (0.0, NEUTRAL)


@pytest.mark.parametrize("value, fraction, state, reason", [
    (0.079, 0.0, NEUTRAL, "neutral is requested"),
    (0.08, 0.08, FORWARD, "0.08 is requested"),
    (1.0, 1.0, FORWARD, "1.00 is requested"),
    (1.5, 1.0, FORWARD, "1.00 is requested (1.5, clamped)"),
    (-0.079, 0.0, NEUTRAL, "neutral is requested"),
    (math.nan, 0.0, NEUTRAL, "the request is nan; it stops in neutral"),
    (-math.inf, 0.0, NEUTRAL, "the request is -inf; it stops in neutral"),
])
def test_forward_is_passed_beyond_the_dead_band_and_clamped_and_what_is_no_number_stops(value, fraction, state, reason):
    decision = Car().stick(value)
    assert (decision.fraction, decision.state, decision.reason) == (fraction, state, reason)
    assert (decision.cause == causes.REQUEST_NOT_FINITE) == (not math.isfinite(value))


@pytest.mark.parametrize("profile", [SEQUENCE, NO_REVERSE])
def test_pull_after_forward_brakes_and_then_holds_the_car_without_odometry_too(profile):
    car = Car(profile)
    car.stick(0.5, 0.5)
    assert car.stick(-0.4, 5.0)[:2] == (-0.4, BRAKING)
    assert car.drive_and_brake_to_standstill()[:4] == (
        -0.5, HOLD, causes.HOLDING, "it stands, and the brake holds it")


@pytest.mark.parametrize("value, fraction", [(-0.079, 0.0), (-0.08, -0.08), (-1.0, -1.0), (-7.0, -1.0)])
def test_pull_is_passed_beyond_the_dead_band_and_clamped(value, fraction):
    car = Car()
    car.stick(0.5, 0.5)
    assert car.stick(value).fraction == fraction


@pytest.mark.parametrize("profile", UNSURE)
def test_esc_that_may_reverse_is_braked_above_the_margin_only(profile):
    car = Car(profile)
    car.stick(0.5, 0.5)
    assert (car.stick(-0.4).fraction, car.decision.cause) == (0.0, "brake uncertain"), "it braked without odometry"
    car.stick(0.5, 0.5, speed=2.0)
    assert car.stick(-0.4, 0.1, speed=2.0)[:2] == (-0.4, BRAKING)
    assert car.stick(-0.4, speed=0.9).fraction == -0.4
    assert car.stick(-0.4, speed=0.7)[:4] == (
        0.0, NEUTRAL, "brake uncertain",
        "below 0.5 m/s the ESC could take this pull for reverse before it is over: it coasts")
    assert car.stick(-0.4, speed=1.2).fraction == 0.0, "it began again at twice the margin only"
    assert car.stick(-0.4, 2.0, speed=0.0).cause == "at standstill"


@pytest.mark.once
@pytest.mark.parametrize("profile", [*KNOWN, "unverified"])
def test_planner_s_hold_never_becomes_reverse_however_often_the_deadman_is_let_go(profile):
    car = Car(profile)
    car.drive_and_brake_to_standstill(planner=True)
    for neutral_s in (0.02, 0.4, 1.5) * 3:
        car.stop(neutral_s, speed=0.0)
        for gear in (DRIVE, AUTO):
            decision = car.planner(-0.4, 0.5, speed=0.0, gear=gear)
            assert decision.state in (HOLD, NEUTRAL) and (decision.fraction == 0 or profile == NO_REVERSE)


def test_pull_is_neutral_while_it_rolls_backward_after_a_guard_s_neutral_and_after_messages_were_dropped():
    backward, guarded, dropped = Car(), Car(), Car()
    backward.planner(0.5, 0.5, speed=1.0)
    assert backward.planner(-0.4, speed=-0.15)[:2] == (0.0, NEUTRAL)
    guarded.drive_and_brake_to_standstill()
    guarded.esc.update_held(0.0, guarded.now_ns)
    assert guarded.stick(-0.5, speed=0.0)[:3] == (0.0, NEUTRAL, "at standstill")
    dropped.stick(0.5, 0.5, speed=0.4)
    dropped.esc.mark_stale()
    assert dropped.stick(-0.5, speed=0.4)[:2] == (0.0, NEUTRAL)


def pulled_twice(car, speed):
    """The fractions and causes of the second pull, of two seconds."""
    car.stick(0.5, 0.5, speed=None if speed is None else 1.0)
    car.stick(-0.5, 1.5, speed=speed)
    car.stick(0.0, 0.1, speed=speed)
    return [(car.stick(-0.5, speed=speed).fraction, car.decision.state) for _ in range(100)]


@pytest.mark.parametrize("speed", [0.0, None])
def test_second_pull_reverses_once_neutral_has_lasted_for_the_dwell(speed):
    answers = pulled_twice(Car(), speed)
    assert answers[0] == (0.0, REVERSE) and answers[-1] == (-0.5, REVERSE)
    assert [fraction for fraction, _ in answers].index(-0.5) in (9, 10, 11)  # 0.1 of 0.3 s had passed


@pytest.mark.parametrize("profile", [SEQUENCE, "unverified"])
@pytest.mark.parametrize("dead_band, first", [(0.08, -0.15), (0.2, -0.2)])
def test_the_pull_that_only_unlocks_reverse_is_weak_since_another_kind_reverses_by_it(profile, dead_band, first):
    car = Car(profile, dead_band_reverse=dead_band)
    answers = [car.planner(-0.5, speed=0.0, gear=REVERSE_GEAR)[:2] for _ in range(60)]
    assert answers[0] == (first, REVERSE) and answers[-1] == (-0.5, REVERSE)
    assert {fraction for fraction, _ in answers} == {first, 0.0, -0.5}


@pytest.mark.parametrize("profile, speed", [(TURNS, 0.0), (DIRECT, None), ("unverified", 0.0), ("unverified", None)])
def test_second_pull_reverses_with_other_profiles(profile, speed):
    assert pulled_twice(Car(profile), speed)[-1] == (-0.5, REVERSE)


def test_locked_wheels_that_read_0_are_no_standstill_for_reverse():
    car = Car()
    car.stick(0.5, 0.5, speed=6.0)
    car.stick(-1.0, 0.2, speed=0.0)
    car.stick(0.0, 0.4, speed=0.0)
    assert car.stick(-0.5, 1.0, speed=0.0).state == NEUTRAL
    assert car.stick(-0.5, 0.8, speed=0.0).state == REVERSE, "6 m/s ÷ 3 m/s² after the brake began"


@pytest.mark.parametrize("profile, speed, answer", [
    (TURNS, None, (0.0, NEUTRAL, "reverse refused", "no reverse without speed: odom was never heard")),
    (NO_REVERSE, 0.0, (-0.4, HOLD, "reverse refused", "this ESC has no reverse (esc/profile: forward_only)")),
])
def test_planner_reverses_neither_without_speed_nor_without_a_reverse(profile, speed, answer):
    assert Car(profile).planner(-0.4, 2.0, speed, gear=REVERSE_GEAR)[:4] == answer


def test_brake_in_reverse_gear_slows_above_the_margin_and_never_drives_forward():
    car = Car()
    pulled_twice(car, 0.0)
    car.planner(-0.4, 0.4, speed=-2.0, gear=REVERSE_GEAR)
    assert car.planner(0.4, speed=-2.0, gear=REVERSE_GEAR)[:2] == (0.4, BRAKING)
    assert car.planner(0.4, speed=-0.7, gear=REVERSE_GEAR).fraction == 0.0
    assert car.planner(0.4, 1.0, speed=0.0, gear=REVERSE_GEAR)[:2] == (0.0, NEUTRAL)


@pytest.mark.parametrize("profile, changes, fraction", [
    *((profile, {}, -0.5) for profile in KNOWN),
    ("unverified", {}, 0.0),
    (SEQUENCE, {"stop_brake": 0.0}, 0.0),
])
def test_stop_brakes_above_the_margin_with_any_named_profile_and_is_certain_of_drag_alone(profile, changes, fraction):
    car = Car(profile, **changes)
    car.stick(0.5, 0.5, speed=3.0)
    decision = car.stop(0.2, speed=3.0)
    assert decision[:3] == (fraction, BRAKING if fraction else NEUTRAL, causes.STOPPING)
    assert decision.reason == ("it brakes" if fraction else "it stops in neutral")
    assert decision.stop_mps2 == 0.3
    assert car.stop(0.02, speed=0.6)[:2] == (0.0, NEUTRAL)


@pytest.mark.parametrize("profile, is_measured, coasts_s, fraction", [
    (SEQUENCE, False, 0.0, 0.0),
    (SEQUENCE, True, 0.0, -0.5),
    (SEQUENCE, True, 0.5, -0.5),
    (SEQUENCE, True, 0.52, 0.0),  # no ESC is trusted to remember for so long
    (TURNS, True, 0.0, 0.0),
    (DIRECT, True, 0.0, 0.0),
])
def test_stop_without_odometry_brakes_only_where_the_profile_is_proven(profile, is_measured, coasts_s, fraction):
    car = Car(profile, profile_measured=is_measured)
    car.stick(0.5, 0.5)
    if coasts_s:
        car.stick(0.0, coasts_s)
    assert car.stop().fraction == fraction
    assert car.decision.stop_mps2 == (1.5 if fraction else 0.3)


def test_stop_brakes_from_arming_on_where_the_esc_was_measured_to_have_no_reverse():
    car = Car(NO_REVERSE, armed=False, profile_measured=True)
    assert car.stop(0.9)[1::3] == (ARMING, 0.3)
    assert car.stop(0.2)[1::3] == (BRAKING, 1.5)


def brakes_to_standstill_and_drives_again(car):
    """The story that proves a profile: see test_esc_proof.py."""
    for _ in range(2):
        car.stick(0.5, 0.5, speed=2.0)
        for index in range(26):
            car.stick(-0.6, speed=2.0 - 0.08 * index)
        car.stick(-0.6, 1.5, speed=0.0)
        car.stick(0.5, 1.0, speed=1.0)


@pytest.mark.parametrize("proves", [False, True])
def test_stop_without_odometry_brakes_once_the_esc_has_stopped_and_held_the_car_twice(proves):
    car = Car(speed_timeout_s=0.1)
    if proves:
        brakes_to_standstill_and_drives_again(car)
    car.stick(0.5, 1.0)
    assert car.stop()[:2] == ((-0.5, BRAKING) if proves else (0.0, NEUTRAL))


@pytest.mark.parametrize("then, is_proven", [("backward_under_a_brake", False), ("no_pulse", False), ("reverse", True)])
def test_doubt_takes_such_a_proof_away(then, is_proven):
    car = Car(speed_timeout_s=0.1)
    brakes_to_standstill_and_drives_again(car)
    if then == "backward_under_a_brake":
        car.stick(-0.6, 0.1, speed=1.0)
        car.stick(-0.6, 0.04, speed=-0.15)  # for less time than the motion check takes
    elif then == "no_pulse":
        car.esc.update_held(None, car.now_ns)
        car.stop(1.2)
    else:
        pulled_twice(car, 0.0)
        assert car.stick(-0.5, 0.5, speed=-1.0)[:2] == (-0.5, REVERSE)
        assert car.stick(0.5, 0.2, speed=-0.5)[:2] == (0.5, BRAKING)  # by a push, which proves nothing
    car.stick(0.5, 1.0, speed=0.2)
    car.stick(0.5, 0.2)
    assert car.stop()[:2] == ((-0.5, BRAKING) if is_proven else (0.0, NEUTRAL))


@pytest.mark.parametrize("after, brakes", [
    pytest.param([(-1.0, 0.6), (-0.3, 0.6)], False, id="it_still_rolls_backward"),
    pytest.param([(-1.0, 0.6), (0.0, 0.2)], False, id="too_short_since_it_stood"),
    pytest.param([(-1.0, 0.6), (0.2, 0.6)], True, id="it_drove_for_the_dwell_since"),
    pytest.param([(None, 1.5)], False, id="nobody_knows_whether_it_stands"),
])
def test_push_that_only_brakes_a_car_that_rolls_backward_makes_no_brake_certain(after, brakes):
    car = Car(profile_measured=True, speed_timeout_s=0.1)
    pulled_twice(car, 0.0)
    car.stick(-0.5, 0.6, speed=-1.0)
    for speed, seconds in after:
        car.stick(0.5, seconds, speed)
    assert bool(car.stop().fraction) == brakes


def test_without_any_odometry_a_car_has_rolled_out_of_reverse_after_some_seconds():
    for seconds, brakes in ((3.0, False), (4.5, True)):
        car = Car(profile_measured=True)
        pulled_twice(car, None)
        car.stick(-0.5, 0.6)
        car.stick(0.5, seconds)
        assert bool(car.stop().fraction) == brakes


@pytest.mark.parametrize("age_ms, begins_mps", [(0, 1.32), (20, 1.08), (100, 1.72)])
def test_brake_of_a_kind_that_may_reverse_begins_later_where_a_speed_is_late_or_doesn_t_say_how_late(
        age_ms, begins_mps):
    for speed_mps, brakes in ((begins_mps + 0.02, True), (begins_mps - 0.02, False)):
        car = Car(TURNS)
        car.now_ns += 20 * MS
        car.measure(speed_mps, age_ms * MS)
        car.now_ns -= 20 * MS  # the next step is at the speed's arrival
        assert bool(car.stick(-0.5).fraction) == brakes


def test_brake_of_a_kind_that_may_reverse_begins_above_its_margin_and_not_at_it():
    car = Car(TURNS)
    car.noise = 0.0
    assert car.stick(-0.5, speed=1.32).fraction == 0.0  # 1.32 − 8 · 0.04 = 2 · 0.5


@pytest.mark.parametrize("ends_mps, fraction", [(0.8, -0.5), (0.5, -0.5), (0.44, 0.0)])
def test_brake_that_may_reverse_is_held_almost_down_to_the_margin_once_it_is_seen_how_it_slows(ends_mps, fraction):
    car = Car(TURNS)
    car.age_ms = 20
    car.stick(0.5, 0.5, speed=3.0)
    assert car.slow(-0.5, 3.0, ends_mps, 2.0).fraction == fraction


@pytest.mark.parametrize("before, after, fractions", [
    (-0.05, -0.1, (-0.1, -0.1)), (-0.1, -0.05, (-0.05, -0.05)),  # nearly the same
    (-0.05, -0.11, (0.0, 0.0)), (-0.1, -0.04, (-0.04, 0.0)),  # it slows more, then less and nobody has seen how much
])
def test_what_was_seen_of_a_brake_says_nothing_about_another_one(before, after, fractions):
    car = Car(TURNS, dead_band_reverse=0.02)
    car.age_ms = 20
    car.stick(0.5, 0.5, speed=3.0)
    assert car.slow(before, 3.0, 0.84, 2.0).fraction == before
    assert (car.stick(after, speed=0.82).fraction, car.stick(after, speed=0.8).fraction) == fractions


@pytest.mark.parametrize("before, fraction", [(-0.5, -0.5), (-0.4, 0.0)])
def test_nor_does_a_pull_about_the_stronger_brake_of_a_stop(before, fraction):
    car = Car(TURNS)
    car.age_ms = 20
    car.stick(0.5, 0.5, speed=3.0)
    car.slow(before, 3.0, 0.82, 2.0)
    assert car.stop(speed=0.8).fraction == fraction


def test_what_was_seen_before_a_brake_began_or_before_the_board_may_have_let_go_says_nothing_about_it():
    begins, paused = Car(TURNS), Car(TURNS)
    for car in (begins, paused):
        car.age_ms = 20
        car.stick(0.5, 0.5, speed=3.0)
    begins.stick(0.0, 0.3, speed=2.08)
    assert begins.slow(-1.0, 2.08, 1.12, 8.0).fraction == -1.0
    assert begins.slow(-1.0, 1.12, 0.8, 8.0).fraction == 0.0
    assert paused.slow(-0.5, 3.0, 0.96, 2.0).fraction == -0.5
    paused.now_ns += 60 * MS
    assert paused.stick(-0.5, speed=0.8).fraction == 0.0


def test_dropped_messages_make_the_speed_unknown():
    car = Car(TURNS)
    car.stick(0.5, 0.5, speed=3.0)
    assert car.stick(-0.5, speed=3.0).fraction == -0.5
    car.esc.mark_stale()
    assert car.stick(-0.5)[:3] == (0.0, NEUTRAL, causes.BRAKE_UNCERTAIN)
    assert "the speed is unknown" in car.decision.reason


@pytest.mark.parametrize("age_ms, says_s, speed, state", [
    (0, 0.34, 0.1, REVERSE), (0, 0.4, 0.1, NEUTRAL),  # without a stamp it may be 0.35 s old
    (20, 0.02, 0.1, REVERSE), (20, 0.04, 0.1, NEUTRAL),  # measured before the pull, and as it began
    (20, 0.02, 0.4, REVERSE),  # it may slide on, at a speed of 0
])
def test_second_pull_is_a_brake_if_a_speed_that_was_measured_during_it_is_forward(age_ms, says_s, speed, state):
    car = Car(TURNS)
    car.age_ms, car.noise = age_ms, 0.0
    for value in (0.5, -0.5, 0.0):
        car.stick(value, 0.2, speed)
    car.stick(-0.5, says_s, speed)
    assert car.stick(-0.5, 1.0, speed=0.0).state == state


def test_a_person_s_reverse_without_a_speed_begins_with_the_brake_that_the_esc_will_make_of_it():
    car = Car()
    car.stick(0.5, 0.5)
    assert car.ask(Request(-0.5, REVERSE_GEAR, is_human=True), 1.0)[:2] == (-0.5, BRAKING)


def test_esc_that_reverses_at_once_gets_neutral_for_the_dwell_before_it():
    car = Car(DIRECT)
    car.stick(0.5, 0.5, speed=0.0)
    car.stick(-0.5, 0.04, speed=0.0)
    car.stick(0.0, 0.04, speed=0.0)
    answers = [car.stick(-0.5, speed=0.0)[:3] for _ in range(30)]
    assert answers == [(0.0, REVERSE, causes.REVERSE_PENDING)] * 11 + [(-0.5, REVERSE, causes.REVERSING)] * 19


def test_a_push_drives_forward_0_15_s_after_the_pull_that_only_unlocked_reverse():
    car = Car(profile_measured=True)
    assert car.planner(-0.5, 0.5, speed=0.0, gear=REVERSE_GEAR)[:2] == (0.0, REVERSE)  # 0.2 s of neutral
    car.planner(0.5, 0.56, speed=1.0)
    assert car.stop(speed=0.4).fraction == -0.5


def test_car_that_a_hill_rolls_backward_is_armed_again_after_a_second_of_neutral_and_may_get_no_faster():
    car = Car()
    car.stop(3.0, speed=0.0)
    assert car.stop(0.24, speed=-0.4)[1:3] == (ARMING, causes.ESC_MOTION)
    assert car.decision.reason.endswith("; 1.0 s of neutral to go")
    assert car.stop(0.9, speed=-0.4).state == ARMING
    assert car.stop(0.1, speed=-0.4).state == car.stop(1.0, speed=-0.4).state == NEUTRAL
    assert car.stop(0.3, speed=-0.7).state == ARMING


def small_pushes(value, cruise_mps, speed_mps, profile=SEQUENCE, **changes):
    """What the ESC gets of a small value for two seconds, forward or, after two pulls, backward."""
    car = Car(profile)
    if value < 0:
        pulled_twice(car, 0.0)
        car.ask(Request(-0.3, REVERSE_GEAR, is_centered=True), 1.5, -0.3)
    else:
        car.planner(0.3, 0.5, 0.3)
    request = Request(value, REVERSE_GEAR if value < 0 else DRIVE, is_centered=True, cruise_mps=cruise_mps)
    return [car.ask(request._replace(**changes), speed=speed_mps).fraction for _ in range(100)]


@pytest.mark.parametrize("value", [0.01, 0.03, 0.04, 0.07, -0.01, -0.05])
def test_push_in_the_dead_band_by_which_a_planner_keeps_a_speed_comes_in_pulses_of_the_least_push(value):
    sign = math.copysign(1.0, value)
    fractions = small_pushes(value, sign * 0.3, sign * 0.3)
    assert set(fractions) == {0.0, sign * 0.08}
    assert sum(fractions) / len(fractions) == pytest.approx(value, abs=0.0017)


def test_pulses_begin_anew_after_each_pause_of_them():
    car, request = Car(), Request(0.01, DRIVE, is_centered=True, cruise_mps=0.3)
    for _ in range(2):
        car.ask(request._replace(cruise_mps=0.0), speed=0.3)
        assert car.esc.step(request, car.now_ns).fraction == 0.0  # no time has passed
        assert [car.ask(request, speed=0.3).fraction for _ in range(4)] == [0.08, 0.0, 0.0, 0.0]
    assert any(car.ask(request).fraction for _ in range(7))
    assert not any(car.ask(request).fraction for _ in range(50))  # its speed is older than 0.15 s


@pytest.mark.parametrize("value, cruise_mps, speed_mps, changes", [
    pytest.param(0.04, 0.0, 0.3, {}, id="no_speed_is_kept"),
    pytest.param(0.04, 0.3, 0.3, {"is_human": True}, id="a_person_drives"),
    pytest.param(0.04, 0.3, 0.3, {"is_stop": True}, id="it_stops"),
    pytest.param(0.04, 0.3, 0.0, {}, id="it_stands"),
    pytest.param(0.04, -0.3, 0.3, {}, id="the_speed_is_the_other_way"),
    pytest.param(-0.04, -0.3, -0.3, {"profile": TURNS}, id="each_neutral_costs_this_esc_its_dwell")])
def test_push_in_the_dead_band_is_neutral_where(value, cruise_mps, speed_mps, changes):
    assert not any(small_pushes(value, cruise_mps, speed_mps, **changes)[5:])


def brakes_downhill(profile, speed, cruise=0.3, age_ms=20, is_stop=False, value=-1.0, **config):
    """What a whole brake becomes where the car got faster in neutral; its speed doesn't change meanwhile."""
    car = Car(profile, **config)
    request = Request(0.0, DRIVE, is_centered=True, cruise_mps=cruise)
    car.ask(request._replace(value=0.3), 0.2, speed - 0.1)
    car.ask(request, 0.3, speed - 0.1)
    car.ask(request, 0.1, speed)
    car.now_ns += 20 * MS
    car.measure(speed, age_ms * MS)
    return car.ask(request._replace(value=value, is_stop=is_stop)).fraction


@pytest.mark.parametrize("profile", [SEQUENCE, *UNSURE])
@pytest.mark.parametrize("speed, cruise, age_ms, brake", [
    (0.4, 0.3, 20, 0.4 / 0.14 / 16), (0.4, 0.3, 120, 0.4 / 0.24 / 16), (0.8, 0.3, 20, 0.8 / 0.14 / 16),
    (2.0, 0.3, 20, 1.0),
    (0.21, 0.1, 20, 0.21 / 0.14 / 16), (0.21, 0.1, 60, 0.0),  # less than the ESC takes for a pull
    (0.8, 0.3, 120, 0.8 / 0.24 / 16), (0.8, 0.3, 140, 0.0),  # an old speed
    (0.4, 0.3, 0, 0.0),  # nobody knows how old its speed is
    (0.4, 0.0, 20, 0.4 / 0.14 / 16)])
def test_downhill_a_car_is_braked_by_a_pull_so_weak_that_it_ends_before_it_becomes_reverse(
        profile, speed, cruise, age_ms, brake):
    assert brakes_downhill(profile, speed, cruise, age_ms) == pytest.approx(-brake)


@pytest.mark.parametrize("value, brake", [(-0.079, 0.0), (-0.08, -0.08), (-0.1, -0.1)])
def test_downhill_a_pull_that_is_weak_itself_is_given_as_it_is(value, brake):
    assert brakes_downhill(TURNS, 0.4, value=value) == brake


@pytest.mark.parametrize("profile, brake", [
    (TURNS, 0.4 / 0.14 / 16), (DIRECT, 0.4 / 0.14 / 16), (SEQUENCE, 0.4 / 0.31 / 16), ("unverified", 0.0)])
def test_downhill_a_stop_brakes_as_weakly_unless_nobody_has_said_what_the_esc_is(profile, brake):
    """A brake_then_reverse's pull the board holds for longer, if this node stands still."""
    assert brakes_downhill(profile, 0.4, is_stop=True) == pytest.approx(-brake)


def test_a_brake_that_may_reverse_ends_soon_where_odometry_repeats_a_speed():
    car, pulls = Car(TURNS), []
    car.stick(0.5, 0.5, speed=1.5)
    for _ in range(20):
        car.now_ns += 20 * MS
        car.esc.update_speed(1.5, car.now_ns, 0)
        pulls.append(car.stick(-0.5).fraction)
    assert pulls[0] < 0.0 and not any(pulls[6:])


def test_a_weak_pull_waits_until_the_motor_has_let_go_of_a_stronger_one():
    car = Car(DIRECT)
    request = Request(0.0, DRIVE, is_centered=True, cruise_mps=0.3)
    car.ask(request._replace(value=0.3), 0.2, 1.9)
    car.ask(request, 0.3, 1.9)
    car.ask(request, 0.1, 2.0)
    assert car.ask(request._replace(value=-1.0), 0.3, 2.0).fraction == -1.0
    pulls = []
    for _ in range(30):
        car.now_ns += 20 * MS
        car.measure(0.5, 20 * MS)
        pulls.append(car.ask(request._replace(value=-1.0)).fraction)
    assert not any(pulls[:5]) and pulls[-1] < 0.0


@pytest.mark.parametrize("speed, cruise, age_ms, fraction", [
    (-0.4, -0.3, 0, 0.25), (-0.4, -0.4, 0, 0.0), (-0.29, -0.3, 0, 0.0), (-0.4, -0.3, 160, 0.0),
    (-0.25, -0.2, 0, 0.25), (-0.19, -0.16, 0, 0.0), (-0.4, 0.0, 0, 0.0), (-2.0, 0.0, 0, 0.5)])
def test_backward_downhill_a_planner_s_car_is_braked_by_a_gentle_push_while_it_rolls_faster_than_asked(
        speed, cruise, age_ms, fraction):
    car = Car()
    pulled_twice(car, 0.0)
    request = Request(-0.3, REVERSE_GEAR, is_centered=True, cruise_mps=cruise)
    car.ask(request, 0.5, speed + 0.05)
    car.ask(request._replace(value=0.0), 0.3, speed + 0.05)
    car.ask(request._replace(value=0.0), 0.1, speed)  # it gets faster in neutral
    car.now_ns += 20 * MS
    car.noise = 0.0
    car.measure(speed, age_ms * MS)
    assert car.ask(request._replace(value=0.5)).fraction == fraction


def test_a_planner_s_car_that_a_hill_drives_backward_in_reverse_gear_isn_t_disarmed_and_another_is():
    for cruise_mps, state in ((-0.3, BRAKING), (0.0, ARMING)):
        car = Car()
        pulled_twice(car, 0.0)
        car.ask(Request(-0.3, REVERSE_GEAR, is_centered=True, cruise_mps=cruise_mps), 0.5, -0.3)
        for speed in (-0.3, -0.4, -0.5, -0.6, -0.7, -0.8, -0.8, -0.8, -0.8):
            car.ask(Request(0.3, REVERSE_GEAR, is_centered=True, cruise_mps=cruise_mps), 0.1, speed)
        assert car.decision.state == state


@pytest.mark.parametrize("still_ms, brakes", [(180, True), (200, True), (220, False), (600, False)])
def test_brake_that_the_board_may_have_ended_while_the_node_stood_still_is_no_brake_any_more(still_ms, brakes):
    """Whether it has said so or not: neutral lets this ESC take the next pull for reverse."""
    car = Car(profile_measured=True)
    car.stick(0.5, 0.5)
    car.stop(0.3)
    car.now_ns += (still_ms - 20) * MS
    assert car.stop().fraction == (-0.5 if brakes else 0.0)


def test_stop_brakes_no_longer_than_its_time_and_not_at_standstill():
    car = Car(profile_measured=True, stop_brake_time_s=1.0)
    car.stick(0.5, 0.5)
    answers = [car.stop()[::3] for _ in range(60)]
    assert answers[50] == (-0.5, "it brakes")
    assert answers[51] == (0.0, "it has braked for 1 s") and answers[52] == (0.0, "it stops in neutral")
    standing = Car(profile_measured=True)
    standing.drive_and_brake_to_standstill()
    assert standing.stop(speed=0.0).fraction == 0.0


@pytest.mark.parametrize("profile, is_measured, on_s", [
    (SEQUENCE, True, 0.2), (NO_REVERSE, True, 0.2), (SEQUENCE, False, 0.0), (TURNS, True, 0.0), (DIRECT, True, 0.0)])
def test_a_stop_that_is_certain_brakes_on_for_0_2_s_at_odometry_s_standstill(profile, is_measured, on_s):
    """Which is anything below 0.1 m/s: neutral would let the car roll on a hill. Also after esc/stop_brake_time."""
    car = Car(profile, armed=False, profile_measured=is_measured, stop_brake_time_s=0.5)
    car.stop(1.1)
    car.stick(0.5, 0.5, speed=2.0)
    for step in range(48):
        car.stop(speed=2.0 - 0.04 * step)
    car.stop(speed=0.09)  # after 0.12 m/s the wheels may have locked, and the car slide for 0.04 s
    braked = [car.stop(speed=0.09)[:2] for _ in range(30)]
    assert braked == [(-0.5, BRAKING)] * round(on_s / 0.02) + [(0.0, NEUTRAL)] * round((0.6 - on_s) / 0.02)


def test_a_stop_of_a_car_that_already_stood_does_not_brake():
    car = Car(profile_measured=True)
    car.stick(0.5, 0.6, speed=0.0)
    assert car.stop(speed=0.0)[:2] == (0.0, NEUTRAL)


def test_stop_brakes_on_while_the_car_is_known_to_roll():
    car = Car(profile_measured=True, stop_brake_time_s=1.0)
    car.stick(0.5, 0.5, speed=2.0)
    assert car.stop(3.0, speed=2.0)[::3] == (-0.5, "it brakes")
    assert car.stop(0.6).fraction == 0.0  # its speed is lost


@pytest.mark.once
@pytest.mark.parametrize("profile, is_measured, rolls_mps, holds", [
    (SEQUENCE, True, 0.6, True), (NO_REVERSE, True, 0.6, True), (SEQUENCE, True, 0.4, False),
    (SEQUENCE, False, 0.6, False), (TURNS, True, 0.6, False)])
def test_stop_holds_the_car_where_neutral_is_known_to_roll_and_the_brake_is_certain(
        profile, is_measured, rolls_mps, holds):
    car = Car(profile, profile_measured=is_measured, armed=False)
    car.stop(1.1)
    car.stick(0.5, 0.5, speed=0.5)
    car.stick(0.0, 0.3, speed=0.5)
    car.stick(0.0, 0.1, speed=rolls_mps)
    car.stop(0.2, speed=0.5)
    decision = car.stop(30.0, speed=0.0)
    assert decision[:2] == ((-0.5, HOLD) if holds else (0.0, NEUTRAL))
    assert ("stands on a hill" in decision.reason) == holds
    assert car.stop(0.1, speed=-0.2).fraction == 0.0  # it rolls back, or the ESC was powered anew


def test_stop_with_an_unknown_chip_or_from_reverse_is_neutral_and_never_a_push_forward():
    car = Car()
    car.stick(0.5, 0.5, speed=3.0)
    car.board_says = False
    car.stick(0.5, 2.6, speed=3.0)
    assert car.stop(speed=3.0).fraction == 0.0
    reversing = Car(profile_measured=True)
    pulled_twice(reversing, 0.0)
    reversing.stick(-0.5, 0.5, speed=-2.0)
    assert {reversing.stop(speed=-2.0).fraction for _ in range(100)} == {0.0}


def test_rolling_backward_under_a_brake_disproves_the_profile_and_ends_in_neutral_until_rearmed():
    car = Car(profile_measured=True)
    car.drive_and_brake_to_standstill(planner=True)
    decision = car.planner(-0.5, 0.5, speed=-0.4)
    assert decision[:3] == (0.0, ARMING, "esc motion")
    assert decision.reason.startswith("it rolled backward at 0.4 m/s without reverse: esc/profile is wrong, or this is "
                                      "a hill; let go of the deadman")
    assert car.planner(0.5, 2.0, speed=0.0).fraction == 0.0
    car.stop(1.2, speed=0.0)
    assert car.planner(0.5, speed=0.0).fraction == 0.5
    car.planner(0.5, 1.0)
    assert car.stop().fraction == 0.0


def test_rolling_forward_in_reverse_ends_in_neutral_or_is_a_brake_where_reverse_began_without_speed():
    car = Car()
    pulled_twice(car, 0.0)
    assert car.stick(-0.5, 0.5, speed=0.4).cause == "esc motion"
    blind = Car()
    for speed in (0.0, None):  # what it saw of the first time is over
        blind.stick(0.5, 0.6)
        pulled_twice(blind, speed)
    assert blind.stick(-0.5, 1.0, speed=3.0)[:2] == (-0.5, BRAKING)
    assert blind.stick(-0.5, 3.0, speed=0.0).fraction == 0.0
    again = Car()
    pulled_twice(again, 0.0)
    again.stick(0.0)
    again.esc.mark_stale()
    assert again.stick(-0.5).state == REVERSE
    assert again.stick(-0.5, 0.1, speed=3.0)[:2] == (-0.5, BRAKING)


def test_calibration_drive_passes_a_person_s_stick_once_it_is_armed_and_nobody_else_s():
    car = Car("unverified", calibration_drive=True, armed=False)
    assert car.stick(0.5, 3.0, speed=0.0)[:2] == (0.0, ARMING)
    car.stop(1.1)
    for value, seconds, speed, state in (
            (0.5, 0.5, 2.0, FORWARD), (-0.5, 0.1, 2.0, BRAKING), (-0.5, 2.0, 0.0, REVERSE), (-0.5, 2.0, -1.0, REVERSE),
            (0.5, 0.1, -1.0, BRAKING), (0.0, 1.0, 0.0, NEUTRAL), (0.01, 0.1, 0.0, FORWARD), (-0.01, 0.1, 0.0, REVERSE)):
        assert car.stick(value, seconds, speed)[:4] == (
            value, state, "calibration drive",
            "calibration drive: the ESC gets the stick as it is, and a brake may become reverse")
    assert car.stop(speed=-1.0).fraction == 0.0
    assert car.planner(-0.5, speed=0.0).fraction == car.planner(0.01, speed=0.0).fraction == 0.0


def test_person_s_pull_in_the_planner_s_gear_drive_pushes_against_a_car_that_rolls_backward_fast_enough():
    car = Car()
    pulled_twice(car, 0.0)
    car.stick(-0.5, 0.6, speed=-2.0)
    pull = Request(-0.4, DRIVE, is_human=True)
    assert car.ask(pull, 0.4, speed=-2.0)[:2] == (0.4, BRAKING)
    assert car.ask(pull, speed=-0.7)[:3] == (0.0, NEUTRAL, "at standstill")
    car.stick(0.5, 0.5, speed=2.0)
    assert car.ask(pull, speed=2.0)[:2] == (-0.4, BRAKING)


@pytest.mark.parametrize("rolled_s, ends", [(0.3, NEUTRAL), (0.6, REVERSE)])
def test_second_pull_never_becomes_reverse_if_the_newest_speed_of_the_half_second_before_it_was_forward(rolled_s, ends):
    car = Car(TURNS)
    car.stick(0.5, 0.5, speed=0.4)
    car.stick(-0.5, 0.1, speed=0.4)
    car.stick(0.0, 0.1, speed=0.4)
    car.stick(0.0, rolled_s)
    assert car.stick(-0.5, 5.0).state == ends


@pytest.mark.parametrize("stop_brake, holds", [(0.5, True), (0.0, False)])
def test_stop_of_a_car_that_a_hill_drives_holds_the_brake_that_it_began_while_it_rolled(stop_brake, holds):
    car = Car(profile_measured=True, stop_brake=stop_brake)
    cruise = Request(0.0, DRIVE, is_centered=True, cruise_mps=0.3)
    for value, seconds, speed in (
            (0.3, 0.5, 0.5), (0.0, 0.3, 0.5), (0.0, 0.1, 0.7), (-0.5, 0.3, 0.5), (-0.5, 0.3, 0.0)):
        car.ask(cruise._replace(value=value), seconds, speed)
    assert car.stop(speed=0.0).state == (HOLD if holds else NEUTRAL)
    decision = car.stop(20.0, speed=0.0)
    assert decision[:4] == ((-0.5, HOLD, "stopping", "it stands on a hill, and the brake holds it") if holds else
                            (0.0, NEUTRAL, "stopping", "it stops in neutral"))
