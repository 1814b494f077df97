"""The area: where arcs lead, and by how much turns leave it."""
import math
import random
from dataclasses import replace

import pytest

from car_interface.throttle.obstacle_stop import Outline
from car_interface.tools.calibration.drive.area import Area, Pose, Turn, moved

OUTLINE = Outline(front_m=0.4, rear_m=0.1, width_m=0.3)
START = Pose(0.0, 0.0, 0.0)


def area(radius_m=3.0):
    return Area((0.0, 0.0), radius_m, OUTLINE)


@pytest.mark.parametrize("curvature, end", [
    (0.0, (1.0, 0.0, 0.0)), (math.pi / 2, (2 / math.pi, 2 / math.pi, math.pi / 2)),
    (-math.pi / 2, (2 / math.pi, -2 / math.pi, -math.pi / 2)), (1e-9, (1.0, 0.0, 0.0)),
], ids=("straight", "left_quarter", "right_quarter", "next_to_straight"))
def test_an_arc_ends_where_geometry_has_it(curvature, end):
    assert moved(Pose(0.0, 0.0, 0.0), 1.0, curvature) == pytest.approx(end, abs=1e-8)


def test_extent_is_that_of_the_farthest_corner_of_a_car_or_of_its_whole_circle():
    assert area().extent_m(START) == pytest.approx(math.hypot(0.4, 0.15))
    assert area().extent_m(Pose(1.0, 0.0, math.pi)) == pytest.approx(math.hypot(1.1, 0.15))
    assert area().circle_extent_m(START, 1.0) == pytest.approx(1.0 + math.hypot(1.15, 0.4))
    around_the_center = Pose(0.0, -1.0, 0.0)
    assert area().circle_extent_m(around_the_center, 1.0) == pytest.approx(math.hypot(1.15, 0.4))


@pytest.mark.parametrize("yaw_deg, expected_deg", [(0, 180), (-90, 90), (540, 0)])
def test_inward_is_the_angle_to_the_center(yaw_deg, expected_deg):
    found = area().inward_rad(Pose(2.0, 0.0, math.radians(yaw_deg)))
    assert math.degrees(found) == pytest.approx(expected_deg, abs=1e-6)


def farthest_m(pose, curvature_per_m):
    """The same step by step, by the definition."""
    one, step_rad = area(), 0.002
    farthest = 0.0
    for _ in range(math.ceil(2 * math.pi / step_rad)):
        farthest = max(farthest, one.extent_m(pose))
        pose = moved(pose, step_rad / abs(curvature_per_m), curvature_per_m)
    return farthest


@pytest.mark.parametrize("seed", range(4))
def test_a_circle_reaches_as_far_as_its_corners_do_step_by_step(seed):
    rng = random.Random(seed)
    pose = Pose(rng.uniform(-3, 3), rng.uniform(-3, 3), rng.uniform(-7, 7))
    curvature = rng.choice((-1, 1)) * rng.uniform(0.3, 1.5)
    assert area().circle_extent_m(pose, curvature) == pytest.approx(farthest_m(pose, curvature), abs=0.005)


@pytest.mark.parametrize("curvature", [1.0, -0.6])
@pytest.mark.parametrize("stop_m", [0.0, 0.5])
def test_where_it_stops_on_a_turn_is_as_far_as_the_front_of_a_car_that_is_longer_by_that(curvature, stop_m):
    longer = Area((0.0, 0.0), 3.0, replace(OUTLINE, front_m=OUTLINE.front_m + stop_m))
    for pose in (Pose(1.5, 0.0, 0.0), Pose(1.0, -1.0, 2.0), Pose(-1.8, 0.5, 1.0)):
        assert area().circle_extent_m(pose, curvature, stop_m) == longer.circle_extent_m(pose, curvature)


def test_a_turn_leaves_the_area_by_what_the_car_does_or_by_where_it_stops():
    pose, turn = Pose(0.0, 1.0, 0.5), Turn(-1.0, 0.3)
    after = moved(pose, 0.3, 0.0)
    for stop_m, stop_radius_m in ((0.0, 9.0), (0.6, 9.0), (0.6, 3.1), (0.6, None)):
        one = Area((0.0, 0.0), 3.0, OUTLINE, stop_radius_m)
        (extent_m, excess_m), = one.ways_out(pose, 0.0, (turn,), 1.0, stop_m)
        stops_m = one.circle_extent_m(after, -1.0, stop_m)
        assert extent_m == max(one.extent_m(pose), one.extent_m(after), one.circle_extent_m(after, -1.0))
        assert excess_m == pytest.approx(max(extent_m - 3.0, stops_m - (stop_radius_m or 3.0)))


@pytest.mark.parametrize("radius_m, has_circle", [(2.3, True), (2.5, False)])
def test_a_circle_fits_where_its_outer_corner_stays_inside(radius_m, has_circle):
    one = Area((1.0, -2.0), math.hypot(2.4 + 0.15, 0.4), OUTLINE)
    assert [one.has_circle(sign / radius_m) for sign in (1, -1)] == [has_circle, has_circle]


@pytest.mark.parametrize("pose, expected_m", [
    (Pose(0.0, 0.0, 0.0), 2.6), (Pose(1.0, 0.0, 0.0), 1.6), (Pose(1.0, 0.0, math.pi), 3.6), (Pose(2.7, 0.0, 0.0), 0.0),
], ids=("from_the_center", "outward", "inward", "its_front_is_outside"))
def test_ahead_is_what_is_left_of_the_circle(pose, expected_m):
    assert area().ahead_m(pose, 3.0) == pytest.approx(expected_m)
