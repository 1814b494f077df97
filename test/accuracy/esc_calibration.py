"""What calibrate_esc finds of random virtual ESCs, whose kind and numbers it does not know.

A scripted person drives as docs/calibrate.md asks for, through throttle_arb's rules with esc/calibration_drive, and the
command sees the bag only. The person reacts late, trembles, counts badly, and now and then does something else.

    PYTHONPATH=src:test python3 -m accuracy.esc_calibration [--first SEED] [--escs N]
"""
from __future__ import annotations

import argparse
import contextlib
import io
import random
import sys
import tempfile
from pathlib import Path
from typing import Iterator, NamedTuple

import virtual_escs
import yaml
from many_drives import THROTTLE

from accuracy.virtual_drive import NS_PER_S, START_NS, Command, View, record
from car_interface.common.sources import TELEOP
from car_interface.interlock.motion_interlock import InterlockConfig
from car_interface.sim import drive_train as virtual
from car_interface.sim.drive_train import DriveTrainConfig
from car_interface.sim.vehicle import VehicleConfig
from car_interface.throttle.arbiter import ThrottleArbiterConfig
from car_interface.throttle.control import ThrottleControl
from car_interface.throttle.esc_config import UNVERIFIED, EscConfig
from car_interface.throttle.stick import StickConfig
from car_interface.tools.cli.main import main as command_line

MAKES = (virtual_escs.xl5, virtual_escs.vxl, virtual_escs.crawler, virtual_escs.direct, virtual_escs.race)
TICK_S = 0.02


def random_car(seed: int) -> VehicleConfig:
    """A car with an ESC of one of the five typical kinds, and random numbers."""
    rng = random.Random(5000 + seed)
    neutral = rng.uniform(4870, 4960)
    esc = MAKES[seed % len(MAKES)](
        dwell_s=rng.uniform(0.1, 0.4), brake_seen_s=rng.uniform(0.0, 0.1), turn_s=rng.uniform(0.0, 0.4),
        neutral_duty=neutral, forward_band_duty=rng.uniform(60, 110), reverse_band_duty=rng.uniform(60, 110),
        drag_brake=rng.choice((0.0, 0.05, 0.3)), arming_s=rng.uniform(0.1, 0.9), starts_ready=rng.random() < 0.3,
        forget_s=rng.choice((0.0, 0.0, rng.uniform(2.0, 4.0))),
        second_pull=rng.choice((virtual.REVERSES, virtual.BRAKES, virtual.BRAKES_AND_TURNS)))
    drive = DriveTrainConfig(
        neutral_duty=neutral, forward_mps2=rng.uniform(4.5, 7.0), reverse_mps2=rng.uniform(2.5, 5.0),
        brake_mps2=rng.uniform(4.0, 8.0), drag_mps2=rng.uniform(0.25, 0.5))
    return VehicleConfig(drive=drive, esc=esc, pulse_phase=(rng.random(), rng.random()))


class Person:
    """One who follows the page."""

    def __init__(self, see: View):
        self._see = see
        self.rng = rng = see.random
        self.stick, self.holds_deadman, self.button = 0.0, False, 0
        self._reaction_s = rng.uniform(0.18, 0.32)
        self._stick_per_s = rng.uniform(8.0, 20.0)
        self._rests_at = rng.uniform(-0.03, 0.03)

    def drive(self) -> Iterator[None]:
        """The page from its top to its end; each step is a tick."""
        yield from self._hold(0.0, 2.0)
        self.holds_deadman = True
        yield from self._hold(0.0, 0.5)
        for pressed in (1, 0, 1, 0):  # Y, twice: half of the throttle
            self.button = pressed
            yield from self._hold(0.0, 0.2)
        yield from self._creep(1)
        yield from self._brake()
        yield from self._pull_twice()
        yield from self._creep(-1)
        yield from self._wait_and_pull()
        self.holds_deadman = False
        yield from self._hold(0.0, 1.0)

    def _brake(self):
        for _ in range(3):
            yield from self._forward_and_pull()
            yield from self._stand(0.7)

    def _pull_twice(self):
        for count_s in (0.9, 0.9, 0.9, 0.9, 0.45, 0.36, 0.28, 0.2, 0.14):
            yield from self._forward_and_pull()
            if self._see.speed_mps < -0.1:
                yield from self._stand(0.5)
                return  # this ESC needs no second pull
            yield from self._hold(0.0, count_s * self.rng.uniform(0.85, 1.2))
            yield from self._pull()
            yield from self._stand(0.7)

    def _wait_and_pull(self):
        for count_s in (4.0, 8.0, 8.0):
            yield from self._forward()
            yield from self._hold(0.0, count_s * self.rng.uniform(0.85, 1.2))
            yield from self._pull()
            yield from self._stand(0.7)

    def _forward_and_pull(self):
        yield from self._forward()
        if self.rng.random() < 0.1:  # hesitates
            yield from self._hold(0.0, self.rng.uniform(0.2, 0.8))
        yield from self._pull()

    def _forward(self):
        yield from self._hold(1.0 if self.rng.random() < 0.8 else self.rng.uniform(0.8, 1.0),
                              self.rng.uniform(0.9, 1.6))

    def _pull(self):
        """Back all the way until it has stood for two seconds, or rolls backward."""
        seconds = self.rng.uniform(1.8, 2.6) if self.rng.random() < 0.9 else self.rng.uniform(0.5, 1.0)
        seconds += max(0.0, self._see.speed_mps) / 2.0
        strength = -1.0 if self.rng.random() < 0.8 else -self.rng.uniform(0.75, 1.0)
        yield from self._hold(strength, seconds, lambda: self._see.speed_mps < -0.5)

    def _creep(self, sign):
        for _ in range(3):
            per_s, position = self.rng.uniform(0.06, 0.13), self.rng.uniform(0.0, 0.06)
            while abs(self._see.speed_mps) < 0.08 and position < 0.9:
                yield from self._hold(sign * position, TICK_S)
                position += per_s * TICK_S
            yield from self._hold(sign * position, self._reaction_s)
            yield from self._stand(1.0)

    def _stand(self, seconds):
        """Let the stick go until the car stands, and for so long."""
        yield from self._hold(0.0, 12.0, lambda: abs(self._see.speed_mps) < 0.02)
        yield from self._hold(0.0, seconds)

    def _hold(self, target, seconds, until=lambda: False):
        end_s, seen_s = self._see.now_s + seconds, None
        while self._see.now_s < end_s - TICK_S / 2:
            if seen_s is None and until():
                seen_s = self._see.now_s
            if seen_s is not None and self._see.now_s > seen_s + self._reaction_s:
                return
            step = self._stick_per_s * TICK_S
            goal = target + self._rests_at if abs(target) < 0.95 else target
            self.stick += max(-step, min(step, goal - self.stick))
            trembles = self.rng.gauss(0.0, 0.004) if 0.06 < abs(target) < 0.95 else 0.0
            self.stick = max(-1.0, min(1.0, self.stick + trembles))
            yield


class Node:
    """throttle_arb, as car.launch calibration_drive:=true starts it, without ROS."""

    def __init__(self):
        self._control = ThrottleControl(
            THROTTLE, ThrottleArbiterConfig(stick=StickConfig(), interlock=InterlockConfig(grant_at_start=False)),
            EscConfig(profile=UNVERIFIED, calibration_drive=True))
        self._ticks, self._kind, self._duty = 0, None, None

    def step(self, person, speed_mps, now_ns):
        """The duty, and the state if it is published now."""
        control, arbiter = self._control, self._control.arbiter
        arbiter.update_e_stop(False, now_ns)
        arbiter.update_human(person.holds_deadman, now_ns)
        arbiter.update_mode("manual", now_ns)
        arbiter.update_steering(TELEOP, "", now_ns)
        arbiter.scale.update(person.button)
        arbiter.update_teleop(person.stick, now_ns)
        control.update_odometry(speed_mps, now_ns, 0)
        if self._duty is not None:
            control.update_output([-1, self._duty, *[-1] * 14], now_ns)
        decision = control.decide(now_ns)
        self._duty, self._ticks = decision.duty, self._ticks + 1
        state = None
        if decision.kind != self._kind or self._ticks % 5 == 0:
            self._kind, esc, arbitration = decision.kind, decision.esc, decision.arbitration
            state = {"source": arbitration.source, "cause": arbitration.cause, "asked": arbitration.asked,
                     "granted": esc.fraction, "esc": esc.state, "esc_cause": esc.cause,
                     "esc_reason": esc.reason, "profile": control.esc_config.profile, "duty": decision.duty,
                     "human_scale": decision.scale}
        return decision.duty, state


def script(see: View) -> Iterator[Command]:
    """Yield what the person at the gamepad and the node make, for ``virtual_drive.record``."""
    person, node = Person(see), Node()
    for _ in person.drive():
        now_ns = START_NS + round(see.now_s * NS_PER_S)
        duty, state = node.step(person, see.speed_mps, now_ns)
        yield Command(5100.0, 0.0, duty, state)


def record_drive(seed: int, path) -> None:
    """Let a person drive the car of a seed by the page, and write the bag."""
    record(random_car(seed), path, seed, script, duration_s=240.0)


class Outcome(NamedTuple):
    kind: str  # the true one
    code: int
    profile: str | None  # that was written
    text: str
    errors: tuple[str, ...]  # numbers that are not the ESC's


def judge(seed: int, folder: Path, bag: str | None = None) -> Outcome:
    """Calibrate by a drive with the ESC of a seed, recorded anew or before."""
    output, car = folder / f"{seed}.yaml", random_car(seed)
    if bag is None:
        bag = str(folder / f"{seed}.bag")
        record_drive(seed, bag)
    text = io.StringIO()
    with contextlib.redirect_stdout(text), contextlib.redirect_stderr(text):
        code = command_line("calibrate_esc", [bag, "-o", str(output)])
    written = yaml.safe_load(output.read_text(encoding="utf-8")) if code == 0 else {}
    return Outcome(car.esc.kind, code, written.get("esc", {}).get("profile"), text.getvalue(),
                   tuple(_errors(car, written)) if written else ())


def _errors(car, written):
    """Yield what of a file is wrong."""
    esc, drive, servo, found = car.esc, car.drive, written["servo"], written["esc"]
    neutral, low, high = servo["neutral"], servo["duty_table"][0], servo["duty_table"][-1]
    band_low, band_high = esc.neutral_duty - esc.reverse_band_duty, esc.neutral_duty + esc.forward_band_duty
    if not band_low < neutral < band_high:
        yield f"neutral {neutral} is not within {band_low:.0f} to {band_high:.0f}"
    for name, edge, true, full, push_mps2 in (
            ("forward", neutral + found["dead_band_forward"] * (high - neutral), band_high, esc.full_forward_duty,
             drive.forward_mps2),
            ("reverse", neutral - found.get("dead_band_reverse", 0.08) * (neutral - low), band_low,
             esc.full_reverse_duty, drive.reverse_mps2)):
        sets_off = true + drive.drag_mps2 / push_mps2 * (full - true)
        late = 100 if name == "forward" else -100  # what the stick moves from there until that is seen
        if not min(true, sets_off + late) <= edge <= max(true, sets_off + late):
            yield (f"dead_band_{name} ends at {edge:.0f}, the ESC's at {true:.0f}, and the car sets off at "
                   f"{sets_off:.0f}")
    if esc.kind == virtual.BRAKE_THEN_REVERSE and not -0.01 <= found["dwell"] - esc.dwell_s <= 0.2:
        yield f"dwell {found['dwell']} s, the ESC's is {esc.dwell_s:.2f} s"
    forgets_s = found.get("reverse_after_neutral", 0.0)
    is_true = forgets_s <= esc.forget_s and bool(forgets_s) == bool(esc.forget_s)
    if esc.kind == virtual.BRAKE_THEN_REVERSE and not is_true:
        yield f"reverse_after_neutral {forgets_s} s, the ESC's is {esc.forget_s:.2f} s"


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--escs", type=int, default=20)
    arguments = parser.parse_args()
    counts = {"right": 0, "refused": 0, "wrong": 0}
    with tempfile.TemporaryDirectory() as folder:
        for seed in range(arguments.first, arguments.first + arguments.escs):
            outcome = judge(seed, Path(folder))
            result = ("refused" if outcome.profile is None else
                      "right" if outcome.profile == outcome.kind and not outcome.errors else "wrong")
            counts[result] += 1
            print(f"{seed}: {outcome.kind}: {result} {'; '.join(outcome.errors)}")
            if outcome.code:
                print("  " + outcome.text.strip().replace("\n", "\n  "), flush=True)
    print(", ".join(f"{count} {name}" for name, count in counts.items()))
    return int(counts["wrong"] > 0)


if __name__ == "__main__":
    sys.exit(main())
