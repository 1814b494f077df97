"""Whether a hill drives the car: by its speed while the ESC has neutral."""
from __future__ import annotations

import pytest

from car_interface.throttle.esc_config import EscConfig
from car_interface.throttle.esc_hill import HillWatch
from car_interface.throttle.esc_motion import MeasuredMotion

MS, S = 1_000_000, 1_000_000_000


class Roll:
    def __init__(self):
        self.watch, self._motion = HillWatch(), MeasuredMotion(EscConfig())
        self._now_ns, self._speed_mps = S, 0.0

    def then(self, fraction, seconds, speed_mps, noise=0.0):
        """The speed changes evenly to that."""
        steps = round(seconds / 0.02)
        change_mps = (speed_mps - self._speed_mps) / steps
        for index in range(steps):
            self._now_ns += 20 * MS
            self._speed_mps += change_mps
            self._motion.update(self._speed_mps * (1 + noise * (-1) ** index), self._now_ns)
            self.watch.step(fraction, self._motion, self._now_ns)
        return self


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("speed_mps, after_mps, noise, drives", [
    (0.3, 0.36, 0.0, True), (0.3, 0.31, 0.0, False), (0.3, 0.2, 0.0, False),
    (3.0, 3.3, 0.0, True), (3.0, 2.7, 0.02, False), (3.0, 3.0, 0.01, False)])
def test_a_car_that_gets_faster_in_neutral_is_driven_by_a_hill(speed_mps, after_mps, noise, drives, sign):
    roll = Roll().then(sign * 0.3, 0.5, sign * speed_mps).then(0.0, 0.5, sign * after_mps, noise)
    assert roll.watch.drives_the_car == drives


def test_what_the_motor_still_does_just_after_a_push_is_no_hill():
    assert not Roll().then(0.3, 0.5, 0.3).then(0.0, 0.1, 0.36).then(0.0, 0.5, 0.3).watch.drives_the_car


def test_it_counts_while_the_car_is_pushed_and_braked_until_it_stood_or_slowed_in_neutral():
    roll = Roll().then(0.3, 0.5, 0.3).then(0.0, 0.5, 0.4).then(-0.1, 1.0, 0.2).then(0.1, 1.0, 0.4)
    assert roll.watch.drives_the_car
    assert not roll.then(0.0, 0.5, 0.3).watch.drives_the_car
    roll.then(0.0, 0.5, 0.4)
    assert roll.watch.drives_the_car
    assert roll.then(-0.1, 0.5, 0.0).watch.drives_the_car  # a brake holds it there
    assert not roll.then(0.0, 0.04, 0.0).watch.drives_the_car
