"""The area: where arcs lead, and how far a car can go until no turn keeps it inside."""
import math
import random
from dataclasses import replace

import pytest

from car_interface.throttle.obstacle_stop import Outline
from car_interface.tools.calibration.drive.area import INWARD_RAD, Area, Pose, Turn, moved

OUTLINE = Outline(front_m=0.4, rear_m=0.1, width_m=0.3)
START = Pose(0.0, 0.0, 0.0)
TURNS = (Turn(1.0, 0.3), Turn(-1.0, 0.3))


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
    around_the_center = Pose(0.0, -1.0, 0.0)  # which never looks inward
    assert area(1.0).turn_extent_m(around_the_center, 1.0) == pytest.approx(math.hypot(1.15, 0.4))


@pytest.mark.parametrize("yaw_deg, expected_deg", [(0, 180), (-90, 90), (540, 0)])
def test_inward_is_the_angle_to_the_center(yaw_deg, expected_deg):
    found = area().inward_rad(Pose(2.0, 0.0, math.radians(yaw_deg)))
    assert math.degrees(found) == pytest.approx(expected_deg, abs=1e-6)


def farthest_m(pose, curvature_per_m):
    """The same step by step, by the definition."""
    one, step_rad = area(0.1), 0.002
    farthest = 0.0
    for _ in range(math.ceil(2 * math.pi / step_rad)):
        farthest = max(farthest, one.extent_m(pose))
        if one.inward_rad(pose) < INWARD_RAD:
            break
        pose = moved(pose, step_rad / abs(curvature_per_m), curvature_per_m)
    return farthest


@pytest.mark.parametrize("seed", range(4))
def test_a_turn_reaches_as_far_as_its_corners_do_step_by_step(seed):
    rng = random.Random(seed)
    pose = Pose(rng.uniform(-3, 3), rng.uniform(-3, 3), rng.uniform(-7, 7))
    curvature = rng.choice((-1, 1)) * rng.uniform(0.3, 1.5)
    # In an area of next to no size no circle stays inside, and none is taken for the turn.
    assert area(0.1).turn_extent_m(pose, curvature) == pytest.approx(farthest_m(pose, curvature), abs=0.005)


@pytest.mark.parametrize("curvature", [1.0, -0.6])
@pytest.mark.parametrize("stop_m", [0.0, 0.5])
def test_where_it_stops_on_a_turn_is_as_far_as_the_front_of_a_car_that_is_longer_by_that(curvature, stop_m):
    longer = Area((0.0, 0.0), 0.1, replace(OUTLINE, front_m=OUTLINE.front_m + stop_m))
    for pose in (Pose(1.5, 0.0, 0.0), Pose(1.0, -1.0, 2.0), Pose(-1.8, 0.5, 1.0)):
        assert area(0.1).turn_extent_m(pose, curvature, stop_m) == longer.turn_extent_m(pose, curvature)
        assert area().circle_extent_m(pose, curvature, stop_m) == longer.circle_extent_m(pose, curvature)


def test_a_turn_leaves_the_area_by_what_the_car_does_or_by_where_it_stops():
    pose, turn = Pose(0.0, 1.0, 0.5), Turn(-1.0, 0.3)
    after = moved(pose, 0.3, 0.0)
    for stop_m, stop_radius_m in ((0.0, 9.0), (0.6, 9.0), (0.6, 3.1), (0.6, None)):
        one = Area((0.0, 0.0), 3.0, OUTLINE, stop_radius_m)
        (extent_m, excess_m, circle_excess_m), = one.ways_out(pose, 0.0, (turn,), 1.0, stop_m)
        assert circle_excess_m == max(excess_m, one.circle_extent_m(after, -1.0) - 3.0)
        stops_m = one.turn_extent_m(after, -1.0, stop_m)
        assert extent_m == max(one.extent_m(pose), one.extent_m(after), one.turn_extent_m(after, -1.0))
        assert excess_m == pytest.approx(max(extent_m - 3.0, stops_m - (stop_radius_m or 3.0)))


def rooms_m(pose, curvature_per_m=0.0, max_m=10.0, stop_m=0.0, min_ahead_m=lambda gone_m: 0.0, one=None,
            speed_mps_at=lambda at: 1.0):
    return (one or area()).rooms_m(pose, curvature_per_m, TURNS, max_m, stop_m, speed_mps_at, min_ahead_m)


def extents_m(pose, curvature_per_m=0.0):
    return [way.extent_m for way in area().ways_out(pose, curvature_per_m, TURNS, 1.0, 0.0)]


def test_room_ends_where_the_last_turn_would_leave_the_area():
    free_m = max(rooms_m(START))
    assert 0.8 < free_m < 1.8
    beyond = moved(START, free_m + 0.2, 0.0)
    assert min(extents_m(beyond)) > 3.0
    assert rooms_m(START, max_m=0.4) == [0.4, 0.4]
    assert rooms_m(START, 1.0, 50.0) == [50.0, 50.0], "a circle that stays inside"
    pose = Pose(-1.0, 1.0, 0.0)
    rooms = [max(rooms_m(pose, stop_m=stop_m)) for stop_m in (0.0, 0.3, 0.9)]
    assert rooms[0] > rooms[1] > rooms[2] > 0.0, "less for a car that takes longer to stop"
    assert max(rooms_m(pose, stop_m=0.3, one=Area((0.0, 0.0), 3.0, OUTLINE, 3.5))) == rooms[0]


def test_the_turn_towards_the_center_can_begin_later_than_the_other_one():
    pose = Pose(-1.5, 0.5, 0.0)  # the center is to the right
    left_m, right_m = rooms_m(pose)
    assert left_m < right_m - 0.3
    for turn, room_m in zip((0, 1), (left_m, right_m)):
        extents = [extents_m(moved(pose, at_m, 0.0))[turn] for at_m in (room_m, room_m + 0.2)]
        assert extents[0] <= 3.0 < extents[1]


def test_a_turn_that_fits_only_later_on_the_way_counts_from_there():
    pose, curvature = Pose(-0.8, 0.7, 0.2), -0.4
    stays = [extents_m(moved(pose, at_m, curvature), curvature)[0] <= 3.0 for at_m in (0.0, 0.6, 1.4)]
    assert stays == [False, True, False]
    assert rooms_m(pose, curvature)[0] == pytest.approx(1.0)


def test_a_turn_is_as_late_as_it_is_from_where_it_begins():
    late_m, slowed_m, early_m = (max(rooms_m(Pose(-2.0, 0.0, 0.0), speed_mps_at=speed_mps_at)) for speed_mps_at in (
        lambda at: 1.0, lambda at: 1.0 if at.x_m > 0.0 else 4.0, lambda at: 4.0))
    assert late_m == slowed_m > early_m + 0.5


def test_room_ends_earlier_where_it_must_be_able_to_go_straight_on():
    pose = Pose(-2.0, 1.0, 0.3)
    far_m, near_m = max(rooms_m(pose)), max(rooms_m(pose, min_ahead_m=lambda gone_m: 2.0))
    assert 0.0 < near_m < far_m
    assert area().ahead_m(moved(pose, near_m, 0.0), 3.0) == pytest.approx(2.0, abs=0.2)
    room_m, slower_m = (max(rooms_m(Pose(-2.0, 0.0, 0.0), min_ahead_m=min_ahead_m)) for min_ahead_m in (
        lambda gone_m: 3.0, lambda gone_m: 3.0 - gone_m))
    assert room_m == pytest.approx(1.6) and slower_m > room_m + 0.3, "by the distance that it has gone"


@pytest.mark.parametrize("radius_m, has_circle", [(2.3, True), (2.5, False)])
def test_a_circle_fits_where_its_outer_corner_stays_inside(radius_m, has_circle):
    one = Area((1.0, -2.0), math.hypot(2.4 + 0.15, 0.4), OUTLINE)
    assert [one.has_circle(sign / radius_m) for sign in (1, -1)] == [has_circle, has_circle]


@pytest.mark.parametrize("pose, expected_m", [
    (Pose(0.0, 0.0, 0.0), 2.6), (Pose(1.0, 0.0, 0.0), 1.6), (Pose(1.0, 0.0, math.pi), 3.6), (Pose(2.7, 0.0, 0.0), 0.0),
], ids=("from_the_center", "outward", "inward", "its_front_is_outside"))
def test_ahead_is_what_is_left_of_the_circle(pose, expected_m):
    assert area().ahead_m(pose, 3.0) == pytest.approx(expected_m)
