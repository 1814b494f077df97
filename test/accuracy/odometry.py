#!/usr/bin/env python3
"""How well the wheels' reports become a pose, measured on the virtual car, whose true pose is known.

    PYTHONPATH=src:test python3 -m accuracy.odometry [--runs N] [--only NAME]

Virtual time: the car drives, its Teensy reports byte by byte, gates and odometry follow. Where the wheels stand
between magnets at the start differs from run to run, as do the Teensy's clock and the driver's hand. Scored are: the
final error of the position, as a share of the distance, and of the heading; the 95th percentile of the speed's relative
error over all reports above 0.5 m/s, at the crawl over all in which it really crawls; and how many reports have the
truth within three sigma in x, y and heading at once.
"""
from __future__ import annotations

import argparse
import math
import random
import statistics
import sys
from bisect import bisect_left
from dataclasses import dataclass, field
from typing import Callable

from accuracy.clock import percentile
from car_interface.sim.teensy_config import FirmwareConfig
from car_interface.sim.teensy_firmware import TeensyFirmware
from car_interface.sim.vehicle import Vehicle, VehicleConfig, true_acceleration_mps2
from car_interface.teensy.link.framing import SHIPPED, FrameDecoder, encode
from car_interface.teensy.link.protocol import SonarStatus, WheelStatus, decode, wheel_reset
from car_interface.teensy.sensing.odometry import Odometry, OdometryConfig
from car_interface.teensy.sensing.plausibility import Gates

NS_PER_S, NS_PER_MS = 1_000_000_000, 1_000_000
STEP_NS = 2 * NS_PER_MS
CONTROL_NS = 20 * NS_PER_MS
SPEED_FROM_MPS = 0.5
CRAWL_MPS = 0.05


@dataclass(frozen=True)
class Order:
    """What the driver wants now."""

    speed_mps: float
    curvature_per_m: float = 0.0


@dataclass(frozen=True)
class Drive:
    name: str
    order: Callable  # Vehicle, seconds → Order or None when done
    gain_per_s: float = 4.0
    max_mps2: float = 2.0
    resets_s: tuple = ()  # when somebody sets the odometers to zero


@dataclass
class Score:
    distance_m: float = 0.0
    position_m: float = 0.0  # final error
    yaw_deg: float = 0.0
    speed: list = field(default_factory=list)  # relative errors at speed
    crawl: list = field(default_factory=list)
    inside: int = 0
    reports: int = 0


def straight(distance_m, speed_mps, curvature_per_m=0.0):
    def order(car, now_s):
        left = distance_m - car.travel_m
        if now_s < 0.7:
            return Order(0.0, curvature_per_m)
        if left <= 0.03 and car.speed_mps < 0.02:
            return None
        return Order(min(speed_mps, math.sqrt(2 * 1.5 * max(0.0, left - 0.02))), curvature_per_m)
    return order


def figure_eight(rounds, radius_m, speed_mps):
    def order(car, now_s):
        if now_s < 0.7:
            return Order(0.0, 1 / radius_m)
        part = int(car.travel_m / (2 * math.pi * radius_m))
        if part >= 2 * rounds:
            return Order(0.0, 0.0) if car.speed_mps > 0.02 else None
        return Order(speed_mps, (-1 if part % 2 else 1) / radius_m)
    return order


def stop_and_go(times, leg_m, speed_mps, curvatures=(0.0,)):
    state = {"leg": 0, "rest": 0.7}
    def order(car, now_s):
        curvature = curvatures[state["leg"] % len(curvatures)]
        target = (state["leg"] + 1) * leg_m
        if now_s < state["rest"]:
            return Order(0.0, curvature)
        left = target - car.travel_m
        if left <= 0.03 and abs(car.speed_mps) < 0.02:
            state["leg"] += 1
            state["rest"] = now_s + 0.4 + 0.35 * (state["leg"] % 5)
            return Order(0.0, curvature) if state["leg"] < times else None
        return Order(min(speed_mps, math.sqrt(2 * 2.0 * max(0.0, left))), curvature)
    return order


def reversing(times, leg_m, speed_mps, curvatures=(0.0,)):
    state = {"leg": 0, "rest": 0.7, "from": 0.0}
    def order(car, now_s):
        leg = state["leg"]
        sign = -1 if leg % 2 else 1
        curvature = curvatures[leg % len(curvatures)]
        if now_s < state["rest"]:
            return Order(0.0, curvature)
        left = leg_m - sign * (car.travel_m - state["from"])
        if left <= 0.03 and abs(car.speed_mps) < 0.03:
            state.update(leg=leg + 1, rest=now_s + (0.0 if leg % 3 else 0.8))
            state["from"] = car.travel_m
            return Order(0.0, curvature) if leg + 1 < times else None
        return Order(sign * min(speed_mps, math.sqrt(2 * 2.0 * max(0.0, left))), curvature)
    return order


def wandering(distance_m, speed_mps, sharpest_per_m):
    def order(car, now_s):
        if now_s < 0.7:
            return Order(0.0)
        left = distance_m - car.travel_m
        if left <= 0.03 and car.speed_mps < 0.05:
            return None
        bend = sharpest_per_m * math.sin(car.travel_m / 5.0)
        return Order(min(speed_mps, math.sqrt(2 * 3.0 * max(0.0, left))), bend)
    return order


def drives():
    return [
        lambda: Drive("straight 20 m", straight(20.0, 2.0)),
        lambda: Drive("figure eight x 5", figure_eight(5, 1.6, 1.5)),
        lambda: Drive("stop and go 60 m", stop_and_go(30, 2.0, 1.5, (0.0, 0.3, -0.5))),
        lambda: Drive("reversing 60 m", reversing(20, 3.0, 1.2, (0.0, 0.4, 0.4, -0.3))),
        lambda: Drive("crawl 0.05 m/s", straight(3.0, CRAWL_MPS), 8.0),
        lambda: Drive("crawl in a circle", straight(3.0, CRAWL_MPS, 0.5), 8.0),
        lambda: Drive("8 m/s", straight(100.0, 8.0), 4.0, 5.0),
        lambda: Drive("8 m/s, bends", wandering(100.0, 8.0, 0.05), 4.0, 5.0),
        lambda: Drive("20 m, six resets", straight(20.0, 2.0), resets_s=(3, 4.1, 5.2, 6.3, 7.4, 8.5)),
        lambda: Drive("reversing, resets", reversing(8, 3.0, 1.2, (0.0, 0.4)), resets_s=(3, 5.3, 7.6, 9.9, 12.2, 14.5)),
        lambda: Drive("wandering 60 m", wandering(60.0, 1.5, 0.6), 4.0, 5.0),
    ]


class Driver:
    """Turns orders into duties, knowing the truth."""

    def __init__(self, drive, car, rng):
        self._drive = drive
        self._curve = car.config.steering.curve
        self._car = car
        self._random = rng

    def duties(self, order):
        car = self._car
        wanted = self._drive.gain_per_s * (order.speed_mps - car.speed_mps)
        wanted = max(-self._drive.max_mps2, min(self._drive.max_mps2, wanted))
        if order.speed_mps == 0.0 and abs(car.speed_mps) < 1e-6:
            return self._steering(order.curvature_per_m), 4915
        low, high = 3277, 6554
        while high - low > 1:
            middle = (low + high) // 2
            if true_acceleration_mps2(middle, car.speed_mps) < wanted:
                low = middle
            else:
                high = middle
        return self._steering(order.curvature_per_m), high if self._random.random() < 0.5 else low

    def _steering(self, curvature):
        curve = self._curve
        for (d0, k0), (d1, k1) in zip(curve, curve[1:]):
            if k1 <= curvature <= k0:
                return round(d0 + (k0 - curvature) / (k0 - k1) * (d1 - d0))
        return curve[0][0] if curvature > 0 else curve[-1][0]


class Bench:
    def __init__(self, make_drive, phase, seed, config):
        self._random = random.Random(seed)
        self.car = Vehicle(VehicleConfig(pulse_phase=phase, tyres=None))
        self.drive = make_drive()
        self._driver = Driver(self.drive, self.car, self._random)
        self.teensy = TeensyFirmware(
            FirmwareConfig(clock_start_ms=300 + self._random.randrange(3_600_000),
                           clock_drift_ppm=self._random.uniform(-50, 50),
                           wheel_positions=tuple(math.floor(position) for position in phase)),
            lambda sensor, at_ns: self._random.choice((1500, 5832, 14_000, 0)))
        self._resets_s = list(self.drive.resets_s)
        self._decoder = FrameDecoder()
        self.gates = Gates()
        self.odometry = Odometry(config)
        self.score = Score()
        self._truth = []  # (device ns, x, y, yaw, speed, yaw rate)

    def run(self):
        car = self.car
        now_ns = control_ns = 0
        duties = (5070, 4915)
        self._note(now_ns)
        while True:
            if now_ns >= control_ns:
                control_ns += CONTROL_NS
                order = self.drive.order(car, now_ns / NS_PER_S)
                if order is None:
                    break
                duties = self._driver.duties(order)
            self._step(duties)
            now_ns = car.time_ns
        for _ in range(350):
            self._step((duties[0], 4915))
        return self.score

    def _step(self, duties):
        car, teensy = self.car, self.teensy
        before_m = car.travel_m
        for pulse in car.step(STEP_NS, *duties):
            teensy.wheel_pulse(pulse.side, pulse.direction, pulse.at_ns)
        self.score.distance_m += abs(car.travel_m - before_m)
        now_ns = car.time_ns
        self._note(now_ns)
        if self._resets_s and self._resets_s[0] <= now_ns / NS_PER_S:
            self._resets_s.pop(0)
            teensy.receive(encode(wheel_reset(), SHIPPED), now_ns)
        for body in self._decoder.feed(teensy.transmit(now_ns)):
            record = decode(body)
            if isinstance(record, SonarStatus):
                self.gates.sonar(record)
            elif isinstance(record, WheelStatus):
                self._on_wheels(record, now_ns)

    def _note(self, now_ns):
        car = self.car
        self._truth.append((self.teensy.device_ns(now_ns) / NS_PER_MS, *car.pose, car.speed_mps))
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
        at_ms = newest_ms + 0.5 if has_pulse else self.teensy.device_ns(now_ns) / NS_PER_MS
        motion = self.odometry.report(record, verdict.pulses, verdict.restarted, record.left.when, record.right.when,
                                      at_ms, verdict.unproven)
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
        if abs(speed_mps) > SPEED_FROM_MPS:
            score.speed.append(error / abs(speed_mps))
        elif 0.8 * CRAWL_MPS < abs(speed_mps) < 1.25 * CRAWL_MPS:
            score.crawl.append(error / abs(speed_mps))


def run(make_drive, phase, seed) -> Score:
    """One drive."""
    return Bench(make_drive, phase, seed, OdometryConfig()).run()


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--only", default="", help="drives with this in their name")
    arguments = parser.parse_args()
    rng = random.Random(1)
    phases = [(rng.random(), rng.random()) for _ in range(arguments.runs)]
    print(20 * " " + " |   way | position, %  | heading, deg | speed p95, % | within")
    print(20 * " " + " |     m | median worst | median worst | median worst | 3 sigma")
    for make in drives():
        name = make().name
        if arguments.only in name:
            print(row(name, [run(make, phase, seed) for seed, phase in enumerate(phases)]), flush=True)
    return 0


def row(name, scores):
    """A line of the table."""
    position = [100 * score.position_m / score.distance_m for score in scores]
    heading = [score.yaw_deg for score in scores]
    speed = [100 * percentile(score.crawl if "crawl" in name else score.speed, 0.95) for score in scores]
    columns = " | ".join(f"{statistics.median(values):6.2f} {max(values):5.2f}"
                         for values in (position, heading, speed))
    return f"{name:20} | {scores[0].distance_m:5.1f} | {columns} | {min(s.inside / s.reports for s in scores):6.1%}"


if __name__ == "__main__":
    sys.exit(main())
