"""obstacle_stop in random rooms, judged by room and car alone: a sample of ``python3 test/rooms``."""

import math
import os
import random

import pytest
from rooms import empty
from rooms.command_line import OTHERS_SHARE, verdict
from rooms.drive import Contact, Echo, Record, Sample, run
from rooms.judge import ECHO, LOST, NEVER, NONE, OTHER_ARC, RAN_AWAY, ROLLED, TURNED, judge
from rooms.room import Pose, Post, Room, Side
from rooms.scene import ESCS, Driver, Scene, random_scene

IS_ALL = bool(os.environ.get("CAR_INTERFACE_ALL"))
ROOMS, THIN_POSTS = (1000, 1000) if IS_ALL else (60, 30)


@pytest.mark.once
def test_car_is_no_faster_than_it_can_stop_for_what_gave_an_echo_on_its_arc():
    verdicts = [verdict(seed) for seed in range(ROOMS)]
    hits = [one for one in verdicts if one.is_collision]
    assert [one for one in hits if one.name == ECHO] == []
    others = [one for one in hits if one.name not in (ECHO, ROLLED)]
    assert len(others) <= OTHERS_SHARE * ROOMS, others
    assert sum(one.distance_m for one in verdicts) > ROOMS, "they hardly drive"


@pytest.mark.once
def test_most_cars_without_obstacle_stop_run_fast_into_something():
    verdicts = [verdict(seed, stops=False) for seed in range(10)]
    assert sum(one.speed_mps > 0.3 for one in verdicts) >= 7


@pytest.mark.once
def test_car_in_an_empty_room_is_not_slowed_more_than_its_fan_demands():
    named, baseline = empty.scenes(), empty.read_baseline()
    sample = named if IS_ALL else list(named)[::11]
    speeds = {name: (empty.mean_mps(named[name]), empty.wanted_mps(name, named[name], baseline)) for name in sample}
    assert {name: (mps, wanted_mps) for name, (mps, wanted_mps) in speeds.items() if mps < wanted_mps} == {}


def _thin_post(seed):
    """A thin post somewhere before a car that drives straight on; with or without a wall behind it."""
    rng = random.Random(seed)
    kind, wall_m = rng.choice(tuple(ESCS)), rng.choice((math.inf, 4.3))
    post = Post("post", rng.uniform(1.2, 2.2), rng.choice((-1, 1)) * rng.uniform(0.02, 0.19), rng.uniform(0.01, 0.05))
    room = Room((post,) if math.isinf(wall_m) else (post, Side("wall.0", wall_m, -4.0, wall_m, 4.0)))
    driver = Driver("planner", rng.choice((0.6, 1.5, 3.0)), False, rng.random() < 0.5, "straight", 0.0, 5.0)
    car = empty.CAR._replace(becomes_reverse=kind == "crawler")
    return Scene(seed, room, Pose(0.0, 0.0, 0.0), car, kind, driver, 4.0, rng.random() < 0.5, firing_s=0.065,
                 dropouts=0.0, noise_m=0.003, odometry_late_s=rng.choice((0.0, 0.02, 0.1)))


@pytest.mark.once
def test_a_thin_post_between_two_cones_is_not_forgotten():
    """Once it has slid out of a cone no sonar sees it: looks that find nothing there prove nothing."""
    verdicts = [judge(run(_thin_post(seed), drive_s=25.0)) for seed in range(THIN_POSTS)]
    assert [one for one in verdicts if one.is_collision] == []


def _drives_on_m(curvature_per_m, left_m):
    """How far a car gets once a post has gone that it had stopped for, 1.8 m ahead on its arc."""
    turn_rad = 1.8 * curvature_per_m
    ahead = (math.sin(turn_rad) / curvature_per_m, (1 - math.cos(turn_rad)) / curvature_per_m) if turn_rad else (1.8, 0)
    room = Room((Post("post", ahead[0], ahead[1] + left_m, 0.05),))
    driver = Driver("planner", 1.5, False, False, "arc", curvature_per_m, 5.0)
    record = run(Scene(0, room, Pose(0.0, 0.0, 0.0), empty.CAR, "measured", driver, 4.0, False, firing_s=0.065,
                       dropouts=0.0, noise_m=0.005, odometry_late_s=0.0, gone_s=8.0), drive_s=16.0)
    before = [sample for sample in record.samples if sample.at_s < 8.0]
    assert record.contact is None and before[-1].speed_mps < 0.1 and before[-1].pose.x_m > 0.5
    return sum(sample.speed_mps for sample in record.samples if sample.at_s >= 8.0) * 0.02


@pytest.mark.once
def test_most_cars_drive_on_once_what_they_stopped_for_has_gone():
    """In the others a place where it may have been is beside the cones (limits.md)."""
    ways_m = [_drives_on_m(curvature_per_m, left_m) for curvature_per_m in (0.0, 0.1, -0.2)
              for left_m in (-0.1, 0.0, 0.1)]
    assert sum(way_m > 1.0 for way_m in ways_m) >= 6, ways_m


SCENE = next(one for one in map(random_scene, range(1000)) if one.kind == "measured" and not one.car.slope)


def _record(echoes, curvatures=(0.0,) * 100, speed_mps=1.0, gravity_mps2=0.0, requests=(0.2,) * 100):
    """Two seconds up to a wall at x = 0."""
    samples = [Sample(number * 0.02, Pose((number - 100) * 0.02 * speed_mps, 0.0, 0.0), speed_mps, curvature,
                      curvature, request, gravity_mps2, "")
               for number, (curvature, request) in enumerate(zip(curvatures, requests))]
    contact = Contact(2.0, speed_mps, curvatures[-1], curvatures[-1], "wall.0", 0.0, 0.0, 0.426, 0.0)
    return Record(SCENE, samples, [Echo(at_s, "front_middle", 1.0, *rest) for at_s, *rest in echoes], contact, 2.0)


STEERS_LATE = (0.3,) * 90 + (0.0,) * 10


@pytest.mark.parametrize("record, name", [
    (_record([(0.5, "wall.0", 0.0, 0.2, False)]), ECHO),
    (_record([(0.5, "wall.0", 0.0, 0.2, False)], STEERS_LATE), OTHER_ARC),
    (_record([(1.9, "wall.0", 0.0, 0.2, False)], STEERS_LATE), TURNED),
    (_record([(1.9, "wall.0", 0.0, 0.2, False)], (0.3,) * 10 + (0.0,) * 90, 0.2), ECHO),
    (_record([(0.5, "wall.0", 0.0, 0.2, True)]), LOST),
    (_record([(0.5, "wall.0", 0.0, 0.3, False)]), NEVER),
    (_record([(0.5, "wall.1", 0.0, 0.0, False)]), NEVER),
    (_record([(0.5, "wall.0", 0.0, 0.0, False)], gravity_mps2=0.9, requests=(0.0,) * 100), ECHO),
    (Record(SCENE, [], [], None, 3.0), NONE),
], ids=["echo", "echo_before_it_steered", "too_late_to_stop", "early_enough_to_stop", "echo_lost",
        "echo_of_another_part_of_the_wall", "echo_of_another_wall", "fast_downhill_is_no_excuse", "no_contact"])
def test_collision_is_of_the_class(record, name):
    assert judge(record).name == name


def test_car_that_stood_and_was_not_pushed_since_has_rolled():
    record = _record([(0.5, "wall.0", 0.0, 0.0, False)], gravity_mps2=0.9, requests=(0.2,) * 10 + (0.0,) * 90)
    stood = [*record.samples]
    stood[50] = stood[50]._replace(speed_mps=0.0)
    slow = record.contact._replace(speed_mps=0.5)
    assert judge(record._replace(samples=stood, contact=slow)).name == ROLLED
    assert judge(record._replace(samples=stood)).name == RAN_AWAY
    level = [sample._replace(gravity_mps2=0.0) for sample in stood]
    assert judge(record._replace(samples=level)).name == ECHO
