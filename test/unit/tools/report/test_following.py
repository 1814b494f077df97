"""How closely a car followed what it was sent."""
import math
from types import SimpleNamespace

import pytest

from car_interface.tools.report.motion import MAX_LATERAL_MPS2, MIN_COMPARED, Accelerating, Bins, Following


def test_median_is_the_middle_of_its_bin_numbers_beyond_count_at_the_ends_and_few_have_none():
    bins = Bins(0.0, 1.0, 0.1)
    for number in [-5.0] * 14 + [0.31, 0.32, 0.33] + [99.0] * 12:
        bins.add(number)
    assert bins.median() is None and len([-5.0] * 14 + [0.31] * 3 + [99.0] * 12) == MIN_COMPARED - 1
    bins.add(99.0)
    assert bins.median() == pytest.approx(0.35)


def following(sent, driven, speed_mps=1.0, since_s=0.0, time_s=1.0, **limits):
    found = Following(SimpleNamespace(curvature_per_m=sent, unchanged_since_s=since_s), **limits)
    for _ in range(MIN_COMPARED):
        found.add(time_s, driven, speed_mps)
    return found


@pytest.mark.parametrize("sent, driven, sides", [(0.5, 0.55, (1.1, None)), (-0.5, -0.4, (None, 0.8))],
                         ids=["left_tighter", "right_wider"])
def test_bend_is_a_ratio_by_side(sent, driven, sides):
    found = following(sent, driven)
    for wanted, side in zip(sides, (found.left, found.right)):
        assert side.median() == (None if wanted is None else pytest.approx(wanted, abs=0.002))


def test_straight_on_is_a_difference_and_a_car_that_does_exactly_what_it_was_sent_is_off_by_nothing():
    assert following(0.5, 0.5).left.median() == pytest.approx(1.0, abs=1e-9)
    assert following(0.0, 0.0).straight_per_m.median() == pytest.approx(0.0, abs=1e-9)
    assert accelerating(1.0, 1.0) == [0.0, None, None]
    found = following(0.01, 0.05)
    assert found.straight_per_m.median() == pytest.approx(0.04, abs=0.001)
    assert found.left.samples == found.right.samples == 0


@pytest.mark.parametrize("driven", [0.0, -0.3], ids=["goes_straight_on", "turns_to_the_other_side"])
def test_ratio_of_a_car_that_does_not_turn_has_an_inverse(driven):
    assert 0 < following(0.5, driven).left.median() < 0.01


@pytest.mark.parametrize("case", [
    {"sent": None}, {"sent": math.nan}, {"speed_mps": 0.2}, {"since_s": 0.5}, {"sent": 0.05},
], ids=["nothing_sent", "not_a_number", "slow", "just_changed", "neither_straight_nor_a_bend"])
def test_what_can_not_be_compared_does_not_count(case):
    found = following(**{"sent": 0.5, "driven": 0.5, **case})
    assert found.straight_per_m.samples == 0 and found.left.samples == found.right.samples == 0


def test_bend_in_which_tyres_slide_judges_no_table():
    for speed_mps, counts in ((1.7, True), (1.8, False)):  # 1.44 and 1.62 m/s² sideways
        found = following(0.6, 0.5, speed_mps=speed_mps, max_lateral_mps2=MAX_LATERAL_MPS2)
        assert (found.left.samples > 0) == counts
    assert following(0.6, 0.5, speed_mps=9.0).left.samples > 0


def accelerating(requested, driven, speed_mps=1.0):
    found = Accelerating()
    for step in range(20):
        found.request(step / 20, requested)
    for _ in range(MIN_COMPARED):
        found.add(0.5, 0.8, driven, speed_mps)
    medians = [bins.median() for bins in (found.driving, found.holding, found.braking)]
    return [one if one is None else round(one, 2) for one in medians]


@pytest.mark.parametrize("requested, driven, differences", [
    (1.0, 0.8, [-0.2, None, None]), (0.1, 0.2, [None, 0.1, None]), (-1.0, -1.3, [None, None, -0.3]),
], ids=["drives_less", "holds_more", "brakes_more"])
def test_difference_of_acceleration_is_told_by_what_was_requested(requested, driven, differences):
    for found, wanted in zip(accelerating(requested, driven), differences):
        assert found == (None if wanted is None else pytest.approx(wanted, abs=0.011))


def test_standing_car_and_a_window_without_requests_do_not_count():
    assert accelerating(1.0, 0.0, speed_mps=0.1) == [None, None, None]
    assert accelerating(math.nan, 0.5) == [None, None, None]
    assert accelerating(1.0, math.nan) == [None, None, None]


def test_requests_count_for_what_the_car_does_a_reaction_later_and_old_ones_are_forgotten():
    found = Accelerating()
    for time_s, requested in ((0.0, 3.0), (10.35, 3.0), (10.45, 1.0), (10.65, 1.0), (10.75, 3.0)):
        found.request(time_s, requested)
    for _ in range(MIN_COMPARED):
        found.add(10.5, 10.8, 1.0, 1.0)
    assert found.driving.median() == pytest.approx(0.0, abs=0.011)
    assert len(found._requests) == 4
