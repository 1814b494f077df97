"""A drive of one scene: the product's throttle, asked as its node would, on this car in this room.

Of the product it knows ``ThrottleControl`` and its configurations. Between them and the car are a servo board, six
sonars that fire one after another, and odometry that comes late with its true age.
"""
from __future__ import annotations

import math
import random
from collections import deque
from typing import NamedTuple

from car_interface.throttle.arbiter import PLANNER, TELEOP, ThrottleArbiterConfig
from car_interface.throttle.calibration import ThrottleCalibration
from car_interface.throttle.control import ThrottleControl
from car_interface.throttle.obstacle_stop import Mount, ObstacleConfig

from .car import Car
from .room import Pose
from .scene import ALL_IN_TURN, FIELD_OF_VIEW_RAD, MIN_RANGE_M, MOSTLY_AHEAD, MOUNTS, OUTLINE, SONARS, Scene

MS, S = 1_000_000, 1_000_000_000
STEP_NS = 5 * MS
STEP_S = STEP_NS / S
TICK_STEPS = 4  # 20 ms: the arbiters, odometry, and a pulse for the ESC
NEUTRAL = 4915
THROTTLE = ThrottleCalibration(  # config/throttle.yaml
    channel=1, value_axis=[-5.0, 0.0, 3.0], duty_table=[3277, NEUTRAL, 6554], neutral=NEUTRAL)
LATERAL_MPS2 = 4.0  # turn_arb widens what is tighter at the measured speed
SOUND_MPS = 343.0
HELD_S, BEGINS_S = 0.4, 1.6  # when the deadman is held, and when the driver begins
DRIVE_S = 13.0
STOOD_S = 4.0  # a car that stands for so long is done


class Echo(NamedTuple):
    """What one sonar's pulse met."""

    at_s: float
    sonar: str
    range_m: float  # the true one
    name: str
    x_m: float
    y_m: float
    is_lost: bool  # there was an echo, which the car did not get


class Sample(NamedTuple):
    """The car, every 20 ms."""

    at_s: float
    pose: Pose
    speed_mps: float
    curvature_per_m: float
    wanted_per_m: float
    request: float  # of the duty that the arbiter gives
    gravity_mps2: float
    limit: str


class Contact(NamedTuple):
    """What the car touched first, and how."""

    at_s: float
    speed_mps: float
    curvature_per_m: float
    wanted_per_m: float
    name: str
    x_m: float
    y_m: float
    ahead_m: float  # the same place seen from the car
    left_m: float


class Record(NamedTuple):
    scene: Scene
    samples: list
    echoes: list
    contact: Contact | None
    distance_m: float


class Board:
    """The servo board: a duty comes to it late, and what it holds is reported late."""

    def __init__(self, rng):
        self._rng = rng
        self._duties = deque([(0, NEUTRAL)])
        self._reports = deque()

    def command(self, duty: int, now_ns: int) -> None:
        if duty != self._duties[-1][1]:
            self._duties.append((max(self._duties[-1][0], now_ns + self._rng.randint(1, 10) * MS), duty))

    def duty(self, now_ns: int) -> int:
        while len(self._duties) > 1 and self._duties[1][0] <= now_ns:
            self._duties.popleft()
        return self._duties[0][1]

    def report(self, now_ns: int) -> list:
        """The duties that arrive now at the arbiter."""
        self._reports.append((now_ns + self._rng.randint(1, 30) * MS, self.duty(now_ns)))
        arrived = [duty for at_ns, duty in self._reports if at_ns <= now_ns]
        self._reports = deque(report for report in self._reports if report[0] > now_ns)
        return arrived[-1:]


class Sonars:
    def __init__(self, scene: Scene, rng):
        self._scene, self._rng = scene, rng
        self._number, self._next_s = 0, 0.03
        self._stopped_s = -math.inf
        self._under_way = deque()
        self.echoes = []

    def step(self, car: Car, at_s: float) -> list:
        """The ranges that arrive now, as (sonar, m)."""
        if car.speed_mps > 0.05:
            self._stopped_s = at_s + 1.0
        if at_s >= self._next_s:
            self._next_s += self._scene.firing_s
            self._fire(car.pose, at_s, car.speed_mps > -0.05 and at_s < self._stopped_s)
        arrived = []
        while self._under_way and self._under_way[0][0] <= at_s:
            arrived.append(self._under_way.popleft()[1:])
        return arrived

    def _fire(self, pose, at_s, is_ahead):
        sequence = MOSTLY_AHEAD if is_ahead and self._scene.is_mostly_ahead else ALL_IN_TURN
        self._number += 1
        sonar = SONARS[sequence[self._number % len(sequence)]]
        met = self._scene.room_at(at_s).first_in_cone(pose.mounted(MOUNTS[sonar]), FIELD_OF_VIEW_RAD / 2,
                                                   self._scene.max_range_m)
        range_m, flight_s = math.inf, 0.038
        if met is not None:
            is_lost = self._rng.random() < self._scene.dropouts
            self.echoes.append(Echo(at_s, sonar, *met, is_lost))
            if not is_lost:
                range_m, flight_s = self._measured(met.range_m), 2 * met.range_m / SOUND_MPS
        self._under_way.append((at_s + flight_s + 0.01, sonar, range_m))

    def _measured(self, range_m):
        range_m += self._rng.gauss(0, self._scene.noise_m)
        return -math.inf if range_m < MIN_RANGE_M else range_m if range_m <= self._scene.max_range_m else math.inf


class Odometry:
    """The wheels' speed, 50 times a second, late."""

    def __init__(self, late_s: float, rng):
        self._late, self._rng = round(late_s / STEP_S), rng
        self._speeds = deque([0.0], maxlen=self._late + 1)
        self.speed_mps = 0.0  # the newest that has arrived

    def add(self, speed_mps: float) -> None:
        self._speeds.append(speed_mps)

    def arrive(self, control: ThrottleControl, now_ns: int) -> None:
        speed = self._speeds[0]
        self.speed_mps = speed * (1 + self._rng.gauss(0, 0.01)) + self._rng.gauss(0, 0.01) if speed else 0.0
        age_ns = max(1, self._late * STEP_NS)  # 0 would say that there is no stamp
        control.update_odometry(self.speed_mps, now_ns, age_ns)


class Hand:
    """What a planner or a stick sends."""

    def __init__(self, scene: Scene):
        self._driver = scene.driver
        self.is_stick = scene.driver.hand == "stick"

    def send(self, control: ThrottleControl, at_s: float, now_ns: int) -> None:
        """Deadman, mode, who steers, and the request."""
        arbiter = control.arbiter
        arbiter.update_human(at_s >= HELD_S, now_ns)
        arbiter.update_mode("manual" if self.is_stick else "autonomous", now_ns)
        arbiter.update_steering(TELEOP if self.is_stick else PLANNER, "", now_ns)
        asks = at_s >= BEGINS_S and self._driver.pushes(at_s)
        if self.is_stick:
            arbiter.update_teleop(self._stick(at_s) if asks else 0.0, now_ns)
            return
        is_backward = self._driver.is_backward
        arbiter.update_planner_state("reverse" if is_backward else "drive", None, now_ns)
        control.update_planner((-self._driver.push if is_backward else self._driver.push) if asks else 0.0, now_ns)

    def _stick(self, at_s):
        """A push, or for backward a pull, the center, and a second pull."""
        if not self._driver.is_backward:
            return self._driver.push
        return 0.0 if BEGINS_S + 0.4 <= at_s < BEGINS_S + 1.2 else -self._driver.push


def run(scene: Scene, stops: bool = True, drive_s: float = DRIVE_S) -> Record:
    """Drive one scene; without ``stops`` as a car without obstacle_stop."""
    rng = random.Random(scene.seed + 1_000_003)
    obstacles = ObstacleConfig(mounts={name: Mount(*mount) for name, mount in MOUNTS.items()},
                               max_range_m=scene.max_range_m) if stops else None
    control = ThrottleControl(THROTTLE, ThrottleArbiterConfig(), scene.esc, obstacles=obstacles)
    car, board, sonars = Car(scene.car, scene.start), Board(rng), Sonars(scene, rng)
    odometry, hand = Odometry(scene.odometry_late_s, rng), Hand(scene)
    decides, reports, pulses = rng.randrange(TICK_STEPS), rng.randrange(TICK_STEPS), rng.randrange(TICK_STEPS)
    start_ns = 100 * S
    request, steered, contact, samples, near = 0.0, 0.0, None, [], []
    moved_s = BEGINS_S if math.isinf(scene.gone_s) else scene.gone_s
    for step in range(round(drive_s / STEP_S)):
        now_ns, at_s = start_ns + step * STEP_NS, step * STEP_S
        wanted = scene.driver.curvature(at_s)
        for sonar, range_m in sonars.step(car, at_s):
            control.update_range(sonar, range_m, now_ns)
        for duty in board.report(now_ns) if step % TICK_STEPS == pulses else ():
            control.update_output([-1, duty] + [-1] * 14, now_ns)
        if step % TICK_STEPS == reports:
            odometry.arrive(control, now_ns)
        if step % TICK_STEPS == decides:
            steered = _steer(control, wanted, odometry.speed_mps)
            hand.send(control, at_s, now_ns)
            decision = control.decide(now_ns)
            board.command(decision.duty, now_ns)
            samples.append(Sample(at_s, car.pose, car.speed_mps, car.curvature_per_m, wanted, _request(decision.duty),
                                  car.gravity_mps2, decision.limited.cause))
            near = scene.room_at(at_s).near(car.pose, OUTLINE.radius_m + abs(car.speed_mps) * 0.05 + 0.05)
        if step % TICK_STEPS == pulses:
            request = _request(board.duty(now_ns))
        car.step(request, steered, STEP_S)
        odometry.add(car.speed_mps)
        contact = _contact(near, car, at_s, wanted)
        if abs(car.speed_mps) > 0.02:
            moved_s = max(moved_s, at_s)
        if contact is not None or at_s - moved_s > STOOD_S:
            break
    return Record(scene, samples, sonars.echoes, contact, car.distance_m)


def _steer(control, wanted, speed_mps):
    """The curvature that turn_arb steers, of which the throttle is told."""
    tightest = LATERAL_MPS2 / max(speed_mps ** 2, 0.01)
    steered = max(-tightest, min(tightest, wanted))
    max_speed_mps = math.sqrt(LATERAL_MPS2 / abs(wanted)) if wanted else math.inf
    control.update_turn(1 / steered if steered else math.inf, max_speed_mps)
    return steered


def _request(duty):
    """The duty as a fraction of the way from neutral to each end."""
    return (duty - NEUTRAL) / (6554 - NEUTRAL if duty > NEUTRAL else NEUTRAL - 3277)


def _contact(near, car, at_s, wanted):
    for thing in near:
        touched = thing.touched(car.pose, OUTLINE)
        if touched is not None:
            return Contact(at_s, car.speed_mps, car.curvature_per_m, wanted, thing.name, *car.pose.place(*touched),
                           *touched)
    return None
