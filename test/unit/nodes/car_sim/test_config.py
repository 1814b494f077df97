"""A virtual car that turns as a real one's calibration tables say, whatever way its servo is built in."""
from pathlib import Path

import pytest
import yaml

from car_interface.common.declared import read
from car_interface.common.errors import ConfigError
from car_interface.common.params import Params
from car_interface.nodes.car_sim.config import steering_curve
from car_interface.pca9685.registers import counts_of_duty, duty_of_counts
from car_interface.sim.vehicle import SteeringConfig, TyreConfig, Vehicle, VehicleConfig, path_curvature_per_m
from car_interface.steering.calibration import SteeringCalibration

DEMO = Path(__file__).parents[4] / "demo" / "turn_arb.yaml"
RADII_M = [1, 2, 10, 300]
LEFT, RIGHT = [3800, 4200, 5000, 5100], [6700, 6200, 5300, 5100]
CENTER = 5100


def car(center, radii_m, left, right):
    return Vehicle(VehicleConfig(steering=SteeringConfig(curve=steering_curve(center, radii_m, left, right),
                                                         center_duty=center)))


@pytest.mark.parametrize(("left", "right"), [
    pytest.param(LEFT, RIGHT, id="left_by_less_duty"), pytest.param(RIGHT, LEFT, id="left_by_more_duty")])
def test_car_turns_as_its_tables_say_between_their_radii_too(left, right):
    vehicle = car(CENTER, RADII_M, left, right)
    calibration = SteeringCalibration(left[0], CENTER, right[0], 0, RADII_M, left, right)
    for radius_m in (1.0, 1.5, 1.9, 2.0, 5.5, 10.0, 200.0):
        for wanted_m in (radius_m, -radius_m):
            driven_m = 1 / vehicle.true_curvature_per_m(calibration.planner_duty(wanted_m))
            assert driven_m == pytest.approx(wanted_m, rel=0.02)
    assert vehicle.true_curvature_per_m(CENTER) == 0.0


@pytest.mark.parametrize("speed_mps", [0.5, 1.0, 1.2])
def test_car_of_the_demo_turns_as_requested_within_2_percent_on_the_steps_of_the_servo_board(speed_mps):
    demo = {**yaml.safe_load(DEMO.read_text(encoding="utf-8")), "servo_channel": 0}
    calibration = read(Params(demo), SteeringCalibration)
    steered = car(calibration.servo_center, calibration.radius_axis_m, calibration.left_duties,
                  calibration.right_duties)
    for radius_m in (1.1, 1.35, 1.5, 1.6, 1.75, 2.0, 2.25, 2.5, 2.7, 3.0):
        for wanted_m in (radius_m, -radius_m):
            if radius_m < calibration.tightest_radius_m(wanted_m, speed_mps):
                continue
            duty = duty_of_counts(counts_of_duty(calibration.planner_duty(wanted_m, speed_mps)))
            driven_per_m = path_curvature_per_m(steered.true_curvature_per_m(duty), speed_mps, 0.0, TyreConfig())
            assert 1 / driven_per_m == pytest.approx(wanted_m, rel=0.02), duty


def test_table_that_ends_in_equal_duties_gives_each_once():
    curve = steering_curve(CENTER, [1, 2, 3, 300], [3800, 3800, 4000, 5100], [6700, 6500, 6500, 5100])
    duties = [duty for duty, _ in curve]
    assert {3800, 4000, 5100, 6500, 6700} < set(duties) and duties == sorted(set(duties))


@pytest.mark.parametrize(("left", "right", "accepted"), [
    ([3800], RIGHT, "three of the same length"), ([], [], "three of the same length"),
    (LEFT, LEFT, "left and right on different sides of the center")])
def test_tables_that_are_no_pair_of_sides_are_refused(left, right, accepted):
    with pytest.raises(ConfigError, match=f"steering tables is .*; accepted: .*{accepted}"):
        steering_curve(CENTER, RADII_M, left, right)
