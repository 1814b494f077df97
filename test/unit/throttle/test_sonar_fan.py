"""How far a car gets on an arc until it touches a point, and until it leaves what its sonars look at."""

import itertools
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from car_interface.throttle.sonar_fan import Arc, Fan, Mount, Outline, cone_points

CAR = Outline(front_m=0.4, rear_m=0.1, width_m=0.3)
SIDE_M = 0.05
CONE_RAD = math.radians(30)
FRONT = {"front_right": Mount(0.40, -0.10, -CONE_RAD), "front_middle": Mount(0.42, 0.0, 0.0),
         "front_left": Mount(0.40, 0.10, CONE_RAD)}
REAR = {"rear_right": Mount(-0.12, -0.10, -5 * CONE_RAD), "rear_middle": Mount(-0.14, 0.0, math.pi),
        "rear_left": Mount(-0.12, 0.10, 5 * CONE_RAD)}
BUMPER_M, REAR_BUMPER_M = 0.426, 0.142
SLASH = Outline(BUMPER_M, REAR_BUMPER_M)


def along(curvature_per_m, way_m):
    """(x, y, heading) of a car that has driven so far on an arc; backward with a negative way."""
    turn_rad = way_m * curvature_per_m
    if abs(curvature_per_m) < 1e-9:
        return way_m, 0.0, 0.0
    return math.sin(turn_rad) / curvature_per_m, (1 - math.cos(turn_rad)) / curvature_per_m, turn_rad


@pytest.mark.parametrize(("x_m", "y_m", "curvature_per_m", "is_backward", "distance_m"), [
    (1.4, 0.0, 0.0, False, 1.0), (1.4, 0.19, 0.0, False, 1.0), (1.4, -0.19, 0.0, False, 1.0),
    (1.4, 0.21, 0.0, False, None), (0.4, 0.0, 0.0, False, 0.0), (-1.0, 0.0, 0.0, False, None),
    (0.0, 0.0, 0.0, False, None), (-1.1, 0.0, 0.0, True, 1.0), (1.1, 0.0, 0.0, True, None),
    # By hand: on 1 m to the left the front's outer corner is √(1.2² + 0.4²) = 1.265 m from the turn's centre, (0, 1).
    pytest.param(0.0, -0.25, 1.0, True, math.acos(1.2 / 1.25), id="beside_the_axle_as_the_front_swings_out"),
    pytest.param(0.5, -0.1456, 1.0, True, None, id="behind_the_corner_s_way"),
    pytest.param(0.0, -0.3, 1.0, True, None, id="beyond_the_corner"),
])
def test_it_is_the_way_until_bumper_or_flank_with_a_margin_touch(x_m, y_m, curvature_per_m, is_backward, distance_m):
    found_m = Arc(curvature_per_m, is_backward, CAR, SIDE_M).distance_m(x_m, y_m)
    assert found_m == (None if distance_m is None else pytest.approx(distance_m))


@pytest.mark.parametrize(("curvature_per_m", "x_m", "y_m", "distance_m"), [
    pytest.param(0.0, 3.0, 0.5, 1.0, id="left_flank"), pytest.param(0.0, 3.0, -0.5, 1.0, id="right_flank"),
    pytest.param(1.0, 2.0, -0.5, 0.0, id="outer_corner_of_the_bumper"),
    pytest.param(1.0, 0.5, 1.0, math.pi / 2, id="inner_flank_in_a_quarter_of_a_turn")])
def test_what_the_outline_just_touches_is_in_the_way(curvature_per_m, x_m, y_m, distance_m):
    arc = Arc(curvature_per_m, False, Outline(front_m=2.0, rear_m=1.0, width_m=1.0), 0.0)
    assert arc.sweeps([(x_m, y_m)]) == [True]
    assert arc.distance_m(x_m, y_m) == pytest.approx(distance_m)


def drives_into(x_m, y_m, curvature_per_m, is_backward, step_m=0.002, until_m=1.3):
    """The same by driving: the first distance at which the point is inside the outline, grown by the margin."""
    for step in range(int(until_m / step_m)):
        at_x, at_y, turn = along(curvature_per_m, step * step_m * (-1 if is_backward else 1))
        ahead = (x_m - at_x) * math.cos(turn) + (y_m - at_y) * math.sin(turn)
        left = (y_m - at_y) * math.cos(turn) - (x_m - at_x) * math.sin(turn)
        if -CAR.rear_m <= ahead <= CAR.front_m and abs(left) <= CAR.width_m / 2 + SIDE_M:
            return step * step_m
    return math.inf


@pytest.mark.once
@pytest.mark.parametrize("is_backward", [False, True])
@pytest.mark.parametrize("curvature_per_m", [0.0, 0.3, -0.3, 1.0, -1.0])
def test_on_any_arc_it_is_where_a_driven_car_meets_the_point(curvature_per_m, is_backward):
    met, arc = 0, Arc(curvature_per_m, is_backward, CAR, SIDE_M)
    for x_m, y_m in itertools.product((0.231 * step for step in range(-8, 9)), (0.217 * step for step in range(-8, 9))):
        if -0.15 <= x_m <= 0.45 and abs(y_m) <= 0.22:
            continue  # it touches the car already, or nearly
        expected_m, found_m = drives_into(x_m, y_m, curvature_per_m, is_backward), arc.distance_m(x_m, y_m)
        if expected_m < 1.2:
            met += 1
            assert found_m == pytest.approx(expected_m, abs=0.01), (x_m, y_m)
        else:
            assert found_m is None or found_m >= 1.19, (x_m, y_m)
    assert met >= 5


def test_points_across_a_cone_are_all_at_its_range_from_one_edge_to_the_other():
    mount = Mount(0.4, 0.1, 0.5)
    points = cone_points(mount, 1.5, 0.4)
    assert [math.dist(point, mount[:2]) for point in points] == pytest.approx([1.5] * 9)
    angles = [math.atan2(y_m - mount.y_m, x_m - mount.x_m) for x_m, y_m in points]
    assert angles == pytest.approx([0.3 + 0.05 * index for index in range(9)])


def fan(mounts, is_backward=False):
    return Fan(mounts, CONE_RAD, SLASH, is_backward)


def ends(curvature_per_m, mounts, is_backward=False, **reaches_m):
    """(distance, sonar, whether at an edge) where an arc ends, with reaches of 2 m."""
    return fan(mounts, is_backward).end(curvature_per_m, {**dict.fromkeys(mounts, 2.0), **reaches_m})[:3]


@pytest.mark.parametrize(("curvature_per_m", "distance_m", "sonar", "is_edge"), [
    (0.0, 1.994, "front_middle", False), (0.3, 2.031, "front_left", False), (-0.3, 2.031, "front_right", False),
    # By hand: at 1 1/m the bumper runs round (0, 1) at 1.087 m. The left edge is y = x − 0.3, which it crosses where
    # sin φ + cos φ = 1.3 / 1.087, at 77.3°; it began at 23.1°.
    (1.0, 0.946, "front_left", True), (-1.0, 0.946, "front_right", True), (2.0, 0.306, "front_left", True)])
def test_an_arc_ends_where_the_middle_of_the_bumper_leaves_the_fan(curvature_per_m, distance_m, sonar, is_edge):
    assert ends(curvature_per_m, FRONT) == (pytest.approx(distance_m, abs=0.001), sonar, is_edge)


def test_an_echo_hides_what_is_behind_it_in_its_cone():
    """The arc enters the left part 1.2 m from here, which that sonar sees for half a metre only."""
    distance_m, sonar, is_edge = ends(0.3, FRONT, front_left=0.5)
    assert (sonar, is_edge) == ("front_left", True)
    assert distance_m == pytest.approx(1.191, abs=0.001)
    assert ends(0.0, FRONT, front_left=0.5) == ends(0.0, FRONT)
    assert ends(0.0, FRONT, front_middle=0.5) == (pytest.approx(0.494, abs=0.001), "front_middle", False)


def test_sonars_that_the_car_lacks_narrow_the_fan():
    without_left = {name: mount for name, mount in FRONT.items() if name != "front_left"}
    assert ends(0.5, without_left)[:2] == (pytest.approx(0.234, abs=0.001), "front_middle")
    assert ends(-0.5, without_left) == ends(-0.5, FRONT)
    only_left = {"front_left": FRONT["front_left"]}
    assert ends(0.0, only_left)[0] == ends(-0.5, only_left)[0] == 0.0
    assert ends(1.0, only_left)[0] == pytest.approx(ends(1.0, FRONT)[0])
    assert fan({}).end(0.3, {}) == (0.0, "", True, ())


def test_the_area_just_before_the_bumper_counts_as_looked_at():
    """The right sonar's left edge, at 30°, runs to the right of the bumper's middle, and is moved to it.

    By hand: the arc begins at atan(0.426) = 23.07° and so leaves the moved edge at 30° + 6.93°.
    """
    right = {"front_right": FRONT["front_right"]}
    end = Fan(right, math.radians(120), SLASH, False).end(1.0, {"front_right": 2.0})
    assert end == (pytest.approx(math.radians(2 * 6.926), abs=1e-4), "front_right", True, ("front_right",))


def test_it_tells_through_whose_parts_an_arc_leads():
    reaches_m = dict.fromkeys(FRONT, 2.0)
    assert [fan(FRONT).end(curvature_per_m, reaches_m).sonars for curvature_per_m in (0.0, 0.5, -0.5)] == [
        ("front_middle",), ("front_middle", "front_left"), ("front_middle", "front_right")]


def is_looked_at(x_m, y_m, reach_m):
    """Whether a point is between the outermost edges, at 45° from x = 0.4 and y = ±0.1, and within reach of a sonar."""
    is_between = abs(y_m) - 0.1 <= x_m - 0.4 + 1e-9
    return is_between and any(math.dist((x_m, y_m), mount[:2]) <= reach_m + 0.05 for mount in FRONT.values())


@pytest.mark.once
@given(curvature_per_m=st.floats(-1.5, 1.5), reach_m=st.floats(0.5, 4.0))
def test_all_the_way_to_the_end_the_bumper_is_inside_of_the_fan_and_beyond_it_outside(curvature_per_m, reach_m):
    end = fan(FRONT).end(curvature_per_m, dict.fromkeys(FRONT, reach_m))
    for share in (0.0, 0.3, 0.6, 0.9, 0.99):
        x_m, y_m, turn_rad = along(curvature_per_m, end.distance_m * share)
        assert is_looked_at(x_m + BUMPER_M * math.cos(turn_rad), y_m + BUMPER_M * math.sin(turn_rad), reach_m)
    x_m, y_m, turn_rad = along(curvature_per_m, end.distance_m + 0.12)
    assert not is_looked_at(x_m + BUMPER_M * math.cos(turn_rad), y_m + BUMPER_M * math.sin(turn_rad), reach_m - 0.05)


@pytest.mark.once
@given(curvature_per_m=st.floats(-1.5, 1.5), reaches_m=st.lists(st.floats(0.0, 4.0), min_size=3, max_size=3))
def test_left_and_right_are_mirror_images_and_a_shorter_reach_never_frees_an_arc(curvature_per_m, reaches_m):
    reaches = dict(zip(FRONT, reaches_m))
    mirrored = dict(zip(FRONT, reversed(reaches_m)))
    end = fan(FRONT).end(curvature_per_m, reaches)
    assert fan(FRONT).end(-curvature_per_m, mirrored).distance_m == pytest.approx(end.distance_m, abs=1e-6)
    assert end.distance_m <= fan(FRONT).end(curvature_per_m, dict.fromkeys(FRONT, 4.0)).distance_m + 1e-9
    assert end.distance_m >= 0.0


@pytest.mark.once
@given(curvature_per_m=st.floats(-1.5, 1.5), is_backward=st.booleans(),
       points=st.lists(st.tuples(st.floats(-3.0, 3.0), st.floats(-3.0, 3.0)), max_size=20))
def test_no_point_that_the_car_touches_fails_the_quick_test(curvature_per_m, is_backward, points):
    arc = Arc(curvature_per_m, is_backward, CAR, SIDE_M)
    for point, is_swept in zip(points, arc.sweeps(points)):
        assert is_swept or arc.distance_m(*point) is None


def test_a_circle_beside_a_sonar_far_in_front_of_the_bumper_is_not_free_for_ever():
    """Its path never meets the edge of the cone, and is nowhere beyond the sonar's range."""
    mounts = {"front_left": Mount(1.46, 0.0, 0.9)}
    assert Fan(mounts, CONE_RAD, SLASH, False).end(-19.0, {"front_left": 2.0}).distance_m < math.pi / 19.0
