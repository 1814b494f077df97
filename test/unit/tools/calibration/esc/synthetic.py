"""A person who drives a virtual ESC as calibrate_esc asks for, and what is recorded of it."""
from __future__ import annotations

import math
import random

import numpy as np
import virtual_escs
from esc_car import EscCar, EscCarConfig

from car_interface.sim import drive_train as virtual
from car_interface.tools.calibration.esc.drive import EscDrive, sampled
from car_interface.tools.calibration.shared import Series

MS = 1_000_000
PULSE_M = 0.0149
NEUTRAL, FULL_FORWARD, FULL_REVERSE = 4912.0, 6554.0, 3277.0


class Person:
    """Drives and records: duty at each change and each second, odometry at 50 Hz, 30 ms old and with some noise.

    Args:
        esc, car: what is driven.
        seed: of everything that differs from one person to the next.
        resting: the duty that the centered stick gives.
    """

    def __init__(self, esc: virtual.VirtualEscConfig, car: EscCarConfig | None = None, seed=0, resting=NEUTRAL):
        self.rng = random.Random(seed)
        self._esc, self.car = virtual.VirtualEsc(esc, self.rng.randrange(20) * MS), EscCar(car or EscCarConfig())
        self._resting, self._now_ns = resting, 0
        self._duty: list = []
        self._speed: list = []
        self._pulses: list = []
        self._magnets = random.Random(seed)  # of its own: the person is the same with any magnets

    def hold(self, fraction, seconds, until=lambda speed_mps: False):
        """Holds the stick for so long, or until the car's speed is as asked for."""
        end_ns = self._now_ns + round(seconds * 1e9)
        full = FULL_FORWARD if fraction > 0 else FULL_REVERSE
        duty = 16 * round((self._resting + abs(fraction) * (full - self._resting)) / 16)
        while self._now_ns < end_ns and not until(self.car.speed_mps):
            self._now_ns += 10 * MS
            if not self._duty or self._duty[-1][1] != duty or self._now_ns % 1_000_000_000 == 0:
                self._duty.append((self._now_ns / 1e9, duty))
            before_m = self.car.place_m
            self.car.step(0.01, self._esc.step(duty, self._now_ns, self.car.wheel_mps))
            self._pass_magnets(before_m, self.car.place_m)
            if self._now_ns % (20 * MS) == 0:
                noise = self.rng.gauss(0, 0.01) if self.car.wheel_mps else 0.0
                self._speed.append((self._now_ns / 1e9 + 0.03, self.car.wheel_mps + noise))

    def replace_esc(self, esc):
        self._esc = esc

    def _pass_magnets(self, before_m, after_m):
        """A pulse at each PULSE_M, some of them a little off."""
        low, high = sorted((before_m, after_m))
        for place in range(math.ceil(low / PULSE_M), math.floor(high / PULSE_M) + 1):
            if before_m != after_m and place * PULSE_M != before_m:
                ratio = (place * PULSE_M - before_m) / (after_m - before_m)
                late_s = self._magnets.uniform(0, 0.03) * PULSE_M / max(0.1, abs(self.car.speed_mps))
                self._pulses.append((self._now_ns / 1e9 - 0.01 + 0.01 * ratio + late_s, place * PULSE_M))

    def center(self, seconds=None):
        """Lets the stick go until the car stands, or for so long."""
        if seconds is None:
            self.hold(0, 30, lambda speed: speed == 0)
            seconds = self.rng.uniform(0.3, 0.8)
        self.hold(0, seconds)

    def set_off(self, sign):
        """Moves the stick so slowly that the car just sets off."""
        self.center()
        fraction = 0.02
        while abs(self.car.speed_mps) < 0.15 and fraction < 0.4:
            self.hold(sign * fraction, 0.1)
            fraction += self.rng.uniform(0.004, 0.01)
        self.center()

    def forward(self):
        fraction, top_mps = self.rng.uniform(0.3, 0.5), self.rng.uniform(1.5, 2.5)
        self.hold(fraction, 10, lambda speed: speed > top_mps)

    def brake(self, strength=None):
        """Forward, pull back, hold until it has stood for a second, or rolls backward."""
        strength = strength or -self.rng.uniform(0.4, 0.6)
        self.forward()
        self.hold(strength, 4, lambda speed: speed <= 0)
        self.hold(strength, self.rng.uniform(1.1, 1.5), lambda speed: speed < -0.6)

    def reverse(self, neutral_s):
        """After a brake: center, pull again."""
        self.brake()
        if self.car.speed_mps < 0:
            self.center()
        self.center(neutral_s)
        self.hold(-self.rng.uniform(0.4, 0.6), self.rng.uniform(1.3, 1.6), lambda speed: speed < -0.8)
        self.center()

    def wait_and_pull(self, neutral_s, pull_s=2.0):
        """A pull so long after driving forward to a standstill."""
        self.forward()
        self.center()
        self.center(neutral_s)
        self.hold(-0.5, pull_s, lambda speed: speed < -0.6)
        self.center()

    def drive(self, leaves_out=()) -> EscDrive:
        """All that calibrate_esc asks for, but for the parts that are left out."""
        parts = {"creep forward": self._creep, "coast": self._coast, "brake": self._brake,
                 "pull twice": self._pull_twice, "creep backward": lambda: self._creep(-1),
                 "wait and pull": self._wait_and_pull}
        self.center(2.0)
        for name, part in parts.items():
            if name not in leaves_out:
                part()
        return self.recorded()

    def _creep(self, sign=1):
        for _ in range(3):
            self.set_off(sign)

    def _coast(self):
        for _ in range(3):
            self.forward()
            self.center()

    def _brake(self):
        for _ in range(3):
            self.brake()
            self.center()

    def _pull_twice(self):
        for neutral_s in (0.8, 0.7, 0.9, 0.48, 0.4, 0.3, 0.22, 0.14):
            self.reverse(neutral_s)

    def _wait_and_pull(self):
        for neutral_s in (1.0, 6.5):
            self.wait_and_pull(neutral_s, 1.2)

    def recorded(self) -> EscDrive:
        duty, speed = np.array(self._duty), np.array(self._speed)
        return sampled(Series(*duty.T), Series(*speed.T), self._resting, FULL_FORWARD, FULL_REVERSE,
                       (Series(*np.array(self._pulses).T),) if self._pulses else ())


def random_esc(seed) -> tuple[virtual.VirtualEscConfig, EscCarConfig]:
    """One of the typical ESCs with random numbers, in a random car."""
    rng = random.Random(1000 + seed)
    make = (virtual_escs.xl5, virtual_escs.vxl, virtual_escs.crawler, virtual_escs.direct, virtual_escs.race)[seed % 5]
    esc = make(dwell_s=rng.uniform(0.1, 0.4), brake_seen_s=rng.uniform(0.0, 0.1), turn_s=rng.uniform(0.0, 0.4),
               neutral_duty=rng.uniform(4870, 4960), forward_band_duty=rng.uniform(60, 110),
               reverse_band_duty=rng.uniform(60, 110), drag_brake=rng.choice((0.0, 0.05, 0.3)),
               arming_s=rng.uniform(0.1, 0.9), forget_s=rng.choice((0.0, 0.0, rng.uniform(2.0, 4.0))),
               second_pull=rng.choice((virtual.REVERSES, virtual.BRAKES, virtual.BRAKES_AND_TURNS)))
    car = EscCarConfig(brake_mps2=rng.uniform(4, 8), reverse_mps2=rng.uniform(2.5, 5), drag_mps2=rng.uniform(0.25, 0.5))
    return esc, car
