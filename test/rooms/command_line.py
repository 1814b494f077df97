"""Cars that are pushed blindly through random rooms with obstacle_stop on: what do they hit, and how fast?

``python3 test/rooms 1000`` drives so many on all cores, from ``--seed`` on. ``--one SEED`` tells a drive's story.
``--empty`` compares the speeds where there is nothing with those that were recorded (``--record``), or with what the
fan of the cones allows on tight arcs.
"""
from __future__ import annotations

import argparse
import itertools
import multiprocessing
from collections import Counter
from functools import partial

from . import empty
from .drive import run
from .judge import CLASSES, ECHO, NONE, ROLLED, judge
from .scene import random_scene

OTHERS_SHARE = 0.02


def verdict(seed: int, stops: bool = True):
    return judge(run(random_scene(seed), stops))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("number", nargs="?", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0, help="the first seed")
    parser.add_argument("--one", type=int, metavar="SEED", help="the story of one drive")
    parser.add_argument("--without", action="store_true", help="obstacle_stop is off")
    parser.add_argument("--empty", action="store_true", help="speeds where there is nothing")
    parser.add_argument("--record", action="store_true", help="with --empty: keep them as what later ones are held to")
    args = parser.parse_args()
    if args.one is not None:
        return tell(args.one, not args.without)
    with multiprocessing.get_context("spawn").Pool() as pool:
        if args.empty:
            return compare(pool, args.record)
        seeds = range(args.seed, args.seed + args.number)
        return summarize(pool.map(partial(verdict, stops=not args.without), seeds, chunksize=10))


def summarize(verdicts: list) -> int:
    """Print what happened by class; 0 = within what is demanded."""
    for name in CLASSES:
        of_class = sorted((one for one in verdicts if one.name == name), key=lambda one: -one.speed_mps)
        hits = [one for one in of_class if one.is_collision]
        print(f"{name}: {len(hits)} collisions, {len(of_class) - len(hits)} touches{_counts(hits)}")
        for one in hits[:12]:
            known = f"; first echo on it {one.known_s:.2f} s and {one.known_m:.2f} m before" if one.known_s else ""
            print(f"    seed {one.seed}: {one.speed_mps:.2f} m/s, {one.scene}{known}")
    known = sum(one.is_collision and one.name == ECHO for one in verdicts)
    others = sum(one.is_collision and one.name not in (ECHO, ROLLED) for one in verdicts)
    clear = sum(one.name == NONE for one in verdicts)
    print(f"{len(verdicts)} drives, {sum(one.distance_m for one in verdicts):.0f} m, {clear} without a touch")
    print(f"{known} collisions with a known thing (0), {others} others ({OTHERS_SHARE:.0%}: "
          f"{OTHERS_SHARE * len(verdicts):.0f})")
    hits = [one for one in verdicts if one.is_collision]
    print(f"whatever moved the car: {sum(one.is_known for one in hits)} with an echo on that arc, "
          f"{sum(not one.is_known for one in hits)} without")
    return int(known > 0 or others > OTHERS_SHARE * len(verdicts))


def _counts(hits):
    """How often each kind, path and slope is among collisions."""
    scenes = (one.scene.split(", ") for one in hits)
    columns = zip(*((kind, path.split()[0], slope) for kind, _, path, _, slope in scenes))
    return "".join("; " + ", ".join(f"{word} {count}" for word, count in Counter(column).most_common())
                   for column in columns)


def compare(pool, is_recorded: bool) -> int:
    """Print the speeds in an empty room; 0 = each as fast as it should be."""
    named = empty.scenes()
    speeds = dict(zip(named, pool.map(empty.mean_mps, named.values(), chunksize=4)))
    if is_recorded:
        empty.write_baseline(speeds)
    baseline, slow = empty.read_baseline(), 0
    print("m/s, and what is demanded, at", ", ".join(f"{curvature:g}" for curvature in empty.CURVATURES_PER_M), "1/m")
    for row, cells in itertools.groupby(named.items(), key=lambda item: item[0].rsplit(",", 1)[0]):
        texts = []
        for name, scene in cells:
            wanted_mps = empty.wanted_mps(name, scene, baseline)
            slow += speeds[name] < wanted_mps
            texts.append(f"{speeds[name]:.2f} {'<' if speeds[name] < wanted_mps else '≥'} {wanted_mps:.2f}")
        print(f"{row + ':':33}", "  ".join(texts))
    print(f"{slow} of {len(named)} are too slow")
    return int(slow > 0)


def tell(seed: int, stops: bool) -> int:
    """A drive's story, a line every 0.1 s and one for each pulse of a sonar that met what was touched."""
    scene = random_scene(seed)
    record = run(scene, stops)
    thing = record.contact.name.split(".")[0] if record.contact else ""
    lines = [(one.at_s, _of_echo(one)) for one in record.echoes if one.name.split(".")[0] == thing]
    lines += [(one.at_s, _of_car(one)) for one in record.samples[::5]]
    print(scene.brief, scene.driver, scene.car, *(line for _, line in sorted(lines)), sep="\n")
    print(record.contact, judge(record), sep="\n")
    return 0


def _of_echo(echo):
    lost = " (lost)" if echo.is_lost else ""
    return f"        {echo.sonar} {echo.range_m:.2f} m: {echo.name} at {echo.x_m:.2f}, {echo.y_m:.2f}{lost}"


def _of_car(sample):
    x_m, y_m, yaw_rad = sample.pose
    return (f"{sample.at_s:6.2f} s  {sample.speed_mps:+.2f} m/s  {sample.curvature_per_m:+.2f} 1/m  request "
            f"{sample.request:+.2f}  slope {sample.gravity_mps2:+.2f}  at {x_m:.2f}, {y_m:.2f}, {yaw_rad:+.2f}  "
            f"{sample.limit}")
