"""What is missing for a table is a sentence that says what to drive."""
from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest

from car_interface.tools.calibration.steering.ends import Side
from car_interface.tools.calibration.steering.problems import find_problems
from car_interface.tools.calibration.steering.table import DRIVEN, LEFT, RIGHT, UNKNOWN, Breakpoint

RADII_M = (1.0, 2.0, 5.0, 20.0)


def curve(center=5100.0, sigma=1e-4):
    end = Side(3900.0, 1.0, 0.01, False, False, 3950.0)
    return SimpleNamespace(center=center, center_sigma=12.0, left=end, right=end._replace(farthest_duty=6400.0),
                           duties=np.array([3900.0, 6500.0]), sigmas=np.full(2, sigma))


def points(sources):
    return [Breakpoint(radius_m, 4000.0 + 100 * index, 1.0, 0.1, 3, 10.0, source)
            for index, (radius_m, source) in enumerate(zip(RADII_M, sources))]


ALL = points([DRIVEN] * 4)


def test_tables_that_were_driven_have_no_problems():
    assert list(find_problems(curve(), {LEFT: ALL, RIGHT: ALL})) == []


@pytest.mark.parametrize("sources, problem", [
    ([UNKNOWN] * 4, "no data for left turns: drive slow left circles at ten positions"),
    ([UNKNOWN, UNKNOWN, DRIVEN, DRIVEN], "no data for left turns tighter than 5 m: drive three slow left circles"),
    ([DRIVEN, UNKNOWN, DRIVEN, DRIVEN], "too little data for left turns of 2 m: drive three slow ones with duties"),
    ([DRIVEN, UNKNOWN, UNKNOWN, DRIVEN], "too little data for left turns of 2 m to 5 m"),
    ([DRIVEN, DRIVEN, DRIVEN, UNKNOWN], "too little data for left turns of 20 m and wider"),
], ids=["whole_side", "tight_turns", "one_radius", "two_radii", "wide_turns"])
def test_unknown_radii_are_one_problem_with_what_to_drive(sources, problem):
    (found,) = find_problems(curve(), {LEFT: points(sources), RIGHT: ALL})
    assert found.startswith(problem)


def test_duties_to_drive_are_named_for_each_gap():
    unknown_end, gap = points([UNKNOWN, UNKNOWN, DRIVEN, DRIVEN]), points([DRIVEN, UNKNOWN, DRIVEN, DRIVEN])
    (tight,), (between,) = (list(find_problems(curve(), {LEFT: one, RIGHT: ALL})) for one in (unknown_end, gap))
    assert "with duties beyond 3950, up to the end of the stick" in tight
    assert "with duties from 4000 to 4200, come to from both sides" in between
    gaps = points([DRIVEN, UNKNOWN, DRIVEN, UNKNOWN])
    assert len(list(find_problems(curve(), {LEFT: gaps, RIGHT: gaps}))) == 4


@pytest.mark.parametrize("found, problem", [
    (curve(center=math.nan), "the car never went straight"),
    (curve(sigma=0.02), "where the car goes straight is known to ±24 duty only"),
], ids=["no_center", "uncertain_center"])
def test_center_that_is_not_known_is_a_problem(found, problem):
    (text,) = find_problems(found, {LEFT: ALL, RIGHT: ALL})
    assert text.startswith(problem)
