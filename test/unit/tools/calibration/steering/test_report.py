"""The report on a steering calibration.

The curve is a line of 1/1200 1/m per duty, with a segment of 2 m at each of its 151 counts.
"""
import math
from dataclasses import replace

import numpy as np
import pytest

from car_interface.tools.calibration.steering.calibrate import (
    DRIVEN,
    END,
    LEFT,
    OLD,
    RIGHT,
    UNKNOWN,
    Breakpoint,
    SteeringResult,
    breakpoints,
    find_problems,
    report,
    short_report,
)
from car_interface.tools.calibration.steering.fit import UNKNOWN_BACKLASH, Side, Understeer
from tools.calibration.steering.known_curve import line_curve, recorded


def point(radius_m, duty, source=DRIVEN, duty_sigma=2.0, radius_sigma_m=0.1, segments=7, distance_m=14.0):
    return Breakpoint(radius_m, duty, duty_sigma, radius_sigma_m, segments, distance_m, source)


POINTS = {LEFT: [point(1.0, 4000.0, END), point(2.0, 4600.0)], RIGHT: [point(1.0, 6400.0, END), point(2.0, 5800.0)]}


def lines(curve=None, recordings=None, axis_m=None, points=None, problems=(), disagreement=""):
    curve = curve or line_curve()
    made = SteeringResult(curve, curve.center, {}, points or POINTS, list(problems), disagreement)
    return list(report(made, recordings or [recorded()], axis_m))


def test_what_steady_circles_cannot_show_is_said_to_be_unknown():
    steady = line_curve(backlash_duty=0.0, backlash_sigma=UNKNOWN_BACKLASH[1])
    assert lines(steady)[2] == ("  how fast the servo follows, and the backlash of the steering, aren't known: the "
                                "duty never changed within a recording")


def test_side_that_was_not_driven_has_no_end():
    curve = line_curve()
    found = curve.observations
    left = replace(curve, observations=found.those(found.curvature_per_m > 0.05), center=math.nan)
    assert [line[:8] for line in lines(left) if ": duty" in line] == ["  left: "]
    points = breakpoints(left, [1.0, 2.0], RIGHT)
    assert {point.source for point in points} == {UNKNOWN}
    assert "no data for right turns: " in " ".join(find_problems(left, {LEFT: [], RIGHT: points}))


@pytest.mark.parametrize("sigma, line", [
    (0.0008, "  understeer: 0.0091 ± 0.0016 1/m for each (m/s²)², from 4 positions at several speeds"),
    (0.001, "  by how much turns widen with speed isn't known well enough (0.0091 ± 0.0020 1/m for each (m/s²)², "),
    (0.1, "  by how much turns widen with speed isn't known, and understeer stays as it was: "),
], ids=["within_a_fifth", "not_within_a_fifth", "not_at_all"])
def test_understeer_is_taken_where_it_is_known_within_a_fifth(sigma, line):
    assert lines(line_curve(understeer=Understeer(0.0091, sigma, 4)))[3].startswith(line)


def test_report_sums_up_the_recordings_what_was_used_of_them_and_what_the_fit_found():
    assert lines()[:8] == [
        "steering by a.bag: 60 s, 151 segments of steady steering, 302 m in them",
        "  left out (intervals): none",
        "  the servo follows after 0.10 s, with a lag of 0.15 s; backlash of the steering: 6 ± 2 duty",
        ("  by how much turns widen with speed isn't known, and understeer stays as it was: drive some circles at "
         "other speeds, too, up to 4 m/s² sideways"),
        "  segments lie off the curve by 0.0000 1/m (median), 0.0000 (95 %)",
        "  straight on: duty 5200 ± 4",
        "  left: duty 4000, radius 1.00 m: the radius shrinks no more",
        "  right: duty 6400, radius 1.00 m: the radius shrinks no more"]
    curve = replace(line_curve(counts={"slow or standing": 3, "servo on its way": 0, "gaps in odometry or duty": 1}),
                    center=math.nan, right=Side(5200.0, 0.0, False, False, 5200.0))
    curve.observations.curvature_per_m[:] += 0.0125
    curve = replace(curve, observations=curve.observations.those(np.arange(151) > 50))
    two = [recorded("x/a.bag", duration_s=30.4, notes=("no IMU", "short")), recorded("x/b.bag", duration_s=12.0)]
    found = lines(curve, two)
    assert found[:5] == [
        "steering by a.bag, b.bag: 42 s, 100 segments of steady steering, 200 m in them",
        "  x/a.bag: no IMU", "  x/a.bag: short",
        "  left out (intervals): 3 slow or standing, 1 gaps in odometry or duty",
        "  the servo follows after 0.10 s, with a lag of 0.15 s; backlash of the steering: 6 ± 2 duty"]
    assert "  segments lie off the curve by 0.0125 1/m (median), 0.0125 (95 %)" in found
    assert not any("straight on:" in line for line in found)
    assert any(line.startswith("  right: duty 5200, radius none: ") for line in found)


# --- the table ---

def row(radius_text, points):
    (found,) = [line.split() for line in lines(points=points) if line.startswith(f"  {radius_text:>6} m ")]
    return found


@pytest.mark.parametrize("left, right, cells", [
    # ± 1.96 · 2 duty, 1.96 · 0.1 m of 2 m
    (point(2.0, 4600.0), point(2.0, 5800.0, duty_sigma=5.0, segments=3, distance_m=6.0),
     "2 m 4600 4 9.8% 7 14 5800 10 9.8% 3 6"),
    (point(1.0, 4000.0, END), point(1.0, 6400.0, END, duty_sigma=1e9, radius_sigma_m=1e9),
     "1 m 4000e 4 19.6% 7 14 6400e 9999 999.0% 7 14"),
    (point(3.0, 4700.0), point(3.0, 5900.0, OLD), "3 m 4700 4 6.5% 7 14 5900 * old"),
], ids=["both_driven", "ends_are_marked_and_a_large_error_is_limited", "old_duty_is_marked_and_has_no_error"])
def test_row_has_both_sides_with_two_standard_errors(left, right, cells):
    assert row(cells.split()[0], {LEFT: [left], RIGHT: [right]}) == cells.split()


def test_columns_are_below_each_other_whatever_a_duty_rests_on():
    points = [point(2.0, 4600.0), point(3.0, 4700.0, OLD), point(4.0, 4800.0, END)]
    found = lines(points={LEFT: points, RIGHT: points})
    for one in points:
        (line,) = [line for line in found if line.startswith(f"  {one.radius_m:6g} m  ")]
        assert [line.find(f"{one.duty:.0f}"), line.rfind(f"{one.duty:.0f}"), len(line)] == [16, 58, 93]


def test_short_report_fits_80_columns_with_eight_radii_and_both_ends():
    points = {side: [point(1.0 + index, 5000.0 + index, OLD if index == 29 else DRIVEN) for index in range(30)]
              for side in (LEFT, RIGHT)}
    curve = line_curve()
    found = list(short_report(SteeringResult(curve, curve.center, {}, points, ["no center"], ""), [recorded()]))
    assert found[5:7] == ["  radius         left  ±duty   ±radius        right  ±duty   ±radius",
                          "       1 m      5000      4    19.6%       5000      4    19.6%"]
    assert [line.split()[0] for line in found[6:14]] == ["1", "5", "9", "13", "18", "22", "26", "30"]
    assert found[13] == "      30 m      5029 *           old       5029 *           old"
    assert max(map(len, found[3:14])) < 80 and len(found) == 15


def test_problems_and_a_disagreement_end_it():
    assert lines(problems=["no data for left turns", "no center"], disagreement="a and b disagree")[-3:] == [
        "  missing: no data for left turns", "  missing: no center", "  a and b disagree?"]
    assert not any("missing" in line for line in lines())
