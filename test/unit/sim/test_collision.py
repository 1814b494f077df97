"""What stops the virtual car: its outline against walls, boxes and posts."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from car_interface.common.vehicle_geometry import FRONT_M, REAR_M, WIDTH_M
from car_interface.sim.vehicle import ORIGIN, Pose, Vehicle, VehicleConfig
from car_interface.sim.world import Box, Post, World, WorldConfig

MS, S = 1_000_000, 1_000_000_000
STRAIGHT, FORWARD, REVERSE = 5070, 5400, 4400
SIDE_M = WIDTH_M / 2
WALL_M = 2.0  # an endless one across x
FAR = Box(0.0, 0.0, 100.0, 100.0)


def wall_ahead():
    return World(WorldConfig(walls=Box(WALL_M - 50.0, 0.0, 100.0, 100.0), boxes=(), posts=()))


def car_before(world, start=ORIGIN):
    return Vehicle(VehicleConfig(start=start), 0, world), world


def drive(vehicle, seconds, esc_duty, steering_duty=STRAIGHT):
    pulses = []
    for _ in range(round(seconds * S / (2 * MS))):
        pulses += vehicle.step(2 * MS, steering_duty, esc_duty)
    return pulses


@pytest.mark.parametrize(("pose", "free"), [
    ((WALL_M - FRONT_M - 0.01, 0.0, 0.0), True), ((WALL_M - FRONT_M + 0.01, 0.0, 0.0), False),  # nose
    ((WALL_M + REAR_M + 0.01, 0.0, 0.0), True), ((WALL_M + REAR_M - 0.01, 0.0, 0.0), False),  # tail, from behind
    ((WALL_M - REAR_M - 0.01, 0.0, math.pi), True), ((WALL_M - REAR_M + 0.01, 0.0, math.pi), False),  # tail, backward
    ((WALL_M - SIDE_M - 0.01, 0.0, math.pi / 2), True), ((WALL_M - SIDE_M + 0.01, 0.0, math.pi / 2), False),  # side
    ((WALL_M - 0.40, 0.0, math.radians(45)), False),  # only a corner, which is 0.406 m ahead
    ((WALL_M - FRONT_M + 0.01, 0.0, math.radians(80)), True),  # turned away
])
def test_outline_meets_a_wall_where_it_reaches(pose, free):
    assert wall_ahead().is_free(pose) is free


@pytest.mark.parametrize(("post", "free"), [
    ((FRONT_M + 0.15, 0.0, 0.1), True), ((FRONT_M + 0.09, 0.0, 0.1), False),  # before the nose
    ((0.2, SIDE_M + 0.11, 0.1), True), ((0.2, SIDE_M + 0.09, 0.1), False),  # beside it
    ((FRONT_M + 0.08, SIDE_M + 0.08, 0.1), True),  # off the corner: 0.113 m from it
    ((FRONT_M + 0.06, SIDE_M + 0.06, 0.1), False),  # 0.085 m
    ((0.2, 0.0, 0.01), False),  # below the car
])
def test_outline_meets_a_post_where_it_reaches(post, free):
    world = World(WorldConfig(walls=FAR, boxes=(), posts=(Post(*post),)))
    assert world.is_free((0.0, 0.0, 0.0)) is free


@pytest.mark.once
@given(st.floats(-5.5, 5.5), st.floats(-4.5, 4.5), st.floats(-math.pi, math.pi), st.floats(-math.pi, math.pi),
       st.floats(0.0, 0.999))
def test_car_that_moves_less_than_its_clearance_touches_nothing(x_m, y_m, yaw_rad, direction_rad, ratio):
    world = World()
    clear_m = world.clearance_m((x_m, y_m, yaw_rad))
    if clear_m > 0:
        moved_m = ratio * clear_m
        assert world.is_free((x_m + moved_m * math.cos(direction_rad), y_m + moved_m * math.sin(direction_rad),
                                  yaw_rad))


def test_car_that_runs_into_a_wall_stands_before_it_and_its_wheels_stall_until_it_drives_away():
    vehicle, world = car_before(wall_ahead())
    drive(vehicle, 4, FORWARD)
    assert vehicle.pose.x_m == pytest.approx(WALL_M - FRONT_M, abs=0.005) and vehicle.speed_mps == 0.0
    assert vehicle.pose.x_m < WALL_M - FRONT_M
    assert world.count == 1 and 1.0 < world.speed_mps < 3.0
    assert drive(vehicle, 2, FORWARD) == []
    assert vehicle.travel_m == pytest.approx(math.hypot(vehicle.pose.x_m, vehicle.pose.y_m), rel=1e-3)
    assert drive(vehicle, 1, REVERSE) != [] and vehicle.speed_mps < -0.3
    assert world.count == 1
    drive(vehicle, 6, FORWARD)
    assert world.count == 2 and vehicle.speed_mps == 0.0


def test_car_that_runs_into_a_wall_backward_has_a_collision_of_negative_speed():
    vehicle, world = car_before(wall_ahead(), Pose(WALL_M - 1.0, 0.0, math.pi))
    drive(vehicle, 4, REVERSE)
    assert vehicle.pose.x_m == pytest.approx(WALL_M - REAR_M, abs=0.005)
    assert world.count == 1 and world.speed_mps < -0.5
