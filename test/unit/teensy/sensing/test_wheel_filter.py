"""One wheel from its pulses: times are the Teensy's, in ms; positions are in pulses."""

import math

import pytest

from car_interface.teensy.sensing.wheel_filter import STANDS_AFTER_MS, WheelFilter, WheelStart

NOW = 1000.0


@pytest.fixture
def wheel():
    wheel = WheelFilter()
    wheel.begin(NOW)
    return wheel


def roll(wheel, count, interval_ms, forward=True, begin_ms=NOW):
    """Pulses at an even pace; the time of the last."""
    for _ in range(count):
        begin_ms += interval_ms
        wheel.update(1 if forward else -1, forward, begin_ms, begin_ms)
    return begin_ms


def test_wheel_stands_between_two_magnets_at_the_start(wheel):
    wheel.advance(NOW + 100)
    assert (wheel.position, wheel.speed, wheel.count) == (0.5, 0.0, 0)
    assert wheel.position_variance == pytest.approx(1 / 12)


@pytest.mark.parametrize("forward, count, position", [(True, 20, 20.0), (False, -20, -19.0)])
def test_wheel_is_at_its_magnet_as_it_makes_a_pulse(wheel, forward, count, position):
    roll(wheel, 20, 20, forward)
    assert wheel.count == count and wheel.position == pytest.approx(position, abs=0.05)


@pytest.mark.parametrize("interval_ms", [5, 50, 400])
def test_speed_is_that_of_an_even_pace(wheel, interval_ms):
    at_ms = roll(wheel, 200, interval_ms)
    assert wheel.speed == pytest.approx(1 / interval_ms, rel=0.02)
    wheel.advance(at_ms + interval_ms / 2)
    assert wheel.position == pytest.approx(200.5, abs=0.05)


def test_wheel_without_a_pulse_passes_no_magnet_and_stands_in_the_end(wheel):
    at_ms = roll(wheel, 20, 20)
    for later_ms in (30, 100, 300, STANDS_AFTER_MS):
        before = wheel.speed
        wheel.advance(at_ms + later_ms)
        assert 20 <= wheel.position <= 21.1 and 0 < wheel.speed < before
    wheel.advance(at_ms + STANDS_AFTER_MS + 1)
    assert wheel.speed == 0.0


@pytest.mark.parametrize("after_ms, count", [(100, 45), (5000, 41)], ids=["rolling", "stood"])
def test_first_pulse_after_uncounted_ones_is_that_of_the_nearest_magnet_for_a_wheel_that_rolled(wheel, after_ms, count):
    at_ms = roll(wheel, 40, 20)
    wheel.is_uncounted = True
    wheel.resume(1, True, at_ms + after_ms, at_ms + after_ms)
    assert wheel.count == count and not wheel.is_uncounted


def test_wheel_starts_at_the_magnet_that_a_restart_found(wheel):
    at_ms = roll(wheel, 40, 20)
    wheel.start(WheelStart(60, 0.05, True, [(1, at_ms + 400), (1, at_ms + 420)]), True, at_ms + 420)
    assert wheel.count == 61 and wheel.position == pytest.approx(61, abs=0.1)
    assert wheel.speed == pytest.approx(0.05, rel=0.1)


def test_wheel_that_rolled_through_a_restart_is_at_its_magnet_and_its_speed_known_by_15_percent(wheel):
    wheel.advance(NOW + 400)
    wheel.start(WheelStart(60, 0.05, True, [(1, NOW + 400)]), True, NOW + 400)
    assert wheel.speed == 0.05 and wheel.position_variance < 1e-4
    assert wheel.speed_variance == pytest.approx((1.6 * 0.15 * 0.05) ** 2)
    wheel.advance(NOW + 500)  # its acceleration is unknown, 2.2e-4, and fades within half a second
    assert wheel.speed_variance == pytest.approx(
        1.6 ** 2 * ((0.15 * 0.05) ** 2 + (2.2e-4 * 500 * (1 - math.exp(-0.2))) ** 2), rel=0.02)


def test_slow_wheel_whose_pulses_are_not_counted_may_have_accelerated_as_any_other(wheel):
    at_ms = roll(wheel, 20, 400)
    wheel.is_uncounted = True
    wheel.advance(at_ms + 1000)  # Singer's variance of the speed after two time constants
    singer = 7e-5 ** 2 * 500 ** 2 * (4 * math.exp(-2) - 3 - math.exp(-4) + 2 * 2)
    assert wheel.speed_variance == pytest.approx(1.6 ** 2 * singer, rel=0.01)


def test_wheel_whose_pulses_are_not_counted_for_more_than_two_seconds_stands_or_rolls_as_before(wheel):
    at_ms = roll(wheel, 40, 20)
    wheel.is_uncounted = True
    wheel.advance(at_ms + 2001)
    assert wheel.speed == 0.0 and wheel.position_variance == pytest.approx(1 / 12)
    assert wheel.speed_variance == pytest.approx((1.6 * 0.05) ** 2, rel=0.02)


@pytest.mark.parametrize("late_ms, is_known", [(0.5, True), (0.6, False)])
def test_pulse_of_the_report_s_own_tick_is_known_by_its_time_and_one_of_a_later_tick_is_not(wheel, late_ms, is_known):
    at_ms = roll(wheel, 20, 20) + 20
    wheel.update(1, True, at_ms + late_ms, at_ms)
    assert (wheel.position_variance < 3.1e-4) == is_known, "0.05² · 1/12 + 0.01²: of half a tick, and of its magnet"


def follow(wheel, speed_at, until_ms, begin_ms=NOW):
    """Give a wheel the pulses of a car whose speed is known, and yield by how many sigma its own is off at each."""
    position = 0.0
    for ms in range(1, until_ms + 1):
        before, position = position, position + speed_at(ms)
        if int(position) > int(before):
            wheel.update(1, True, begin_ms + ms, begin_ms + ms)
            yield abs(wheel.speed - speed_at(ms)) / math.sqrt(wheel.speed_variance)


def test_speed_that_rises_by_2_mps2_and_then_falls_as_fast_is_within_four_sigma(wheel):
    off = list(follow(wheel, lambda ms: 1.34e-4 * (ms if ms < 750 else 1500 - ms), 1300))
    assert max(off[10:]) < 4 and sum(one > 3 for one in off[10:]) <= 3


def test_slow_wheel_that_stopped_between_two_pulses_and_went_on_is_not_sure_of_its_mean_speed(wheel):
    at_ms = roll(wheel, 20, 50)
    wheel.update(1, True, at_ms + 400, at_ms + 400)
    assert math.sqrt(wheel.speed_variance) > (1 / 50 - 1 / 400) / 2


def test_first_pulses_after_a_stand_are_those_of_a_car_that_has_just_set_off(wheel):
    """v² grows with the way: with four pulses in a report it is twice as fast as with one."""
    assert wheel.speed_variance == pytest.approx(1.6 ** 2 * 1e-10), "it stands"
    for pulses in (1, 4, -4):
        wheel = WheelFilter()
        wheel.begin(NOW)
        wheel.update(pulses, pulses > 0, NOW + 100, NOW + 100)
        assert wheel.speed == pytest.approx(math.copysign(0.01 * math.sqrt(abs(pulses)), pulses))


@pytest.mark.parametrize("after_ms", [50, 60])
@pytest.mark.parametrize("forward", [True, False], ids=["forward", "backward"])
def test_wheel_whose_pulse_is_overdue_is_right_before_its_magnet(wheel, forward, after_ms):
    """By 0.02 pulses. The pulse before was within half a ms, in which the wheel rolls by 0.5/60 at most after 60 ms."""
    wheel.update(9 if forward else -9, forward, NOW + 100, NOW + 100)  # at 0.03 pulses per ms, as one can think
    wheel.advance(NOW + 100 + after_ms)
    rolled = 1 - 0.02 + 0.5 / after_ms
    assert wheel.position == pytest.approx(9 + rolled if forward else -8 - rolled, abs=0.003)


def test_second_look_at_a_wheel_in_the_same_ms_changes_nothing(wheel):
    at_ms = roll(wheel, 50, 10) + 13
    looks = []
    for _ in range(2):
        wheel.advance(at_ms)
        looks.append((wheel.position, wheel.speed, wheel.position_variance, wheel.speed_variance))
    assert looks[0] == looks[1] and looks[0][0] > wheel.count + 1, "its pulse is overdue"


@pytest.mark.parametrize("after_ms, speed", [(20, 1 / 19.8), (100, 1 / 100)])
def test_wheel_is_no_faster_than_if_its_pulse_came_now_when_that_is_later_than_20_ms(wheel, after_ms, speed):
    wheel.advance(roll(wheel, 100, 19.8) + after_ms)
    assert wheel.speed == pytest.approx(speed, rel=2e-3)


def test_first_pulse_after_uncounted_ones_may_be_as_old_as_the_last_look_at_the_wheel(wheel):
    at_ms = roll(wheel, 5, 20)
    wheel.is_uncounted = True
    wheel.advance(at_ms + 20)
    wheel.resume(1, True, at_ms + 20, at_ms + 50)
    assert wheel.first_pulses[-1][0] == at_ms + 20


@pytest.mark.parametrize("apart_ms, is_known", [(60, True), (60.5, False)])
def test_speed_after_a_restart_is_not_known_from_pulses_that_are_more_than_60_ms_apart(wheel, apart_ms, is_known):
    start = WheelStart(60, 1 / apart_ms, True, [(1, NOW + 400), (1, NOW + 400 + apart_ms)])
    wheel.start(start, True, NOW + 400 + apart_ms)
    assert (wheel.speed_variance < 0.008 ** 2) == is_known


def test_noise_of_a_short_time_is_the_limit_of_singer_s(wheel):
    roll(wheel, 10, 20)
    short, longer = (wheel._noise(ms, ms / 500, math.exp(-ms / 500)) for ms in (24.999, 25.001))
    assert short == pytest.approx(longer, rel=0.08)


def test_pending_pulses_are_in_the_variance(wheel):
    before = wheel.position_variance
    wheel.pending = 3
    assert wheel.position_variance == before + 9 and wheel.speed_variance > 0


def test_first_pulses_are_kept_for_the_alignment_until_nobody_needs_them(wheel):
    roll(wheel, 3, 20)
    assert wheel.first_pulses == [(NOW + 20, 1), (NOW + 40, 2), (NOW + 60, 3)]
    wheel.first_pulses = None
    roll(wheel, 3, 20, begin_ms=NOW + 60)
    assert wheel.first_pulses is None and wheel.count == 6
