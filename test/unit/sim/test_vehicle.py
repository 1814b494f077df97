"""The simulated car against geometry, and against the calibration that ships for the real one."""

import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from car_interface.common.errors import ConfigError
from car_interface.sim.drive_train import DriveTrainConfig
from car_interface.sim.teensy_sensors import FORWARD, LEFT, RIGHT
from car_interface.sim.vehicle import Pose, SteeringConfig, TyreConfig, Vehicle, VehicleConfig

MS, S = 1_000_000, 1_000_000_000
LEFT_DUTY, CENTER, RIGHT_DUTY = 3800, 5100, 6700
REVERSE, NEUTRAL, FULL = 3277, 4915, 6554
OFF, NEVER_SET = 0, -1


# A car without surprises: what it's told is what it does.
PLAIN = VehicleConfig(steering=SteeringConfig(curve=((4000, 1.0), (6000, -1.0)), center_duty=5000), tyres=None)


def drive(vehicle, seconds, steering_duty, esc_duty, dt_ns=MS):
    pulses = []
    for _ in range(round(seconds * S / dt_ns)):
        pulses += vehicle.step(dt_ns, steering_duty, esc_duty)
    return pulses


def rolling(speed_mps, config=PLAIN):
    vehicle = Vehicle(config)
    vehicle.speed_mps = speed_mps
    return vehicle


def frictionless():
    drive = DriveTrainConfig(drag_mps2=0.0, drag_per_s=0.0, drag_per_m=0.0)
    return VehicleConfig(steering=PLAIN.steering, drive=drive, tyres=None)


def test_wheels_of_a_car_on_a_box_turn_alike_and_it_stays_where_it_is():
    vehicle = Vehicle(replace(PLAIN, on_box=True, start=Pose(1.0, 2.0, 0.5)))
    pulses = drive(vehicle, 1.0, LEFT_DUTY, FULL)
    counts = [sum(pulse.side == side for pulse in pulses) for side in (LEFT, RIGHT)]
    assert vehicle.pose == Pose(1.0, 2.0, 0.5) and vehicle.yaw_rate_radps == 0.0 and vehicle.speed_mps > 1.0
    assert abs(counts[0] - counts[1]) <= 1 < min(counts) and vehicle.steered_per_m == 1.0


@pytest.mark.once
@given(st.floats(1638, 8192), st.floats(1638, 8192))
def test_steering_with_more_duty_never_turns_more_to_the_left(one, other):
    vehicle = Vehicle()
    low, high = sorted((one, other))
    left_per_m, right_per_m = (vehicle.true_curvature_per_m(duty) for duty in (2000, 8000))
    assert (1 / left_per_m, 1 / right_per_m) == pytest.approx((0.971, -1.031), abs=0.001)  # at its stops
    assert left_per_m >= vehicle.true_curvature_per_m(low) >= vehicle.true_curvature_per_m(high) >= right_per_m


def test_steering_takes_a_quarter_of_a_second_from_stop_to_stop_and_stays_there_without_pulse():
    vehicle = Vehicle()
    drive(vehicle, 0.5, LEFT_DUTY, NEUTRAL)
    drive(vehicle, 0.1, RIGHT_DUTY, NEUTRAL)
    assert vehicle.servo_duty < 5200
    drive(vehicle, 0.25, RIGHT_DUTY, NEUTRAL)
    assert RIGHT_DUTY - 10 <= vehicle.servo_duty <= RIGHT_DUTY
    drive(vehicle, 0.5, RIGHT_DUTY, NEUTRAL)
    assert vehicle.servo_duty == RIGHT_DUTY
    for no_pulse in (NEVER_SET, OFF, 65535):
        drive(vehicle, 1.0, no_pulse, NEUTRAL)
        assert vehicle.servo_duty == RIGHT_DUTY


@pytest.mark.parametrize("esc_duty", [NEUTRAL, OFF, NEVER_SET])
@pytest.mark.parametrize("speed_mps", [3.0, -3.0])
def test_car_without_thrust_coasts_to_a_standstill(speed_mps, esc_duty):
    vehicle = rolling(speed_mps)
    drive(vehicle, 1, 5000, esc_duty)
    assert 2.0 < abs(vehicle.speed_mps) < 3.0
    drive(vehicle, 9, 5000, esc_duty)
    assert vehicle.speed_mps == 0.0 and vehicle.travel_m * speed_mps > 0
    stands = vehicle.pose, vehicle.travel_m
    assert drive(vehicle, 2, LEFT_DUTY, esc_duty) == []
    assert (vehicle.pose, vehicle.travel_m) == stands


def test_car_in_one_long_step_moves_on_the_exact_arc():
    vehicle = rolling(2.0, frictionless())
    vehicle.servo_duty, vehicle.steered_per_m = 4500.0, 0.5
    vehicle.step(S, 4500, NEUTRAL)  # 2 m on a circle of 2 m: 1 rad
    assert vehicle.pose == pytest.approx((2 * math.sin(1), 2 * (1 - math.cos(1)), 1.0))


@pytest.mark.parametrize("dt_ns", [MS, 20 * MS, 500 * MS])
def test_car_that_stops_within_a_step_stands_where_it_stopped(dt_ns):
    even = VehicleConfig(steering=PLAIN.steering, drive=DriveTrainConfig(drag_mps2=0.5, drag_per_s=0.0, drag_per_m=0.0))
    vehicle = rolling(1.0123, even)
    drive(vehicle, 3, 5000, NEUTRAL, dt_ns)
    assert vehicle.travel_m == pytest.approx(1.0123**2 / (2 * 0.5), abs=1e-9)
    assert vehicle.speed_mps == 0.0


def test_pulses_of_a_straight_come_every_15_millimetres_of_each_wheel():
    vehicle = rolling(1.0, frictionless())
    pulses = drive(vehicle, 10, 5000, NEUTRAL)
    for side in (LEFT, RIGHT):
        times_ns = [pulse.at_ns for pulse in pulses if pulse.side == side]
        assert len(times_ns) == pytest.approx(10 / (math.pi * 0.095 / 20), abs=1)
        spans_ns = [later - earlier for earlier, later in zip(times_ns, times_ns[1:])]
        assert max(spans_ns) - min(spans_ns) <= 2 and spans_ns[0] == pytest.approx(14_922_565, abs=2)
    assert {pulse.direction for pulse in pulses} == {FORWARD}


def test_play_in_the_steering_leaves_the_wheels_half_of_it_behind_on_either_way():
    vehicle = Vehicle(VehicleConfig(steering=replace(PLAIN.steering, backlash_duty=40.0)))
    drive(vehicle, 1.0, 5400, NEUTRAL)
    assert vehicle.curvature_per_m == pytest.approx(-0.380, abs=1e-4)
    drive(vehicle, 1.0, 5370, NEUTRAL)  # within the play: they don't follow at all
    assert vehicle.curvature_per_m == pytest.approx(-0.380, abs=1e-4)
    drive(vehicle, 1.0, 4600, NEUTRAL)
    drive(vehicle, 1.0, 5000, NEUTRAL)
    assert vehicle.curvature_per_m == pytest.approx(0.020, abs=1e-4)  # from the other side: as much too far left


def test_car_stands_on_a_slope_that_its_drag_holds_and_rolls_on_a_steeper_one():
    held, rolls, turned = (
        Vehicle(VehicleConfig(steering=PLAIN.steering, slope=slope, start=Pose(0, 0, yaw_rad)))
        for slope, yaw_rad in ((0.02, 0.0), (0.10, 0.0), (0.10, math.pi)))
    for vehicle in (held, rolls, turned):
        drive(vehicle, 1.0, CENTER, NEUTRAL)
    assert held.travel_m == 0.0 and rolls.travel_m < -0.1 and turned.travel_m == pytest.approx(-rolls.travel_m)


def circling(tyres, speed_mps, steering_duty=4500, seconds=0.3):
    """A frictionless car on a circle that its steering would make of 2 m radius."""
    vehicle = rolling(speed_mps, replace(frictionless(), tyres=tyres))
    drive(vehicle, seconds, steering_duty, NEUTRAL)
    return vehicle


def test_the_faster_it_is_the_wider_the_same_steering_turns_but_for_a_kinematic_car():
    slow, fast = circling(TyreConfig(), 0.5), circling(TyreConfig(), 3.0)
    assert 1 / slow.curvature_per_m == pytest.approx(2.0, rel=0.001)
    assert 1 / fast.curvature_per_m == pytest.approx(2.51, rel=0.01)
    assert fast.steered_per_m == slow.steered_per_m
    kinematic = circling(None, 20.0)
    assert kinematic.curvature_per_m == 0.5 and kinematic.rollovers.count == 0


def test_car_that_turns_too_fast_tips_over_and_is_counted_once():
    vehicle = circling(TyreConfig(understeer=0.0, rollover_mps2=6.0), 3.6)
    assert vehicle.rollovers.count == 1 and vehicle.rollovers.lateral_mps2 == pytest.approx(6.48, rel=0.01)
    assert circling(TyreConfig(understeer=0.0, rollover_mps2=6.0), 3.4).rollovers.count == 0


def test_a_brake_beyond_the_grip_locks_the_wheels_it_slides_straight_on_and_makes_no_pulses():
    config = replace(frictionless(), tyres=TyreConfig(grip_mps2=3.0))
    vehicle = rolling(4.0, config)
    drive(vehicle, 0.3, 4500, NEUTRAL)
    turning = vehicle.pose.yaw_rad
    pulses = drive(vehicle, 0.5, 4500, REVERSE)
    assert vehicle.slides and not pulses and vehicle.pose.yaw_rad == turning
    assert vehicle.speed_mps == pytest.approx(4.0 - 0.5 * 3.0, abs=0.01)
    drive(vehicle, 0.3, 4500, NEUTRAL)
    assert not vehicle.slides and vehicle.pose.yaw_rad > turning


@pytest.mark.parametrize("kind, name, value, accepted", [
    (SteeringConfig, "curve", ((4000, 1.0), (3900, 0.0)), "rising duty, falling 1/m"),
    (VehicleConfig, "track_m", 3.0, "inside the tightest turn"),
])
def test_impossible_config_is_refused(kind, name, value, accepted):
    with pytest.raises(ConfigError, match=f"{name} is .*; accepted: .*{accepted}"):
        kind(**{name: value})
