#!/usr/bin/env python3
"""What a reboot of the Teensy in mid-drive costs of the heading, measured on the virtual Teensy.

    PYTHONPATH=src:test python3 -m accuracy.reboot [--fault off|unplugged|both|hidden] [--no-sonars] [--parked]

Wheels roll by a plan, their hall pins stand anywhere, and power is cut in the middle, for up to 0.2 s. Scored is what
the reboot itself changes: the error of the heading at the end less that just before it; and whether the truth lies
within the published covariance's three sigma: heading at the end, and place, heading and speed in each message from the
fault on. Other faults: power off for seconds, the port unplugged for seconds, or unplugged and power off meanwhile;
hidden: so long that uptime and counts are higher than before.
With --no-sonars none is connected; with --parked the car hasn't moved since it was switched on, and starts 0.3 s after
the fault.
"""
from __future__ import annotations

import argparse
import math
import random
from typing import NamedTuple

from many_drives import MS, S

from accuracy.virtual_drive import Link
from car_interface.sim.teensy_firmware import FirmwareConfig, TeensyFirmware
from car_interface.sim.teensy_sensors import BACKWARD, FORWARD
from car_interface.teensy.sensing.measurements import MotionMeasurement

PULSE_M, TRACK_M = math.pi * 0.095 / 20, 0.296
STEP_NS, REBOOT_S, END_S = MS, 6.0, 9.0
REBOOT, OFF, UNPLUGGED, BOTH, HIDDEN = "reboot", "off", "unplugged", "both", "hidden"
DARK_S, HIDDEN_S = (1.0, 4.0), (10.0, 14.0)
HIDDEN_UPTIME_MS = 2_000  # at most, at the start
DARK_KINDS = ("straight", "curve", "slowing", "slalom", "stopping", "backward", "standing", "turning")
KINDS = ("straight", "curve", "slowing", "starting", "slalom", "stopping", "backward", "standing")
PARKED = "parked"
STEADY = ("straight", "curve", "slowing", "backward")  # those whose curvature stays


class Plan(NamedTuple):
    """What the driver wants: speed (m/s) and curvature (1/m, left positive) by the time."""

    kind: str
    speed_mps: float
    curvature_per_m: float

    def at(self, now_s):
        speed, curvature = self.speed_mps, self.curvature_per_m
        if now_s < 1.0:
            return 0.0, curvature
        if self.kind == "slowing" and now_s > REBOOT_S - 0.2:
            speed /= 2
        elif self.kind == "starting" and now_s < REBOOT_S + 0.1 or self.kind == "standing":
            # It has driven before: where the wheels stand at the reboot is known.
            speed = speed if now_s < 3.0 else 0.0
            if self.kind == "standing" and now_s > REBOOT_S + 1.0:
                speed = self.speed_mps
        elif self.kind == "stopping" and now_s > REBOOT_S - 0.1 or self.kind == PARKED and now_s < REBOOT_S + 0.3:
            speed = 0.0
        elif self.kind == "slalom":
            curvature *= math.sin(2.5 * now_s)
        elif self.kind == "turning" and REBOOT_S + 0.3 < now_s < REBOOT_S + 1.5:
            return -0.5, -curvature
        return speed, curvature


class Outcome(NamedTuple):
    plan: Plan
    heading_deg: float  # that the reboot changed the error of the heading by
    heading_sigmas: float  # after the reboot
    gap_s: float  # without odometry
    inside: float  # ratio of the messages since the fault that have the truth within three sigma


def make_plan(rng, kinds=KINDS):
    kind = rng.choice(kinds)
    speed = rng.uniform(0.3, 3.0) * (-1 if kind == "backward" else 1)
    curvature = 0.0 if kind == "straight" else rng.uniform(-0.9, 0.9)
    if abs(curvature) * speed ** 2 > 4.0:  # what tyres hold
        speed = math.copysign(math.sqrt(4.0 / abs(curvature)), speed)
    return Plan(kind, speed, curvature)


class Drive:
    """A car on rails: its wheels roll by the plan."""

    def __init__(self, plan, rng, sonars_missing=(), max_start_ms=100_000):
        self.plan = plan
        self.now_ns = 0
        self.speed = self.yaw = self.x = self.y = 0.0
        self.curvature = plan.at(0.0)[1]
        self.positions = [rng.uniform(0, 4), rng.uniform(0, 4)]
        whole = tuple(math.floor(position) for position in self.positions)
        self.teensy = TeensyFirmware(FirmwareConfig(
            clock_start_ms=rng.randrange(300, max_start_ms), clock_drift_ppm=rng.uniform(-50, 50),
            wheel_positions=whole, seed=rng.randrange(1000)), lambda sensor, at_ns: 4000 + 900 * sensor)
        for sensor in sonars_missing:
            self.teensy.set_sonar(sensor, "missing", -1)  # before it works

    def step(self):
        wanted, curvature = self.plan.at(self.now_ns / S)
        change = 2.0 * STEP_NS / S
        self.speed += max(-change, min(change, wanted - self.speed))
        self.curvature += max(-0.01, min(0.01, curvature - self.curvature))  # a servo takes a fifth of a second
        rolled = self.speed * STEP_NS / S
        self.x += rolled * math.cos(self.yaw + rolled * self.curvature / 2)
        self.y += rolled * math.sin(self.yaw + rolled * self.curvature / 2)
        self.yaw += rolled * self.curvature
        pulses = []
        for side, sign in ((0, -1), (1, 1)):
            before = self.positions[side]
            self.positions[side] = after = before + rolled * (1 + sign * self.curvature * TRACK_M / 2) / PULSE_M
            first, last = math.floor(before), math.floor(after)
            for magnet in [*range(first + 1, last + 1), *range(first, last, -1)]:
                at_ns = self.now_ns + round((magnet - before) / (after - before) * STEP_NS)
                pulses.append((at_ns, side, FORWARD if after > before else BACKWARD))
        for at_ns, side, direction in sorted(pulses):
            self.teensy.wheel_pulse(side, direction, at_ns)
        self.now_ns += STEP_NS


def run(seed: int, fault: str = REBOOT, has_sonars: bool = True, is_parked: bool = False) -> Outcome:
    rng = random.Random(seed)
    plan = make_plan(rng, KINDS if fault == REBOOT else DARK_KINDS)
    drive = Drive(plan._replace(kind=PARKED) if is_parked else plan, rng, () if has_sonars else range(6),
                  *(HIDDEN_UPTIME_MS,) if fault == HIDDEN else ())
    link = Link(drive.teensy)
    fault_ns = round((REBOOT_S + rng.uniform(0, 0.2)) * S)
    off_ns = rng.choice((0, 0, rng.randrange(200 * MS)))
    dark_ns = 0 if fault == REBOOT else round(rng.uniform(*HIDDEN_S if fault == HIDDEN else DARK_S) * S)
    reboot_ns = None if fault == UNPLUGGED else fault_ns + (
        rng.randrange(dark_ns // 2) if fault == BOTH else rng.randrange(S) if fault == HIDDEN else 0)
    unplugged_until_ns = fault_ns + dark_ns if fault in (UNPLUGGED, BOTH, HIDDEN) else 0
    before_rad, found, truth, last_ns, gap_ns = None, [], {}, 0, 0
    while drive.now_ns < END_S * S + dark_ns:
        now_ns = drive.now_ns
        truth[now_ns // STEP_NS] = (drive.x, drive.y, drive.yaw, drive.speed)
        if before_rad is None and now_ns >= fault_ns:
            before_rad = found[-1][0]
            found.clear()
        if reboot_ns is not None and now_ns >= reboot_ns:
            drive.teensy.reboot(now_ns, dark_ns // 2 if fault == OFF else off_ns)
            reboot_ns = None
            link.pinger.retry_now()
        if fault_ns <= now_ns < unplugged_until_ns:
            drive.teensy.transmit(now_ns)
        else:
            for _, result in link.step(now_ns):
                if isinstance(result, MotionMeasurement):
                    gap_ns = max(gap_ns, now_ns - last_ns) if last_ns else 0
                    last_ns = now_ns
                    found.append(error(result, truth))
        drive.step()
    off_rad, sigmas, _ = found[-1]
    inside = sum(worst <= 3 for _, _, worst in found) / len(found)
    return Outcome(drive.plan, math.degrees(off_rad - before_rad), sigmas, gap_ns / S, inside)


def error(result, truth):
    """Return the heading off the truth at the stamp, in rad and in sigmas, and the worst of all in sigmas."""
    at = result.stamp.time_ns // STEP_NS
    x_m, y_m, yaw_rad, speed_mps = truth[at] if at in truth else truth[max(truth)]
    motion = result.motion
    offs = (motion.x_m - x_m, motion.y_m - y_m, motion.yaw_rad - yaw_rad)
    sigmas = [abs(off) / math.sqrt(motion.pose_covariance[axis][axis] + 1e-6) for axis, off in enumerate(offs)]
    return offs[2], sigmas[2], max(*sigmas, abs(motion.speed_mps - speed_mps) / math.sqrt(motion.speed_variance))


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--reboots", type=int, default=200)
    parser.add_argument("--fault", choices=(REBOOT, OFF, UNPLUGGED, BOTH, HIDDEN), default=REBOOT)
    parser.add_argument("--no-sonars", action="store_true")
    parser.add_argument("--parked", action="store_true")
    options = parser.parse_args()
    outcomes = [run(1000 + index, options.fault, not options.no_sonars, options.parked)
                for index in range(options.reboots)]
    print("drive     |   n | heading off, deg | within 3 sigma | messages inside | no odometry, s")
    all_kinds = (PARKED,) if options.parked else KINDS if options.fault == REBOOT else DARK_KINDS
    for name, kinds in [*((kind, (kind,)) for kind in all_kinds), ("all", all_kinds)]:
        some = [outcome for outcome in outcomes if outcome.plan.kind in kinds]
        if some:
            heading = sorted(abs(outcome.heading_deg) for outcome in some)
            inside = sum(outcome.heading_sigmas <= 3 for outcome in some)
            messages = 100 * sum(outcome.inside for outcome in some) / len(some)
            print(f"{name:9} | {len(some):3} | {heading[len(some) // 2]:7.2f} {heading[-1]:8.2f} | "
                  f"{inside:7}/{len(some):<6} | {messages:13.2f} % | {max(outcome.gap_s for outcome in some):5.2f}")


if __name__ == "__main__":
    main()
