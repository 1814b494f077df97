"""Which position comes next, and what curvature is expected of it."""
import numpy as np
import pytest

from car_interface.tools.calibration.drive.knowledge import Knowledge
from car_interface.tools.calibration.drive.positions import (
    APART_DUTY,
    FIRST,
    STEEP_NEED,
    Measured,
    Positions,
    nearest_count,
)
from tools.calibration.drive.light_car import base

DUTIES = np.arange(3904, 6401, 16)


def knowledge(errors=None):
    errors = {} if errors is None else errors
    return Knowledge("", DUTIES, (5200 - DUTIES) / 1300, *2 * [np.array([errors.get(duty, 0.1) for duty in DUTIES])])


def measured(duty, curvature=0.0, from_side=1):
    return Measured(duty, from_side, curvature)


def all_first(positions):
    for candidate in list(positions.candidates()):
        positions.add(measured(candidate.duty, from_side=candidate.from_side or 1))


def test_ends_and_center_from_both_sides_come_first_until_each_was_held_and_again_while_there_is_no_curve():
    positions = Positions(base())
    positions.update_knowledge(knowledge({4512: 9.0}), len(positions.held))  # a fit of few positions knows nothing
    assert [candidate.duty for candidate in positions.candidates()[:4]] == [3900, 6400, 5184, 5184]
    assert sorted(one.from_side for one in positions.candidates() if one.duty == 5184) == [-1, 1]
    assert len(positions.first) == len(FIRST)
    positions = Positions(base())
    positions.add(measured(5184, from_side=1))
    assert [one.from_side for one in positions.candidates() if one.duty == 5184] == [-1]
    for candidate in positions.candidates(lambda duty: duty > 5200):
        positions.add(measured(candidate.duty))
    assert positions.candidates(lambda duty: duty > 5200) == [], "while another of the first is left"
    all_first(positions)
    assert (len(positions.first), len(positions.held)) == (0, len(FIRST))
    assert len(positions.candidates()) == len(FIRST)


def test_then_the_greatest_errors_come_first_and_apart_from_each_other():
    positions = Positions(base())
    all_first(positions)
    positions.update_knowledge(knowledge({4512: 1.4, 4528: 1.3, 5792: 1.2}), len(positions.held))
    duties = [candidate.duty for candidate in positions.candidates()]
    assert duties[:2] == [4512, 5792]
    assert all(abs(one - other) >= APART_DUTY for one in duties for other in duties if one != other)


@pytest.mark.parametrize("by", ["errors", "needs"])
@pytest.mark.parametrize("known", [{4416: 3.0, 5696: 2.0}, {4416: 2.0, 5696: 3.0}])
def test_of_what_the_tool_refuses_or_would_write_that_of_which_least_is_known_comes_first(known, by):
    positions = Positions(base())
    all_first(positions)
    numbers = np.array([known.get(duty, 0.1) for duty in DUTIES])
    positions.update_knowledge(knowledge()._replace(**{by: numbers}), len(positions.held))
    first, second = positions.candidates(lambda duty: duty < 6000)[:2]
    assert first.duty == max(known, key=known.get) and first.need == second.need
    assert all(one.duty > 6000 for one in positions.candidates(lambda duty: duty > 6000))


@pytest.mark.parametrize(("error", "has_gap"), [(0.88, False), (0.92, True), (1.5, True)])
def test_what_is_nearly_refused_between_positions_that_were_held_often_is_a_gap(error, has_gap):
    positions = Positions(base())
    all_first(positions)
    for duty in 3 * (4624, 4656):
        positions.add(measured(duty))
    positions.update_knowledge(knowledge({4640: error}), len(positions.held))
    assert positions.has_gaps is has_gap
    assert ((4640, STEEP_NEED) in [(one.duty, one.need) for one in positions.candidates()]) is has_gap


def test_where_one_count_changes_much_each_is_to_be_held_whatever_the_fit_says():
    positions = Positions(base())
    all_first(positions)
    steep = knowledge()
    curvatures = np.where(DUTIES < 5008, 0.2, np.where(DUTIES == 5008, 0.1, -0.1))
    positions.update_knowledge(steep._replace(curvatures=curvatures), len(positions.held))
    asked = {candidate.duty for candidate in positions.candidates() if candidate.need == STEEP_NEED}
    assert asked & {4992, 5008, 5024} and asked <= {4992, 5008, 5024}
    assert positions.has_gaps
    for duty in (4992, 5008, 5024):
        positions.add(measured(duty))
    assert all(candidate.need < 0.2 for candidate in positions.candidates()) and not positions.has_gaps


def test_an_end_that_the_fit_lost_is_asked_for_again():
    positions = Positions(base())
    all_first(positions)
    short = knowledge()
    positions.update_knowledge(short._replace(duties=short.duties[8:], curvatures=short.curvatures[8:],
                                              errors=short.errors[8:], needs=short.needs[8:]), len(positions.held))
    assert positions.candidates()[0].duty == 3900
    positions.add(measured(3900))
    assert positions.candidates()[0].duty != 3900, "the next fit tells"


def test_what_was_held_since_the_fits_samples_counts_for_less():
    positions = Positions(base())
    all_first(positions)
    positions.update_knowledge(knowledge({4512: 3.0, 5792: 2.0}), len(positions.held))
    positions.add(measured(4512))
    assert positions.candidates()[0].duty == 5792
    positions.update_knowledge(knowledge({4512: 3.0, 5792: 1.0}), len(positions.held))
    assert positions.candidates()[0].duty == 4512, "the new fit has it, and still knows too little"


def test_a_position_is_come_to_from_the_other_side_the_next_time():
    positions = Positions(base())
    all_first(positions)
    positions.add(measured(4512, from_side=-1))
    positions.update_knowledge(knowledge({4512: 3.0}), len(positions.held))
    assert positions.candidates()[0].from_side == 1


def test_expected_curvature_is_a_guess_then_between_what_was_held_then_the_fits():
    positions = Positions(base())
    assert positions.expected_per_m(3900) > 0.5 and positions.expected_per_m(6400) < -0.5
    positions.add(measured(3900, 0.7))
    positions.add(measured(6000, -0.2))
    # The rough center is expected to be straight on until it was held.
    assert [positions.expected_per_m(duty) for duty in (3900, 4540, 5180, 5590)] == pytest.approx([0.7, 0.35, 0, -0.1])
    positions.add(measured(5184, 0.1))
    assert positions.expected_per_m(5180) == pytest.approx(0.1, abs=0.01)
    positions.update_knowledge(knowledge()._replace(curvatures=np.full(len(DUTIES), 0.25)), len(positions.held))
    assert positions.expected_per_m(4550) == 0.25


def test_what_was_held_bounds_the_curvature_and_shows_half_the_way():
    positions = Positions(base())
    assert positions.least_per_m(3900) == 0.0
    positions.add(measured(3900, 1.0))
    assert positions.half_way_duty(3900) == 3900
    for duty, curvature in ((4200, 0.7), (4600, 0.4), (6000, -0.4)):
        positions.add(measured(duty, curvature))
    # The least is that of the next one towards the center.
    assert [positions.least_per_m(duty) for duty in (3900, 4000, 4700, 6300)] == [1.0, 0.7, 0.0, -0.4]
    assert positions.half_way_duty(3900) == 4200


@pytest.mark.parametrize("servo", [(3900, 5180, 6400), (6400, 5180, 3900)], ids=("usual", "the_other_way_round"))
def test_the_request_is_what_turn_arb_makes_the_duty_of(servo):
    one = base(*servo)
    positions = Positions(one)
    for duty in range(3900, 6401, 50):
        assert one.teleop_duty(positions.steering(duty)) == duty


@pytest.mark.parametrize("duty, count", [(5000, 5008), (5007, 5008), (3000, 3900), (9000, 6400)])
def test_a_position_is_a_count_between_the_ends(duty, count):
    assert nearest_count(duty, base()) == count
