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


def bound_of(ranges, curvature_per_m=0.0, is_backward=False, later_ms=0, is_dropped=False, names=("front_middle",)):
    """The bound by sonars that have seen this for some cycles of 400 ms."""
    stop = ObstacleStop(ObstacleConfig({name: Mount(*SONARS[name]) for name in names}, outline=CAR))
    for step in range(5):
        for name, range_m in ranges.items():
            stop.update_range(name, range_m, 10 * S + (step - 4) * 400 * MS)
    if is_dropped:
        stop.mark_stale()
    return stop.bound(curvature_per_m, is_backward, BRAKE, 10 * S + later_ms * MS)


FRONT = ("front_middle", "front_left", "front_right")
BLIND = ", and the car doesn't drive blind:"
# With what is left to the margin, and the age, a cycle and the actuation; the cone's edge is a little nearer.
TO_1_M, TO_2_M = (pytest.approx(stopping_speed_mps(seen_m + 0.02 - 0.1, age_s + 0.4 + 0.1, BRAKE), rel=0.02)
                  for seen_m, age_s in ((1.0, 0.05), (2.0, 0.0)))
LITTLE = pytest.approx(0.1, abs=0.06)


@pytest.mark.parametrize(("ranges", "inputs", "speed_mps", "cause", "words"), [
    ({"front_middle": 1.0}, {"later_ms": 50}, TO_1_M, causes.OBSTACLE_SLOWED, "front_middle sees 1.00 m, which allows"),
    *(({"front_middle": range_m}, {}, TO_2_M, causes.OBSTACLE_SLOWED, "front_middle sees nothing to 2 m, which allows")
      for range_m in (2.0, 3.5, math.inf)),
    ({"front_middle": -math.inf}, {}, 0.0, causes.OBSTACLE_SLOWED, "front_middle sees 0.00 m, which allows"),
    # the least of all counts
    (dict(zip(FRONT, (1.5, 0.2, math.inf))), {"names": FRONT}, LITTLE, causes.OBSTACLE_SLOWED,
     "front_left sees 0.20 m, which allows"),
    ({"rear_middle": 0.1, "front_left": 0.3}, {"is_backward": True, "names": ("rear_middle", "front_left")}, LITTLE,
     causes.OBSTACLE_SLOWED, "rear_middle sees 0.10 m, which allows"),
    # a faulty one allows no speed
    ({"front_middle": 1.0}, {"later_ms": 1500}, 0.0, causes.SONAR_SILENT, "front_middle silent for 1.50 s" + BLIND),
    ({}, {}, 0.0, causes.SONAR_SILENT, "front_middle was never heard" + BLIND),
    ({"front_middle": math.nan}, {}, 0.0, causes.SONAR_SILENT, "front_middle measures nan" + BLIND),
    ({"front_middle": 1.0}, {"is_dropped": True}, 0.0, causes.SONAR_SILENT,
     "front_middle was not heard since messages were dropped" + BLIND),
])
def test_speed_is_bounded_by_the_nearest_that_a_sonar_sees_or_may_not_see(ranges, inputs, speed_mps, cause, words):
    assert bound_of(ranges, **inputs) == (speed_mps, cause, words)


def test_a_sonar_that_looks_elsewhere_or_that_the_car_does_not_have_does_not_count():
    assert bound_of({"rear_middle": 0.1, "front_left": 0.3}, -0.9, names=("rear_middle", "front_left")) is None
    assert bound_of({"front_middle": 1.0, "rear_left": 0.1}, is_backward=True) is None


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
