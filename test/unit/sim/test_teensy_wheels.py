"""The simulated Teensy's wheels, specified as rules; test_captures.py holds them against captures of the original."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from car_interface.sim.teensy_wheels import BACKWARD, FORWARD, LEFT, RIGHT
from teensy_bench import MS, RESET, WHEELS, Bench, S, Wheel, fields, parse_wheels, wheel_bytes, wheel_reports


def test_first_report_after_a_boot_comes_at_once_and_says_nothing():
    bench = Bench().until(5 * MS)
    assert [fields(wheel) for wheel in parse_wheels(bench.frames(WHEELS)[0])] == [(0, 2, 0, 0, 0)] * 2


def test_wheels_that_have_never_turned_are_reported_every_201_ms_without_a_tick():
    bench = Bench().until(2020 * MS)
    assert len(bench.frames(WHEELS)) == 11
    assert set(bench.frames(WHEELS)) == {bytes([1, 2, WHEELS, 0]) + wheel_bytes(Wheel(0, 2, 0, 0, 0, 0)) * 2}


def test_wheels_that_stand_repeat_their_newest_entry_every_201_ms_with_the_present_tick():
    bench = Bench().until(500 * MS).roll(LEFT, FORWARD, 3, 30 * MS).roll(RIGHT, FORWARD, 3, 30 * MS).after(2 * S)
    reports = bench.frames(WHEELS)[-8:]
    for before, after in zip(reports, reports[1:]):
        for old, new in zip(parse_wheels(before), parse_wheels(after)):
            assert (new.dist, new.dist_abs, new.when - old.when) == (old.dist, old.dist_abs, 201)
    assert len({wheel.when for wheel in parse_wheels(reports[-1])}) == 1


@settings(max_examples=60)
@given(stop_ms=st.integers(300, 1500))
def test_first_repeat_comes_201_to_402_ms_after_the_last_pulse_s_report(stop_ms):
    bench = Bench().until((stop_ms - 50) * MS).roll(LEFT, FORWARD, 2, 25 * MS).after(S)
    ticks = [report.when for report in wheel_reports(bench)]
    last = 300 + stop_ms
    assert 201 <= ticks[ticks.index(last) + 1] - last <= 402


def test_first_repeat_s_time_goes_round_with_the_stop_s():
    gaps = set()
    for stop_ms in range(500, 701, 10):
        bench = Bench().until(stop_ms * MS).roll(LEFT, FORWARD, 1, MS).after(S)
        first, second = [report.when for report in wheel_reports(bench) if report.when][:2]
        gaps.add(second - first)
    assert min(gaps) < 215 and max(gaps) > 390


def test_wheel_that_stands_beside_one_that_turns_is_never_repeated():
    bench = Bench().until(500 * MS).roll(RIGHT, FORWARD, 12, 30 * MS).after(10 * MS)
    before = wheel_reports(bench, RIGHT)[-1]
    bench.roll(LEFT, FORWARD, 60, 100 * MS)
    assert len(bench.frames(WHEELS)) > 60
    assert wheel_reports(bench, RIGHT)[-1] == before and before.speed == 33


def test_wheel_that_has_never_turned_has_no_tick_beside_one_that_has():
    left, right = parse_wheels(Bench().until(S).roll(RIGHT, BACKWARD, 1, MS).after(2 * S).frames(WHEELS)[-1])
    assert (left.when, left.direction) == (0, 2)
    assert right.when > 3000


def test_wheels_that_race_are_reported_every_5_ms_and_no_pulse_is_lost():
    bench = Bench().until(500 * MS)
    bench.roll(LEFT, FORWARD, 1000, every_ns=1_070_000)  # 14 m/s
    reports = wheel_reports(bench.after(400 * MS))
    racing = [report.when for report in reports if 0 < report.dist_abs < 1000]
    assert {later - earlier for earlier, later in zip(racing, racing[1:])} <= {5, 6, 7}
    assert reports[-1].dist_abs == 1000
    assert bench.teensy.counters["rotUpdSkip"] + len(racing) in (999, 1000)


@pytest.mark.parametrize(("gap_ms", "reported"), [(4, False), (5, True)])
def test_pulse_within_5_ms_of_a_reported_one_waits_for_the_next_report(gap_ms, reported):
    bench = Bench().until(300 * MS)
    bench.teensy.wheel_pulse(LEFT, FORWARD, 300 * MS)
    bench.teensy.wheel_pulse(RIGHT, FORWARD, (300 + gap_ms) * MS)
    bench.until(390 * MS)
    assert wheel_reports(bench, RIGHT)[-1].dist_abs == int(reported)
    assert bench.teensy.counters["rotUpdSkip"] == int(not reported)
    bench.teensy.wheel_pulse(LEFT, FORWARD, 391 * MS)
    right = wheel_reports(bench.until(400 * MS), RIGHT)[-1]
    assert (right.dist_abs, right.when) == (1, 600 + gap_ms)


def test_pulse_that_waits_comes_with_a_repeat_at_the_latest_and_loses_its_tick():
    bench = Bench().until(300 * MS)
    bench.teensy.wheel_pulse(LEFT, FORWARD, 300 * MS)
    bench.teensy.wheel_pulse(RIGHT, FORWARD, 304 * MS)
    left, right = parse_wheels(bench.until(720 * MS).frames(WHEELS)[-1])
    assert right.dist_abs == 1 and right.when == left.when > 800


def test_wheel_that_turns_back_splits_the_way_at_dist():
    bench = Bench().roll(LEFT, FORWARD, 12, 40 * MS).roll(LEFT, BACKWARD, 5, 40 * MS).roll(LEFT, FORWARD, 3, 40 * MS)
    reports = wheel_reports(bench.after(20 * MS))
    turned = [report for report in reports if report.dist == report.dist_abs and report.dist]
    assert [(report.direction, report.dist, report.speed) for report in turned] == [(0, 1, 0), (1, 13, 0), (0, 18, 0)]
    assert reports[-1].dist_abs == 20

    travel, before = 0, Wheel(0, 2, 0, 0, 0, 0)
    for report in reports:
        step = report.dist_abs - before.dist_abs
        if report.direction != before.direction and report.dist_abs:
            old = report.dist - 1 - before.dist_abs
            travel += old * (-1 if before.direction == BACKWARD else 1)
            step -= old
        travel += step * (-1 if report.direction == BACKWARD else 1)
        before = report
    assert travel == 12 - 5 + 3


def test_speed_is_the_mean_over_ten_intervals():
    bench = Bench().until(30 * MS).roll(LEFT, FORWARD, 20, 20 * MS).roll(LEFT, FORWARD, 10, 40 * MS).after(5 * MS)
    speeds = [report.speed for report in wheel_reports(bench) if report.dist_abs]
    assert speeds[:20] == [0] + [50] * 19
    assert speeds[20:] == [10_000 // (200 + 20 * slow) for slow in range(1, 11)]


def test_speed_after_a_stop_falls_to_zero_with_nine_reports():
    bench = Bench().until(3 * MS).roll(LEFT, FORWARD, 30, 20 * MS).after(4 * S)
    speeds = [report.speed for report in wheel_reports(bench) if report.dist_abs == 30]
    assert speeds[0] == 50 and speeds[1:] == sorted(speeds[1:], reverse=True)
    assert speeds.index(0) in (9, 10)  # nine of the ten intervals are repeats, or the tenth is below 1/s


def test_speed_after_a_start_in_the_same_direction_is_too_low_for_a_dozen_pulses():
    bench = Bench().roll(LEFT, FORWARD, 20, 20 * MS).after(3 * S).roll(LEFT, FORWARD, 30, 20 * MS).after(5 * MS)
    speeds = [report.speed for report in wheel_reports(bench) if report.dist_abs > 20]
    assert speeds[0] < 2 and speeds[:7] == sorted(speeds[:7]) and max(speeds[:7]) < 20
    assert len(speeds) > 25 and set(speeds[12:]) == {50}


def test_speed_of_the_first_pulse_after_a_change_of_direction_is_zero():
    bench = Bench().roll(LEFT, FORWARD, 20, 20 * MS).roll(LEFT, BACKWARD, 3, 20 * MS).after(5 * MS)
    speeds = [report.speed for report in wheel_reports(bench) if report.direction == BACKWARD]
    assert speeds == [0, 50, 50]


def test_wheel_reset_zeroes_both_odometers_until_a_wheel_turns_but_keeps_the_ticks():
    # As captured: the tick of the last pulse stays (capture_mixed, 448 and 664) while dist_abs is 0.
    bench = Bench().roll(LEFT, FORWARD, 9, 30 * MS).roll(RIGHT, BACKWARD, 4, 30 * MS)
    before = parse_wheels(bench.after(5 * MS).frames(WHEELS)[-1])
    after = parse_wheels(bench.command(RESET).after(450 * MS).frames(WHEELS)[-1])
    for old, wheel in zip(before, after):
        assert (wheel.speed, wheel.direction, wheel.dist, wheel.dist_abs) == (0, 2, 0, 0)
        assert wheel.when >= old.when > 300
    bench.roll(RIGHT, BACKWARD, 1, 30 * MS).after(10 * MS)
    left, right = parse_wheels(bench.frames(WHEELS)[-1])
    assert (left.direction, left.dist_abs) == (2, 0)
    assert (right.direction, right.dist, right.dist_abs) == (1, 1, 1)


# Each pair is a hall state (pulses modulo 4 of a Gray code 0 1 3 2) and what the first pulses seem to be:
# (direction, dist, dist_abs). The levels are never read at power-up, and an interrupt reads its own pin only.
@pytest.mark.parametrize(
    ("direction", "position", "seen"),
    [
        pytest.param(FORWARD, 0, [(0, 1, 1), (0, 1, 2), (0, 1, 3)], id="forward_from_00_is_right"),
        pytest.param(FORWARD, 1, [(1, 1, 1), (1, 1, 2), (0, 3, 3)], id="forward_from_01_seems_backward_twice"),
        pytest.param(FORWARD, 2, [(2, 0, 1), (2, 0, 2), (0, 3, 3)], id="forward_from_11_has_no_direction_twice"),
        pytest.param(FORWARD, 3, [(2, 0, 1), (0, 2, 2), (0, 2, 3)], id="forward_from_10_has_no_direction_once"),
        pytest.param(BACKWARD, 0, [(1, 1, 1), (1, 1, 2), (1, 1, 3)], id="backward_from_00_is_right"),
        pytest.param(BACKWARD, 3, [(0, 1, 1), (0, 1, 2), (1, 3, 3)], id="backward_from_10_seems_forward_twice"),
        pytest.param(BACKWARD, 2, [(2, 0, 1), (2, 0, 2), (1, 3, 3)], id="backward_from_11_has_no_direction_twice"),
        pytest.param(BACKWARD, 1, [(2, 0, 1), (1, 2, 2), (1, 2, 3)], id="backward_from_01_has_no_direction_once"),
    ],
)
def test_hall_pins_are_taken_for_00_at_power_up(direction, position, seen):
    bench = Bench(wheel_positions=(position, position + 4)).until(300 * MS)
    bench.roll(LEFT, direction, 3, 15 * MS).roll(RIGHT, direction, 3, 15 * MS).after(5 * MS)
    for side in (LEFT, RIGHT):
        reports = [report for report in wheel_reports(bench, side) if report.dist_abs]
        assert [(report.direction, report.dist, report.dist_abs) for report in reports[:2]] == seen[:2]
        assert (reports[-1].direction, reports[-1].dist, reports[-1].dist_abs) == seen[2]


def test_wheel_without_a_direction_has_a_speed():
    # As captured: (0, 2, 311, 0, 1), (66, 2, 326, 0, 2).
    bench = Bench(wheel_positions=(2, 0)).until(300 * MS).roll(LEFT, FORWARD, 2, 15 * MS).after(5 * MS)
    assert [fields(report) for report in wheel_reports(bench)[-2:]] == [(0, 2, 615, 0, 1), (66, 2, 630, 0, 2)]
