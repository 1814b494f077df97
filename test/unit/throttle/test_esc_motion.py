"""The measured speed: standstill, the least speed, motion against the ESC's state, a hill that drives the car."""

import math

import pytest

from car_interface.throttle.esc_config import EscConfig
from car_interface.throttle.esc_motion import HillWatch, MeasuredMotion, MotionCheck

MS = 1_000_000
S = 1000 * MS


def motion(*speeds):
    """Speeds at 0, 100, 200 … ms."""
    measured = MeasuredMotion(EscConfig())
    for index, speed_mps in enumerate(speeds):
        measured.update(speed_mps, index * 100 * MS)
    return measured


@pytest.mark.parametrize("speeds, age_ms, speed_mps", [
    ([], 0, None), ([1.0], 500, 1.0), ([1.0], 501, None), ([1.0, math.nan], 0, None), ([1.0, math.inf, 2.0], 0, 2.0),
    ([1.0, 100.1], 0, None), ([1.0, -1e308], 0, None), ([-100.0], 0, -100.0)])
def test_speed_is_unknown_before_the_first_after_half_a_second_and_if_it_is_no_car_s(speeds, age_ms, speed_mps):
    measured = motion(*speeds)
    assert measured.speed_mps((max(0, len(speeds) - 1) * 100 + age_ms) * MS) == speed_mps
    if not speeds:
        assert (measured.measured_ns, measured.is_stamped) == (-math.inf, False)
    measured.mark_stale()
    assert measured.speed_mps(0) is None and not measured.rolls_forward(0) and not measured.stands(0)


@pytest.mark.parametrize("speed_mps, stands, forward, backward", [
    (0.0, True, False, False), (0.09, True, False, False), (0.1, False, True, False), (-0.09, True, False, False),
    (-0.1, False, False, True)])
def test_standstill_is_below_a_tenth_of_a_meter_a_second(speed_mps, stands, forward, backward):
    measured, later_ns = motion(speed_mps), 100 * MS  # no longer as if its wheels were locked
    assert (measured.stands(later_ns), measured.rolls_forward(later_ns),
            measured.rolls_backward(later_ns)) == (stands, forward, backward)


@pytest.mark.parametrize("silent_ms, speed_mps, sigma_mps, is_known", [
    (151, 2.0, 0.31, False), (151, -2.0, 0.31, False), (151, 2.0, 0.3, True), (150, 2.0, 9.0, True),
    (151, 8.0, 0.8, True), (151, 8.0, 0.81, False), (151, 0.09, 9.0, True), (151, 0.1, 9.0, False)])
def test_uncertain_speed_of_a_rolling_car_is_unknown_after_a_silence(silent_ms, speed_mps, sigma_mps, is_known):
    measured = motion(2.0)
    measured.update(speed_mps, silent_ms * MS, 0, sigma_mps)
    assert (measured.speed_mps(silent_ms * MS) is not None) == is_known


def test_it_stays_unknown_until_one_is_certain_and_then_later_ones_count_again():
    measured = motion()
    for at_ms, sigma_mps, is_known in ((0, 0.5, False), (20, 0.5, False), (40, 0.1, True), (60, 0.5, True)):
        measured.update(2.0, at_ms * MS, 0, sigma_mps)
        assert (measured.speed_mps(at_ms * MS) == 2.0) == is_known
    measured.update(2.0, S, 0, 0.5)
    assert measured.unknown_reason(S) == "odom was not heard since it was uncertain by 0.5 m/s"


def test_locked_wheels_are_no_standstill_until_the_car_must_have_stopped():
    locked = motion(1.0, 3.0, 0.0)  # 3 m/s ÷ 3 m/s²: a second after it was measured
    assert locked.rolls_forward(200 * MS) and not locked.stands(200 * MS)
    locked.update(0.0, 1099 * MS)
    assert not locked.stands(1099 * MS)
    locked.update(0.0, 1100 * MS)
    assert locked.stands(1100 * MS) and not locked.rolls_forward(1100 * MS)


def test_least_speed_falls_with_the_age_of_the_last():
    measured = motion(2.0)
    assert measured.least_speed_mps(0) == pytest.approx(2.0 - 8 * 0.04)
    assert measured.least_speed_mps(100 * MS) == pytest.approx(2.0 - 8 * 0.14)
    assert measured.least_speed_mps(400 * MS) == 0 and motion().least_speed_mps(0) == 0
    assert motion(-2.0).least_speed_mps(0) == pytest.approx(2.0 - 8 * 0.04)


@pytest.mark.parametrize("speed_mps, age_ms, rolls", [
    (0.81, 0, True), (0.79, 0, False), (-0.81, 0, True), (1.61, 100, True), (1.59, 100, False)])
def test_a_pull_is_outlasted_by_what_the_tyres_cannot_stop_until_the_board_has_ended_it(speed_mps, age_ms, rolls):
    for measured in (MeasuredMotion(EscConfig()), MeasuredMotion(EscConfig())):
        measured.update(speed_mps, S, age_ms * MS)
        assert measured.outlasts_a_pull(S) == rolls
    assert not motion().outlasts_a_pull(0) and motion().mps2_to_outlast_a_pull(0) == 0.0


@pytest.mark.parametrize("speed_mps, is_faster", [(1.0 + 1e-9, True), (1.0, False)])
def test_it_is_outlasted_only_by_a_car_that_is_faster_than_a_margin(speed_mps, is_faster):
    assert motion(speed_mps).outlasts_a_pull(0, above_mps=1.0) == is_faster


def test_a_speed_that_repeats_under_a_brake_is_no_newer_than_the_brake():
    measured = motion(1.5)
    for at_ms in (20, 40, 60, 80):
        measured.update(1.5, at_ms * MS)
    assert measured.least_speed_mps(80 * MS) == pytest.approx(1.5 - 8 * 0.04)  # a car may hold its speed
    for at_ms in (80, 100, 120, 140):
        measured.update_brake(at_ms * MS)
        measured.update(1.5, (at_ms + 10) * MS)
    assert measured.least_speed_mps(160 * MS) == pytest.approx(1.5 - 8 * 0.12)
    assert measured.outlasts_a_pull(160 * MS) and not measured.outlasts_a_pull(170 * MS)
    assert not measured.outlasts_a_pull(300 * MS, braked_since_ns=0)  # it isn't taken for a brake that hardly slows
    assert measured.mps2_to_outlast_a_pull(160 * MS) == pytest.approx(1.5 / 0.18)
    assert measured.speed_mps(500 * MS) == 1.5  # it is fresh all the same
    measured.update(1.4, 180 * MS)
    assert measured.least_speed_mps(180 * MS) == pytest.approx(1.4 - 8 * 0.04)


@pytest.mark.parametrize("slows_mps2, late_ms, speed_mps, rolls", [
    (2.0, 0, 0.4, True), (2.0, 0, 0.3, False),  # (1.25 · 2 + 1) · 0.1 s
    (5.6, 0, 0.9, True), (5.6, 0, 0.7, False),  # no more than 8 · 0.1 s
    (2.0, 100, 0.8, True), (2.0, 90, 0.6, False), (2.0, 110, 1.6, False),  # it may have hit something since
    (0.0, 0, 0.15, True), (0.0, 0, 0.09, False),  # a brake without effect may begin to have one: 1 · 0.1 s
])
def test_a_brake_that_is_held_slows_by_little_more_than_it_did(slows_mps2, late_ms, speed_mps, rolls):
    measured, since_ns = MeasuredMotion(EscConfig()), 0
    for index in range(30, -1, -1):
        at_ns = S - index * 20 * MS
        measured.update(speed_mps + slows_mps2 * index * 0.02, at_ns + late_ms * MS, late_ms * MS)
    now_ns = S + late_ms * MS
    assert measured.outlasts_a_pull(now_ns, 0.0, since_ns) == rolls
    assert not measured.outlasts_a_pull(now_ns, speed_mps, since_ns)
    assert measured.outlasts_a_pull(now_ns, 0.0, S - 230 * MS) == rolls
    assert not measured.outlasts_a_pull(now_ns, 0.0, S - 229 * MS) or speed_mps > 0.8  # braked for too short a time


@pytest.mark.parametrize("speed_mps, rolls", [(0.48, True), (0.46, False)])
def test_what_a_brake_did_more_than_0_3_s_ago_does_not_count(speed_mps, rolls):
    measured = MeasuredMotion(EscConfig())
    for index in range(30, -1, -1):  # 0.3 m/s in 20 ms, and then 2 m/s²: 0.9 m/s in 0.3 s, times 1.25, and 1
        measured.update(speed_mps + 0.04 * min(index, 15) + 0.3 * (index > 14), S - index * 20 * MS)
    assert measured.outlasts_a_pull(S, 0.0, 0) == rolls


def test_a_speed_is_as_old_as_it_was_when_it_arrived():
    measured = MeasuredMotion(EscConfig())
    measured.update(3.0, S, 300 * MS)
    assert measured.measured_ns == 700 * MS
    assert measured.least_speed_mps(S) == pytest.approx(3.0 - 8 * 0.34)
    assert measured.speed_mps(1200 * MS) == 3.0 and measured.speed_mps(1201 * MS) is None
    measured.update(0.0, 1650 * MS, 300 * MS)
    assert measured.stands(1700 * MS) and not measured.stands(1699 * MS)  # 3 m/s ÷ 3 m/s² after it was measured


@pytest.mark.parametrize("age_ns, measured_ns, is_stamped", [(-1, S, False), (0, S, False), (1, S - 1, True)])
def test_speed_has_a_stamp_if_it_says_an_age(age_ns, measured_ns, is_stamped):
    measured = MeasuredMotion(EscConfig())
    measured.update(1.0, S, age_ns)
    assert (measured.measured_ns, measured.is_stamped) == (measured_ns, is_stamped)


def test_speed_is_fresh_for_150_ms_since_it_was_measured():
    measured = MeasuredMotion(EscConfig())
    assert not measured.is_fresh(S)
    measured.update(1.0, S, 50 * MS)
    assert measured.is_fresh(S + 100 * MS) and not measured.is_fresh(S + 100 * MS + 1)


@pytest.mark.parametrize("speed_mps, since_ns, rolled", [
    (0.1, 0, True), (0.1, 1, False), (0.099, 0, False), (-1.0, 0, False)])
def test_newest_speed_says_whether_it_rolled_forward_since(speed_mps, since_ns, rolled):
    assert motion(speed_mps).rolled_forward_since(since_ns) == rolled


@pytest.mark.parametrize("speed_mps, stands", [(0.099, True), (0.1, False), (-0.1, False)])
def test_wheels_that_turned_faster_than_at_standstill_may_be_locked(speed_mps, stands):
    measured = motion(speed_mps)
    measured.update(0.0, 33 * MS)
    assert measured.stands(33 * MS) == stands and measured.stands(34 * MS)  # 0.1 m/s ÷ 3 m/s²


def test_car_may_roll_backward_until_a_speed_was_measured_once_the_motor_has_let_go_of_reverse():
    measured = motion(0.0)
    assert not measured.may_roll_backward(0)
    for at_ms, may in ((100, True), (150, True), (151, False), (152, False)):
        if at_ms < 101:
            measured.update_reverse(0)
        measured.update(0.0, at_ms * MS)
        assert measured.may_roll_backward(at_ms * MS) == may


def test_car_that_rolled_backward_may_do_so_until_a_later_speed_says_otherwise():
    measured = motion(-0.1)
    assert measured.may_roll_backward(0) and measured.may_roll_backward(10 * S)
    measured.update(-0.1, 20 * S)
    assert measured.may_roll_backward(20 * S)
    measured.update(-0.09, 20 * S)
    assert measured.may_roll_backward(20 * S)
    measured.update(-0.09, 20 * S + 1)
    assert not measured.may_roll_backward(20 * S + 1) and not measured.may_roll_backward(30 * S)


def test_without_odometry_a_car_has_rolled_out_3_s_after_the_motor_let_go():
    measured = motion()
    measured.update_reverse(0)
    assert measured.may_roll_backward(3150 * MS) and not measured.may_roll_backward(3150 * MS + 1)
    lost = motion(0.0)
    lost.update_reverse(0)
    assert lost.may_roll_backward(10 * S)


def checked(*speeds, is_reverse=False, after_reverse=False, late_ms=0):
    """The first text of a check with speeds 50 ms apart, and when; after a standstill."""
    check, measured = MotionCheck(EscConfig()), MeasuredMotion(EscConfig())

    def text_of(speed_mps, was_reverse, at_ms):
        measured.update(speed_mps, S + at_ms * MS, late_ms * MS)
        return check.check(measured, was_reverse, S + at_ms * MS)

    assert text_of(0.0, is_reverse, 0) == ""
    if after_reverse:
        assert text_of(speeds[0], True, 0) == ""
    for index, speed_mps in enumerate(speeds):
        text = text_of(speed_mps, is_reverse, index * 50)
        if text:
            return text, index * 50
    return "", None


@pytest.mark.parametrize("speeds, reverse, found", [
    ([-0.3] * 9, {}, ("it rolled backward at 0.3 m/s without reverse", 200)),
    ([-0.19] * 9, {}, ("", None)),
    ([-0.3, -0.3, -0.3, 0.0, -0.3, -0.3], {}, ("", None)),
    ([0.4] * 9, {"is_reverse": True}, ("it rolled forward at 0.4 m/s in reverse", 200)),
    ([0.2] * 9, {"is_reverse": True}, ("", None)), ([-0.2] * 9, {}, ("", None)),
    ([-2.0] * 9, {"is_reverse": True}, ("", None)),
    # it may roll out after reverse, but neither get faster nor set off again
    ([-1.0, -0.9, -0.8, -0.7, -0.6, -0.5], {"after_reverse": True}, ("", None)),
    ([*[-1.0] * 4, -0.8, *[-1.1] * 9], {"after_reverse": True}, ("it rolled backward at 1.1 m/s without reverse", 450)),
    ([*[-1.0] * 4, -0.5, 0.0, *[-0.5] * 9], {"after_reverse": True},
     ("it rolled backward at 0.5 m/s without reverse", 500)),
    # the motor pushes on for a moment, and what is measured late was in reverse
    ([-0.4, -0.6, -0.8, *[-1.0] * 9], {"after_reverse": True}, ("", None)),
    ([-0.4, -0.5, -0.6, -0.7, -0.8, -0.9, -1.0, *[-1.1] * 9], {"after_reverse": True, "late_ms": 200}, ("", None)),
])
def test_motion_against_the_state_is_found_within_the_time(speeds, reverse, found):
    assert checked(*speeds, **reverse) == found


def test_unknown_speed_neither_tells_nor_forgets():
    check, measured = MotionCheck(EscConfig()), motion(0.0)
    check.check(measured, False, 0)
    measured.update(-0.5, 50 * MS)
    check.check(measured, False, 50 * MS)
    measured.mark_stale()
    assert check.check(measured, False, 300 * MS) == ""
    measured.update(-0.5, 350 * MS)
    assert check.check(measured, False, 350 * MS)


def found_at(*steps):
    """The times (ms) at which a check finds something, of (ms, speed, changes of what it is told)."""
    check, measured, found = MotionCheck(EscConfig()), MeasuredMotion(EscConfig()), []
    for at_ms, speed_mps, told in steps:
        measured.update(speed_mps, S + at_ms * MS)
        if check.check(measured, now_ns=S + at_ms * MS, **{"is_reverse": False, **told}):
            found.append(at_ms)
    return found


REVERSES, WANTED = {"is_reverse": True}, {"wants_backward": True}


def test_motion_against_the_state_that_lasts_is_found_again_after_the_time():
    assert found_at((0, 0.0, {}), *((at_ms, -0.5, {}) for at_ms in range(50, 600, 50))) == [250, 500]


@pytest.mark.parametrize("told", [REVERSES, WANTED])
def test_car_may_roll_out_as_fast_as_it_was_when_reverse_or_the_wish_for_it_was_seen_last(told):
    after = [(at_ms, -0.9, {}) for at_ms in range(300, 900, 50)]
    assert found_at((0, 0.0, {}), (50, -0.9, told), *after) == []
    assert found_at((0, 0.0, {}), *after) == [500, 750]


@pytest.mark.parametrize("slowed_mps, found", [(-0.09, [300]), (-0.1, [])])
def test_car_that_stood_may_not_set_off_backward_again(slowed_mps, found):
    assert found_at((0, -0.5, {}), (50, slowed_mps, {}), *((at_ms, -0.25, {}) for at_ms in (100, 200, 300))) == found


@pytest.mark.parametrize("late_ms, found", [(150, []), (151, [380])])
def test_car_may_get_faster_until_the_motor_has_let_go_of_reverse(late_ms, found):
    assert found_at((0, -0.5, REVERSES), (late_ms, -0.5, {}), *((at_ms, -0.9, {}) for at_ms in (180, 380))) == found


def test_car_that_reversed_without_a_speed_may_roll_out_of_it():
    check, measured = MotionCheck(EscConfig()), motion(0.0)
    assert not check.check(measured, False, 0)
    measured.mark_stale()
    assert not check.check(measured, True, S)
    for at_ms in range(1500, 2000, 50):
        measured.update(-0.5, at_ms * MS)
        assert not check.check(measured, False, at_ms * MS)


class Roll:
    def __init__(self):
        self.watch, self.motion = HillWatch(), MeasuredMotion(EscConfig())
        self.now_ns, self._speed_mps = S, 0.0

    def measure(self, speed_mps):
        self.now_ns += 20 * MS
        self.motion.update(speed_mps, self.now_ns)
        self.watch.step(0.0, self.motion, self.now_ns)

    def then(self, fraction, seconds, speed_mps, noise=0.0):
        """The speed changes evenly to that."""
        steps = round(seconds / 0.02)
        change_mps = (speed_mps - self._speed_mps) / steps
        for index in range(steps):
            self.now_ns += 20 * MS
            self._speed_mps += change_mps
            self.motion.update(self._speed_mps * (1 + noise * (-1) ** index), self.now_ns)
            self.watch.step(fraction, self.motion, self.now_ns)
        return self


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("speed_mps, after_mps, noise, drives", [
    (0.3, 0.36, 0.0, True), (0.3, 0.31, 0.0, False), (0.3, 0.2, 0.0, False),
    (3.0, 3.3, 0.0, True), (3.0, 2.7, 0.02, False), (3.0, 3.0, 0.01, False)])
def test_a_car_that_gets_faster_in_neutral_is_driven_by_a_hill(speed_mps, after_mps, noise, drives, sign):
    roll = Roll().then(sign * 0.3, 0.5, sign * speed_mps).then(0.0, 0.5, sign * after_mps, noise)
    assert roll.watch.drives_the_car == drives


def test_what_the_motor_still_does_just_after_a_push_is_no_hill():
    assert not Roll().then(0.3, 0.5, 0.3).then(0.0, 0.1, 0.36).watch.drives_the_car
    assert Roll().then(0.3, 0.5, 0.3).then(0.0, 0.12, 0.3).then(0.0, 0.02, 0.36).watch.drives_the_car


def test_a_car_at_just_more_than_standstill_rolls():
    assert Roll().then(0.3, 0.02, 0.1).then(0.0, 0.3, 0.1).then(0.0, 0.02, 0.13).watch.drives_the_car


@pytest.mark.parametrize("speed_mps, drives", [(0.3 * (1 + 0.03) + 0.02, True), (0.328, False)])
def test_a_gain_is_one_from_odometry_s_noise_on(speed_mps, drives):
    roll = Roll().then(0.3, 0.5, 0.3)
    for each_mps in (*[0.3] * 7, speed_mps):
        roll.measure(each_mps)
    assert roll.watch.drives_the_car == drives


@pytest.mark.parametrize("speed_mps, drives", [(0.36 - 0.05, False), (0.311, True)])
def test_a_loss_in_neutral_is_one_from_0_05_on(speed_mps, drives):
    roll = Roll().then(0.3, 0.5, 0.3)
    for each_mps in (*[0.3] * 7, 0.36, speed_mps):
        roll.measure(each_mps)
    assert roll.watch.drives_the_car == drives


def test_what_it_gained_while_its_speed_was_unknown_is_no_hill_s():
    roll = Roll().then(0.3, 0.5, 0.3).then(0.0, 0.5, 0.3)
    roll.motion.mark_stale()
    roll.watch.step(0.0, roll.motion, roll.now_ns)
    assert not roll.then(0.0, 0.02, 0.4).then(0.0, 0.3, 0.4).watch.drives_the_car


def test_it_counts_while_the_car_is_pushed_and_braked_until_it_stood_or_slowed_in_neutral():
    roll = Roll().then(0.3, 0.5, 0.3).then(0.0, 0.5, 0.4).then(-0.1, 1.0, 0.2).then(0.1, 1.0, 0.4)
    assert roll.watch.drives_the_car
    assert not roll.then(0.0, 0.5, 0.3).watch.drives_the_car
    roll.then(0.0, 0.5, 0.4)
    assert roll.watch.drives_the_car
    assert roll.then(-0.1, 0.5, 0.0).watch.drives_the_car  # a brake holds it there
    assert not roll.then(0.0, 0.04, 0.0).watch.drives_the_car
