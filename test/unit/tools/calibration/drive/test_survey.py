"""Evidence and progress: when a fit is due, and when it is enough."""
import math

import pytest

from car_interface.tools.calibration.delay import Delay
from car_interface.tools.calibration.drive.knowledge import Knowledge
from car_interface.tools.calibration.drive.positions import Measured
from car_interface.tools.calibration.drive.survey import ENOUGH, FULL_FIT_NS, MIN_LEFT_S, MIN_POSITIONS, Survey
from tools.calibration.drive.light_car import base

S = 1_000_000_000


def survey():
    return Survey(base(), 300.0)


def hold(one, count):
    for candidate in one.positions.candidates()[:count]:
        one.add(Measured(candidate.duty, candidate.from_side or 1, 1.5, 0.0))


def knowledge(number, error=0.1, missing=()):
    duties = tuple(range(3904, 6401, 16))
    return Knowledge(number, "", duties, (0.0,) * len(duties), (error,) * len(duties), (), missing,
                     Delay(0.02, 0.12, 0.9), 20.0, 1.5, 5200.0, 8.0)


def test_one_fit_at_a_time_after_some_positions_and_only_after_something_new():
    one = survey()
    assert one.progress(0.0).missing == ("everything; the ends and straight on come first",)
    hold(one, MIN_POSITIONS - 1)
    assert one.take_task(0) is None, "too few positions"
    hold(one, 1)
    assert one.take_task(0).number == 1
    hold(one, 1)
    assert one.take_task(S) is None, "one is under way"
    one.update_knowledge(knowledge(0))
    assert one.knowledge is None, "an answer to an older task"
    one.update_knowledge(knowledge(1))
    assert one.take_task(S).number == 2
    one.update_knowledge(knowledge(2))
    assert one.take_task(S) is None, "nothing new"


def test_delay_and_backlash_are_estimated_now_and_then():
    one = survey()
    hold(one, MIN_POSITIONS)
    assert one.take_task(0).delay is None
    one.update_knowledge(knowledge(1))
    hold(one, 1)
    quick = one.take_task(S)
    assert (quick.delay, quick.backlash_duty, quick.backlash_sigma) == (Delay(0.02, 0.12, 0.9), 20.0, 1.5)
    one.update_knowledge(knowledge(2))
    hold(one, 1)
    full = one.take_task(FULL_FIT_NS)
    assert (full.delay, full.backlash_duty, full.backlash_sigma) == (None, None, 0.0)


def finished(error, missing=()):
    one = survey()
    hold(one, 99)
    one.take_task(0)
    one.update_knowledge(knowledge(1, error, missing))
    return one


def test_it_is_enough_when_all_is_known_by_far():
    assert finished(0.9 * ENOUGH).is_enough
    assert not finished(1.1 * ENOUGH).is_enough
    assert not finished(0.9 * ENOUGH, ("drive straight on",)).is_enough
    assert not survey().is_enough


def test_it_is_not_enough_while_a_count_was_not_held_where_one_changes_much():
    one = finished(0.9 * ENOUGH)
    assert one.is_enough
    flat = one.knowledge
    steep = tuple(0.2 if duty < 5008 else -0.1 for duty in flat.duties)
    hold(one, 1)
    one.take_task(S)
    one.update_knowledge(flat._replace(number=2, curvatures=steep))
    assert not one.is_enough
    for duty in (4992, 5008):
        one.add(Measured(duty, 1, 1.5, 0.0))
    one.take_task(2 * S)
    one.update_knowledge(flat._replace(number=3, curvatures=steep))
    assert one.is_enough


def test_progress_grows_and_time_left_shrinks():
    early = survey()
    hold(early, 3)
    poor, good = finished(4.0), finished(1.2 * ENOUGH)
    fractions = [survey().progress(0.0).fraction, early.progress(10.0).fraction, poor.progress(60.0).fraction,
                 good.progress(60.0).fraction]
    assert fractions == sorted(fractions) and fractions[0] == 0.0 and fractions[-1] < 1.0
    assert poor.progress(60.0).left_s > good.progress(60.0).left_s
    assert poor.progress(290.0).left_s <= 10.0, "the time ends"
    assert finished(0.5 * ENOUGH).progress(60.0).fraction == 1.0


def test_time_left_is_what_the_errors_take_that_shrink_with_the_root_of_time():
    found = finished(2 * ENOUGH).progress(60.0)
    assert (found.fraction, found.left_s) == pytest.approx((0.25, 180.0))
    assert finished(0.9 * ENOUGH, ("drive straight on",)).progress(60.0).left_s == MIN_LEFT_S, "not yet over"
    assert finished(math.inf).progress(60.0).left_s == 240.0, "the rest of the time"
    assert [survey().progress(driven_s).left_s for driven_s in (0.0, 40.0)] == [240.0, 200.0]
