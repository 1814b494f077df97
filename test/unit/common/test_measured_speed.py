"""The measured speed, and how fast the car may be once a command takes effect."""
import math

import pytest

from car_interface.common.measured_speed import MeasuredSpeed

MS, S = 1_000_000, 1_000_000_000


def fed(speeds, step_ns=20 * MS, timeout_s=0.5):
    measured = MeasuredSpeed(timeout_s)
    for index, speed_mps in enumerate(speeds):
        measured.update(speed_mps, index * step_ns)
    return measured, (len(speeds) - 1) * step_ns


def test_before_the_first_it_is_unknown_and_lost():
    measured = MeasuredSpeed(0.5)
    assert not measured.was_received and measured.is_stale(0) and math.isnan(measured.last_mps)
    assert measured.stale_reason(0) == "odom was never heard" and measured.age_s(0) == math.inf
    assert measured.magnitude_mps == 0.0


@pytest.mark.parametrize("speed_mps", [3.0, -3.0])
def test_a_steady_car_is_as_fast_as_it_was(speed_mps):
    measured, now_ns = fed([speed_mps] * 20)
    assert measured.was_received and measured.last_mps == speed_mps and measured.highest_mps(now_ns) == 3.0


@pytest.mark.parametrize("sign", [1, -1])
def test_one_that_gets_faster_will_be_faster_when_the_servo_has_turned(sign):
    measured, now_ns = fed([0.0] * 60 + [sign * 0.1 * index for index in range(31)])  # 5 m/s² up to 3 m/s
    assert measured.highest_mps(now_ns) == pytest.approx(3.0 + 5.0 * 0.06)
    assert measured.highest_mps(now_ns + 40 * MS) == pytest.approx(3.0 + 5.0 * 0.10, abs=0.001)


def test_an_acceleration_is_measured_over_a_tenth_of_a_second():
    measured, now_ns = fed([2.0, 2.0, 2.0, 2.0, 2.2])
    assert measured.highest_mps(now_ns) == 2.2
    measured.update(2.2, now_ns + 20 * MS)
    assert measured.highest_mps(now_ns + 20 * MS) == pytest.approx(2.2 + 2.0 * 0.06)


def test_while_reports_are_missing_it_may_be_at_full_throttle_and_then_they_are_late():
    measured, now_ns = fed([2.0] * 100)
    assert measured.highest_mps(now_ns + 40 * MS) == pytest.approx(2.0, abs=0.001)
    assert measured.highest_mps(now_ns + 100 * MS) == pytest.approx(2.0 + 6.0 * 0.06, abs=0.001)
    assert not measured.is_late(now_ns + 139 * MS) and measured.is_late(now_ns + 141 * MS)
    assert measured.highest_mps(now_ns + S) == pytest.approx(2.0 + 6.0 * 0.10, abs=0.001)


@pytest.mark.parametrize("speeds, step_ns, late_s", [
    ([2.0] * 2, 100 * MS, 0.3),
    ([2.0] * 100, 100 * MS, 0.3),
    ([2.0] * 100, S, 0.5),
    ([2.0], S, 0.5),  # as a standing car's odometry
])
def test_reports_that_come_slowly_are_late_later(speeds, step_ns, late_s):
    measured, now_ns = fed(speeds, step_ns)
    late_ns = now_ns + round(late_s * S)
    assert not measured.is_late(late_ns) and measured.is_late(late_ns + MS)


def test_their_period_is_the_mean_of_about_eight():
    measured, now_ns = fed([2.0] * 100)
    measured.update(2.0, now_ns + 100 * MS)  # after 20 ms each: a mean of 30 ms
    assert not measured.is_late(now_ns + 259 * MS) and measured.is_late(now_ns + 261 * MS)


def test_a_lost_speed_stays_and_stops_rising():
    measured, now_ns = fed([0.0] * 60 + [0.1 * index for index in range(31)])
    assert measured.is_stale(now_ns + S) and measured.stale_reason(now_ns + S) == "odom silent for 1.00 s"
    assert measured.highest_mps(now_ns + S) == measured.highest_mps(now_ns + 60 * S) == pytest.approx(
        3.0 + 5.0 * 0.2 + 6.0 * 0.1, abs=0.001)


@pytest.mark.parametrize("speed_mps, is_lost", [(math.nan, True), (-math.inf, True), (100.1, True), (-100.0, False)])
def test_what_is_no_speed_makes_it_lost_and_leaves_the_last(speed_mps, is_lost):
    measured, now_ns = fed([2.0, speed_mps])
    assert measured.is_stale(now_ns) == is_lost and measured.last_mps == (2.0 if is_lost else speed_mps)
    measured.update(2.1, now_ns + MS)
    assert not measured.is_stale(now_ns + MS)
    measured.mark_stale()
    assert measured.is_stale(now_ns + MS) and "messages were dropped" in measured.stale_reason(now_ns)


def test_after_a_silence_a_jump_is_no_acceleration_and_a_car_that_was_stopped_meanwhile_stands():
    measured, now_ns = fed([1.0, 1.0])
    measured.update(5.0, now_ns + 2 * S)
    assert measured.highest_mps(now_ns + 2 * S) == 5.0
    measured.update(0.0, now_ns + 3 * S)
    assert measured.magnitude_mps == 0.0


def test_no_acceleration_beyond_what_tyres_do_is_believed():
    measured, now_ns = fed([0.0] * 6 + [9.0] * 5)
    assert measured.highest_mps(now_ns) <= 9.0 + 10.0 * 0.06 + 1e-9


def test_wheels_that_lock_make_no_slow_car():
    measured, now_ns = fed([3.0] * 5 + [0.0] * 11)  # 0.22 s locked, on dust
    assert measured.last_mps == 0.0
    assert measured.magnitude_mps == measured.highest_mps(now_ns) == pytest.approx(3.0 - 3.0 * 0.22)
    measured.update(2.3, now_ns + 20 * MS)
    assert measured.magnitude_mps == 2.3


@pytest.mark.parametrize("after_mps, believed_mps", [(2.53, 2.53), (2.52, 2.52), (2.51, 2.94)])
def test_a_fall_is_believed_that_a_tyre_and_noise_can_make_and_else_the_car_slides(after_mps, believed_mps):
    measured, _ = fed([3.0, 3.0, after_mps])  # 10 m/s² · 20 ms + 0.1 m/s + 6 %: by up to 0.48 m/s
    assert measured.magnitude_mps == pytest.approx(believed_mps)


def test_a_hard_brake_is_believed_and_counts_as_fast_as_it_was_measured():
    measured, now_ns = fed([5.0 - 9.0 * 0.02 * index for index in range(20)])
    assert measured.magnitude_mps == measured.highest_mps(now_ns) == pytest.approx(5.0 - 9.0 * 0.38)


@pytest.mark.parametrize("late_ms, gained_mps", [(0, 0.0), (20, 0.0), (150, 6.0 * 0.13), (300, 6.0 * 0.28)])
def test_late_reports_leave_room_for_full_throttle_since_they_were_measured_and_are_not_missing(late_ms, gained_mps):
    measured = MeasuredSpeed(0.5)
    for index in range(100):
        now_ns = S + index * 20 * MS
        measured.update(2.0, now_ns, late_ms * MS)
    assert not measured.is_late(now_ns) and measured.age_s(now_ns) == pytest.approx(late_ms / 1000)
    assert measured.highest_mps(now_ns + 20 * MS) == pytest.approx(2.0 + gained_mps)


def test_time_that_a_report_took_is_none_in_which_a_car_slowed_down():
    measured = MeasuredSpeed(1.0)
    measured.update(4.0, 0)
    measured.update(0.0, 500 * MS, age_ns=400 * MS)  # the wheels stood 0.1 s after the first
    assert measured.magnitude_mps == pytest.approx(4.0 - 3.0 * 0.1)
