"""Evidence and progress: when a fit is due, and when it is enough."""
import math

import numpy as np
import pytest

from car_interface.tools.calibration.drive.config import CalibrationDriveConfig
from car_interface.tools.calibration.drive.knowledge import Knowledge
from car_interface.tools.calibration.drive.positions import Measured
from car_interface.tools.calibration.drive.survey import ENOUGH, FULL_FIT_NS, MIN_LEFT_S, MIN_POSITIONS, Survey
from car_interface.tools.calibration.steering.drive import CurveFitConfig, Delay
from tools.calibration.drive.light_car import base

S = 1_000_000_000


def survey(driven_s=0.0):
    one = Survey(base(), CalibrationDriveConfig())
    one._driven_ns = round(driven_s * S)
    return one


def task_at(one, now_ns):
    one._tick(now_ns)
    return one.take_fit_task()


def hold(one, count):
    for candidate in one.positions.candidates()[:count]:
        one.positions.add(Measured(candidate.duty, candidate.from_side or 1, 0.0))


GIVEN = CurveFitConfig(Delay(0.02, 0.12), 20.0, 1.5)


def knowledge(error=0.1, missing=()):
    duties = np.arange(3904.0, 6401.0, 16.0)
    errors = np.full(len(duties), error)
    return Knowledge("", duties, 0 * duties, errors, errors, (), missing, 5200.0, 8.0, GIVEN)


def test_one_fit_at_a_time_after_some_positions_and_only_after_something_new():
    one = survey()
    assert one.progress().known.missing == ("everything; the ends and straight on come first",)
    hold(one, MIN_POSITIONS - 1)
    assert task_at(one, 0) is None, "too few positions"
    hold(one, 1)
    assert task_at(one, 0)
    hold(one, 1)
    assert task_at(one, S) is None, "one is under way"
    one.update_knowledge(knowledge(), S)
    assert task_at(one, S)
    one.update_knowledge(knowledge(), S)
    assert task_at(one, S) is None, "nothing new"


def test_delay_and_backlash_are_estimated_now_and_then():
    one = survey()
    hold(one, MIN_POSITIONS)
    full = CurveFitConfig(limits=(3900, 6400))
    assert task_at(one, 0)[1] == full
    one.update_knowledge(knowledge(), S)
    hold(one, 1)
    assert task_at(one, S)[1] == GIVEN
    one.update_knowledge(knowledge(), S)
    hold(one, 1)
    assert task_at(one, FULL_FIT_NS)[1] == full


def finished(error, missing=(), driven_s=60.0):
    one = survey(driven_s)
    hold(one, 99)
    task_at(one, 0)
    one.update_knowledge(knowledge(error, missing), S)
    return one


def test_it_is_enough_when_all_is_known_by_far():
    assert finished(0.9 * ENOUGH).is_enough
    assert not finished(1.1 * ENOUGH).is_enough
    assert not finished(0.9 * ENOUGH, ("drive straight on",)).is_enough
    assert not survey().is_enough
    one = finished(0.9 * ENOUGH)
    hold(one, 1)
    task_at(one, S)
    one.update_knowledge(Knowledge("the car turned to one side only so far"), S)
    assert not one.is_enough, "the newest fit found no curve"


def test_it_is_not_enough_while_a_count_was_not_held_where_one_changes_much():
    one = finished(0.9 * ENOUGH)
    assert one.is_enough
    flat = one.progress().known
    steep = np.where(flat.duties < 5008, 0.2, -0.1)
    hold(one, 1)
    task_at(one, S)
    one.update_knowledge(flat._replace(curvatures=steep), S)
    assert not one.is_enough
    for duty in (4992, 5008):
        one.positions.add(Measured(duty, 1, 0.0))
    task_at(one, 2 * S)
    one.update_knowledge(flat._replace(curvatures=steep), S)
    assert one.is_enough


def test_progress_grows_and_time_left_shrinks():
    early = survey(10.0)
    hold(early, 3)
    poor, good = finished(4.0).progress(), finished(1.2 * ENOUGH).progress()
    fractions = [survey().progress().fraction, early.progress().fraction, poor.fraction, good.fraction]
    assert fractions == sorted(fractions) and fractions[0] == 0.0 and fractions[-1] < 1.0
    assert poor.left_s > good.left_s
    assert finished(4.0, driven_s=290.0).progress().left_s <= 10.0, "the time ends"
    assert finished(0.5 * ENOUGH).progress().fraction == 1.0


def test_time_left_is_what_the_errors_take_that_shrink_with_the_root_of_time():
    found = finished(2 * ENOUGH).progress()
    assert (found.fraction, found.left_s) == pytest.approx((0.25, 180.0))
    assert finished(0.9 * ENOUGH, ("drive straight on",)).progress().left_s == MIN_LEFT_S, "not yet over"
    assert finished(math.inf).progress().left_s == 240.0, "the rest of the time"
    assert [survey(driven_s).progress().left_s for driven_s in (0.0, 40.0)] == [240.0, 200.0]
