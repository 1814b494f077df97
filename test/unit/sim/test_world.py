"""What the simulated sonars hear, against distances that can be seen without a calculator."""

import math

import pytest

from car_interface.sim.world import Box, Pose, Post, World, WorldConfig

FRONT_RIGHT, FRONT, FRONT_LEFT, REAR_RIGHT, REAR, REAR_LEFT = range(6)
# All six sonars in the middle of the rear axle: distances are the pose's own.
CENTERED = tuple(Pose(0.0, 0.0, math.radians(yaw)) for yaw in (-30, 0, 30, -150, 180, 150))


def hall(boxes=(), posts=(), **config):
    """20 m by 20 m around the origin, and nothing in it that isn't asked for."""
    config = dict({"walls": Box(0, 0, 20, 20), "mounts": CENTERED, "temperature_c": 20.0}, **config)
    return World(WorldConfig(boxes=boxes, posts=posts, **config))


@pytest.mark.parametrize(("pose", "sensor", "distance_m"), [
    ((9.0, 0.0, 0.0), FRONT, 1.0), ((9.0, 0.0, math.pi), REAR, 1.0),
    ((0.0, 8.5, math.pi / 2), FRONT, 1.5), ((0.0, -8.5, -math.pi / 2), FRONT, 1.5),
    ((9.0, 0.0, math.radians(-30)), FRONT_LEFT, 1.0), ((9.0, 0.0, math.radians(30)), FRONT_RIGHT, 1.0),
    ((-9.0, 0.0, math.radians(30)), REAR_LEFT, 1.0), ((-9.0, 0.0, math.radians(-30)), REAR_RIGHT, 1.0),
    ((9.0, 0.0, math.radians(15)), FRONT, 1.0),  # the nearest edge of the cone
    ((5.9, 0.0, 0.0), FRONT, None),  # beyond four metres
])
def test_distance_to_a_wall(pose, sensor, distance_m):
    heard_m = hall().distance_m(pose, sensor)
    assert heard_m == (distance_m and pytest.approx(distance_m))


@pytest.mark.parametrize(("boxes", "posts", "distance_m"), [
    pytest.param((Box(1.5, 0.0, 1.0, 1.0),), (), 1.0, id="box_ahead"),
    pytest.param((Box(1.5, 0.0, 1.0, 1.0, math.pi / 4),), (), 1.5 - math.sqrt(0.5), id="box_on_its_corner"),
    pytest.param((), (Post(1.5, 0.0, 0.25),), 1.25, id="post_ahead"),
    pytest.param((Box(1.5, 0.0, 0.2, 0.2),), (Post(1.0, 0.0, 0.1),), 0.9, id="the_nearer_one"),
    pytest.param((Box(-1.5, 0.0, 1.0, 1.0),), (Post(-1.0, 0.0, 0.25),), None, id="behind_its_back"),
    pytest.param((), (Post(1.5 * math.cos(0.244), 1.5 * math.sin(0.244), 0.04),), 1.47, id="14_degrees_to_the_left"),
    pytest.param((), (Post(1.5 * math.cos(0.297), 1.5 * math.sin(0.297), 0.04),), None, id="17_degrees_to_the_left"),
    pytest.param((), (Post(0.0, 0.0, 0.25),), 0.0, id="inside_a_post"),
])
def test_distance_to_an_obstacle(boxes, posts, distance_m):
    heard_m = hall(boxes, posts).distance_m((0.0, 0.0, 0.0), FRONT)
    assert heard_m == (distance_m if distance_m is None else pytest.approx(distance_m, abs=0.005))


@pytest.mark.parametrize(("temperature_c", "echo_us"), [(20.0, 5824), (40.0, 5625)])
def test_echo_of_a_metre_is_there_and_back_at_the_speed_of_sound(temperature_c, echo_us):
    assert hall(temperature_c=temperature_c).echo_us((9.0, 0.0, 0.0), FRONT) == echo_us


def test_echo_from_beyond_four_metres_is_zero_and_any_other_is_not():
    assert hall().echo_us((5.99, 0.0, 0.0), FRONT) == 0
    assert hall().echo_us((6.01, 0.0, 0.0), FRONT) > 23_000
    assert hall(posts=(Post(0.0, 0.0, 1.0),)).echo_us((0.0, 0.0, 0.0), FRONT) == 1  # what touches isn't, either
