"""How fast a car may drive towards what its sonars see."""
import itertools
import math

import pytest

from car_interface.common import causes
from car_interface.common.errors import ConfigError
from car_interface.common.params import Params
from car_interface.throttle.obstacle_stop import (
    Guarantee,
    Mount,
    ObstacleConfig,
    ObstacleStop,
    Outline,
    cone_distance_m,
    point_distance_m,
    read_obstacle_stop,
    stopping_speed_mps,
)

MS, S = 1_000_000, 1_000_000_000
BRAKE, DRAG = Guarantee(1.5, 0.0, 0.3), Guarantee(0.3, 0.0, 0.3)
CAR = Outline(front_m=0.4, rear_m=0.1, width_m=0.3)
AHEAD = Mount(0.4, 0.0, 0.0)
SONARS = {"front_right": [0.40, -0.10, -0.5236], "front_middle": [0.42, 0.0, 0.0], "front_left": [0.40, 0.10, 0.5236],
          "rear_right": [-0.12, -0.10, -2.6180], "rear_middle": [-0.14, 0.0, 3.1416],
          "rear_left": [-0.12, 0.10, 2.6180]}


# --- the arithmetic ---

@pytest.mark.parametrize("distance_m", [0.05, 1.0, 3.9])
@pytest.mark.parametrize("time_s", [0.1, 1.0])
@pytest.mark.parametrize("guarantee", [BRAKE, DRAG])
def test_from_the_speed_that_is_allowed_the_car_stops_exactly_there(distance_m, time_s, guarantee):
    speed_mps = stopping_speed_mps(distance_m, time_s, guarantee)
    assert speed_mps * time_s + speed_mps ** 2 / (2 * guarantee.stop_mps2) == pytest.approx(distance_m)
    assert stopping_speed_mps(0.0, time_s, guarantee) == stopping_speed_mps(-0.1, time_s, guarantee) == 0.0


def test_a_brake_that_ends_early_leaves_the_rest_to_drag_and_where_it_is_too_short_drag_alone_counts():
    guarantee = Guarantee(1.5, 0.5, 0.3)
    speed_mps = stopping_speed_mps(1.9, 0.5, guarantee)
    assert speed_mps > 0.5
    assert speed_mps * 0.5 + (speed_mps ** 2 - 0.25) / 3.0 + 0.25 / 0.6 == pytest.approx(1.9)
    assert stopping_speed_mps(0.4, 0.5, guarantee) == stopping_speed_mps(0.4, 0.5, DRAG)


# --- the arc ---

@pytest.mark.parametrize(("x_m", "y_m", "is_backward", "distance_m"), [
    (1.4, 0.0, False, 1.0), (1.4, 0.19, False, 1.0), (1.4, -0.19, False, 1.0), (1.4, 0.21, False, None),
    (0.4, 0.0, False, 0.0), (-1.0, 0.0, False, None), (0.0, 0.0, False, None), (-1.1, 0.0, True, 1.0),
    (1.1, 0.0, True, None)])
def test_straight_on_it_is_the_way_to_the_bumper_within_the_width_and_a_margin(x_m, y_m, is_backward, distance_m):
    found_m = point_distance_m(x_m, y_m, 0.0, is_backward, CAR)
    assert found_m == (None if distance_m is None else pytest.approx(distance_m))


def drives_into(x_m, y_m, curvature_per_m, is_backward, outline, step_m=0.002, until_m=1.3):
    """The same by driving: the first distance at which the point is inside the outline, grown by the margin."""
    for step in range(int(until_m / step_m)):
        way_m = step * step_m * (-1 if is_backward else 1)
        turn = way_m * curvature_per_m
        at_x = math.sin(turn) / curvature_per_m if curvature_per_m else way_m
        at_y = (1 - math.cos(turn)) / curvature_per_m if curvature_per_m else 0.0
        ahead = (x_m - at_x) * math.cos(turn) + (y_m - at_y) * math.sin(turn)
        left = (y_m - at_y) * math.cos(turn) - (x_m - at_x) * math.sin(turn)
        if -outline.rear_m <= ahead <= outline.front_m and abs(left) <= outline.width_m / 2 + 0.05:
            return abs(way_m)
    return math.inf


@pytest.mark.once
@pytest.mark.parametrize("is_backward", [False, True])
@pytest.mark.parametrize("curvature_per_m", [0.0, 0.3, -0.3, 1.0, -1.0])
def test_on_any_arc_it_is_where_a_driven_car_meets_the_point(curvature_per_m, is_backward):
    met = 0
    for x_m, y_m in itertools.product((0.231 * step for step in range(-8, 9)), (0.217 * step for step in range(-8, 9))):
        if -0.15 <= x_m <= 0.45 and abs(y_m) <= 0.22:
            continue  # it touches the car already, or nearly
        expected_m = drives_into(x_m, y_m, curvature_per_m, is_backward, CAR)
        found_m = point_distance_m(x_m, y_m, curvature_per_m, is_backward, CAR)
        if expected_m < 1.2:
            met += 1
            assert found_m == pytest.approx(expected_m, abs=0.01), (x_m, y_m)
        else:
            assert found_m is None or found_m >= 1.19, (x_m, y_m)
    assert met >= 5


def test_of_a_cone_the_place_counts_where_the_car_arrives_first():
    assert cone_distance_m(AHEAD, 1.0, 0.5, 0.0, False, CAR) == pytest.approx(1.0, abs=0.02)
    assert cone_distance_m(AHEAD, 1.0, 0.5, 0.0, False, CAR) <= 1.0
    assert cone_distance_m(Mount(0.4, 0.1, 1.2), 1.0, 0.5, 0.0, False, CAR) is None
    assert cone_distance_m(AHEAD, 1.0, 0.5, 0.0, True, CAR) is None


# --- ranges ---

def seeing(ranges, now_ns=10 * S, cycle_ns=400 * MS, names=("front_middle",)):
    """One whose sonars have seen this for some cycles, up to now."""
    stop = ObstacleStop(ObstacleConfig({name: Mount(*SONARS[name]) for name in names}, outline=CAR))
    for step in range(4, -1, -1):
        for name, range_m in ranges.items():
            stop.update_range(name, range_m, now_ns - step * cycle_ns)
    return stop


def test_the_speed_is_that_from_which_it_stops_in_time_with_age_cycle_and_actuation():
    bound = seeing({"front_middle": 1.0}).bound(0.0, False, BRAKE, 10 * S + 50 * MS)
    assert bound.speed_mps == pytest.approx(stopping_speed_mps(1.02 - 0.1, 0.05 + 0.4 + 0.1, BRAKE), rel=0.02)
    assert (bound.cause, bound.words) == (causes.OBSTACLE_SLOWED, "front_middle sees 1.00 m, which allows")


@pytest.mark.parametrize(("arrivals_ms", "cycle_s"), [
    ((0,), 0.43), ((0, 140), 0.14), ((0, 300, 440, 580), 0.3), ((0, 300, 440, 580, 720), 0.14)])
def test_a_cycle_is_the_longest_of_the_last_three_and_before_there_is_one_the_longest_that_there_can_be(arrivals_ms,
                                                                                                     cycle_s):
    stop = ObstacleStop(ObstacleConfig({"front_middle": AHEAD}, outline=CAR))
    for at_ms in arrivals_ms:
        stop.update_range("front_middle", 1.0, 10 * S + at_ms * MS)
    bound = stop.bound(0.0, False, BRAKE, 10 * S + arrivals_ms[-1] * MS)
    distance_m = cone_distance_m(AHEAD, 1.0, 0.5236, 0.0, False, CAR)
    assert bound.speed_mps == pytest.approx(stopping_speed_mps(distance_m - 0.1, cycle_s + 0.1, BRAKE), abs=1e-9)


@pytest.mark.parametrize("range_m", [math.inf, 2.0, 3.5])
def test_no_echo_counts_as_the_largest_range_and_too_near_is_no_speed(range_m):
    bound = seeing({"front_middle": range_m}).bound(0.0, False, BRAKE, 10 * S)
    assert bound == seeing({"front_middle": math.inf}).bound(0.0, False, BRAKE, 10 * S)
    assert 1.4 < bound.speed_mps < 1.8 and bound.words == "front_middle sees nothing to 2 m, which allows"
    assert seeing({"front_middle": -math.inf}).bound(0.0, False, BRAKE, 10 * S).speed_mps == 0.0


@pytest.mark.parametrize(("ranges", "later_ns", "is_dropped", "why"), [
    ({"front_middle": 1.0}, 1500 * MS, False, "front_middle silent for 1.50 s"),
    ({}, 0, False, "front_middle was never heard"),
    ({"front_middle": math.nan}, 0, False, "front_middle measures nan"),
    ({"front_middle": 1.0}, 0, True, "front_middle was not heard since messages were dropped"),
])
def test_a_faulty_sonar_allows_no_speed_towards_it_and_is_named(ranges, later_ns, is_dropped, why):
    stop = seeing(ranges)
    if is_dropped:
        stop.mark_stale()
    bound = stop.bound(0.0, False, BRAKE, 10 * S + later_ns)
    assert (bound.speed_mps, bound.cause) == (0.0, causes.SONAR_SILENT)
    assert bound.words == f"{why}, and the car doesn't drive blind:"


def test_a_sonar_that_looks_elsewhere_or_that_the_car_does_not_have_does_not_count():
    stop = seeing({"rear_middle": 0.1, "front_left": 0.3}, names=("rear_middle", "front_left"))
    assert stop.bound(-0.9, False, BRAKE, 10 * S) is None
    assert stop.bound(0.0, True, BRAKE, 10 * S).speed_mps < 0.2
    assert seeing({"front_middle": 1.0, "rear_left": 0.1}).bound(0.0, True, BRAKE, 10 * S) is None


def test_the_least_of_all_sonars_counts():
    names = ("front_middle", "front_left", "front_right")
    bound = seeing({"front_middle": 1.5, "front_left": 0.2, "front_right": math.inf}, names=names).bound(
        0.0, False, BRAKE, 10 * S)
    assert bound.words.startswith("front_left sees 0.20 m")


# --- parameters ---

@pytest.mark.parametrize("values", [{}, {"obstacle_stop": True}])
def test_it_is_off_by_default_and_where_the_hub_s_file_is_left_out(values):
    params = Params({**values, "sonar_hub": {"max_range": 2.0}})
    assert read_obstacle_stop(params, is_complete=not values) is None
    params.finish(ignored_namespaces=("sonar_hub",))


def test_the_sonars_are_those_of_the_hub_s_file_without_the_absent_ones():
    params = Params({"obstacle_stop": True, "sonar_hub": {"sonars": SONARS, "field_of_view": 0.4, "max_range": 3.0,
                                                          "median": False},
                     "obstacle": {"margin": 0.2, "sonars": {"rear_left": "absent", "rear_right": "absent"}}})
    config = read_obstacle_stop(params)
    params.finish(ignored_namespaces=("sonar_hub",))
    assert set(config.mounts) == {"front_right", "front_middle", "front_left", "rear_middle"}
    assert (config.field_of_view_rad, config.max_range_m, config.margin_m) == (0.4, 3.0, 0.2)
    assert config.mounts["front_left"] == Mount(0.40, 0.10, 0.5236)


@pytest.mark.parametrize(("values", "name"), [
    ({"obstacle_stop": True}, "sonar_hub/sonars/front_right"),
    ({"obstacle_stop": True, "sonar_hub": {"sonars": {**SONARS, "front_left": [1, 2]}}}, "sonar_hub/sonars/front_left"),
    ({"obstacle_stop": "yes"}, "obstacle_stop"), ({"obstacle": {"margin": -1}}, "obstacle/margin"),
    ({"obstacle": {"sonars": {"rear_left": "no"}}}, "obstacle/sonars/rear_left")])
def test_what_makes_no_sense_is_refused_by_name(values, name):
    with pytest.raises(ConfigError, match=name):
        read_obstacle_stop(Params(values))
