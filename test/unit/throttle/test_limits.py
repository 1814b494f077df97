"""How fast a car may get, how quickly, and how hard it may brake."""
import math

import pytest

from car_interface.common import causes
from car_interface.common.declared import read
from car_interface.common.errors import ConfigError
from car_interface.common.params import Params
from car_interface.common.sources import NEUTRAL, PLANNER, TELEOP
from car_interface.throttle.arbiter import Arbitration
from car_interface.throttle.limits import DriveLimits, SpeedBound, ThrottleLimiter, ThrottleLimits
from car_interface.throttle.value_map import ValueMap

S = 1_000_000_000
# Acceleration is twice the value; the ESC's whole range are the values of -5 and 3.
MAP = ValueMap([-5.0, 0.0, 3.0], [0.0, 10.0], [[-10.0, -10.0], [0.0, 0.0], [6.0, 6.0]])
DRAG = ValueMap([-5.0, 0.0, 3.0], [0.0, 10.0], [[-16.0, -16.0], [-6.0, -6.0], [0.0, 0.0]])  # of 6 m/s²


NO_LIMITS, TO_3 = DriveLimits(), DriveLimits(max_speed_mps=3.0)
FASTER_BY_3, BRAKED_BY_4 = DriveLimits(max_acceleration_mps2=3.0), DriveLimits(max_braking_mps2=4.0)
SEEN = SpeedBound(0.5, causes.OBSTACLE_SLOWED, "an obstacle allows")
BY_HAND = {"source": TELEOP, "human": TO_3}


def asked(request, source=PLANNER, stops=False):
    return Arbitration(source, causes.PLANNER, "", request, request, request, stops)


def limiter_at(speed_mps, planner=NO_LIMITS, human=NO_LIMITS, **limits):
    limiter = ThrottleLimiter(ThrottleLimits(planner=planner, human=human, **limits),
                              lambda value: value / 3.0 if value > 0 else value / 5.0)
    if speed_mps is not None:
        limiter.speed.update(speed_mps, 0)
    return limiter


def limited(request, speed_mps, planner=NO_LIMITS, source=PLANNER, is_reverse=False, turn_max_mps=0.0, bound=None,
            at_ns=S // 10, **limits):
    return limiter_at(speed_mps, planner, **limits).limit(asked(request, source), is_reverse, turn_max_mps, at_ns,
                                                          bound)


@pytest.mark.parametrize(("request_", "speed_mps", "inputs", "drive", "brake", "cause", "reason"), [
    # towards max_speed the throttle is taken away evenly
    (1.0, 2.4, {"planner": TO_3}, 1.0, 1.0, "", ""),
    (1.0, 2.75, {"planner": TO_3}, 0.5, 1.0, causes.SPEED_LIMITED,
     "max_speed 3.00 m/s, it has 2.75: 0.50 instead of 1.00"),
    (0.5, 2.75, {"planner": TO_3}, 0.5, 0.5, "", ""),
    (1.0, 3.05, {"planner": TO_3}, 0.0, 1.0, causes.SPEED_LIMITED,
     "max_speed 3.00 m/s, it has 3.05: 0.00 instead of 1.00"),
    # beyond it a planner's car brakes the more the faster it is, and a human's rolls
    (1.0, 3.2, {"planner": TO_3}, -0.1, -0.1, causes.SPEED_LIMITED, "max_speed 3.00 m/s, it has 3.20: it brakes"),
    (1.0, 6.0, {"planner": TO_3}, -0.5, -0.5, causes.SPEED_LIMITED, "max_speed 3.00 m/s, it has 6.00: it brakes"),
    (-0.5, 6.0, {"planner": TO_3}, -0.5, -0.5, "", ""),
    (-0.8, 6.0, {"planner": TO_3}, -0.8, -0.8, "", ""),
    (1.0, 6.0, BY_HAND, 0.0, 1.0, causes.SPEED_LIMITED, "max_speed 3.00 m/s, it has 6.00: 0.00 instead of 1.00"),
    (0.0, 6.0, BY_HAND, 0.0, 0.0, "", ""),
    (1.0, 6.0, {"human": TO_3}, 1.0, 1.0, "", ""),
    (1.0, 6.0, {"planner": TO_3, "source": TELEOP}, 1.0, 1.0, "", ""),
    # backward, by the ESC's state or by odometry beyond its noise
    (-1.0, -1.0, {"planner": TO_3, "is_reverse": True}, -1.0, -1.0, "", ""),
    (-1.0, -2.75, {"planner": TO_3, "is_reverse": True}, -0.5, -1.0, causes.SPEED_LIMITED,
     "max_speed 3.00 m/s, it has 2.75: -0.50 instead of -1.00"),
    (-1.0, -3.5, {"planner": TO_3, "is_reverse": True}, 0.0, -1.0, causes.SPEED_LIMITED,
     "max_speed 3.00 m/s, it has 3.50: -0.00 instead of -1.00"),
    (-1.0, -2.75, {"planner": TO_3}, -0.5, -1.0, causes.SPEED_LIMITED,
     "max_speed 3.00 m/s, it has 2.75: -0.50 instead of -1.00"),
    (1.0, -5.0, {"planner": TO_3}, 1.0, 1.0, "", ""),  # which brakes it
    (1.0, -0.09, {"bound": SEEN._replace(speed_mps=0.0)}, 0.0, 1.0, causes.OBSTACLE_SLOWED,
     "an obstacle allows 0.00 m/s, it has 0.09: 0.00 instead of 1.00"),
    (1.0, -0.11, {"bound": SEEN._replace(speed_mps=0.0)}, 1.0, 1.0, "", ""),
    # from standstill a pull may become reverse at once; a brake that it is instead stays as it is
    (-0.4, 0.0, {"bound": SEEN._replace(speed_mps=0.0)}, 0.0, -0.4, causes.OBSTACLE_SLOWED,
     "an obstacle allows 0.00 m/s, it has 0.00: -0.00 instead of -0.40"),
    (-0.4, 0.11, {"bound": SEEN._replace(speed_mps=0.0)}, -0.4, -0.4, "", ""),
    # a bound may come with a throttle of its own
    (1.0, 0.2, {"bound": SEEN._replace(max_throttle=0.1)}, 0.1, 1.0, causes.OBSTACLE_SLOWED,
     "an obstacle allows 0.50 m/s, it has 0.20: 0.10 instead of 1.00"),
    (0.05, 0.2, {"bound": SEEN._replace(max_throttle=0.1)}, 0.05, 0.05, "", ""),
    # a planner's turn, and the least of several speeds
    (0.3, 4.0, {"turn_max_mps": 2.0}, -0.5, -0.5, causes.CURVE_SLOWED,
     "the turn that is asked for allows 2.00 m/s, it has 4.00: it brakes"),
    (0.3, 4.0, {"turn_max_mps": 2.0, "source": TELEOP}, 0.3, 0.3, "", ""),
    (0.3, 4.0, {"turn_max_mps": 2.0, "slow_down": False}, 0.3, 0.3, "", ""),
    (1.0, 0.4, {"planner": TO_3, "turn_max_mps": 2.0, "bound": SEEN}, 0.2, 1.0, causes.OBSTACLE_SLOWED,
     "an obstacle allows 0.50 m/s, it has 0.40: 0.20 instead of 1.00"),
    # accelerations through the value map
    (0.8, 2.0, {"planner": FASTER_BY_3, "value_map": MAP}, 0.5, 0.8, causes.ACCELERATION_LIMITED,
     "3 m/s²: 0.50 instead of 0.80"),
    (0.5, 2.0, {"planner": FASTER_BY_3, "value_map": MAP}, 0.5, 0.5, "", ""),
    (-0.8, 2.0, {"planner": FASTER_BY_3, "value_map": MAP}, -0.8, -0.8, "", ""),
    (-0.8, -2.0, {"planner": FASTER_BY_3, "value_map": MAP}, -0.5, -0.8, causes.ACCELERATION_LIMITED,
     "3 m/s²: -0.50 instead of -0.80"),
    (-0.8, -0.1, {"planner": FASTER_BY_3, "value_map": MAP}, -0.5, -0.8, causes.ACCELERATION_LIMITED,
     "3 m/s²: -0.50 instead of -0.80"),
    (-0.8, 2.0, {"planner": BRAKED_BY_4, "value_map": MAP}, -0.8, -0.4, causes.BRAKING_LIMITED,
     "4 m/s² of braking: -0.40 instead of -0.80"),
    (-0.4, 2.0, {"planner": BRAKED_BY_4, "value_map": MAP}, -0.4, -0.4, "", ""),
    (0.8, 2.0, {"planner": BRAKED_BY_4, "value_map": MAP}, 0.8, 0.8, "", ""),
    (-0.5, 2.0, {"planner": BRAKED_BY_4, "value_map": DRAG}, -0.5, 0.0, causes.BRAKING_LIMITED,
     "4 m/s² of braking: 0.00 instead of -0.50"),  # drag alone is more; no throttle makes up for it
    (1.0, 6.0, {"planner": DriveLimits(3.0, 0.0, 2.0), "value_map": MAP}, -0.5, -0.2, causes.BRAKING_LIMITED,
     "2 m/s² of braking: -0.20 instead of -0.50"),  # the limiter's own
    # without any odometry nothing is limited, and once it is lost the last speed counts
    (1.0, None, BY_HAND, 1.0, 1.0, causes.LIMITS_OFF, "odom was never heard: nothing limits the throttle"),
    (1.0, 2.75, {**BY_HAND, "at_ns": 3600 * S}, 0.5, 1.0, causes.SPEED_LIMITED,
     "max_speed 3.00 m/s, it has 2.75: 0.50 instead of 1.00"),
])
def test_request_is_granted_within_the_limits_of_its_source(request_, speed_mps, inputs, drive, brake, cause, reason):
    answer = limited(request_, speed_mps, **inputs)
    assert (answer.arbitration.drive, answer.arbitration.brake) == (pytest.approx(drive), pytest.approx(brake))
    assert (answer.cause, answer.reason, answer.is_cut) == (cause, reason, cause not in ("", causes.LIMITS_OFF))


def test_max_speed_is_the_least_of_those_in_force():
    assert limited(1.0, 0.4, TO_3).max_speed_mps == 3.0
    assert limited(1.0, 0.4, TO_3, turn_max_mps=2.0, bound=SEEN).max_speed_mps == 0.5
    assert limited(1.0, 0.4).max_speed_mps == limited(1.0, 0.4, turn_max_mps=math.inf).max_speed_mps == 0.0


@pytest.mark.parametrize("speed_mps", [0.0, 5.0])
def test_what_is_not_limited_comes_back_as_the_very_same_arbitration(speed_mps):
    stopping = limiter_at(speed_mps, DriveLimits(1.0, 1.0, 1.0), value_map=MAP)
    for one in (asked(0.0, PLANNER, stops=True), asked(0.0, NEUTRAL)):
        assert stopping.limit(one, False, 0.5, 1) == (one, "", "", 0.0)
    below = limiter_at(1.0, DriveLimits(3.0, 6.0, 10.0), value_map=MAP)
    for request in (0.3, 0.0, -0.3):
        one = asked(request)
        assert below.limit(one, False, 2.5, S // 10).arbitration is one


def test_a_planner_s_throttle_waits_while_reports_of_the_speed_are_missing():
    limiter = limiter_at(1.0)
    assert not limiter.limit(asked(0.5), False, math.inf, S // 10).is_cut
    late = limiter.limit(asked(0.5), False, math.inf, 6 * S // 10)
    assert late.arbitration.drive == 0.0
    assert (late.cause, late.reason) == (causes.SPEED_LATE, "odom silent for 0.60 s: no throttle until its next report")
    assert not limiter.limit(asked(-0.5), False, math.inf, 6 * S // 10).is_cut
    assert not limiter.limit(asked(0.5), False, 0.0, 6 * S // 10).is_cut


def test_cuts_are_counted_when_they_begin():
    limiter = limiter_at(3.0, TO_3)
    for request in (1.0, 0.9, 0.0, 1.0):
        limiter.limit(asked(request), False, 0.0, S // 10)
    assert limiter.cuts == 2


@pytest.mark.parametrize("values, message", [
    ({"human": {"max_acceleration": 2.0}}, "human/max_acceleration is 2.0.*csv_path_value_map"),
    ({"human": {"max_braking": 2.0}}, "human/max_braking is 2.0.*csv_path_value_map"),
])
def test_limit_that_needs_a_value_map_is_refused_without_one(values, message):
    with pytest.raises(ConfigError, match=message):
        read(Params(values), ThrottleLimits)


def test_the_value_map_is_read_where_it_is_needed(tmp_path):
    path = tmp_path / "map.csv"
    path.write_text("default,0,10\n-5,-10,-10\n0,0,0\n3,6,6\n")
    values = {"csv_path_value_map": str(path), "planner": {"max_braking": 2}}
    assert read(Params(values), ThrottleLimits).value_map.acceleration_at(-5, 0) == -10
    assert read(Params({"csv_path_value_map": "/nowhere/map.csv"}), ThrottleLimits).value_map is None
