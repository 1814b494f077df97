"""How fast a car may drive towards what its sonars see."""
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from car_interface.common import causes
from car_interface.common.declared import read
from car_interface.common.errors import ConfigError
from car_interface.common.params import Params
from car_interface.throttle.obstacle_stop import Mount, ObstacleConfig, ObstacleStop, Outline, stopping_speed_mps

MS, S = 1_000_000, 1_000_000_000
BRAKE, DRAG = 1.5, 0.3  # m/s²
CAR = Outline(front_m=0.4, rear_m=0.1, width_m=0.3)
AHEAD = Mount(0.4, 0.0, 0.0)
CREEP = 0.3
SONARS = {"front_right": [0.40, -0.10, -0.5236], "front_middle": [0.42, 0.0, 0.0], "front_left": [0.40, 0.10, 0.5236],
          "rear_right": [-0.12, -0.10, -2.6180], "rear_middle": [-0.14, 0.0, 3.1416],
          "rear_left": [-0.12, 0.10, 2.6180]}


@pytest.mark.parametrize("distance_m", [0.05, 1.0, 3.9])
@pytest.mark.parametrize("time_s", [0.1, 1.0])
@pytest.mark.parametrize("stop_mps2", [BRAKE, DRAG])
def test_from_the_speed_that_is_allowed_the_car_stops_exactly_there(distance_m, time_s, stop_mps2):
    speed_mps = stopping_speed_mps(distance_m, time_s, stop_mps2)
    assert speed_mps * time_s + speed_mps ** 2 / (2 * stop_mps2) == pytest.approx(distance_m)
    assert stopping_speed_mps(0.0, time_s, stop_mps2) == stopping_speed_mps(-0.1, time_s, stop_mps2) == 0.0
    assert stopping_speed_mps(distance_m, time_s, 0.01) == 0.0  # which is certain of nothing


@pytest.mark.parametrize(("arrivals_ms", "cycle_s"), [
    ((0,), 0.43), ((0, 140), 0.14), ((0, 300, 440, 580), 0.3), ((0, 300, 440, 580, 720), 0.14)])
def test_a_cycle_is_the_longest_of_the_last_three_and_before_there_is_one_the_longest_that_there_can_be(arrivals_ms,
                                                                                                     cycle_s):
    stop = ObstacleStop(ObstacleConfig({"front_middle": AHEAD}, outline=CAR))
    for at_ms in arrivals_ms:
        stop.update_range("front_middle", math.inf, 10 * S + at_ms * MS)
    bound = stop.bound(0.0, False, BRAKE, 10 * S + arrivals_ms[-1] * MS)
    assert bound.speed_mps == pytest.approx(stopping_speed_mps(2.0 - 0.1, cycle_s + 0.1, BRAKE), abs=1e-3)


FRONT = ("front_middle", "front_left", "front_right")
REAR = ("rear_middle", "rear_left", "rear_right")


def seeing(ranges, names=("front_middle",), at_ns=10 * S, **config):
    """One whose sonars have seen this for some cycles of 400 ms, and that is told of the car's motion."""
    stop = ObstacleStop(ObstacleConfig({name: Mount(*SONARS[name]) for name in names}, outline=CAR, **config))
    for step in range(5):
        now_ns = at_ns + (step - 4) * 400 * MS
        stop.update_motion(0.0, 0.0, now_ns)
        for name, range_m in ranges.items():
            stop.update_range(name, range_m, now_ns)
    return stop


def bound_of(ranges, curvature_per_m=0.0, is_backward=False, later_ms=0, is_dropped=False, names=("front_middle",),
             stop_mps2=BRAKE, **config):
    stop = seeing(ranges, names, **config)
    if is_dropped:
        stop.mark_stale()
    return stop.bound(curvature_per_m, is_backward, stop_mps2, 10 * S + later_ms * MS)[:3]


BLIND = ", and the car doesn't drive blind:"
# With what is left to the margin, a cycle and the actuation; the cone's edge is a little nearer.
TO_1_M, TO_2_M = (pytest.approx(stopping_speed_mps(seen_m + 0.02 - 0.1, 0.4 + 0.1, BRAKE), rel=0.02)
                  for seen_m in (1.0, 2.0))
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
    # and into its part of the fan only
    (dict.fromkeys(FRONT[:2], math.inf), {"names": FRONT}, TO_2_M, causes.OBSTACLE_SLOWED,
     "front_middle sees nothing to 2 m, which allows"),
    (dict.fromkeys(FRONT[:2], math.inf), {"names": FRONT, "curvature_per_m": -1.0}, 0.0, causes.SONAR_SILENT,
     "front_right was never heard" + BLIND),
    (dict.fromkeys(FRONT[:2], math.inf), {"names": FRONT, "curvature_per_m": -0.2}, 0.0, causes.SONAR_SILENT,
     "front_right was never heard" + BLIND),  # which a flank touches
])
def test_speed_is_bounded_by_the_nearest_that_a_sonar_sees_or_may_not_see(ranges, inputs, speed_mps, cause, words):
    assert bound_of(ranges, **inputs) == (speed_mps, cause, words)


def test_a_sonar_that_looks_elsewhere_does_not_count():
    free = dict.fromkeys(FRONT, math.inf)
    assert bound_of({**free, "front_left": 0.5}, -0.9, names=FRONT) == bound_of(free, -0.9, names=FRONT)
    assert bound_of({**free, "rear_left": 0.3}, names=FRONT + REAR) == bound_of(free, names=FRONT)
    assert bound_of({"front_middle": 1.0, **dict.fromkeys(REAR, math.inf)}, is_backward=True,
                    names=FRONT[:1] + REAR)[2] == "rear_middle sees nothing to 2 m, which allows"


def test_a_creep_is_left_into_the_unknown_and_none_towards_an_echo():
    everywhere = dict.fromkeys(FRONT, math.inf)
    assert bound_of(everywhere, 5.0, names=FRONT)[0] == CREEP
    assert bound_of(everywhere, 5.0, names=FRONT, creep_mps=0.0)[0] < 0.1
    assert bound_of({**everywhere, "front_middle": 0.12}, names=FRONT)[0] < 0.1
    assert bound_of({}, names=REAR) == (CREEP, causes.OBSTACLE_SLOWED, "no sonar looks along this arc, which allows")


def test_an_echo_counts_where_it_is_now_and_a_little_later():
    stop = seeing({"front_middle": 1.5})
    stop.update_motion(1.0, 0.0, 10 * S + 500 * MS)
    for late_s in (0.0, 0.2):
        assert stop.bound(0.0, False, BRAKE, 10 * S + 500 * MS, late_s).speed_mps == pytest.approx(
            stopping_speed_mps(1.5 + 0.02 - 0.5 - 0.1, 0.4 + 0.1 + late_s, BRAKE), rel=0.02)


def test_without_the_car_s_motion_an_echo_counts_where_it_was_with_its_age():
    stop = ObstacleStop(ObstacleConfig({"front_middle": AHEAD}, outline=CAR))
    stop.update_range("front_middle", 1.0, 10 * S)
    assert stop.bound(0.0, False, BRAKE, 10 * S + 200 * MS).speed_mps == pytest.approx(
        stopping_speed_mps(1.0 - 0.1, 0.2 + 0.43 + 0.1, BRAKE), rel=0.02)


def test_one_who_knows_what_is_beside_the_car_is_bounded_by_echoes_and_ranges_alone():
    stop = seeing(dict.fromkeys(FRONT, math.inf), FRONT)
    assert stop.bound(1.0, False, BRAKE, 10 * S, counts_sides=False) is None
    assert stop.bound(0.0, False, BRAKE, 10 * S, counts_sides=False) == stop.bound(0.0, False, BRAKE, 10 * S)
    stop.update_range("front_left", 0.5, 10 * S)
    assert stop.bound(1.0, False, BRAKE, 10 * S, counts_sides=False).words == "front_left sees 0.50 m, which allows"


def test_a_range_of_a_sonar_that_the_car_lacks_is_left_out():
    stop = seeing({"front_middle": math.inf})
    stop.update_range("front_left", 0.1, 10 * S)
    assert stop.bound(0.0, False, BRAKE, 10 * S).speed_mps == TO_2_M


@pytest.mark.once
@given(st.floats(-1.5, 1.5), st.lists(st.one_of(st.floats(0.0, 4.0), st.just(math.inf)), min_size=3, max_size=3),
       st.floats(0.05, 3.0))
def test_from_its_speed_the_car_always_stops_within_what_was_looked_at(curvature_per_m, ranges, stop_mps2):
    """Or it creeps; and no echo is ever in the way of what is allowed."""
    stop = seeing(dict(zip(FRONT, ranges)), FRONT)
    speed_mps = stop.bound(curvature_per_m, False, stop_mps2, 10 * S).speed_mps
    free_m = stop._fans[False].end(curvature_per_m, dict(zip(FRONT, (min(2.0, range_m) for range_m in ranges))))[0]
    way_m = speed_mps * 0.5 + speed_mps ** 2 / (2 * stop_mps2)
    assert speed_mps <= CREEP or way_m <= free_m - 0.1 + 1e-6
    met = [found.distance_m for found in stop._echoes.meets(curvature_per_m, False).values()]
    assert speed_mps == 0.0 or not met or way_m <= min(met) - 0.1 + 1e-6


def test_it_is_off_by_default_and_then_the_hub_s_file_is_not_read():
    params = Params({"sonar_hub": {"max_range": -2.0}})
    assert read(params, ObstacleConfig) is None
    params.finish(ignored_namespaces=("sonar_hub",))


def test_the_sonars_are_those_of_the_hub_s_file_without_the_absent_ones():
    params = Params({"obstacle_stop": True, "sonar_hub": {"sonars": SONARS, "field_of_view": 0.4, "max_range": 3.0,
                                                          "median": False},
                     "obstacle": {"margin": 0.2, "creep": 0.1,
                                  "sonars": {"rear_left": "absent", "rear_right": "absent"}}})
    config = read(params, ObstacleConfig)
    params.finish(ignored_namespaces=("sonar_hub",))
    assert set(config.mounts) == {"front_right", "front_middle", "front_left", "rear_middle"}
    assert (config.field_of_view_rad, config.max_range_m, config.margin_m, config.creep_mps) == (0.4, 3.0, 0.2, 0.1)
    assert config.mounts["front_left"] == Mount(0.40, 0.10, 0.5236)
    short = Params({"obstacle_stop": True, "sonar_hub": {"sonars": SONARS, "max_range": 0.9}})
    assert read(short, ObstacleConfig).max_range_m == 0.9


@pytest.mark.parametrize(("values", "name"), [
    ({"obstacle_stop": True}, "sonar_hub/sonars/front_right"),
    ({"obstacle_stop": True, "sonar_hub": {"sonars": {**SONARS, "front_left": [1, 2]}}}, "sonar_hub/sonars/front_left"),
    ({"obstacle_stop": True, "sonar_hub": {"sonars": SONARS, "field_of_view": 3.1}}, "sonar_hub/field_of_view"),
    ({"obstacle_stop": True, "sonar_hub": {"sonars": SONARS, "max_range": 100.1}}, "sonar_hub/max_range"),
    ({"obstacle_stop": True, "sonar_hub": {"sonars": SONARS, "max_range": 0.0}}, "sonar_hub/max_range"),
    ({"obstacle": {"sonars": {"rear_left": "no"}}}, "obstacle/sonars/rear_left")])
def test_what_makes_no_sense_is_refused_by_name(values, name):
    with pytest.raises(ConfigError, match=name):
        read(Params(values), ObstacleConfig)
