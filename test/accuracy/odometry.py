#!/usr/bin/env python3
"""How well the wheels' reports become a pose, measured on the virtual car, whose true pose is known.

    PYTHONPATH=src:test python3 -m accuracy.odometry [--runs N]

Where the wheels stand between magnets at the start differs from run to run, as do the Teensy's clock and the driver's
hand. Scored are: the final error of the position, as a share of the distance, and of the heading; the 95th percentile
of the speed's relative error over all reports above 0.5 m/s, at the crawl over all in which it really crawls; and how
many reports have the truth within three sigma in x, y and heading at once.
"""
from __future__ import annotations

import argparse
import math
import random
import statistics
from bisect import bisect_left
from dataclasses import dataclass, field
from typing import Callable, NamedTuple

import numpy as np

from accuracy.clock import percentile
from car_interface.sim.drive_train import true_acceleration_mps2
from car_interface.sim.teensy_firmware import FirmwareConfig, TeensyFirmware
from car_interface.sim.vehicle import Vehicle, VehicleConfig
from car_interface.teensy.link.framing import FrameDecoder
from car_interface.teensy.link.protocol import SonarStatus, WheelStatus, decode
from car_interface.teensy.sensing.odometry import Odometry, OdometryConfig
from car_interface.teensy.sensing.plausibility import Gates

NS_PER_S, NS_PER_MS = 1_000_000_000, 1_000_000
STEP_NS = 2 * NS_PER_MS
CONTROL_NS = 20 * NS_PER_MS
CRAWL_MPS = 0.05
STARTS_S = 0.7
NEUTRAL = 4915


class Drive(NamedTuple):
    name: str
    order: Callable  # (Vehicle, seconds) → speed in m/s and curvature in 1/m, or None when done
    gain_per_s: float = 4.0
    max_mps2: float = 2.0


@dataclass
class Score:
    distance_m: float = 0.0
    position_m: float = 0.0  # final error
    yaw_deg: float = 0.0
    speed: list = field(default_factory=list)  # relative errors at speed
    crawl: list = field(default_factory=list)
    inside: int = 0
    reports: int = 0


def approach(speed_mps, left_m, braking_mps2):
    """The speed at which a car may still be, that is to stop after this way."""
    return min(speed_mps, math.sqrt(2 * braking_mps2 * max(0.0, left_m)))


def straight(distance_m, speed_mps, curvature_per_m=0.0):
    def order(car, now_s):
        left = distance_m - car.travel_m
        if now_s >= STARTS_S and left <= 0.03 and car.speed_mps < 0.02:
            return None
        return approach(speed_mps, left - 0.02, 1.5) if now_s >= STARTS_S else 0.0, curvature_per_m
    return order


def stop_and_go(times, leg_m, speed_mps, curvatures):
    leg, rests_until_s = 0, STARTS_S

    def order(car, now_s):
        nonlocal leg, rests_until_s
        curvature = curvatures[leg % len(curvatures)]
        if now_s < rests_until_s:
            return 0.0, curvature
        left = (leg + 1) * leg_m - car.travel_m
        if left <= 0.03 and abs(car.speed_mps) < 0.02:
            leg += 1
            rests_until_s = now_s + 0.4 + 0.35 * (leg % 5)
            return (0.0, curvature) if leg < times else None
        return approach(speed_mps, left, 2.0), curvature
    return order


def drives() -> list[Drive]:
    return [
        Drive("straight 20 m", straight(20.0, 2.0)),
        Drive("stop and go 60 m", stop_and_go(30, 2.0, 1.5, (0.0, 0.3, -0.5))),
        Drive("crawl 0.05 m/s", straight(3.0, CRAWL_MPS), 8.0),
        Drive("crawl in a circle", straight(3.0, CRAWL_MPS, 0.5), 8.0),
        Drive("8 m/s", straight(100.0, 8.0), 4.0, 5.0),
    ]


class Bench:
    def __init__(self, drive: Drive, phase, seed):
        self._random = random.Random(seed)
        self.car = Vehicle(VehicleConfig(pulse_phase=phase, tyres=None))
        self.drive = drive
        self.teensy = TeensyFirmware(
            FirmwareConfig(clock_start_ms=300 + self._random.randrange(3_600_000),
                           clock_drift_ppm=self._random.uniform(-50, 50),
                           wheel_positions=tuple(math.floor(position) for position in phase)),
            lambda sensor, at_ns: self._random.choice((1500, 5832, 14_000, 0)))
        self._decoder = FrameDecoder()
        self.gates = Gates()
        self.odometry = Odometry(OdometryConfig())
        self.score = Score()
        self._truth = []  # (device ms, x, y, yaw, speed)

    def run(self):
        car, control_ns, duties = self.car, 0, (5070, NEUTRAL)
        self._note(0)
        while True:
            if car.time_ns >= control_ns:
                control_ns += CONTROL_NS
                order = self.drive.order(car, car.time_ns / NS_PER_S)
                if order is None:
                    break
                duties = self._duties(*order)
            self._step(duties)
        for _ in range(350):
            self._step((duties[0], NEUTRAL))
        return self.score

    def _duties(self, speed_mps, curvature):
        """The duties for a speed and a curvature, by the truth."""
        car = self.car
        curve = [(-curvature_per_m, duty) for duty, curvature_per_m in car.config.steering.curve]
        steering = round(float(np.interp(-curvature, *zip(*curve))))
        if speed_mps == 0.0 and abs(car.speed_mps) < 1e-6:
            return steering, NEUTRAL
        wanted = self.drive.gain_per_s * (speed_mps - car.speed_mps)
        wanted = max(-self.drive.max_mps2, min(self.drive.max_mps2, wanted))
        low, high = 3277, 6554
        while high - low > 1:
            middle = (low + high) // 2
            if true_acceleration_mps2(middle, car.speed_mps) < wanted:
                low = middle
            else:
                high = middle
        return steering, high if self._random.random() < 0.5 else low

    def _step(self, duties):
        car, teensy = self.car, self.teensy
        before_m = car.travel_m
        for pulse in car.step(STEP_NS, *duties):
            teensy.wheel_pulse(pulse.side, pulse.direction, pulse.at_ns)
        self.score.distance_m += abs(car.travel_m - before_m)
        now_ns = car.time_ns
        self._note(now_ns)
        for body in self._decoder.feed(teensy.transmit(now_ns)):
            record = decode(body)
            if isinstance(record, SonarStatus):
                self.gates.sonar(record)
            elif isinstance(record, WheelStatus):
                self._on_wheels(record, now_ns)

    def _note(self, now_ns):
        car = self.car
        self._truth.append((self.teensy.clock.device_ns(now_ns) / NS_PER_MS, *car.pose, car.speed_mps))
        if len(self._truth) > 400:
            del self._truth[:200]

    def truth_at(self, device_ms):
        truth = self._truth
        index = min(max(1, bisect_left(truth, (device_ms,))), len(truth) - 1)
        before, after = truth[index - 1], truth[index]
        if after[0] <= before[0]:
            return after[1:]
        share = (device_ms - before[0]) / (after[0] - before[0])
        return tuple(a + share * (b - a) for a, b in zip(before[1:], after[1:]))

    def _on_wheels(self, record, now_ns):
        verdict = self.gates.wheels(record)
        if not verdict.accepted:
            return
        newest_ms = max([wheel.when for wheel in record if wheel.when], default=-math.inf)
        has_pulse = any((*verdict.pulses, *verdict.unproven))
        at_ms = newest_ms + 0.5 if has_pulse else self.teensy.clock.device_ns(now_ns) / NS_PER_MS
        motion = self.odometry.report(record, verdict._replace(unsplit=(0, 0)), (record.left.when, record.right.when),
                                      at_ms)
        self._judge(motion, self.truth_at(motion.time_ms))

    def _judge(self, motion, truth):
        score = self.score
        x_m, y_m, yaw_rad, speed_mps = truth
        errors = motion.x_m - x_m, motion.y_m - y_m, motion.yaw_rad - yaw_rad
        score.reports += 1
        score.inside += all(abs(error) <= 3 * math.sqrt(motion.pose_covariance[i][i] + 1e-10)
                            for i, error in enumerate(errors))
        score.position_m = math.hypot(errors[0], errors[1])
        score.yaw_deg = math.degrees(abs(errors[2]))
        error = abs(motion.speed_mps - speed_mps)
        if abs(speed_mps) > 0.5:
            score.speed.append(error / abs(speed_mps))
        elif 0.8 * CRAWL_MPS < abs(speed_mps) < 1.25 * CRAWL_MPS:
            score.crawl.append(error / abs(speed_mps))


def run(name: str, phase, seed: int) -> Score:
    return Bench(next(drive for drive in drives() if drive.name == name), phase, seed).run()


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=5)
    rng = random.Random(1)
    phases = [(rng.random(), rng.random()) for _ in range(parser.parse_args().runs)]
    print(20 * " " + " |   way | position, %  | heading, deg | speed p95, % | within")
    print(20 * " " + " |     m | median worst | median worst | median worst | 3 sigma")
    for drive in drives():
        print(row(drive.name, [run(drive.name, phase, seed) for seed, phase in enumerate(phases)]), flush=True)


def row(name, scores):
    position = [100 * score.position_m / score.distance_m for score in scores]
    heading = [score.yaw_deg for score in scores]
    speed = [100 * percentile(score.crawl if "crawl" in name else score.speed, 0.95) for score in scores]
    columns = " | ".join(f"{statistics.median(values):6.2f} {max(values):5.2f}"
                         for values in (position, heading, speed))
    return f"{name:20} | {scores[0].distance_m:5.1f} | {columns} | {min(s.inside / s.reports for s in scores):6.1%}"


if __name__ == "__main__":
    main()
