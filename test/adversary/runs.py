"""Many sequences at once, and what of them failed."""
from __future__ import annotations

import argparse
import json
import math
import multiprocessing
import os
from collections import Counter
from pathlib import Path
from typing import Iterable, NamedTuple, Sequence

from adversary.car_model import CarSpec
from adversary.cases import SWEEP_CASES, UNVERIFIED, Case, Odometry, Segment, random_case, sweep_case
from adversary.esc_model import BBR, BTR, DIRECT, FORWARD_ONLY, KINDS, EscSpec
from adversary.world import HIT, LOCKED, NO_STAMP, POWERED, RELEARNED, SLOWED, World

ENDED_S = 0.5  # after odometry that shows it: a wrong kind's, and an ESC's that was powered anew
# Wheels that a wall stops, or that lock, all at once: no rule can know before odometry shows it, or is half a second
# old (esc/speed_timeout), and that the message, the timer, the board and the pulse have passed.
STOOD_S, UNSEEN_S = 0.1, 0.6
APART = (NO_STAMP, RELEARNED, POWERED, SLOWED, LOCKED, HIT)  # told apart, the first that applies
WORST = 12


class Found(NamedTuple):
    name: str
    group: str
    kinds: str
    reversal: object

    @property
    def apart(self) -> str:
        return next((name for name in APART if name in self.reversal.faults), "")

    @property
    def is_ended(self) -> bool:
        """Whether it ended within the limit after odometry that shows it, if any did."""
        return not self.reversal.shown_s > ENDED_S

    @property
    def is_failure(self) -> bool:
        if self.apart in (NO_STAMP, RELEARNED, SLOWED):
            return False
        if self.apart == POWERED or self.group == "wrong" and self.reversal.want != "stop":
            return not self.is_ended
        if self.apart in (LOCKED, HIT):
            return self.reversal.stood_s > STOOD_S or self.reversal.stopped_s > UNSEEN_S
        return True

    def __str__(self) -> str:
        found = self.reversal
        shown = "" if math.isnan(found.shown_s) else f", {found.shown_s:.2f} s after odometry showed it"
        return (f"--one {self.name}: {self.group} ({self.kinds}) at {found.at_s:.2f} s, wanted: {found.want}; "
                f"{found.lowest_mps:+.2f} m/s, backward for {found.lasts_s:.2f} s{shown}; "
                f"{', '.join(found.faults) or '-'}")


def case_of(name: str) -> Case:
    """The case of a seed, or of a number of the sweep behind an s."""
    return sweep_case(int(name[1:])) if name.startswith("s") else random_case(int(name))


def run_one(name: str) -> tuple[str, list[Found], str, int, int]:
    """A sequence's name, its reversals, its group, how many reverses were wanted and how many came about."""
    case = case_of(name)
    result = World(case).run()
    profile = case.config["profile"] + (", measured" if case.is_measured else "")
    kinds = profile if case.group == "right" else f"{profile}, is {case.esc.kind}"
    found = [Found(name, case.group, kinds, each) for each in result.reversals]
    return name, found, case.group, result.wanted, result.got


class Summary:
    def __init__(self, results: Iterable[tuple]):
        self.found: list[Found] = []
        self.runs, self.wanted, self.got, self.missed = Counter(), 0, 0, []
        for name, found, group, wanted, got in results:
            self.found += found
            self.runs[group] += 1
            self.wanted += wanted
            self.got += got
            if got < wanted:
                self.missed.append(name)
        self.failures = [each for each in self.found if each.is_failure]

    def lines(self) -> list[str]:
        """A line for each class, for each fault of a failure, and for the worst of each class."""
        runs = ", ".join(f"{number} {group}" for group, number in sorted(self.runs.items()))
        lines = [(f"{sum(self.runs.values())} sequences ({runs}), {len({each.name for each in self.failures})} of them "
                  f"with a reversal that must not be; {self.got} of {self.wanted} wanted reverses came about"
                  + (f", not: {', '.join(self.missed[:10])}" if self.missed else ""))]
        classes: dict[tuple, list[Found]] = {}
        for each in self.found:
            classes.setdefault((not each.is_failure, each.group, each.reversal.want, each.apart), []).append(each)
        for (is_allowed, group, want, apart), members in sorted(classes.items()):
            worst = min(members, key=lambda each: each.reversal.lowest_mps)
            longest_s = max(each.reversal.lasts_s for each in members)
            slightly_s = max((each.reversal.slightly_s for each in members if each.reversal.slightly_s > 0),
                             default=0.0)
            verdict = "told apart" if is_allowed else "FAILED"
            lines.append(f"{verdict:10} {group:10} {want:14} {apart:25} "
                         f"{len(members):5} reversals, worst {worst.reversal.lowest_mps:+.2f} m/s "
                         f"(--one {worst.name}), longest {longest_s:.2f} s, "
                         f"after odometry below -0.05 m/s {slightly_s:.2f} s")
        causes = Counter((each.group, each.reversal.want, ", ".join(each.reversal.faults) or "-")
                         for each in self.failures)
        lines += [f"{number:6} {group}, {want}: {faults}" for (group, want, faults), number in causes.most_common(25)]
        seen = set()
        for each in sorted(self.failures, key=lambda each: each.reversal.lowest_mps):
            if (each.kinds, each.reversal.want) not in seen and len(seen) < WORST:
                seen.add((each.kinds, each.reversal.want))
                lines.append(str(each))
        return lines


STOP_SPEEDS = (1.0, 2.0, 3.0, 4.0, 5.0, 6.0)
MEASURED, ONCE, TWICE = "measured", "held once before", "held twice before"


def stop_cases() -> Iterable[tuple[str, Case]]:
    """A stop from each speed on level ground, with fresh odometry, by kind: not measured, measured, and after a brake
    that held the car.
    """
    kinds = [(kind, kind) for kind in KINDS] + [(UNVERIFIED, kind) for kind in (BTR, BBR, DIRECT, FORWARD_ONLY)]
    for profile, kind in kinds:
        for knowledge in ("", MEASURED, ONCE, TWICE) if profile != UNVERIFIED else ("",):
            for speed_mps in STOP_SPEEDS if profile != UNVERIFIED else STOP_SPEEDS[1:2]:
                name = f"{profile} ({kind}{', ' + knowledge if knowledge else ''}) from {speed_mps:.0f} m/s"
                config = {"profile": profile, "arming_time_s": 0.5, "profile_measured": knowledge == MEASURED}
                script = [Segment(0.7, "coast", deadman=False), Segment(0.9, "coast")]
                for _ in range((ONCE, TWICE).index(knowledge) + 1 if knowledge in (ONCE, TWICE) else 0):
                    at_s = script[-1].end_s
                    script += [Segment(at_s + 1.0, "any", stick=1.0), Segment(at_s + 4.1, "hold", stick=-0.6),
                               Segment(at_s + 4.3, "coast")]
                script += [Segment(script[-1].end_s + 20.0, "drive", stick=0.4 if speed_mps <= 2 else 1.0)]
                script += [Segment(script[-1].end_s + 30.0, "stop", deadman=False)]
                yield name, Case(name, "right", config, EscSpec(kind), CarSpec(top_mps=15.0), script, [],
                                 Odometry(0.02, 0.01), 0.6, speed_mps, is_even=True)


def stop_distances(speeds_mps: Sequence[float] = STOP_SPEEDS) -> dict[str, float]:
    """Metres of each stop from one of these speeds."""
    distances = {}
    for name, case in stop_cases():
        if case.speed_mps not in speeds_mps:
            continue
        world = World(case)
        result = world.run()
        distances[name] = round(world.car.x_m - result.stop_m, 3)
    return distances


def longer_stops(baseline: dict[str, float], now: dict[str, float]) -> list[str]:
    """The stops that became longer than the baseline's by more than 5 % and a centimetre."""
    return [f"{name}: {is_m:.2f} m, was {baseline[name]:.2f} m" for name, is_m in now.items()
            if is_m > baseline[name] * 1.05 + 0.01]


def run_many(names: list[str], cores: int) -> Summary:
    if cores == 1:
        return Summary(map(run_one, names))
    with multiprocessing.get_context("spawn").Pool(cores) as pool:
        return Summary(pool.imap(run_one, names, chunksize=20))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("number", nargs="?", type=int, default=1000, help="of random sequences")
    parser.add_argument("--seed", type=int, default=0, help="of the first one")
    parser.add_argument("--sweep", action="store_true", help="each fault at every 10 ms of a stop, for each kind")
    parser.add_argument("--one", metavar="SEED", help="tell one sequence; s and a number: of the sweep")
    parser.add_argument("--stops", metavar="FILE", help="compare distances of stops, or write the file where it is not")
    args = parser.parse_args()
    if args.one:
        case = case_of(args.one)
        print(case._replace(script=()), *case.script, *World(case, tells=True).run().story, sep="\n")
        print(*run_one(args.one)[1], sep="\n")
        return 0
    if args.stops:
        return _compare_stops(Path(args.stops))
    names = [f"s{index}" for index in range(SWEEP_CASES)] if args.sweep else \
        [str(seed) for seed in range(args.seed, args.seed + args.number)]
    summary = run_many(names, os.cpu_count())
    print(*summary.lines(), sep="\n")
    return 1 if summary.failures or summary.got < summary.wanted else 0


def _compare_stops(path):
    now = stop_distances()
    if not path.exists():
        path.write_text(json.dumps(now, indent=1) + "\n")
        return 0
    longer = longer_stops(json.loads(path.read_text()), now)
    print(*longer or ["no stop is longer"], sep="\n")
    return 1 if longer else 0
