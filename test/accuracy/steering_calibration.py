#!/usr/bin/env python3
"""How well calibrate_steering learns a steering that it never sees: random virtual cars, five minutes of driving each.

    PYTHONPATH=src:test python3 -m accuracy.steering_calibration

Each car is recorded (see virtual_drive: play, a lag of 0.15 s, sensors' noise, a slope of 2 %, a sagging battery), the
command itself calibrates it from the bag alone, turn_arb's own core loads what it wrote, and is asked for turns: radii
up to 5 m, evenly by their logarithm, to both sides; and curvatures evenly over all that the car can reach. What it then
does, with the servo board's nearest count and in the middle of the play, is compared with that. Beside it what the best
of all counts would cost, what the table costs beyond that (this is judged), and what the stock table costs.
"""
from __future__ import annotations

import argparse
import io
import sys
import tempfile
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import NamedTuple

import numpy as np

from accuracy.virtual_drive import COUNT, random_car, record, true_curvature_per_m
from car_interface.steering.config import load_steering
from car_interface.tools.cli.main import main as command

STOCK = Path(__file__).resolve().parents[2] / "config" / "turn_arb.yaml"
WIDEST_M = 5.0
RADII, CURVATURES = 60, 400  # asked for; radii to each side
MEDIAN_SHARE, P95_SHARE, P95_PER_M = 0.03, 0.08, 0.01


class Errors(NamedTuple):
    """Of one table on one car: shares of the radius, and curvatures in 1/m."""

    radius: np.ndarray
    curvature: np.ndarray


def ask(car, radii_m, curvatures_per_m, duty_for) -> Errors:
    """What comes of asking for turns."""
    def driven(curvature):
        counts = np.round(duty_for(1 / curvature) / COUNT) * COUNT
        return float(true_curvature_per_m(car, counts))
    return Errors(np.array([abs(abs(1 / driven(1 / radius)) - abs(radius)) / abs(radius)
                            if driven(1 / radius) * radius > 0 else 9.99 for radius in radii_m]),
                  np.array([abs(driven(curvature) - curvature) for curvature in curvatures_per_m]))


def floor(car, radii_m, curvatures_per_m) -> Errors:
    """The same with the best count for each."""
    counts = np.arange(100, 512) * COUNT
    possible = true_curvature_per_m(car, counts)
    with np.errstate(divide="ignore"):
        radii = 1 / possible
    return Errors(np.array([np.min(np.abs(radii - radius)) / abs(radius) for radius in radii_m]),
                  np.array([np.min(np.abs(possible - curvature)) for curvature in curvatures_per_m]))


def judge(seed, folder, has_gaps) -> tuple[str, Errors | None, Errors, Errors]:
    """Return why no table was written, or the errors of the table; those of the best counts and of the stock table."""
    car = random_car(seed)
    bag, table = Path(folder) / f"{seed}.bag", Path(folder) / f"{seed}.yaml"
    record(car, bag, seed, has_gaps=has_gaps)
    said = io.StringIO()
    with redirect_stdout(said), redirect_stderr(said):
        code = command("calibrate_steering", [str(bag), "-o", str(table)])
    curvatures = [curvature for _, curvature in car.steering.curve]
    turns = asked_for(curvatures[0], curvatures[-1])
    made = None if code else ask(car, *turns, load_steering(str(table)).planner_duty)
    return (said.getvalue().strip().splitlines()[-1] if code else "", made, floor(car, *turns),
            ask(car, *turns, load_steering(str(STOCK)).planner_duty))


def asked_for(left_per_m, right_per_m) -> tuple[np.ndarray, np.ndarray]:
    """Radii and curvatures up to the tightest to both sides."""
    radii = [np.sign(end) * np.exp(np.linspace(np.log(1 / abs(end)), np.log(WIDEST_M), RADII))
             for end in (left_per_m, right_per_m)]
    curvatures = np.linspace(right_per_m, left_per_m, CURVATURES)
    return np.concatenate(radii), curvatures[np.abs(curvatures) > 1e-4]


def together(errors: list[Errors]) -> Errors:
    return Errors(*map(np.concatenate, zip(*errors)))


def beyond(made: Errors, best: Errors) -> Errors:
    """What the board's counts don't explain."""
    return Errors(made.radius - best.radius, made.curvature - best.curvature)


def meets(made: Errors, best: Errors) -> bool:
    more = beyond(made, best)
    return bool(np.median(more.radius) <= MEDIAN_SHARE and np.percentile(more.radius, 95) <= P95_SHARE
                and np.percentile(more.curvature, 95) <= P95_PER_M)


def line(name, *errors: Errors) -> str:
    """Of each the radius, %, median and 95 of 100; then of each the curvature, 95 of 100."""
    radii = [f"{100 * np.median(one.radius):6.2f} {100 * np.percentile(one.radius, 95):6.2f}" for one in errors]
    curvatures = [f"{np.percentile(one.curvature, 95):7.4f}" for one in errors]
    return " | ".join([f"{name:>12}", *radii, " ".join(curvatures)])


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cars", type=int, default=20)
    parser.add_argument("--first", type=int, default=0, metavar="SEED")
    parser.add_argument("--missing", choices=("third",), help="of each ten seconds three weren't recorded")
    options = parser.parse_args()
    print("             |             radius up to 5 m: error in %, median and p95      |   curvature, all: p95, 1/m")
    print("         car | beyond floor  |   calibrated  |  floor: count |  stock table  | beyond calibr. floor  stock")
    made, met = [], 0
    with tempfile.TemporaryDirectory() as folder:
        for seed in range(options.first, options.first + options.cars):
            refusal, *errors = judge(seed, folder, bool(options.missing))
            if refusal:
                print(f"{seed:12d} | {refusal}", flush=True)
                continue
            made.append(errors)
            met += meets(*errors[:2])
            print(line(seed, beyond(*errors[:2]), *errors), "" if meets(*errors[:2]) else " missed", flush=True)
    if made:
        table, best, stock = map(together, zip(*made))
        print(line("all", beyond(table, best), table, best, stock))
    print(f"{met} of {options.cars} cars meet {MEDIAN_SHARE:.0%} median and {P95_SHARE:.0%} p95 of the radius and "
          f"{P95_PER_M} 1/m p95, beyond the floor; {options.cars - len(made)} refused")
    return int(met < len(made))


if __name__ == "__main__":
    sys.exit(main())
