"""What a stop guarantees while the car drives, coasts, brakes or reverses, and what the sonars allow by that."""
from __future__ import annotations

import math

import pytest

from car_interface.common import causes
from car_interface.common.measured_speed import MeasuredSpeed
from car_interface.steering.arbiter import NEUTRAL as NOBODY
from car_interface.steering.arbiter import PLANNER, TELEOP
from car_interface.throttle.arbiter import Arbitration
from car_interface.throttle.esc import BRAKING, FORWARD, NEUTRAL, REVERSE, EscDecision
from car_interface.throttle.esc_config import EscConfig
from car_interface.throttle.obstacle_guard import NONE, ObstacleGuard
from car_interface.throttle.obstacle_stop import Guarantee, Mount, ObstacleConfig, ObstacleStop, stopping_speed_mps

MS, S = 1_000_000, 1_000_000_000
NOW = 10 * S
AHEAD, BEHIND = Mount(0.42, 0.0, 0.0), Mount(-0.14, 0.0, math.pi)
CERTAIN, DRAG = Guarantee(1.5, 0.0, 0.3), Guarantee(0.3, 0.0, 0.3)
BY_BRAKE, BY_DRAG = (pytest.approx(stopping_speed_mps(1.494 - 0.1, 0.43 + 0.1, guarantee), rel=0.05)
                     for guarantee in (CERTAIN, DRAG))


def asked(request, source=PLANNER, stops=False):
    return Arbitration(source, causes.PLANNER, "", request, request, request, stops)


def moving(speed_mps):
    speed = MeasuredSpeed(0.5)
    speed.update(speed_mps, NOW)
    return speed


def guard_after(*answers, ahead_m=1.5, behind_m=1.5):
    """One whose ESC got these (state, fraction, seconds ago), and was told to brake with 1.5 m/s² for certain."""
    guard = ObstacleGuard(ObstacleStop(ObstacleConfig({"front_middle": AHEAD, "rear_middle": BEHIND})), EscConfig())
    for report in range(3):
        guard.sonars.update_range("front_middle", ahead_m, NOW - report * 400 * MS)
        guard.sonars.update_range("rear_middle", behind_m, NOW - report * 400 * MS)
    for state, fraction, ago_s in answers:
        guard.update_esc(EscDecision(fraction, state, causes.DRIVING, "", 1.5, 0.0), NOW - round(ago_s * S))
    return guard


def allowed(guard, arbitration, speed_mps, curvature_per_m=0.0):
    found = guard.check(arbitration, moving(speed_mps), curvature_per_m, NOW)
    bound = found.stop or found.bounds[0]
    return bound.speed_mps, found.stop is not None


@pytest.mark.parametrize(("answers", "request_", "speed_mps"), [
    ([(FORWARD, 0.5, 0.0)], 0.5, BY_BRAKE),
    ([(FORWARD, 0.5, 0.3), (NEUTRAL, 0.0, 0.0)], 0.0, BY_BRAKE),
    ([(FORWARD, 0.5, 0.4), (NEUTRAL, 0.0, 0.0)], 0.0, BY_DRAG),
    ([(REVERSE, -0.5, 0.1), (NEUTRAL, 0.0, 0.0)], 0.0, BY_DRAG),
    ([(BRAKING, -0.5, 0.0)], -0.5, BY_BRAKE),
    ([(BRAKING, -0.5, 0.0)], 0.5, BY_DRAG),  # which is about to be released
    ([], 0.5, BY_DRAG),
])
def test_a_stop_is_trusted_for_as_long_as_it_is_certain(answers, request_, speed_mps):
    assert allowed(guard_after(*answers), asked(request_), 0.5)[0] == speed_mps


def test_backward_it_goes_by_the_sonars_behind_and_by_drag():
    guard = guard_after((REVERSE, -0.5, 0.0), ahead_m=0.2, behind_m=1.5)
    assert allowed(guard, asked(-0.5), -0.4)[0] == BY_DRAG
    assert allowed(guard, asked(-0.5), 0.0)[0] == BY_DRAG
    assert allowed(guard_after((FORWARD, 0.5, 0.0), ahead_m=0.2), asked(0.5), -0.1)[0] == BY_DRAG


@pytest.mark.parametrize("speed_mps", [0.0, 0.09])
def test_at_standstill_the_request_says_which_way(speed_mps):
    guard = guard_after((NEUTRAL, 0.0, 0.0), ahead_m=0.05, behind_m=1.5)
    assert allowed(guard, asked(0.5), speed_mps) == (0.0, False)
    assert allowed(guard, asked(-0.5), speed_mps)[0] == BY_DRAG
    assert allowed(guard, asked(0.0), speed_mps) == (0.0, False)
    assert allowed(guard, asked(-0.5), 0.1) == (0.0, True)


@pytest.mark.parametrize("source", [PLANNER, TELEOP])
def test_a_car_that_is_faster_has_to_stop_whoever_drives(source):
    guard = guard_after((FORWARD, 0.5, 0.0))
    assert allowed(guard, asked(0.5, source), 3.0)[1]
    assert not allowed(guard, asked(0.5, source), 1.0)[1]
    assert allowed(guard_after((FORWARD, 0.5, 0.0), ahead_m=0.05), asked(0.5, source), 0.1) == (0.0, True)


def test_a_turn_that_leaves_every_cone_is_not_bounded():
    assert guard_after((FORWARD, 0.5, 0.0)).check(asked(0.5), moving(1.0), 1.0, NOW) is NONE


@pytest.mark.parametrize("arbitration", [asked(0.0, PLANNER, stops=True), asked(0.0, NOBODY)])
def test_where_nobody_drives_or_without_any_odometry_there_is_nothing_to_bound(arbitration):
    assert guard_after((FORWARD, 0.5, 0.0)).check(arbitration, moving(3.0), 0.0, NOW) is NONE
    assert guard_after().check(asked(0.5), MeasuredSpeed(0.5), 0.0, NOW) is NONE
