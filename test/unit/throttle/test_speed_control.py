"""The speed control on a virtual car, under everything that makes map and car differ; and its rules one by one.

The car of ``speed_rig`` has the ESC's dead band, rules and delays, and the odometry of its own Teensy.
"""

import itertools
import math
import os

import pytest
from virtual_escs import crawler, direct, race, xl5

from car_interface.common import causes
from car_interface.common.sources import NEUTRAL, PLANNER, TELEOP
from car_interface.throttle.arbiter import COAST_GEAR
from car_interface.throttle.speed_control import HOLD_MPS2, STOP, SpeedControl, SpeedControlConfig

from .speed_rig import SpeedRequest, SpeedRig, mean_error, overshoot, settled_s, wrong_map

MS, S = 1_000_000, 1_000_000_000
TICK_NS = 20 * MS
DISTURBED = {
    "as_the_map_says": {},
    "battery_15_percent_weaker": {"thrust": 0.85},
    "5_percent_uphill": {"slope": 0.05},
    "5_percent_downhill": {"slope": -0.05},
    "map_30_percent_too_strong": {"value_map": wrong_map(1.3)},
    "map_30_percent_too_weak": {"value_map": wrong_map(0.7)},
    "values_30_percent_too_large": {"value_map": wrong_map(1.0, 1.3)},
    "values_30_percent_too_small": {"value_map": wrong_map(1.0, 0.7)},
}

IS_ALL = bool(os.environ.get("CAR_INTERFACE_ALL"))
HELD_S = 64.0 if IS_ALL else 11.0


def sample(every, *axes):
    """All combinations with --all, else one in so many, of which each value has its share."""
    return list(itertools.product(*axes))[::1 if IS_ALL else every]


@pytest.mark.once
@pytest.mark.parametrize("target, disturbance", [
    *((3.0, name) for name in DISTURBED), *((-0.3, name) for name, in sample(3, DISTURBED))])
def test_speed_is_reached_in_time_without_overshoot_and_held(disturbance, target):
    sign, magnitude = math.copysign(1, target), abs(target)
    samples = [sample._replace(speed_mps=sign * sample.speed_mps)
               for sample in SpeedRig(**DISTURBED[disturbance]).run(6.0 if target > 0 else 8.0, SpeedRequest(target))]
    assert overshoot(samples, magnitude) < 0.10
    assert abs(mean_error(samples[-100:], magnitude)) < 0.03
    if target == 3.0:
        assert settled_s(samples, 3.0) <= 3.0 / 2.0 + 0.5
        assert max(abs(sample.speed_mps / 3.0 - 1) for sample in samples[-100:]) < 0.03


@pytest.mark.once
@pytest.mark.parametrize("disturbance", DISTURBED)
def test_0_3_mps_is_held_without_a_stall(disturbance):
    samples = SpeedRig(**DISTURBED[disturbance]).run(HELD_S, SpeedRequest(0.3))
    assert overshoot(samples[:300], 0.3) < 0.10
    assert min(sample.speed_mps for sample in samples[200:]) > 0.27
    assert abs(mean_error(samples[200:], 0.3)) < 0.03


@pytest.mark.once
@pytest.mark.parametrize("hill, car, sign", sample(
    3, ((0.05, 0.3, 0.12), (0.05, 1.0, 0.12), (0.08, 1.0, 0.2)),
    ((0.0, 0.05), (0.05, 0.02), (0.1, 0.15), (0.1, 0.02)), (1, -1)))
def test_speed_is_held_downhill(hill, car, sign):
    (slope, speed_mps, within), (drag_brake, lag_s) = hill, car
    rig = SpeedRig(slope=-sign * slope, esc=xl5(drag_brake=drag_brake), is_measured=True, lag_s=lag_s)
    rig.car.speed_mps = 0.0  # it was held until now
    samples = rig.run(13.0, SpeedRequest(sign * speed_mps))
    assert max(sign * sample.speed_mps for sample in samples) < speed_mps + 0.5
    assert all(abs(sign * sample.speed_mps / speed_mps - 1.0) < within for sample in samples[200:])


@pytest.mark.once
@pytest.mark.parametrize("sign, kind, hill", [case for case in sample(
    4, (1, -1),
    ((xl5, "unverified", False), (xl5, "brake_then_reverse", False), (crawler, "brake_becomes_reverse", True),
     (direct, "direct_reverse", True), (crawler, "unverified", False), (direct, "unverified", False),
     (race, "forward_only", True)),
    ((0.05, 0.0, 0.15), (0.08, 0.0, 0.05), (0.08, 0.05, 0.15))) if case[0] > 0 or case[1][0] is not race])
def test_no_kind_rolls_away_downhill_at_a_crawl(sign, kind, hill):
    (esc, profile, is_measured), (slope, drag_brake, lag_s) = kind, hill
    rig = SpeedRig(slope=-sign * slope, esc=esc(drag_brake=drag_brake), profile=profile, is_measured=is_measured,
                   lag_s=lag_s)
    rig.car.speed_mps = 0.0  # it was held until now
    samples = rig.run(10.0, SpeedRequest(sign * 0.3))
    assert max(sign * sample.speed_mps for sample in samples) < 0.3 + 0.5
    assert abs(mean_error(samples[150:], sign * 0.3)) < 0.12


@pytest.mark.once
@pytest.mark.parametrize("lag_s, target, map_", sample(
    5, (0.15, 0.0, 0.02, 0.1), (0.3, 1.0),
    (("as_the_map_says", 0.10), ("map_30_percent_too_strong", 0.15), ("map_30_percent_too_weak", 0.15))))
def test_speed_isn_t_overshot_whatever_the_motor_s_lag(lag_s, target, map_):
    disturbance, limit = map_
    samples = SpeedRig(lag_s=lag_s, **DISTURBED[disturbance]).run(5.0, SpeedRequest(target))
    assert overshoot(samples, target) < limit
    assert abs(mean_error(samples[-75:], target)) < 0.03


@pytest.mark.once
def test_speed_that_falls_is_followed_and_a_stop_ends_at_standstill():
    rig = SpeedRig()
    rig.run(3.0, SpeedRequest(2.0))
    slower = rig.run(2.0, SpeedRequest(1.0))
    assert abs(mean_error(slower[-25:], 1.0)) < 0.03
    stopped = rig.run(2.0, STOP)
    assert stopped[-1].speed_mps == 0.0 and stopped[-1].acceleration_mps2 == -HOLD_MPS2
    assert min(sample.speed_mps for sample in stopped) >= 0.0
    assert "REVERSE" not in {sample.esc for sample in stopped}


@pytest.mark.once
def test_request_with_a_smaller_acceleration_is_followed_with_that():
    samples = SpeedRig().run(4.0, SpeedRequest(2.0, acceleration_mps2=1.0))
    assert settled_s(samples, 2.0) == pytest.approx(2.0, abs=0.3)


@pytest.mark.once
def test_without_odometry_it_says_so_and_the_car_stops():
    rig = SpeedRig()
    rig.run(2.0, SpeedRequest(1.0))
    rig.is_deaf = True
    rig.run(3.0)
    command = rig.commands[-1]
    assert (command.is_known, command.acceleration_mps2) == (False, -3.0)
    assert command.note.startswith("odometry silent for ")
    assert rig.car.speed_mps == 0.0
    rig.is_deaf = False
    samples = rig.run(3.0)
    assert overshoot(samples, 1.0) < 0.10 and abs(mean_error(samples[-25:], 1.0)) < 0.03


@pytest.mark.once
def test_neutral_coasts_drive_goes_on_from_there_and_park_holds():
    rig = SpeedRig(slope=0.05)
    rig.run(3.0, SpeedRequest(2.0))
    samples = rig.run(0.5, SpeedRequest(0.0, gear="neutral"))
    assert {sample.granted for sample in samples[2:]} == {0.0} and samples[-1].speed_mps > 1.0
    assert abs(mean_error(rig.run(3.0, SpeedRequest(2.0, gear="drive"))[-25:], 2.0)) < 0.03
    samples = rig.run(4.0, SpeedRequest(0.0, gear="park"))
    assert [sample.speed_mps for sample in samples[-50:]] == [0.0] * 50


class Bench:
    """The control alone, with a speed and a throttle_arb that the test sets; None: throttle_arb is not there."""

    def __init__(self, speed_mps=1.0, **config):
        self.control = SpeedControl(SpeedControlConfig(**config))
        self.now_ns = 1000 * S
        self.speed_mps = speed_mps
        self.throttle = None

    def run(self, request, seconds=0.02):
        command = None
        for _ in range(round(seconds * 50)):
            self.now_ns += TICK_NS
            self.control.speed.update(self.speed_mps, self.now_ns)
            if self.throttle is not None:
                self.control.update_throttle(*self.throttle, self.now_ns)
            command = self.control.step(request, self.now_ns)
        return command


def test_before_odometry_was_received_and_after_dropped_messages_nothing_is_known():
    command = SpeedControl().step(SpeedRequest(1.0), 0)
    assert not command.is_known and command.note == "odometry was never heard"
    assert math.isnan(SpeedControl().speed.last_mps)
    bench = Bench()
    bench.run(SpeedRequest(1.0))
    bench.control.mark_stale()
    assert bench.control.step(SpeedRequest(1.0), bench.now_ns).note == (
        "odometry was not heard since messages were dropped")


@pytest.mark.parametrize("speed, is_known", [(math.nan, False), (100.1, False), (-100.0, True)])
def test_speed_that_no_car_has_is_unknown_and_the_next_one_begins_from_itself(speed, is_known):
    bench = Bench()
    bench.run(SpeedRequest(1.0))
    bench.control.speed.update(speed, bench.now_ns)
    assert bench.control.step(SpeedRequest(1.0), bench.now_ns).is_known == is_known
    bench.speed_mps = 2.0
    command = bench.run(SpeedRequest(3.0))
    assert command.is_known and (command.reference_mps > 2.0) != is_known


@pytest.mark.parametrize("request_, note, reference_mps", [
    (SpeedRequest(-5.0), "5.00 m/s is above max_speed 3 m/s", -3.0),
    (SpeedRequest(0.05), "0.05 m/s is below 0.1 m/s, which counts as standstill", 0.0),
    (SpeedRequest(0.1), "", 0.1),
    (SpeedRequest(3.0), "", 3.0),
    (STOP, "", 0.0),
])
def test_what_is_changed_of_a_request_is_reported(request_, note, reference_mps):
    assert Bench(speed_mps=0.0).run(request_).note == note
    moving = Bench(speed_mps=0.0)
    moving.run(request_)
    moving.speed_mps = reference_mps
    assert moving.run(request_, 3.0).reference_mps == pytest.approx(reference_mps)


def test_car_that_does_not_move_for_two_seconds_is_told_until_it_moves():
    bench = Bench(speed_mps=0.0)
    assert bench.run(SpeedRequest(0.2), 2.0).note == ""
    assert bench.run(SpeedRequest(0.2), 1.0).note == (
        "it doesn't move at 0.20 m/s: too slow for this car, or it is held")
    bench.speed_mps = 0.1
    assert bench.run(SpeedRequest(0.2)).note == ""
    bench.throttle = (TELEOP, 1.0, 1.0, causes.DRIVING)
    bench.speed_mps = 0.0
    assert bench.run(SpeedRequest(0.2), 5.0).note == ""


def test_car_that_rolls_too_fast_for_a_second_is_told_until_it_does_not():
    notes = []
    control = SpeedControl()
    for index in range(300):
        now_ns = index * TICK_NS
        control.speed.update(1.0 if 50 <= index < 200 else 0.3, now_ns)
        notes.append(control.step(SpeedRequest(0.3), now_ns).note)
    told = [index for index, note in enumerate(notes) if note]
    assert told == list(range(100, 200)) and notes[100] == (
        "it rolls at 1.00 m/s instead of 0.30: downhill, and its ESC isn't certain to brake it, or something else "
        "pushes it")


def test_gear_change_at_speed_stops_first_and_says_so():
    bench = Bench(speed_mps=2.0)
    bench.run(SpeedRequest(2.0, gear="drive"), 1.0)
    command = bench.run(SpeedRequest(-1.0, gear="reverse"), 0.2)
    assert (command.gear, command.note) == ("drive", "it stops before REVERSE: it rolls at 2.00 m/s")
    assert command.acceleration_mps2 < -2.0
    bench.speed_mps = 0.1
    assert bench.run(SpeedRequest(-1.0, gear="reverse"), 0.1).gear == "drive"
    bench.speed_mps = 0.099
    command = bench.run(SpeedRequest(-1.0, gear="reverse"), 0.1)
    assert (command.gear, command.note) == ("reverse", "") and command.acceleration_mps2 < 0.0


def test_stop_keeps_the_gear_brakes_against_the_way_it_rolls_and_holds_by_a_brake_in_either_gear():
    bench = Bench(speed_mps=0.05)
    assert bench.run(STOP).acceleration_mps2 == -HOLD_MPS2
    bench.run(SpeedRequest(-1.0), 0.1)
    assert bench.run(STOP).acceleration_mps2 == HOLD_MPS2
    bench.speed_mps = -1.0
    bench.run(SpeedRequest(-1.0), 1.0)
    command = bench.run(STOP, 0.3)
    assert command.gear == "reverse" and command.acceleration_mps2 > 1.0


def test_braking_that_is_asked_for_is_given_whatever_the_speed_says():
    bench = Bench(speed_mps=1.0)
    bench.run(SpeedRequest(1.0), 1.0)
    assert bench.run(SpeedRequest(2.0, acceleration_mps2=1.5, braking_mps2=1.5), 0.5).acceleration_mps2 == -1.5
    assert bench.run(SpeedRequest(2.0, braking_mps2=9.0), 0.5).acceleration_mps2 == -3.0


@pytest.mark.parametrize("state", [(TELEOP, 1.0, 1.0, causes.DRIVING), (NEUTRAL, 0.0, 0.0, causes.STOPPING)])
def test_while_somebody_else_or_nobody_drives_it_begins_again_at_the_measured_speed(state):
    bench = Bench(speed_mps=0.4)
    bench.throttle = state
    first = bench.run(SpeedRequest(2.0), 0.1)
    assert bench.run(SpeedRequest(2.0), 5.0) == first
    assert first.reference_mps == pytest.approx(0.4, abs=0.05)


@pytest.mark.parametrize("cause", [causes.REVERSE_PENDING, causes.ESC_ARMING, causes.REVERSE_REFUSED])
def test_while_the_esc_waits_it_pulls_evenly_and_nothing_winds_up(cause):
    bench = Bench(speed_mps=0.0)
    bench.throttle = (PLANNER, -0.3, 0.0, cause)
    commands = [bench.run(SpeedRequest(-0.3)).acceleration_mps2 for _ in range(200)]
    assert set(commands) == {-HOLD_MPS2}
    bench.throttle = (PLANNER, -0.1, -0.1, causes.REVERSING)
    assert -0.7 < bench.run(SpeedRequest(-0.3)).acceleration_mps2 < 0.0


def wound_up(asked, granted, cause, speed_mps, seconds=10.0):
    """What is asked for after the car was that slow or fast for long, at 1 m/s and without the error's own part."""
    bench = Bench(speed_mps=1.0, max_correction_mps2=50.0)
    bench.run(SpeedRequest(1.0), 2.0)
    bench.speed_mps = speed_mps
    bench.throttle = (PLANNER, asked, granted, cause)
    bench.run(SpeedRequest(1.0), seconds)
    bench.speed_mps = 1.0
    return bench.run(SpeedRequest(1.0)).acceleration_mps2


@pytest.mark.parametrize("asked, granted, cause, speed_mps, sign", [
    (0.8, 0.4, causes.DRIVING, 0.5, 0),  # a limit cuts
    (0.8, 0.8, causes.DRIVING, 0.5, 1),
    (-0.3, 0.0, causes.BRAKE_UNCERTAIN, 1.5, 0),  # the ESC leaves out a brake
    (-0.3, -0.3, causes.BRAKING, 1.5, -1),
    (0.05, 0.0, causes.NO_THROTTLE, 0.5, 1),  # its dead band, or the car would never start
])
def test_integral_grows_unless_what_is_asked_for_is_cut(asked, granted, cause, speed_mps, sign):
    acceleration_mps2 = wound_up(asked, granted, cause, speed_mps)
    assert acceleration_mps2 == pytest.approx(0.0, abs=1e-9) if not sign else sign * acceleration_mps2 > 5.0


def test_correction_is_limited_and_comes_back_at_once():
    bench = Bench(speed_mps=1.0)
    bench.run(SpeedRequest(1.0), 2.0)
    bench.speed_mps = 0.3
    assert bench.run(SpeedRequest(1.0), 30.0).acceleration_mps2 == pytest.approx(2.0)
    bench.speed_mps = 1.7
    assert bench.run(SpeedRequest(1.0), 0.5).acceleration_mps2 < 0.0


def test_integral_grows_no_further_than_the_limit_leaves_beside_the_error_s_own_part():
    bench = Bench(speed_mps=1.0)
    bench.run(SpeedRequest(1.0), 2.0)
    bench.speed_mps = 0.7  # 0.3 m/s too slow: 1.2 m/s² of 2
    bench.run(SpeedRequest(1.0), 30.0)
    bench.speed_mps = 1.0
    assert bench.run(SpeedRequest(1.0)).acceleration_mps2 == pytest.approx(0.8, abs=0.05)


def test_delayed_step_makes_no_jump():
    bench = Bench(speed_mps=0.0)
    bench.run(SpeedRequest(2.0), 0.2)
    bench.now_ns += 400 * MS
    assert bench.run(SpeedRequest(2.0)).reference_mps < 0.6


def test_gear_neutral_coasts_at_the_measured_speed_and_begins_anew_afterwards():
    control = SpeedControl()
    for tick in range(3):
        control.speed.update(1.5, tick * TICK_NS)
        command = control.step(SpeedRequest(2.0, gear=COAST_GEAR), tick * TICK_NS)
        assert command[:4] == (0.0, 1.5, COAST_GEAR, True)
    assert control.step(SpeedRequest(2.0), 3 * TICK_NS).reference_mps == pytest.approx(1.5, abs=0.1)
