"""What stops the virtual car: its outline against walls, boxes and posts."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from car_interface.sim.vehicle import ORIGIN, Pose, Vehicle, VehicleConfig
from car_interface.sim.world import Obstacles, World

MS, S = 1_000_000, 1_000_000_000
STRAIGHT, FORWARD, REVERSE = 5070, 5400, 4400
REAR_M, FRONT_M, WIDTH_M = 0.1, 0.5, 0.4
WALL_M = 2.0  # an endless one across x


def wall_ahead():
    return Obstacles([(WALL_M, -50.0, 0.0, 100.0)], [], REAR_M, FRONT_M, WIDTH_M)


def car_before(obstacles, start=ORIGIN):
    return Vehicle(VehicleConfig(start=start), 0, obstacles), obstacles


def drive(vehicle, seconds, esc_duty, steering_duty=STRAIGHT):
    pulses = []
    for _ in range(round(seconds * S / (2 * MS))):
        pulses += vehicle.step(2 * MS, steering_duty, esc_duty)
    return pulses


@pytest.mark.parametrize(("pose", "free"), [
    ((1.49, 0.0, 0.0), True), ((1.51, 0.0, 0.0), False),  # nose
    ((2.11, 0.0, 0.0), True), ((2.09, 0.0, 0.0), False),  # tail, from behind
    ((1.89, 0.0, math.pi), True), ((1.91, 0.0, math.pi), False),  # tail, backward
    ((1.79, 0.0, math.pi / 2), True), ((1.81, 0.0, math.pi / 2), False),  # side
    ((1.51, 0.0, math.radians(45)), False),  # only a corner
    ((1.50, 0.0, math.radians(80)), True),  # turned away
])
def test_outline_meets_a_wall_where_it_reaches(pose, free):
    assert wall_ahead().is_free(pose) is free


@pytest.mark.parametrize(("post", "free"), [
    ((0.65, 0.0, 0.1), True), ((0.59, 0.0, 0.1), False),  # before the nose
    ((0.2, 0.31, 0.1), True), ((0.2, 0.29, 0.1), False),  # beside it
    ((0.58, 0.28, 0.1), True), ((0.56, 0.26, 0.1), False),  # off the corner: 0.113 and 0.085 m from it
    ((0.2, 0.0, 0.01), False),  # below the car
])
def test_outline_meets_a_post_where_it_reaches(post, free):
    assert Obstacles([], [post], REAR_M, FRONT_M, WIDTH_M).is_free((0.0, 0.0, 0.0)) is free


@pytest.mark.once
@given(st.floats(-5.5, 5.5), st.floats(-4.5, 4.5), st.floats(-math.pi, math.pi), st.floats(-math.pi, math.pi),
       st.floats(0.0, 0.999))
def test_car_that_moves_less_than_its_clearance_touches_nothing(x_m, y_m, yaw_rad, direction_rad, ratio):
    obstacles = World()
    clear_m = obstacles.clearance_m((x_m, y_m, yaw_rad))
    if clear_m > 0:
        moved_m = ratio * clear_m
        assert obstacles.is_free((x_m + moved_m * math.cos(direction_rad), y_m + moved_m * math.sin(direction_rad),
                                  yaw_rad))


def test_car_that_runs_into_a_wall_stands_before_it_and_its_wheels_stall_until_it_drives_away():
    vehicle, obstacles = car_before(wall_ahead())
    drive(vehicle, 4, FORWARD)
    assert vehicle.pose.x_m == pytest.approx(WALL_M - FRONT_M, abs=0.005) and vehicle.speed_mps == 0.0
    assert vehicle.pose.x_m < WALL_M - FRONT_M
    assert obstacles.count == 1 and 1.0 < obstacles.speed_mps < 3.0
    assert drive(vehicle, 2, FORWARD) == []
    assert vehicle.travel_m == pytest.approx(math.hypot(vehicle.pose.x_m, vehicle.pose.y_m), rel=1e-3)
    assert drive(vehicle, 1, REVERSE) != [] and vehicle.speed_mps < -0.3
    assert obstacles.count == 1
    drive(vehicle, 6, FORWARD)
    assert obstacles.count == 2 and vehicle.speed_mps == 0.0


def test_car_that_runs_into_a_wall_backward_has_a_collision_of_negative_speed():
    vehicle, obstacles = car_before(wall_ahead(), Pose(WALL_M - 1.0, 0.0, math.pi))
    drive(vehicle, 4, REVERSE)
    assert vehicle.pose.x_m == pytest.approx(WALL_M - REAR_M, abs=0.005)
    assert obstacles.count == 1 and obstacles.speed_mps < -0.5
