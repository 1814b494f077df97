"""A virtual car that is near a real one's calibration tables, whatever way its servo is built in."""
import pytest

from car_interface.common.errors import ConfigError
from car_interface.nodes.car_sim.config import steering_curve
from car_interface.sim.vehicle import SteeringConfig, Vehicle, VehicleConfig

RADII_M = [1, 2, 10, 300]
LEFT, RIGHT = [3800, 4200, 5000, 5100], [6700, 6200, 5300, 5100]
CENTER = 5100


def car(center, radii_m, left, right):
    return Vehicle(VehicleConfig(steering=SteeringConfig(curve=steering_curve(center, radii_m, left, right),
                                                         center_duty=center)))


@pytest.mark.parametrize(("left", "right"), [
    pytest.param(LEFT, RIGHT, id="left_by_less_duty"), pytest.param(RIGHT, LEFT, id="left_by_more_duty")])
def test_car_turns_nearly_as_its_tables_say_and_never_exactly(left, right):
    vehicle = car(CENTER, RADII_M, left, right)
    for radius_m, left_duty, right_duty in list(zip(RADII_M, left, right))[:3]:
        assert 1 / vehicle.true_curvature_per_m(left_duty) == pytest.approx(0.97 * radius_m)
        assert 1 / vehicle.true_curvature_per_m(right_duty) == pytest.approx(-1.03 * radius_m)
    assert vehicle.true_curvature_per_m(CENTER) == 0.0


def test_table_that_ends_in_equal_duties_gives_each_once():
    curve = steering_curve(CENTER, [1, 2, 3, 300], [3800, 3800, 4000, 5100], [6700, 6500, 6500, 5100])
    assert [duty for duty, _ in curve] == [3800, 4000, 5100, 6500, 6700]


@pytest.mark.parametrize(("left", "right", "accepted"), [
    ([3800], RIGHT, "three of the same length"), ([], [], "three of the same length"),
    (LEFT, LEFT, "left and right on different sides of the center")])
def test_tables_that_are_no_pair_of_sides_are_refused(left, right, accepted):
    with pytest.raises(ConfigError, match=f"steering tables is .*; accepted: .*{accepted}"):
        steering_curve(CENTER, RADII_M, left, right)
