"""Random planners on random cars, through the arbiters and their limits: does the car tip over?

``python3 test/planner_drives.py 1000`` runs so many planners, each on one of 20 cars, on all cores;
test_virtual_drives.py runs a sample. Each depends on its seed alone.

A planner asks for turns and throttle that no sane one would, and may fall silent. A car's tables are off by some
percent, and odometry is up to 0.26 s late by its stamps, noisy, sometimes away. What happens is judged by the vehicle
alone.
"""
from __future__ import annotations

import argparse
import math
import multiprocessing
import random
import sys
from collections import deque
from typing import NamedTuple

from many_drives import MS, NEUTRAL, THROTTLE, Chip, S, count_duty

from car_interface.interlock.motion_interlock import InterlockConfig
from car_interface.sim.drive_train import DriveTrainConfig, VirtualEscConfig
from car_interface.sim.vehicle import SteeringConfig, TyreConfig, Vehicle, VehicleConfig
from car_interface.steering import arbiter as steering
from car_interface.steering.calibration import SteeringCalibration
from car_interface.steering.limits import SourceLimits, SteeringLimits
from car_interface.throttle.arbiter import ThrottleArbiterConfig
from car_interface.throttle.control import ThrottleControl
from car_interface.throttle.esc_config import EscConfig
from car_interface.throttle.limits import ThrottleLimits

STEP_NS = 5 * MS
STEER_NS, DRIVE_NS, ODOMETRY_NS = 10 * MS, 20 * MS, 20 * MS  # the timers
LATE_NS = 200 * MS  # more than a car's Teensy, in the last of four drives; the stamps say so
CARS = 20
DRIVE_S = 10
RADII_M = (0.8, 0.9, 1.0, 1.2, 1.4, 1.7, 2.0, 2.5, 3.0, 4.0, 5.0, 7.0, 10.0, 15.0, 20.0, 30.0, 50.0, 100.0, 300.0)
STYLES = ("full_lock", "slalom", "steps", "noise", "tightening")


class Car(NamedTuple):
    """A car, and what its files say of it."""

    vehicle: VehicleConfig
    calibration: SteeringCalibration
    odometry_delay_ns: int
    odometry_noise: float


class Result(NamedTuple):
    seed: int
    car: int
    rollovers: int
    max_lateral_mps2: float
    rollover_mps2: float
    max_speed_mps: float
    turn_cuts: int
    throttle_cuts: int


def random_car(number: int) -> Car:
    """A car whose tables are up to 5 % off in radius, with tyres of its own.

    It tips at 5.5 m/s² or more: a limit of 4 needs some margin. Each third one's files know its understeer.
    """
    rng = random.Random(f"car {number}")
    center, reach = rng.uniform(4900, 5200), rng.uniform(1000, 1450)
    tightest_per_m, power = rng.uniform(0.9, 1.2), rng.uniform(1.0, 2.5)
    off = [rng.uniform(0.95, 1.05) for _ in range(2)]
    points = [(center, 0.0)]
    for step in range(1, 41):
        share = step / 40
        points += [(center + side * reach * share, -side * tightest_per_m * share ** power) for side in (-1, 1)]
    understeer = rng.uniform(0.0, 0.015)

    def duty(curvature_per_m, side):
        return center + side * reach * min(1.0, curvature_per_m / tightest_per_m) ** (1 / power)

    return Car(
        vehicle=VehicleConfig(
            steering=SteeringConfig(curve=tuple(sorted(points)), center_duty=center, lag_s=rng.uniform(0.015, 0.06),
                                    rate_duty_per_s=rng.uniform(8000, 14000), backlash_duty=rng.uniform(0, 20)),
            drive=DriveTrainConfig(forward_mps2=rng.uniform(4.0, 9.0), brake_mps2=rng.uniform(5.0, 9.0),
                                   sag=rng.uniform(0.0, 0.3)),
            tyres=TyreConfig(understeer=understeer, grip_mps2=rng.uniform(5.0, 9.0),
                             rollover_mps2=rng.uniform(5.5, 8.0)),
            slope=rng.uniform(0.0, 0.05), uphill_rad=rng.uniform(-math.pi, math.pi), esc=VirtualEscConfig()),
        calibration=SteeringCalibration(
            servo_left=round(center - reach), servo_center=round(center), servo_right=round(center + reach),
            servo_channel=0, radius_axis_m=RADII_M, left_duties=[duty(off[0] / radius, -1) for radius in RADII_M],
            right_duties=[duty(off[1] / radius, 1) for radius in RADII_M],
            understeer=understeer * rng.uniform(0.7, 1.3) if number % 3 == 0 else 0.0),
        odometry_delay_ns=round(rng.uniform(5, 60)) * MS, odometry_noise=rng.uniform(0.0, 0.03))


class Planner:
    """Asks for turns and throttle, in a style of its own."""

    def __init__(self, rng):
        self._rng = rng
        self.period_ns = round(S / rng.choice((5, 10, 20, 50, 100, 200)))
        self._style = rng.choice(STYLES)
        self._period_s = rng.uniform(0.4, 4.0)
        self._until_ns = 0
        self._radius_m, self._value = 1.0, 3.0
        self.silent_ns = rng.uniform(0.2, 1.5) * DRIVE_S * S  # for most beyond the end
        self._side = rng.choice((-1, 1))

    def ask(self, now_ns):
        """(turn radius, the converter's value)."""
        rng = self._rng
        phase = now_ns / S / self._period_s
        if now_ns >= self._until_ns:
            self._until_ns = now_ns + round(rng.uniform(0.2, 4.0) * S)
            self._value = rng.choice((3.0, 3.0, rng.uniform(0.3, 3.0), rng.uniform(-5.0, 0.5)))
            self._radius_m = rng.choice((-1, 1)) * rng.choice((0.3, 1.0, rng.uniform(1, 10), 300.0))
        if self._style == "full_lock":
            return (0.5 if phase % 4 > 1.5 else 300.0) * self._side, self._value
        if self._style == "slalom":
            curvature = 1.2 * math.sin(2 * math.pi * phase)
            return 1 / curvature if abs(curvature) > 1e-3 else 300.0, self._value
        if self._style == "tightening":
            return self._side * max(0.5, 12.0 * (1 - phase % 1)), self._value
        if self._style == "noise":
            return rng.choice((-1, 1)) * rng.uniform(0.3, 20), self._value
        return self._radius_m, self._value


def run(seed: int, number: int, limited: bool = True) -> Result:
    rng = random.Random(f"planner {seed} on {number}")
    car, planner = random_car(number), Planner(rng)
    off = SteeringLimits(planner=SourceLimits())
    open_interlock = InterlockConfig(grant_at_start=True)
    steer = steering.SteeringArbiter(car.calibration, steering.SteeringArbiterConfig(
        interlock=open_interlock, limits=SteeringLimits() if limited else off))
    throttle = ThrottleControl(
        THROTTLE, ThrottleArbiterConfig(interlock=open_interlock), EscConfig(profile="brake_then_reverse"),
        ThrottleLimits())
    vehicle = Vehicle(car.vehicle, 0)
    chip, reports = Chip(rng, 5000), deque()
    delay_ns = car.odometry_delay_ns + LATE_NS * ((seed + seed // CARS) % 4) // 3
    lost = sorted(rng.uniform(2, DRIVE_S * 1.5) * S for _ in range(2))  # odometry is away between them
    duties, fastest, max_lateral_mps2 = [round(car.calibration.servo_center), NEUTRAL], 0.0, 0.0
    for now_ns in range(STEP_NS, DRIVE_S * S, STEP_NS):
        if now_ns % ODOMETRY_NS == 0:
            measured = 0.0 if vehicle.slides else vehicle.speed_mps * (1 + rng.gauss(0, car.odometry_noise))
            reports.append((now_ns + delay_ns, measured))
        while reports and reports[0][0] <= now_ns:
            _, speed_mps = reports.popleft()
            if not lost[0] < now_ns < lost[1]:
                steer.limiter.speed.update(speed_mps, now_ns, delay_ns)
                throttle.update_odometry(speed_mps, now_ns, delay_ns)
        if now_ns % (40 * MS) == 0:
            human = now_ns > 1500 * MS  # let go first: the ESC is armed meanwhile
            steer.update_human(human, now_ns)
            throttle.arbiter.update_human(human, now_ns)
        if now_ns % planner.period_ns < STEP_NS and now_ns < planner.silent_ns:
            radius_m, value = planner.ask(now_ns)
            steer.update_planner(radius_m, now_ns)
            throttle.update_planner(value, now_ns)
        changed = False
        if now_ns % STEER_NS == 0:
            decision = steer.decide(now_ns)
            throttle.arbiter.update_steering(decision.source, decision.reason, now_ns)
            throttle.update_turn(steer.turn_radius_m(decision.duty), decision.max_speed_mps)
            changed = duties[0] != decision.duty
            duties[0] = decision.duty
        if now_ns % DRIVE_NS == 0:
            duty = throttle.decide(now_ns).duty
            changed = changed or duties[1] != duty
            duties[1] = duty
            throttle.update_output([-1, duty, *[-1] * 14], now_ns)
        if changed:
            chip.command(*map(count_duty, duties), now_ns)
        vehicle.step(STEP_NS, *chip.duties(now_ns))
        fastest = max(fastest, abs(vehicle.speed_mps))
        max_lateral_mps2 = max(max_lateral_mps2, abs(vehicle.lateral_mps2))
    return Result(seed, number, vehicle.rollovers.count, max_lateral_mps2, car.vehicle.tyres.rollover_mps2, fastest,
                  steer.limiter.cuts, throttle.limiter.cuts)


def run_planner(seed: int) -> Result:
    return run(seed, seed % CARS)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("number", nargs="?", type=int, default=1000, help="of drives")
    with multiprocessing.get_context("spawn").Pool() as pool:
        results = pool.map(run_planner, range(parser.parse_args().number), chunksize=10)
    tipped = [result for result in results if result.rollovers]
    print(*tipped[:20], sep="\n")
    worst = max(results, key=lambda result: result.max_lateral_mps2 / result.rollover_mps2)
    print(f"{len(results)} drives, {sum(result.rollovers for result in results)} rollovers in {len(tipped)} of them; "
          f"{sum(result.turn_cuts + result.throttle_cuts for result in results)} cuts; the worst: {worst}")
    sys.exit(bool(tipped))
