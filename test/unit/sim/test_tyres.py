"""Tyres, against circles of a real car and the friction circle."""

import pytest

from car_interface.sim.vehicle import Rollovers, TyreConfig, path_curvature_per_m
from slash import SKIDPAD

FROM_HERE = [(angle, speed, radius) for angle, rows in SKIDPAD.items() for speed, radius in rows.items()]


@pytest.mark.parametrize(("angle", "speed_mps", "radius_m"), FROM_HERE)
def test_the_default_car_turns_as_the_measured_one(angle, speed_mps, radius_m):
    steered_per_m = 1 / SKIDPAD[angle][0.5]
    path_per_m = path_curvature_per_m(steered_per_m, speed_mps, 0.0, TyreConfig())
    assert 1 / path_per_m == pytest.approx(radius_m, rel=0.025)


@pytest.mark.parametrize("steered_per_m", [-1.0, -0.1, 0.0, 0.1, 1.0])
def test_at_a_crawl_the_path_is_where_the_steering_points(steered_per_m):
    assert path_curvature_per_m(steered_per_m, 0.0, 0.0, TyreConfig()) == steered_per_m
    assert path_curvature_per_m(steered_per_m, 0.2, 0.0, TyreConfig()) == pytest.approx(steered_per_m, rel=0.001)


def test_the_grip_is_shared_between_along_and_across():
    tyres = TyreConfig(understeer=0.0, grip_mps2=5.0)
    assert path_curvature_per_m(1.0, 5.0, 0.0, tyres) == pytest.approx(5.0 / 25)
    assert path_curvature_per_m(1.0, 5.0, -3.0, tyres) == pytest.approx(4.0 / 25)
    assert path_curvature_per_m(1.0, 5.0, 5.0, tyres) == 0.0


def test_a_rollover_counts_once_until_the_car_stands_again():
    rollovers = Rollovers(6.0)
    for lateral_mps2 in (5.9, 6.0, 6.5, 5.5, 6.2):
        rollovers.update(-lateral_mps2)
    assert (rollovers.count, rollovers.lateral_mps2) == (1, -6.5)
    for lateral_mps2 in (5.3, 6.1):
        rollovers.update(lateral_mps2)
    assert (rollovers.count, rollovers.lateral_mps2) == (2, 6.1)
