"""Tables of duties over turn radii: only what was driven is stated."""
import math
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from car_interface.tools.calibration.steering import fit
from car_interface.tools.calibration.steering.calibrate import (
    DRIVEN,
    END,
    LEFT,
    OLD,
    RIGHT,
    UNKNOWN,
    Breakpoint,
    axis,
    breakpoints,
    completed,
    find_problems,
)
from car_interface.tools.calibration.steering.fit import Side
from car_interface.tools.calibration.steering.smooth import BAND
from tools.calibration.steering.synthetic import (
    CENTER,
    KNOWN,
    drive,
    fitted_mixed,
    from_both_sides,
    mixed,
    true_curvature,
)

pytestmark = pytest.mark.once


def test_breakpoints_have_the_duty_that_turns_so_tight_with_a_band_that_holds_the_truth():
    points = breakpoints(fitted_mixed(), [1.2, 1.5, 2.0, 3.0, 5.0, 10.0, 50.0], LEFT)
    for point in points:
        assert point.source == DRIVEN
        assert true_curvature(point.duty) == pytest.approx(1 / point.radius_m, abs=0.01)
        truth = CENTER - 1300 / point.radius_m
        assert abs(point.duty - truth) < 4 * point.duty_sigma + 3
    assert points[0].segments > 0 and points[0].distance_m > 1


def test_tighter_than_the_stop_has_the_duty_of_the_stop():
    found = fitted_mixed()
    points = breakpoints(found, [0.5, 0.8, 1.5], RIGHT)
    assert [point.source for point in points] == [END, END, DRIVEN]
    assert points[0].duty == points[1].duty == found.right.duty


def test_tighter_than_what_was_driven_is_unknown_unless_a_stop_was_met():
    found = fit.fit([drive(mixed(low=3700, high=5700))], KNOWN)
    assert not found.right.is_stop
    points = breakpoints(found, [1.0, 2.0, 4.0], RIGHT)
    assert [point.source for point in points] == [UNKNOWN, UNKNOWN, DRIVEN]
    assert all(point.duty <= found.right.farthest_duty + 1 for point in points)


def test_gap_in_what_was_driven_is_unknown():
    duties = np.concatenate([mixed(low=3700, high=4100, count=15), mixed(low=4950, high=6600, count=25)])
    curve = lambda duty: np.sign(CENTER - duty) * np.abs((CENTER - duty) / 1250) ** 2.5  # noqa: E731
    found = fit.fit([drive(duties, curve=curve)], KNOWN)
    sources = {point.radius_m: point.source for point in breakpoints(found, [1.2, 3.0, 100.0], LEFT)}
    assert sources == {1.2: DRIVEN, 3.0: UNKNOWN, 100.0: DRIVEN}


def test_what_a_table_says_was_driven_is_known_as_well_as_it_is_promised():
    found = fit.fit([drive(from_both_sides(mixed(count=8)), curve=lambda duty: np.sign(CENTER - duty) * np.abs(
        (CENTER - duty) / 1300) ** 2.5, hold_s=2.0)], KNOWN)
    radii = np.exp(np.linspace(math.log(1.1), math.log(100), 80))
    points = [point for side in (LEFT, RIGHT) for point in breakpoints(found, radii, side)]
    assert {UNKNOWN, DRIVEN} <= {point.source for point in points}
    for point in points:
        count = round(point.duty / 16) * 16
        half_count = abs(np.diff(found.curvature(np.array([count - 16, count + 16])))[0]) / 4
        band = BAND * point.radius_sigma_m / point.radius_m ** 2
        promised = max(0.08 / point.radius_m, 0.01) + half_count
        assert band <= promised + 1e-9 or point.source == UNKNOWN


def point(radius_m, duty, source):
    return Breakpoint(radius_m, duty, 1.0, 0.1, 3, 10.0, source)


@pytest.mark.parametrize("center, old, expected", (
    (5000, [6000, 5700, 5300, 5100], [6000, 5800, 5300, 5200]),
    (5000, [5500, 5700, 5900, 4000], [5800, 5800, 5800, 5200]),
    (5000, [9000, 5700, 5700, 5100], [9000, 5800, 5700, 5200]),
), ids=("they fit", "too near to the center", "one too far"))
def test_old_duties_give_way_to_driven_ones(center, old, expected):
    points = [point(1.0, 0.0, UNKNOWN), point(2.0, 5800.0, DRIVEN), point(3.0, 0.0, UNKNOWN),
              point(9.0, 5200.0, DRIVEN)]
    made = completed(points, center, old)
    assert [one.duty for one in made] == expected
    assert [one.source for one in made] == [OLD, DRIVEN, OLD, DRIVEN]


@given(st.floats(0.3, 7.0))
def test_axis_rises_whatever_the_tightest_turn(tightest_m):
    side = SimpleNamespace(curvature_per_m=1 / tightest_m)
    radii = axis(SimpleNamespace(left=side, right=side))
    assert all(wider > radius + 0.01 for radius, wider in zip(radii, radii[1:]))


def test_axis_begins_at_the_tightest_turn_and_lines_between_its_radii_are_exact():
    found = fitted_mixed()
    radii = axis(found)
    assert radii[0] == pytest.approx(1.0, abs=0.03) and radii[-1] == 300
    tables = {side: [one.duty for one in breakpoints(found, radii, side)] for side in (LEFT, RIGHT)}
    for radius in np.exp(np.linspace(math.log(1.2), math.log(300), 200)):
        for side, sign in ((LEFT, 1), (RIGHT, -1)):
            assert found.curvature(np.interp(radius, radii, tables[side])) == pytest.approx(sign / radius, abs=0.008)


RADII_M = (1.0, 2.0, 5.0, 20.0)


def curve(center=5100.0, sigma=1e-4):
    end = Side(3900.0, 1.0, False, False, 3950.0)
    return SimpleNamespace(center=center, center_sigma=12.0, left=end, right=end._replace(farthest_duty=6400.0),
                           duties=np.array([3900.0, 6500.0]), sigmas=np.full(2, sigma))


def points(sources):
    return [Breakpoint(radius_m, 4000.0 + 100 * index, 1.0, 0.1, 3, 10.0, source)
            for index, (radius_m, source) in enumerate(zip(RADII_M, sources))]


ALL = points([DRIVEN] * 4)


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
