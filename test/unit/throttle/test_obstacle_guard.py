"""What a stop guarantees while the car drives, coasts, brakes or reverses, and what the sonars allow by that."""

import math

import pytest

from car_interface.common import causes
from car_interface.common.measured_speed import MeasuredSpeed
from car_interface.common.sources import NEUTRAL as NOBODY
from car_interface.common.sources import PLANNER, TELEOP
from car_interface.throttle.arbiter import Arbitration
from car_interface.throttle.esc import BRAKING, FORWARD, HOLD, NEUTRAL, REVERSE, EscDecision
from car_interface.throttle.esc_config import BRAKE_THEN_REVERSE, EscConfig
from car_interface.throttle.limits import SpeedBound
from car_interface.throttle.obstacle_guard import MOTOR_LAG_S, ObstacleGuard
from car_interface.throttle.obstacle_stop import Mount, ObstacleConfig, ObstacleStop, stopping_speed_mps
from car_interface.throttle.slope import Coasting

MS, S = 1_000_000, 1_000_000_000
NOW = 10 * S
AHEAD, BEHIND = Mount(0.42, 0.0, 0.0), Mount(-0.14, 0.0, math.pi)
BY_BRAKE, BY_DRAG = (pytest.approx(stopping_speed_mps(1.494 - 0.1, 0.4 + 0.1 + MOTOR_LAG_S, stop_mps2), rel=0.05)
                     for stop_mps2 in (1.5, 0.3))
ROLLS_MPS2 = 0.45  # of the cars here, more than their files say
BRAKES = EscConfig(BRAKE_THEN_REVERSE, profile_measured=True)


def asked(request, source=PLANNER, stops=False):
    return Arbitration(source, causes.PLANNER, "", request, request, request, stops)


def moving(speed_mps, age_ns=0):
    speed = MeasuredSpeed(0.5)
    speed.update(speed_mps, NOW, age_ns)
    return speed


def decided(state, fraction, stop_mps2=1.5):
    return EscDecision(fraction, state, causes.DRIVING, "", stop_mps2)


def roll(guard, speeds, from_ns, curvature_per_m=0.0):
    """Reports of speeds, 50 a second; when the last one came."""
    for index, speed_mps in enumerate(speeds):
        guard.slope.update_speed(speed_mps, from_ns + index * 20 * MS, curvature_per_m)
    return from_ns + (len(speeds) - 1) * 20 * MS


def measured(guard, until_ns, downhill_mps2=0.0, sign=1):
    """It has rolled in neutral for a second, until then, on ground that pulls like that."""
    guard.update_esc(decided(NEUTRAL, 0.0, 0.3), until_ns - 1000 * MS)
    speeds = [sign * (1.0 + (downhill_mps2 - ROLLS_MPS2) * 0.02 * index) for index in range(50)]
    roll(guard, speeds, until_ns - 980 * MS)


def guard_after(*answers, ahead_m=1.5, behind_m=1.5, esc=BRAKES, downhill_mps2=0.0, is_measured=True):
    """One whose ESC got these (state, fraction, seconds ago), which brake with 1.5 m/s², or so much, for certain."""
    guard = ObstacleGuard(ObstacleStop(ObstacleConfig({"front_middle": AHEAD, "rear_middle": BEHIND})), esc)
    if is_measured:
        measured(guard, NOW - 5 * S, downhill_mps2, -1)
        measured(guard, NOW - 2 * S, downhill_mps2)
    for report in range(3):
        guard.sonars.update_range("front_middle", ahead_m, NOW - (2 - report) * 400 * MS)
        guard.sonars.update_range("rear_middle", behind_m, NOW - (2 - report) * 400 * MS)
    for state, fraction, ago_s, *stop_mps2 in answers:
        guard.update_esc(decided(state, fraction, *stop_mps2), NOW - round(ago_s * S))
    return guard


def check(guard, arbitration, speed, curvature_per_m=0.0):
    found = guard.check(arbitration, speed, curvature_per_m, NOW)
    return found, found.is_stop


def allowed(guard, arbitration, speed_mps, curvature_per_m=0.0):
    bound, is_stop = check(guard, arbitration, moving(speed_mps), curvature_per_m)
    return bound.speed_mps, is_stop


@pytest.mark.parametrize(("answers", "request_", "speed_mps"), [
    ([(FORWARD, 0.5, 0.0)], 0.5, BY_BRAKE),
    ([(FORWARD, 0.5, 0.3), (NEUTRAL, 0.0, 0.0)], 0.0, BY_BRAKE),
    ([(FORWARD, 0.5, 0.4), (NEUTRAL, 0.0, 0.0)], 0.0, BY_DRAG),
    ([(REVERSE, -0.5, 0.1), (NEUTRAL, 0.0, 0.0)], 0.0, BY_DRAG),
    ([(BRAKING, -0.5, 0.0)], -0.5, BY_BRAKE),
    ([(BRAKING, -0.5, 0.0)], 0.5, BY_DRAG),  # which is about to be released
    ([(FORWARD, 0.5, 0.0, 0.3)], 0.5, BY_DRAG),  # a brake that may be gone when it is needed
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


@pytest.mark.parametrize(("state", "cause", "ahead_m", "asks", "is_stop"), [
    (BRAKING, causes.STOPPING, 0.05, 0.5, True),
    (HOLD, causes.STOPPING, 0.05, 0.5, True),
    (HOLD, causes.STOPPING, 0.05, 0.0, True),
    (HOLD, causes.STOPPING, 0.05, -0.5, False),  # backward is clear
    (HOLD, causes.STOPPING, 1.5, 0.5, False),
    (HOLD, causes.STOPPING, 1.5, 0.02, True),  # in the dead band
    (HOLD, causes.HOLDING, 0.05, -0.5, False),  # a planner's own brake
    (NEUTRAL, causes.STOPPING, 0.05, 0.5, False)])
def test_the_brake_of_a_stop_is_let_go_only_where_the_car_may_drive_again(state, cause, ahead_m, asks, is_stop):
    guard = guard_after(ahead_m=ahead_m)
    guard.update_esc(EscDecision(-0.5, state, cause, "", 1.5), NOW)
    assert check(guard, asked(asks), moving(0.05))[1] == is_stop


def test_a_turn_that_leaves_every_cone_is_left_a_creep():
    guard = guard_after((FORWARD, 0.5, 0.0))
    assert allowed(guard, asked(0.5), 0.2, 2.5) == (0.3, False)
    assert allowed(guard, asked(0.5), 0.35, 2.5) == (0.3, True)


@pytest.mark.parametrize("arbitration", [asked(0.0, PLANNER, stops=True), asked(0.0, NOBODY)])
def test_where_nobody_drives_or_without_any_odometry_there_is_nothing_to_bound(arbitration):
    assert guard_after((FORWARD, 0.5, 0.0)).check(arbitration, moving(3.0), 0.0, NOW) is None
    assert guard_after().check(asked(0.5), MeasuredSpeed(0.5), 0.0, NOW) is None


# --- the ground ---

def test_downhill_it_counts_on_less_by_drag_and_by_brake():
    by_drag, _ = allowed(guard_after(downhill_mps2=0.25), asked(0.5), 0.2)
    by_brake, _ = allowed(guard_after((FORWARD, 0.5, 0.0), downhill_mps2=0.25), asked(0.5), 0.2)
    level = allowed(guard_after(), asked(0.5), 0.2)[0], allowed(guard_after((FORWARD, 0.5, 0.0)), asked(0.5), 0.2)[0]
    assert by_drag < 0.85 * level[0] and 0.85 * level[1] < by_brake < level[1]


@pytest.mark.parametrize("downhill_mps2", [0.55, 0.37])
def test_where_it_would_hardly_stop_by_itself_it_is_not_pushed_and_where_it_brakes_it_is(downhill_mps2):
    assert allowed(guard_after(downhill_mps2=downhill_mps2, esc=EscConfig()), asked(0.5), 0.0) == (0.0, False)
    assert allowed(guard_after((FORWARD, 0.5, 0.0), downhill_mps2=downhill_mps2), asked(0.5), 0.5)[0] > 1.0


def test_before_it_is_known_how_it_slows_down_here_it_begins_slowly():
    unknown = {"is_measured": False, "esc": EscConfig()}
    bound, is_stop = check(guard_after(**unknown, ahead_m=math.inf), asked(0.5), moving(0.0))
    assert (bound.speed_mps, bound.words, is_stop) == (0.25, "before it is known how it slows down here it has", False)
    near = [allowed(guard_after(ahead_m=0.5, **one), asked(0.5), 0.0)[0] for one in (unknown, {"esc": EscConfig()})]
    assert 0.05 < near[0] < 0.4 * near[1]


def test_a_car_that_may_never_brake_rolls_in_neutral_until_it_is_known_how_it_slows_down():
    guard = guard_after(is_measured=False, ahead_m=math.inf, esc=EscConfig())
    assert check(guard, asked(0.5), moving(0.09))[0].max_throttle > 0.0
    assert check(guard, asked(0.5), moving(0.2))[0].max_throttle == 0.0
    assert check(guard, asked(0.5), moving(0.06))[0].max_throttle == 0.0  # it goes on, until it hardly rolls
    assert check(guard, asked(0.5), moving(0.04))[0].max_throttle > 0.0
    measured(guard, NOW)
    bound, _ = check(guard, asked(0.5), moving(0.22))
    assert bound.speed_mps > 0.7 and bound.max_throttle > 0.0


def test_it_rolls_again_near_its_bound_where_it_turns_to_a_heading_that_is_not_known():
    guard = guard_after(esc=EscConfig(), ahead_m=math.inf)
    near_mps = allowed(guard, asked(0.5), 0.5)[0] - 0.1
    assert check(guard, asked(0.5), moving(near_mps))[0].max_throttle > 0.0
    guard.update_esc(decided(FORWARD, 0.2, 0.3), NOW - S)
    roll(guard, [0.8] * 50, NOW - S, 1.2)
    assert check(guard, asked(0.5), moving(0.3))[0].max_throttle > 0.0
    bound, is_stop = check(guard, asked(0.5), moving(check(guard, asked(0.5), moving(0.3))[0].speed_mps - 0.05))
    assert (bound.max_throttle, is_stop) == (0.0, False)


def test_on_an_arc_the_ground_counts_on_which_it_will_stop():
    guard = guard_after(esc=EscConfig(), ahead_m=math.inf)
    straight_mps, arc_mps = (allowed(guard, asked(0.5), 0.6, curvature)[0] for curvature in (0.0, 0.1))
    assert arc_mps == pytest.approx(straight_mps, rel=0.1)
    guard.slope._yaw_rad += 0.5
    away_mps, back_mps = (allowed(guard, asked(0.5), 0.3, curvature)[0] for curvature in (0.15, -0.15))
    assert away_mps < 0.97 * back_mps  # from the heading that it knows
    guard.slope._yaw_rad += math.pi / 2 - 0.5
    assert allowed(guard, asked(0.5), 0.2)[0] == 0.25


def test_the_less_stops_it_on_an_arc_the_farther_on_its_arc_it_stops():
    """At 1.2 m/s halfway is 1.2 m with 0.3 m/s², which is 0.6 rad on this arc; there 0.18 are certain, so it is 2 m."""
    guard, turns = guard_after(esc=EscConfig()), []

    def coasting(is_backward, turn_rad=0.0):
        turns.append(turn_rad)
        return Coasting(max(-0.5, 0.3 - 0.2 * abs(turn_rad)), 0.5)

    guard.slope.coasting = coasting
    assert guard._coasting(1.2, 0.5, False).certain_mps2 == pytest.approx(0.1)
    assert guard._coasting(1.2, 0.5, True).certain_mps2 == pytest.approx(0.1)
    assert guard._coasting(1.2, 0.0, False).certain_mps2 == 0.3
    assert turns == pytest.approx([0.0, 0.6, 1.0, 0.0, -0.6, -1.0, 0.0])
    assert guard._coasting(3.0, 0.5, False).certain_mps2 == -0.5
    assert turns[-1] == pytest.approx(0.5 * 3.0 ** 2 / (4 * 0.1))  # where nothing stops it, as on 1 %


def test_a_car_that_is_faster_than_its_bound_on_an_arc_is_not_allowed_more_for_stopping_farther_on_it():
    guard = guard_after(esc=EscConfig())
    guard.slope.coasting = lambda is_backward, turn_rad=0.0: Coasting(0.0, 0.5)
    bound = SpeedBound(0.5, causes.OBSTACLE_SLOWED, "")
    assert guard._sustained(bound, 0.3, 0.6, 0.5, False) == bound
    assert 0.4 < guard._sustained(bound, 0.3, 0.4, 0.5, False).speed_mps < 0.5


def test_its_throttle_rises_from_the_least_until_the_car_moves():
    guard = guard_after(is_measured=False, ahead_m=math.inf, esc=EscConfig())
    assert check(guard, asked(1.0), moving(0.0))[0].max_throttle == 0.08
    throttles = []
    for step in range(15):
        throttles.append(guard.check(asked(1.0), moving(0.0), 0.0, NOW + step * 20 * MS).max_throttle)
        guard.update_esc(decided(FORWARD, throttles[-1], 0.3), NOW + step * 20 * MS)
    assert throttles[-1] == pytest.approx(0.08 * (1.0 + 0.02 / 0.8) ** 14)
    until_ns = roll(guard, [0.004 * index for index in range(16)], NOW + 280 * MS)  # 0.2 m/s²
    speed = MeasuredSpeed(0.5)
    speed.update(0.06, until_ns)
    assert guard.check(asked(1.0), speed, 0.0, until_ns + 20 * MS).max_throttle <= throttles[-1]
    assert guard.check(asked(1.0), speed, 0.0, until_ns).max_throttle > 0.08


@pytest.mark.parametrize("found", [{"is_measured": False}, {"downhill_mps2": 0.4}], ids=["unknown", "steep"])
def test_a_push_there_lasts_until_the_brake_is_certain_and_begins_only_with_room_for_it(found):
    for ahead_m, is_begun in ((1.5, True), (1.0, True), (0.5, False)):
        assert (check(guard_after(ahead_m=ahead_m, **found), asked(0.5), moving(0.0))[0].max_throttle > 0.0) == is_begun
    guard = guard_after(**found)
    guard.update_esc(decided(FORWARD, 0.08, 0.3), NOW)
    roll(guard, [0.1 + 0.02 * index for index in range(10)], NOW + 20 * MS)
    assert allowed(guard, asked(0.0), 0.2) == (0.0, True)  # nobody pushes it
    for speed_mps in (0.28, 0.33):
        bound, is_stop = check(guard, asked(0.5), moving(speed_mps))
        assert not is_stop and bound.max_throttle >= 0.08 and bound.speed_mps - speed_mps > 0.04
    assert check(guard, asked(0.5), moving(1.5))[1]


@pytest.mark.parametrize("pushed_s, left_s", [(0.0, 0.6), (0.2, 0.4), (0.7, 0.0)])
def test_until_the_brake_is_certain_it_drives_on_for_what_is_left_of_0_6_s(pushed_s, left_s):
    guard = guard_after((FORWARD, 0.08, pushed_s, 0.3), (FORWARD, 0.08, 0.0, 0.3), is_measured=False)
    assert allowed(guard, asked(0.5), 0.0)[0] == pytest.approx(
        stopping_speed_mps(1.494 - 0.1, 0.4 + 0.1 + MOTOR_LAG_S + left_s, 1.5), rel=0.01)


@pytest.mark.parametrize("speed_mps, throttle", [(0.24, 0.5), (0.25, 0.08)])
def test_such_a_push_is_the_least_from_a_quarter_of_a_metre_per_second_on(speed_mps, throttle):
    guard = guard_after((FORWARD, 0.5, 0.3, 0.3), (FORWARD, 0.5, 0.0, 0.3), is_measured=False)
    assert check(guard, asked(0.5), moving(speed_mps))[0].max_throttle == throttle


def test_a_stop_that_brakes_where_drag_is_not_known_goes_on_until_the_car_hardly_rolls():
    for is_measured in (False, True):
        guard = guard_after((FORWARD, 0.5, 0.0), is_measured=is_measured)
        assert check(guard, asked(0.5), moving(3.0))[1]
        guard.update_esc(decided(BRAKING, -0.5), NOW)
        assert check(guard, asked(0.5), moving(0.15))[1] == (not is_measured)
        assert not check(guard, asked(0.5), moving(0.08))[1]


# --- what the motor, and odometry, do meanwhile ---

def test_what_holds_the_speed_is_the_throttle_without_the_part_that_accelerates_and_none_is_left_at_the_bound():
    def throttle(gain_mps2, speed_mps=0.3, curvature_per_m=0.0):
        guard = guard_after((FORWARD, 0.3, 3.0), ahead_m=math.inf)
        roll(guard, [0.3 - gain_mps2 * 0.02 * (9 - index) for index in range(10)], NOW - 180 * MS)
        guard.update_esc(decided(FORWARD, 0.3), NOW)
        return check(guard, asked(0.5), moving(speed_mps), curvature_per_m)[0].max_throttle

    assert throttle(0.0) - throttle(0.3) == pytest.approx(0.3 / 6.0)  # of a full throttle's 6 m/s²
    assert throttle(0.0, 0.3, 2.5) == 0.0 < 0.3 < throttle(0.0, 0.29, 2.5)  # a creep is 0.3 m/s


def test_odometry_s_age_counts_with_what_the_car_gains_in_it():
    guard = guard_after((FORWARD, 0.5, 0.0))
    roll(guard, [0.2 + 0.04 * index for index in range(10)], NOW - 180 * MS)  # 2 m/s²
    late = MeasuredSpeed(0.5)
    for index in range(10):
        late.update(0.2 + 0.04 * index, NOW - 180 * MS + index * 20 * MS, 150 * MS)
    bound, is_stop = check(guard, asked(0.5), late)
    assert not is_stop and bound.max_throttle == 0.0
    assert allowed(guard, asked(0.5), 0.56)[0] > bound.speed_mps  # an echo comes nearer in that time
    faster = MeasuredSpeed(0.5)
    for index in range(10):
        faster.update(bound.speed_mps - 0.1 + 0.001 * index, NOW - 180 * MS + index * 20 * MS, 150 * MS)
    assert check(guard, asked(0.5), faster)[1]


def test_the_later_the_odometry_the_less_is_given_back_but_never_less_than_moves_the_car():
    def throttle(age_ms, speed_mps, is_pushed=False):
        guard, speed = guard_after((NEUTRAL, 0.0, 0.0), ahead_m=math.inf), moving(speed_mps, age_ms * MS)
        guard.check(asked(1.0), speed, 0.0, NOW)
        for step in range(15 if is_pushed else 0):
            guard.update_esc(decided(FORWARD, 0.5), NOW + step * 20 * MS)
        return guard.check(asked(1.0), speed, 0.0, NOW).max_throttle

    assert throttle(150, 0.2) < 0.7 * throttle(0, 0.2)
    assert throttle(150, 0.2, True) - throttle(150, 0.2) < 0.6 * (throttle(0, 0.2, True) - throttle(0, 0.2))
    assert throttle(150, BY_DRAG.expected - 0.16) == 0.08


def test_a_car_that_gets_faster_gets_no_throttle_where_the_motor_s_lag_will_bring_it_to_the_bound():
    guard = guard_after((FORWARD, 0.5, 0.0))
    limit_mps = allowed(guard, asked(0.5), 0.5)[0]
    gains_mps = 3.0 * (0.05 + MOTOR_LAG_S)
    for second, (gain_mps2, below_mps, is_cut) in enumerate(((0.0, 0.3, False), (3.0, gains_mps - 0.03, True),
                                                             (3.0, gains_mps + 0.03, False))):
        until_mps = limit_mps - below_mps
        roll(guard, [until_mps - gain_mps2 * 0.02 * (9 - index) for index in range(10)], NOW + second * S)
        bound, is_stop = check(guard, asked(0.5), moving(until_mps))
        assert not is_stop and (bound.max_throttle == 0.0) == is_cut


def test_echoes_move_with_the_car_also_while_nobody_drives():
    guard = guard_after((FORWARD, 0.5, 0.0))
    before_mps = allowed(guard, asked(0.5), 0.0)[0]
    for step in range(50):
        guard.check(asked(0.0, NOBODY), moving(0.5), 0.0, NOW + step * 20 * MS)
    speed = MeasuredSpeed(0.5)
    speed.update(0.0, NOW + 980 * MS)
    bound = guard.check(asked(0.5), speed, 0.0, NOW + 980 * MS)
    assert before_mps == BY_BRAKE
    assert bound.speed_mps == pytest.approx(stopping_speed_mps(
        1.494 - 0.1 - 0.5 * 0.98, 0.4 + 0.1 + MOTOR_LAG_S, 1.5), rel=0.05)
