#!/usr/bin/env python3
"""How well calibrate_steering learns a steering that it never sees: random virtual cars, five minutes of driving each.

    PYTHONPATH=src:test python3 -m accuracy.steering_calibration [--cars N] [--first SEED] [--missing third]

Each car is recorded (see virtual_drive: play, a lag of 0.15 s, sensors' noise, a slope of 2 %, a sagging battery), the
command itself calibrates it from the bag alone, turn_arb's own core loads what it wrote, and is asked for turns. What
the car then does, with its duty as the servo board's nearest count and in the middle of the play, is held against what
was asked for: radii that it can reach up to 5 m, evenly by their logarithm, to both sides; and curvatures evenly over
all that it can reach. Beside it what the best of all counts would cost, what the table costs beyond that (this is what
is judged), and what the package's stock table costs.
"""
from __future__ import annotations

import argparse
import io
import sys
import tempfile
import time
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import NamedTuple

import numpy as np

from accuracy.virtual_drive import COUNT, MIXED, NO_FAST, NO_RIGHT, TWO_THIRDS, random_car, record, true_curvature_per_m
from car_interface.cli.main import main as command
from car_interface.steering.params import load_steering

STOCK = Path(__file__).resolve().parents[2] / "config" / "turn_arb.yaml"
WIDEST_M = 5.0
RADII, CURVATURES = 60, 400  # asked for; radii to each side
MEDIAN_SHARE, P95_SHARE, P95_PER_M = 0.03, 0.08, 0.01


class Errors(NamedTuple):
    """Of one table on one car: shares of the radius, and curvatures in 1/m."""

    radius: np.ndarray
    curvature: np.ndarray


class Verdict(NamedTuple):
    """Of one car."""

    seed: int
    code: int
    said: str
    seconds: float
    table: Errors
    floor: Errors
    stock: Errors


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


def judge(seed, folder, missing=MIXED) -> Verdict:
    """Drive, calibrate, ask."""
    car = random_car(seed)
    bag, table = Path(folder) / f"{seed}.bag", Path(folder) / f"{seed}.yaml"
    record(car, bag, seed, missing=missing)
    said, begun = io.StringIO(), time.perf_counter()
    with redirect_stdout(said), redirect_stderr(said):
        code = command("calibrate_steering", [str(bag), "-o", str(table)])
    seconds = time.perf_counter() - begun
    curvatures = [curvature for _, curvature in car.steering.curve]
    radii = np.concatenate([sign * np.exp(np.linspace(np.log(1 / abs(end)), np.log(WIDEST_M), RADII))
                            for sign, end in ((1, curvatures[0]), (-1, curvatures[-1]))])
    asked = np.linspace(curvatures[-1], curvatures[0], CURVATURES)
    asked = asked[np.abs(asked) > 1e-4]
    nothing = Errors(np.full(len(radii), np.nan), np.full(len(asked), np.nan))
    made = nothing if code else ask(car, radii, asked, load_steering(str(table)).planner_duty)
    return Verdict(seed, code, said.getvalue(), seconds, made, floor(car, radii, asked),
                   ask(car, radii, asked, load_steering(str(STOCK)).planner_duty))


def figures(verdict: Verdict) -> list[float]:
    """Radius: beyond the floor (median, p95), table, floor, stock; curvature's p95: the same four."""
    beyond = Errors(*(made - best for made, best in zip(verdict.table, verdict.floor)))
    return [np.median(beyond.radius), np.percentile(beyond.radius, 95),
            np.median(verdict.table.radius), np.percentile(verdict.table.radius, 95),
            np.median(verdict.floor.radius), np.percentile(verdict.floor.radius, 95),
            np.median(verdict.stock.radius), np.percentile(verdict.stock.radius, 95),
            np.percentile(beyond.curvature, 95), np.percentile(verdict.table.curvature, 95),
            np.percentile(verdict.floor.curvature, 95), np.percentile(verdict.stock.curvature, 95)]


def meets(row) -> bool:
    """Whether one car's figures do."""
    return bool(row[0] <= MEDIAN_SHARE and row[1] <= P95_SHARE and row[8] <= P95_PER_M)


def line(name, row, rest=""):
    """A line of the table."""
    pairs = " | ".join(f"{100 * row[i]:6.1f} {100 * row[i + 1]:6.1f}" for i in (0, 2, 4, 6))
    return f"{name:>6} | {pairs} | " + " ".join(f"{value:7.4f}" for value in row[8:]) + f" | {rest}"


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cars", type=int, default=20)
    parser.add_argument("--first", type=int, default=0, metavar="SEED")
    parser.add_argument("--missing", default=MIXED, choices=(MIXED, NO_RIGHT, NO_FAST, TWO_THIRDS))
    options = parser.parse_args()
    print("       |             radius up to 5 m: error in %, median and p95      |    curvature, all: p95, 1/m   |")
    print("   car | beyond floor  |   calibrated  |  floor: count |  stock table  |  beyond  calibr.  floor   stock |"
          " s")
    with tempfile.TemporaryDirectory() as folder:
        verdicts = []
        for seed in range(options.first, options.first + options.cars):
            verdict = judge(seed, folder, options.missing)
            verdicts.append(verdict)
            if verdict.code:
                print(f"{seed:6d} | {verdict.said.strip().splitlines()[-1]}", flush=True)
            else:
                row = figures(verdict)
                print(line(str(seed), row, f"{verdict.seconds:.1f}{'' if meets(row) else '  missed'}"), flush=True)
    made = [verdict for verdict in verdicts if not verdict.code]
    if made:
        together = Verdict(0, 0, "", sum(verdict.seconds for verdict in made), *(
            Errors(*(np.concatenate([getattr(verdict, part)[index] for verdict in made]) for index in range(2)))
            for part in ("table", "floor", "stock")))
        print(line("all", figures(together)))
    met = sum(meets(figures(verdict)) for verdict in made)
    print(f"{met} of {len(verdicts)} cars meet {MEDIAN_SHARE:.0%} median and {P95_SHARE:.0%} p95 of the radius and "
          f"{P95_PER_M} 1/m p95, beyond the floor; {len(verdicts) - len(made)} refused")
    return 0 if all(meets(figures(verdict)) for verdict in made) else 1


if __name__ == "__main__":
    sys.exit(main())
