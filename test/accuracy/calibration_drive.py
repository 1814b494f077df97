#!/usr/bin/env python3
"""How well a car calibrates its own steering while a person holds a button: random virtual cars.

    PYTHONPATH=src:test python3 -m accuracy.calibration_drive

The same cars as in steering_calibration, here with an ESC of some kind and with tyres, half of them in a room of
6 × 6 m whose walls their sonars see. Between the drive and the car are the real arbiters, speed control, converter,
Teensy and odometry. A person lets the button go at random for a random time, and sometimes pushes the car back to
the middle meanwhile, also where the drive asks for it. The fit answers late, as on a slow computer.

With --releases the button is let go for good at regular moments, too, each time in a copy of the whole, which rolls
until it stands: whether it stays inside whenever a person lets go.

Judged by the vehicle alone: where its corners were, what it ran into; and by turn_arb's core with the table that was
written, as in steering_calibration.
"""
from __future__ import annotations

import argparse
import math
import multiprocessing
import random
import sys
import tempfile
from collections import deque
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple
from unittest.mock import Mock

import numpy as np
import virtual_escs
from many_drives import THROTTLE, Chip

from accuracy.steering_calibration import Errors, ask, asked_for, beyond, floor, line, meets, together
from accuracy.virtual_drive import NS_PER_MS, NS_PER_S, START_NS, Hub, count_duty, random_car
from car_interface.common.causes import AUTONOMOUS
from car_interface.common.vehicle_geometry import SONARS
from car_interface.interlock.motion_interlock import InterlockConfig
from car_interface.planner.messages import PlannerRequest
from car_interface.sim.vehicle import Pose, TyreConfig, Vehicle, VehicleConfig
from car_interface.sim.world import Box, World, WorldConfig
from car_interface.steering.arbiter import SteeringArbiter, SteeringArbiterConfig
from car_interface.steering.calibration import SteeringCalibration, trimmed
from car_interface.steering.config import load_steering
from car_interface.teensy.link.protocol import WheelStatus
from car_interface.throttle.arbiter import ThrottleArbiterConfig
from car_interface.throttle.control import ThrottleControl
from car_interface.throttle.converter import Converter, ConverterConfig
from car_interface.throttle.esc_config import UNVERIFIED, EscConfig
from car_interface.throttle.limits import ThrottleLimits
from car_interface.throttle.obstacle_stop import Mount, ObstacleConfig
from car_interface.throttle.speed_control import SpeedControl
from car_interface.throttle.value_map import load_value_map
from car_interface.tools.calibration.drive.calibration_drive import CalibrationDrive
from car_interface.tools.calibration.drive.conclusion import Conclusion, conclude
from car_interface.tools.calibration.drive.config import CalibrationDriveConfig
from car_interface.tools.calibration.drive.grant import SLOWS
from car_interface.tools.calibration.drive.knowledge import assess
from car_interface.tools.calibration.drive.survey import BLOCKED, DONE, PAUSED, Step

CONFIG = Path(__file__).resolve().parents[2] / "config"
STOCK, MAP = CONFIG / "turn_arb.yaml", CONFIG / "value_map.csv"
STEP_NS, TICK_NS = 5 * NS_PER_MS, 20 * NS_PER_MS
HALF_M = 3.0  # of the area
MAX_S = 900.0  # of the whole, with all its pauses
QUICK_FIT_NS, FULL_FIT_NS = 400 * NS_PER_MS, 3000 * NS_PER_MS
MAKES = (virtual_escs.xl5, virtual_escs.vxl, virtual_escs.crawler, virtual_escs.direct, virtual_escs.race)
PUSHED_MPS = 0.7
ROLLS_S, STANDS_MPS = 20.0, 0.02
MAX_RANGE_M = 2.0  # of its sonars, as sonars.yaml has it
PLACES_PER_M = 1.25  # half a circle to the left leaves the middle 1.6 m to the left


class Sonars:
    """Six sonars that fire one after another: the next when this one's echo came, or after 38 ms, and 30 ms later."""

    def __init__(self, rng, world):
        self._rng, self._world = rng, world
        self._index, self._next_ns = rng.randrange(len(SONARS)), 0
        self._reports = deque()

    def step(self, pose, now_ns):
        """The ranges that arrive now, by name."""
        if now_ns >= self._next_ns:
            sensor = self._index
            self._index = (self._index + 1) % len(SONARS)
            distance_m = self._world.distance_m(pose, sensor)
            flight_ns = 38 * NS_PER_MS if distance_m is None else round(2e9 * distance_m / 343)
            range_m = math.inf if distance_m is None or distance_m > MAX_RANGE_M else max(
                0.0, distance_m + self._rng.gauss(0, 0.005))
            self._next_ns = now_ns + flight_ns + 30 * NS_PER_MS
            late_ns = round(self._rng.uniform(2, 12)) * NS_PER_MS
            self._reports.append((now_ns + flight_ns + late_ns, SONARS[sensor], range_m))
        arrived = []
        while self._reports and self._reports[0][0] <= now_ns:
            arrived.append(self._reports.popleft()[1:])
        return arrived


class Car(NamedTuple):
    """A car, what its files say of it, and where it is."""

    vehicle: VehicleConfig
    base: SteeringCalibration
    esc: EscConfig
    world: WorldConfig | None


class Result(NamedTuple):
    seed: int
    conclusion: Conclusion
    held_s: float
    max_m: float  # the farthest that any corner was from the middle of the area, along x or y
    extent_m: float  # the same from the start, in a straight line
    collisions: int


class Release(NamedTuple):
    """What a car did after the button had been let go for good."""

    distance_m: float
    extent_m: float  # as of a Result
    max_m: float
    hit_mps: float | None  # the speed at which it ran into something
    took_s: float


def driving_car(seed: int) -> Car:
    """The car of that seed, with its ESC, its tyres and its room; its owner found ends and center roughly."""
    rng = random.Random(f"calibration drive {seed}")
    car = random_car(seed)
    duties = [duty for duty, _ in car.steering.curve]
    middle = next(duty for (duty, k), (_, after) in zip(car.steering.curve, car.steering.curve[1:]) if k >= 0 >= after)
    left, right = duties[0] - rng.uniform(-20, 40), duties[-1] + rng.uniform(-20, 40)
    base = trimmed(load_steering(str(STOCK)), round(left), round(middle + rng.uniform(-60, 60)), round(right))
    make = rng.choice(MAKES)
    virtual_esc = make(neutral_duty=car.drive.neutral_duty, forward_band_duty=rng.uniform(60, 110),
                       reverse_band_duty=rng.uniform(60, 110), dwell_s=rng.uniform(0.1, 0.4))
    profile = rng.choice((UNVERIFIED, virtual_esc.kind))
    esc = EscConfig(profile=profile, profile_measured=profile != UNVERIFIED, drag_deceleration_mps2=0.25)
    tyres = TyreConfig(understeer=rng.uniform(0.0, 0.012), grip_mps2=rng.uniform(5.0, 9.0))
    steering = replace(car.steering, lag_s=rng.uniform(0.04, 0.18))
    vehicle = replace(car, esc=virtual_esc, tyres=tyres, steering=steering, start=Pose(
        rng.uniform(-0.1, 0.1) - 0.14, rng.uniform(-0.1, 0.1), rng.uniform(-0.3, 0.3)))
    walls = Box(0.0, 0.0, 2 * HALF_M, 2 * HALF_M)
    world = WorldConfig(walls=walls, boxes=(), posts=(), rays=13) if seed % 2 else None
    return Car(vehicle, base, esc, world)


class Person:
    """Who holds the button, lets it go now and then, and pushes the car back."""

    push_ratio = 0.3  # of the releases, after which the car is pushed back though nothing asks for that

    def __init__(self, rng):
        self._rng = rng
        self.holds = False
        self._until_s = 1.6  # the ESC is armed meanwhile
        self._blocked_s = 0.0
        self.pushes = self._wants_push = False
        self._side = 0.0  # where the middle is to lie, if that was asked for: 1 = to the left, −1 = to the right
        self._places = False  # from the middle half round, so that it lies there

    def step(self, now_s, car: Vehicle, phase, text):
        self._blocked_s = self._blocked_s + 0.02 if phase == BLOCKED else 0.0
        if phase == BLOCKED:
            self._side = 1.0 if "to its left" in text else -1.0 if "to its right" in text else 0.0
        if self.pushes:
            is_there = not self._places and math.hypot(car.pose.x_m, car.pose.y_m) < 0.5
            if self._side and is_there:
                self._places, self._until_s = True, now_s + math.pi / PLACES_PER_M / PUSHED_MPS
            elif now_s > self._until_s or is_there:
                self._release(now_s, 1.0)
        elif self.holds and (now_s > self._until_s or self._blocked_s > 1.5):
            self._wants_push = self._blocked_s > 1.5 or self._rng.random() < self.push_ratio
            self._release(now_s, self._rng.choice((0.15, 0.6, 2.0, 5.0)))
        elif not self.holds and now_s > self._until_s:
            self.pushes, self._wants_push = self._wants_push and not self.pushes, False
            self.holds = not self.pushes
            self._until_s = now_s + (6.0 if self.pushes else self._rng.uniform(8.0, 60.0))

    def _release(self, now_s, for_s):
        if self._places:
            self._side = 0.0
        self.holds = self.pushes = self._places = False
        self._until_s = now_s + for_s

    def push(self, car: Vehicle):
        """Push the car towards the middle, forward or backward, lifting its front round: (m/s, 1/m)."""
        if self._places:
            return PUSHED_MPS, PLACES_PER_M * self._side
        x_m, y_m, yaw_rad = car.pose
        off_rad = math.remainder(math.atan2(-y_m, -x_m) - yaw_rad, 2 * math.pi)
        speed_mps = PUSHED_MPS
        if abs(off_rad) > math.pi / 2:
            off_rad, speed_mps = math.remainder(off_rad + math.pi, 2 * math.pi), -PUSHED_MPS
        return speed_mps, math.copysign(1.0, speed_mps) * max(-2.0, min(2.0, 2.0 * off_rad))


class Bench:
    """The car, its chain and the drive."""

    def __init__(self, seed: int, trace=None, person=None):
        self._seed, self.car = seed, driving_car(seed)
        car = self.car
        self._rng = rng = random.Random(f"drive {seed}")
        self._trace = trace
        self._world = None if car.world is None else World(car.world)
        self.vehicle = Vehicle(car.vehicle, START_NS, self._world)
        self._sonars = None if self._world is None else Sonars(rng, self._world)
        mounts = {name: Mount(mount.x_m, mount.y_m, mount.yaw_rad) for name, mount in zip(SONARS, WorldConfig().mounts)}
        config = CalibrationDriveConfig(
            radius_m=HALF_M, obstacles=ObstacleConfig(mounts if self._world else {}, math.radians(30), 2.0))
        self.drive = CalibrationDrive(car.base, config)
        interlock = InterlockConfig(grant_at_start=False)
        self._steering = SteeringArbiter(car.base, SteeringArbiterConfig(interlock=interlock))
        self._throttle = ThrottleControl(
            THROTTLE, ThrottleArbiterConfig(interlock=interlock), car.esc, ThrottleLimits())
        self._speed = SpeedControl()
        self._converter = Converter(ConverterConfig(value_map=load_value_map(str(MAP))))
        self.person = person or Person(rng)
        noise = np.random.default_rng(rng.randrange(1 << 30))
        self._hub = Hub(car.vehicle, rng, noise)
        self._odom, self._odom_ns = None, START_NS
        self._held = None
        self._chip = Chip(rng, car.base.servo_center, START_NS)
        self._duties = [car.base.servo_center, THROTTLE.neutral]
        self._due = deque()  # (time, knowledge)
        self._step = None
        self._tick_ns = START_NS
        self._max_m = self._extent_m = 0.0
        x_m, y_m, yaw_rad = car.vehicle.start
        self.start = x_m + 0.142 * math.cos(yaw_rad), y_m + 0.142 * math.sin(yaw_rad)  # the car's middle

    def run(self, max_s: float = MAX_S) -> Result:
        end_ns = START_NS + round(max_s * NS_PER_S)
        while self.vehicle.time_ns < end_ns and not (self._step is not None and self._step.phase == DONE):
            self._advance()
        base_text = STOCK.read_text(encoding="utf-8")
        conclusion = conclude(self.drive.samples.drive(), self.car.base, base_text, "calibration drive")
        return Result(self._seed, conclusion, self.drive.driven_s, self._max_m, self._extent_m,
                      self._world.count if self._world else 0)

    def _advance(self):
        now_ns = self.vehicle.time_ns
        self._hear(now_ns)
        if now_ns >= self._tick_ns:
            self._tick_ns += TICK_NS
            self._tick(now_ns)
        duties = self._chip.duties(now_ns)
        pulses = self._push() if self.person.pushes else self.vehicle.step(STEP_NS, *duties)
        now_ns = self.vehicle.time_ns
        self._hub.roll(pulses, self.vehicle.speed_mps, now_ns)

    def let_go(self) -> Release:
        """What happens if the button is let go now, for good; this bench goes on as if it had not been."""
        fork = multiprocessing.get_context("fork")  # the virtual firmware can't be copied otherwise
        answer, sends = fork.Pipe(duplex=False)
        child = fork.Process(target=lambda: sends.send(self._roll()))
        child.start()
        sends.close()
        release = answer.recv()
        child.join()
        return release

    def _roll(self):
        self.drive = Mock(**{"step.return_value": Step(None, 0.0, PAUSED, ""), "take_fit_task.return_value": None})
        self.person, self._trace = Mock(holds=False, pushes=False), None
        self._max_m = self._extent_m = 0.0
        vehicle, collisions = self.vehicle, self._world
        begin_ns, travel_m = vehicle.time_ns, vehicle.travel_m
        hits = collisions.count if collisions else 0
        while vehicle.time_ns < begin_ns + ROLLS_S * NS_PER_S and abs(vehicle.speed_mps) > STANDS_MPS:
            self._advance()
        self._judge()
        hit_mps = collisions.speed_mps if collisions and collisions.count > hits else None
        return Release(vehicle.travel_m - travel_m, self._extent_m, self._max_m, hit_mps,
                       (vehicle.time_ns - begin_ns) / NS_PER_S)

    def _push(self):
        """A step in which the person moves the car, whose wheels roll."""
        vehicle, dt_s = self.vehicle, STEP_NS / NS_PER_S
        vehicle.speed_mps, curvature = self.person.push(vehicle)
        pose = vehicle._pose_after(vehicle.speed_mps * dt_s, curvature)
        vehicle.time_ns += STEP_NS
        if self._world is not None and not self._world.is_free(pose):
            vehicle.speed_mps, curvature = -PUSHED_MPS, 0.0  # first straight back
            pose = vehicle._pose_after(vehicle.speed_mps * dt_s, curvature)
        vehicle.pose = pose
        return vehicle._roll(vehicle.speed_mps * dt_s, dt_s, vehicle.speed_mps, curvature)

    def _hear(self, now_ns):
        for record, measured in self._hub.step(now_ns):
            if isinstance(record, WheelStatus):
                self._odom = measured or self._odom
        if self._odom is not None and now_ns >= self._odom_ns:
            motion, self._odom_ns = self._odom.motion, now_ns + TICK_NS
            self.drive.update_odometry(motion.x_m, motion.y_m, motion.yaw_rad, motion.speed_mps,
                                       self._odom.stamp.time_ns, now_ns)
            for update in (self._steering.limiter.speed.update, self._throttle.update_odometry,
                           self._speed.speed.update, self._converter.odometry.update):
                update(motion.speed_mps, now_ns, 0)
            self._odom = None
        if self._sonars is not None:
            for name, range_m in self._sonars.step(self.vehicle.pose, now_ns - START_NS):
                self.drive.update_range(name, range_m, now_ns)

    def _tick(self, now_ns):
        person, drive = self.person, self.drive
        person.step((now_ns - START_NS) / NS_PER_S, self.vehicle, self._step.phase if self._step else "",
                    self._step.text if self._step else "")
        self._fit(now_ns)
        self._step = step = drive.step(now_ns, "" if person.holds else "nobody holds it")
        self._arbitrate(step, now_ns)
        self._judge()
        if self._trace:
            self._trace(now_ns, self, step)

    def _arbitrate(self, step, now_ns):
        """From the request to the duties on the chip."""
        person, throttle, steering = self.person, self._throttle, self._steering
        for arbiter in (steering, throttle.arbiter):
            arbiter.update_human(person.holds, now_ns)
        throttle.arbiter.update_mode(AUTONOMOUS, now_ns)
        steering.update_teleop(0.0, now_ns)
        throttle.arbiter.update_teleop(0.0, now_ns)
        if step.steering is not None:
            steering.update_planner_steering(step.steering, now_ns)
            command = self._speed.step(PlannerRequest(None, step.speed_mps), now_ns)
            throttle.arbiter.update_planner_state(command.gear, None, now_ns)
            converted = self._converter.convert(command.acceleration_mps2, now_ns)
            if converted.value is not None:
                throttle.update_planner(converted.value, now_ns)
        decision = steering.decide(now_ns)
        throttle.arbiter.update_steering(decision.source, decision.reason, now_ns)
        throttle.update_turn(steering.turn_radius_m(decision.duty), decision.max_speed_mps)
        made = throttle.decide(now_ns)
        arbitration = made.arbitration
        self.drive.is_slowed = made.esc.state in SLOWS
        self._speed.update_throttle(arbitration.source, arbitration.asked, made.esc.fraction, made.esc.cause, now_ns)
        throttle.update_output([-1, made.duty, *[-1] * 14], now_ns)
        duties = [count_duty(decision.duty), count_duty(made.duty)]
        if duties != self._duties:
            self._duties = duties
            self._chip.command(*duties, now_ns)
        if duties[0] != self._held or now_ns % (100 * NS_PER_MS) < TICK_NS:
            self._held = duties[0]
            self.drive.update_duty(duties[0], now_ns + 2 * NS_PER_MS)

    def _fit(self, now_ns):
        task = self.drive.take_fit_task()
        if task is not None:
            self._due.append((now_ns + (FULL_FIT_NS if task[1].delay is None else QUICK_FIT_NS), assess(*task)))
        while self._due and self._due[0][0] <= now_ns:
            self.drive.update_knowledge(self._due.popleft()[1], now_ns)

    def _judge(self):
        if self.person.pushes:
            return
        x_m, y_m, yaw_rad = self.vehicle.pose
        cos_yaw, sin_yaw = math.cos(yaw_rad), math.sin(yaw_rad)
        start = self.start
        for ahead, left in ((0.426, 0.148), (0.426, -0.148), (-0.142, 0.148), (-0.142, -0.148)):
            at = (x_m + ahead * cos_yaw - left * sin_yaw, y_m + ahead * sin_yaw + left * cos_yaw)
            self._max_m = max(self._max_m, abs(at[0]), abs(at[1]))
            self._extent_m = max(self._extent_m, math.hypot(at[0] - start[0], at[1] - start[1]))


class Releases:
    """A trace that lets the button go at regular moments while the car is driven, each time in a copy."""

    def __init__(self, every_s: float):
        self._found: list[Release] = []
        self._every_ns = round(every_s * NS_PER_S)
        self._next_ns = 0

    def __call__(self, now_ns, bench, step):
        if now_ns >= self._next_ns and step.steering is not None and bench.vehicle.speed_mps > STANDS_MPS:
            self._next_ns = now_ns + self._every_ns
            self._found.append(bench.let_go())

    def text(self) -> str:
        found = self._found
        if not found:
            return "never let go"
        out_m = [one.extent_m - HALF_M for one in found if one.extent_m > HALF_M]
        hits_mps = [one.hit_mps for one in found if one.hit_mps is not None]
        return (f"let go {len(found)} times: {len(out_m)} leave {HALF_M:g} m, "
                f"by {max(out_m, default=0.0):.2f} m at most ({max(one.max_m for one in found):.2f} m along x or y); "
                f"{len(hits_mps)} hit a wall, at {max(hits_mps, default=0.0):.2f} m/s at most; "
                f"rolls {max(one.distance_m for one in found):.2f} m, {max(one.took_s for one in found):.1f} s at most")


def errors(car: Car, yaml_text: str) -> tuple[Errors, Errors]:
    """(of the table, of the board's nearest count alone), for what the car can turn between its ends."""
    with tempfile.NamedTemporaryFile("w", suffix=".yaml") as file:
        file.write(yaml_text)
        file.flush()
        table = load_steering(file.name)
    duties, curvatures = zip(*car.vehicle.steering.curve)
    turns = asked_for(*(float(np.interp(count_duty(end), duties, curvatures)) for end in
                        (car.base.servo_left, car.base.servo_right)))
    return ask(car.vehicle, *turns, table.planner_duty), floor(car.vehicle, *turns)


def row(result: Result, pair: tuple[Errors, Errors] | None) -> str:
    """A line of the table; the errors are those of ``errors``, ``None`` = nothing was written."""
    kind = "slash" if result.seed % 4 == 3 else "smooth"
    figures = result.conclusion.refusal[:150] if pair is None else line("", beyond(*pair), *pair)
    return (f"{result.seed:5d} {kind:6} {'walls' if driving_car(result.seed).world else '     '} | "
            f"{result.held_s:4.0f} s | {result.max_m:4.2f} {result.extent_m:4.2f} {result.collisions}{figures}")


def is_good(result: Result, pair: tuple[Errors, Errors] | None) -> bool:
    """Whether a drive is what is asked of it, its table by the bounds of steering_calibration."""
    return (pair is not None and result.held_s <= 300.1 and result.max_m <= HALF_M and not result.collisions
            and meets(*pair))


def judge(seed: int, trace=None) -> tuple[Result, tuple[Errors, Errors] | None]:
    """Let one car drive: the result, and the errors of its table."""
    result = Bench(seed, trace).run()
    text = result.conclusion.yaml_text
    return result, errors(driving_car(seed), text) if text else None


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cars", type=int, default=20)
    parser.add_argument("--first", type=int, default=0, metavar="SEED")
    parser.add_argument("--releases", type=float, metavar="EVERY_S")
    options = parser.parse_args()
    print("  car              | held   | max_x ext col      "
          " | radius, %: beyond | calibrated    | floor: count  | curvature, 1/m: the same")
    judged = []
    for seed in range(options.first, options.first + options.cars):
        releases = None if options.releases is None else Releases(options.releases)
        judged.append(judge(seed, releases))
        print(row(*judged[-1]), "" if is_good(*judged[-1]) else " missed", flush=True)
        if releases is not None:
            print("     ", releases.text(), flush=True)
    pairs = [pair for _, pair in judged if pair is not None]
    if pairs:
        made, best = map(together, zip(*pairs))
        print(line("all written", beyond(made, best), made, best))
    results, good = [result for result, _ in judged], sum(is_good(*one) for one in judged)
    print(f"{len(pairs)} of {len(judged)} written, {good} as is asked for; "
          f"{sum(result.collisions for result in results)} collisions, {max(result.max_m for result in results):.2f} m "
          f"from the middle at most, {max(result.held_s for result in results):.0f} s of held button at most")
    return int(good < len(judged))


if __name__ == "__main__":
    sys.exit(main())
