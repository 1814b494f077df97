"""The area: where arcs lead, and how far a car can go until no turn keeps it inside."""
from __future__ import annotations

import math

import pytest

from car_interface.calibration.drive.area import Area, Pose, Turn, moved
from car_interface.throttle.obstacle_stop import Outline

OUTLINE = Outline(front_m=0.4, rear_m=0.1, width_m=0.3)
TURNS = (Turn(1.0, 0.3), Turn(-1.0, 0.3))


def area(radius_m=3.0):
    return Area((0.0, 0.0), radius_m, OUTLINE)


@pytest.mark.parametrize("curvature, end", [
    (0.0, (1.0, 0.0, 0.0)), (math.pi / 2, (2 / math.pi, 2 / math.pi, math.pi / 2)),
    (-math.pi / 2, (2 / math.pi, -2 / math.pi, -math.pi / 2)), (1e-9, (1.0, 0.0, 0.0)),
], ids=("straight", "left_quarter", "right_quarter", "next_to_straight"))
def test_an_arc_ends_where_geometry_has_it(curvature, end):
    assert moved(Pose(0.0, 0.0, 0.0), 1.0, curvature) == pytest.approx(end, abs=1e-8)


def test_an_arc_backward_leads_back():
    pose = Pose(1.0, 2.0, 0.7)
    assert moved(moved(pose, 0.8, 0.5), -0.8, 0.5) == pytest.approx(pose)


def test_extent_is_that_of_the_farthest_corner():
    assert area().extent_m(Pose(0.0, 0.0, 0.0)) == pytest.approx(math.hypot(0.4, 0.15))
    assert area().extent_m(Pose(1.0, 0.0, math.pi)) == pytest.approx(math.hypot(1.1, 0.15))


def test_a_whole_circle_reaches_as_far_as_its_center_and_the_outer_front_corner():
    assert area().circle_extent_m(Pose(0.0, 0.0, 0.0), 1.0) == pytest.approx(1.0 + math.hypot(1.15, 0.4))


@pytest.mark.parametrize("yaw_deg, expected_deg", [(0, 180), (180, 0), (90, 90), (-90, 90), (540, 0)])
def test_inward_is_the_angle_to_the_center(yaw_deg, expected_deg):
    found = area().inward_rad(Pose(2.0, 0.0, math.radians(yaw_deg)))
    assert math.degrees(found) == pytest.approx(expected_deg, abs=1e-6)


def test_a_turn_counts_until_the_car_looks_inward_again():
    outward, inward = Pose(1.5, 0.0, 0.0), Pose(1.5, 0.0, math.pi)
    assert area(2.0).turn_extent_m(outward, 1.0) > 2.8
    assert area(2.0).turn_extent_m(inward, 1.0) == pytest.approx(area().extent_m(inward))


def test_the_way_out_is_the_turn_towards_the_center():
    left_m, right_m = area().ways_out(Pose(0.0, 1.5, 0.0), 0.0, TURNS)
    assert right_m < left_m


def test_a_turn_that_begins_later_gets_farther_out():
    extents = area().ways_out(Pose(0.8, 0.0, 0.0), 0.0, [Turn(1.0, reaction_m) for reaction_m in (0.1, 0.5, 0.9)])
    assert extents == sorted(extents) and extents[0] + 0.3 < extents[2]


def test_room_ends_where_the_last_turn_would_leave_the_area():
    free_m = area().free_m(Pose(0.0, 0.0, 0.0), 0.0, TURNS, 10.0)
    assert 0.8 < free_m < 1.8
    beyond = moved(Pose(0.0, 0.0, 0.0), free_m, 0.0)
    assert min(area().ways_out(beyond, 0.0, TURNS)) > 3.0
    assert area().free_m(Pose(0.0, 0.0, 0.0), 0.0, TURNS, 0.4) == 0.4


def test_room_ends_earlier_where_it_must_be_able_to_go_straight_on():
    pose = Pose(-2.0, 1.0, 0.3)
    far_m = area().free_m(pose, 0.0, TURNS, 10.0)
    near_m = area().free_m(pose, 0.0, TURNS, 10.0, 2.0)
    assert 0.0 < near_m < far_m
    assert area().ahead_m(moved(pose, near_m, 0.0), 3.0) == pytest.approx(2.0, abs=0.2)


def test_a_circle_inside_has_all_the_room():
    assert area().free_m(Pose(0.0, 0.0, 0.0), 1.0, TURNS, 50.0) == 50.0


def test_there_is_more_room_in_a_larger_area():
    rooms = [area(radius_m).free_m(Pose(0.0, 0.0, 0.0), 0.1, TURNS, 20.0) for radius_m in (3.0, 4.0, 6.0)]
    assert rooms == sorted(rooms) and rooms[0] < rooms[2]


@pytest.mark.parametrize("pose, expected_m", [
    (Pose(0.0, 0.0, 0.0), 2.6), (Pose(1.0, 0.0, 0.0), 1.6), (Pose(1.0, 0.0, math.pi), 3.6), (Pose(2.7, 0.0, 0.0), 0.0),
], ids=("from_the_center", "outward", "inward", "its_front_is_outside"))
def test_ahead_is_what_is_left_of_the_circle(pose, expected_m):
    assert area().ahead_m(pose, 3.0) == pytest.approx(expected_m)
