"""Where the wheels' magnets stood at the start: phases are parts of a pulse that each wheel had behind its magnet."""

import math

import pytest

from car_interface.teensy.sensing.wheel_filter import ALIGNED_PULSES, ALIGNING_PULSES, WheelFilter, starting_difference


def rolled(phase, speed, duration_ms):
    """The pulses of a wheel that began so far behind a magnet and rolled evenly, pulses/ms."""
    wheel = WheelFilter()
    wheel.begin(0.0)
    for number in range(1, math.floor(phase + speed * duration_ms) + 1):
        at_ms = (number - phase) / speed
        wheel.update(1, True, at_ms, at_ms)
    return wheel.first_pulses


def pulsed(*times_ms):
    """Those of a wheel that made its pulses at these times."""
    wheel = WheelFilter()
    wheel.begin(0.0)
    for at_ms in times_ms:
        wheel.update(1, True, at_ms, at_ms)
    return wheel.first_pulses


@pytest.mark.parametrize("left, right, ratio, difference", [
    (0.2, 0.9, 1.25, 0.685), (0.9, 0.2, 1.25, -0.7075), (0.5, 0.5, 0.8, 0.0)],
    ids=["up_to_the_right_wheel_s_magnet", "up_to_the_left_wheel_s", "anywhere_on_the_line"])
def test_in_a_turn_the_start_is_in_the_middle_of_all_that_the_line_allows(left, right, ratio, difference):
    """By hand: right = left · ratio + a, with a = 0.65, −0.925 and 0.1, has both within a pulse for a left place of
    0 to 0.28, 0.74 to 1, and 0 to 1; difference = a + (ratio − 1) · its middle.
    """
    found = starting_difference(rolled(left, 0.05, 400), rolled(right, 0.05 * ratio, 400))
    assert found == pytest.approx(difference, abs=1e-6)


@pytest.mark.parametrize("right_from, left_to, difference", [(4, 6, -1.0), (5, 6, None), (23, 23, None), (24, 24, 0.0)],
    ids=["six_places", "four_places", "few_places", "few_places_of_many_pulses"])
def test_six_places_at_the_same_time_are_enough_and_differ_by_a_pulse_at_most(right_from, left_to, difference):
    """Of six pulses of the right wheel that begin as the left one has made some; both ends count."""
    left = pulsed(*range(20, 20 * left_to + 1, 20))
    right = pulsed(*range(20 * right_from, 20 * (right_from + 5) + 1, 20))
    assert starting_difference(left, right) == (difference if difference is None else pytest.approx(difference))


def test_pulses_that_all_come_in_one_ms_tell_no_difference():
    assert starting_difference(pulsed(*range(20, 140, 20)), pulsed(*[60] * 6)) == 0.0


@pytest.mark.parametrize("ratio", [0.8, 1.0, 1.3], ids=["to_the_right", "straight", "to_the_left"])
@pytest.mark.parametrize("left, right", [(0.1, 0.9), (0.9, 0.1), (0.5, 0.5), (0.02, 0.4), (0.7, 0.95)])
def test_difference_is_found_where_the_curvature_stays_the_same(left, right, ratio):
    found = starting_difference(rolled(left, 0.05, 400), rolled(right, 0.05 * ratio, 400))
    # On a straight only the difference of the phases is known; in a turn also where on the line the start was.
    tolerance = 3 * ALIGNED_PULSES if ratio != 1.0 else 0.02
    assert found == pytest.approx(right - left, abs=tolerance)


def test_too_few_pulses_tell_nothing_yet():
    left, right = (rolled(0.5, 0.05, 20 * (ALIGNING_PULSES - 1)) for _ in range(2))
    assert starting_difference(left, right) is None


def test_wheel_that_stands_ends_the_alignment_after_many_pulses_of_the_other():
    standing = rolled(0.5, 0.05, 0)
    assert starting_difference(rolled(0.5, 0.05, 20 * 23), standing) is None
    assert starting_difference(rolled(0.5, 0.05, 20 * 24), standing) == 0.0


def test_wheels_whose_speeds_no_turn_makes_tell_no_difference():
    assert starting_difference(rolled(0.1, 0.05, 800), rolled(0.9, 0.15, 800)) == 0.0
