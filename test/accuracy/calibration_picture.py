#!/usr/bin/env python3
"""Draw docs/calibration.gif: a virtual car calibrates its own steering.

    PYTHONPATH=src:test python3 -m accuracy.calibration_picture docs/calibration.gif

The drive is that of calibration_drive, with a person who moves the car only where the drive asks for that. Left: the
area and the path, by the vehicle's true pose, while the button is held. Right: the true curvature for each duty, what
the car's old table says, and what the drive knows by then. Needs matplotlib and Pillow, takes about two minutes and is
the same each time.
"""
from __future__ import annotations

import argparse
import math
import random
from typing import NamedTuple

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from PIL import Image

from accuracy.calibration_drive import HALF_M, Bench, Person
from accuracy.virtual_drive import NS_PER_S
from car_interface.tools.calibration.drive.terminal import UNKNOWN, mark
from car_interface.tools.calibration.steering.calibrate import SIGNS, Breakpoint

SEED = 0  # a car without walls around it
FRAMES_PER_S, MOVING_S, END_S = 10, 9.0, 2.0
FIRST_STEP_S = 0.5  # of the drive, from the first frame to the second; later frames are farther apart
WIDTH_INCH, HEIGHT_INCH, DPI = 8.0, 4.3, 100
# m ahead and to the left of the middle of the rear axle; the nose is drawn narrower, to show which way it drives.
OUTLINE = ((-0.142, 0.148), (0.25, 0.148), (0.426, 0.06), (0.426, -0.06), (0.25, -0.148), (-0.142, -0.148))
POINT_SIZE = 26
SHADES = 10  # of each color towards white, for smooth edges
MOVED_M = 0.3  # between two moments; the drive's own 1.2 m/s are 0.12 m
INK, GREY, PATH, KNOWN, PARTLY = "#202020", "#9a9a9a", "#7fa8d9", "#17824a", "#e09a00"


class Moment(NamedTuple):
    """What one frame needs of the drive."""

    held_s: float
    pose: tuple[float, float, float]
    points: tuple[tuple[float, Breakpoint], ...]  # of the tables, each with the sign of its side


class PatientPerson(Person):
    """Lets the button go now and then, but moves the car only where the drive asks for that."""

    push_ratio = 0.0


class Recorder:
    """A trace that keeps the moments of a drive while the button is held, 10 in a second."""

    def __init__(self):
        self.moments: list[Moment] = []
        self._next_ns = 0

    def __call__(self, now_ns, bench, step):
        if now_ns >= self._next_ns and bench.person.holds:
            self._next_ns = now_ns + NS_PER_S // 10
            tables = bench.drive.progress().known.points
            points = tuple((SIGNS[side], point) for side, table in tables.items() for point in table)
            self.moments.append(Moment(bench.drive.driven_s, tuple(bench.vehicle.pose), points))


def frame_indices(count: int) -> list[int]:
    """Return which of the moments to draw: close together at first, then by steps that grow evenly."""
    frames = round(FRAMES_PER_S * MOVING_S)
    first = FIRST_STEP_S * 10
    growth = 2 * (count - 1 - first * (frames - 1)) / ((frames - 1) * (frames - 2))
    return [min(count - 1, round(first * n + growth * n * (n - 1) / 2)) for n in range(frames)]


class Picture:
    """The two plots, of which only what changes is drawn again."""

    def __init__(self, bench: Bench):
        plt.rcParams.update({"font.size": 12, "axes.edgecolor": GREY, "axes.labelcolor": INK, "text.color": INK,
                             "xtick.color": INK, "ytick.color": INK})
        self.figure, (area, tables) = plt.subplots(1, 2, figsize=(WIDTH_INCH, HEIGHT_INCH), dpi=DPI)
        self.figure.subplots_adjust(left=0.0, right=0.985, top=0.9, bottom=0.135, wspace=0.14)
        self._draw_area(area, bench)
        self._draw_tables(tables, bench)

    def _draw_area(self, area, bench):
        x_m, y_m = bench.start
        area.add_patch(plt.Circle((x_m, y_m), HALF_M, fill=False, color=GREY, linestyle="--"))
        area.set(xlim=(x_m - 3.1, x_m + 3.1), ylim=(y_m - 3.1, y_m + 3.1), aspect="equal")
        area.axis("off")
        self._time = area.text(x_m - 3.05, y_m + 3.0, "", color=INK, fontsize=14, va="top")
        area.text(x_m + 3.05, y_m - 3.05, "6 m", color=INK, ha="right")
        self._path, = area.plot([], [], color=PATH, linewidth=1.2)
        self._body = plt.Polygon(np.zeros((len(OUTLINE), 2)), color=INK)
        area.add_patch(self._body)

    def _draw_tables(self, tables, bench):
        base, curve = bench.car.base, bench.car.vehicle.steering.curve
        radii_m = np.geomspace(0.8, 100.0, 100)
        curvatures = np.concatenate([1 / radii_m, -1 / radii_m[::-1]])
        tables.plot([base.planner_duty(1 / one) for one in curvatures], curvatures, color=GREY, linestyle="--",
                    label="the table before")
        tables.plot(*zip(*curve), color=GREY, linewidth=1.5, label="the car's true steering")
        for color, label in ((PARTLY, "measured, not yet well enough"), (KNOWN, "known")):
            tables.scatter([], [], s=POINT_SIZE, color=color, label=label)
        self._points = tables.scatter([], [], s=POINT_SIZE, zorder=3)
        tables.set(xlim=(base.servo_left - 150, base.servo_right + 150), ylim=(-1.3, 1.75))
        tables.set_xlabel("servo duty")
        tables.set_title("curvature of the turn, 1/m", color=INK, fontsize=12, loc="left")
        tables.legend(loc="upper right", frameon=False, fontsize=11)
        self._count = tables.text(0.03, 0.05, "", transform=tables.transAxes, color=INK, fontsize=14)

    def update(self, moments: list[Moment]) -> None:
        """Draw the newest of the moments, and the path of all."""
        now = moments[-1]
        self._path.set_data(*zip(*path(moments)))
        x_m, y_m, yaw_rad = now.pose
        cos_yaw, sin_yaw = math.cos(yaw_rad), math.sin(yaw_rad)
        self._body.set_xy([(x_m + ahead * cos_yaw - left * sin_yaw, y_m + ahead * sin_yaw + left * cos_yaw)
                           for ahead, left in OUTLINE])
        self._time.set_text(f"{int(now.held_s) // 60}:{int(now.held_s) % 60:02d}")
        measured = [(sign, point) for sign, point in now.points if mark(point) != UNKNOWN]
        places = [(point.duty, sign / point.radius_m) for sign, point in measured]
        self._points.set_offsets(np.array(places).reshape(-1, 2))
        self._points.set_color([KNOWN if point.is_known else PARTLY for _, point in measured])
        known = sum(point.is_known for _, point in now.points)
        self._count.set_text(f"{known} of {len(now.points)} radii known" if now.points else "")


def path(moments: list[Moment]) -> list[tuple[float, float]]:
    """Return the points of the path, with a gap wherever the car was moved by hand."""
    points = [moments[0].pose[:2]]
    for before, now in zip(moments, moments[1:]):
        if math.dist(before.pose[:2], now.pose[:2]) > MOVED_M:
            points.append((math.nan, math.nan))
        points.append(now.pose[:2])
    return points


def images(picture: Picture, moments: list[Moment]) -> list[Image.Image]:
    made = []
    for index in frame_indices(len(moments)):
        picture.update(moments[:index + 1])
        picture.figure.canvas.draw()
        made.append(Image.fromarray(np.asarray(picture.figure.canvas.buffer_rgba())).convert("RGB"))
    return made


def save(frames: list[Image.Image], file: str) -> None:
    """Write a GIF in which each frame holds only what has changed, so that it stays small."""
    shades = [round(255 + (int(color[at:at + 2], 16) - 255) * shade / SHADES)
              for color in (INK, GREY, PATH, KNOWN, PARTLY) for shade in range(SHADES + 1) for at in (1, 3, 5)]
    transparent = len(shades) // 3
    palette = Image.new("P", (1, 1))
    palette.putpalette(shades + shades[:3] * (256 - transparent))
    drawn = [np.asarray(frame.quantize(palette=palette, dither=0)) for frame in frames]
    changes = [drawn[0], *(np.where(now == before, transparent, now).astype(np.uint8)
                           for before, now in zip(drawn, drawn[1:]))]
    files = [Image.fromarray(change) for change in changes]
    for one in files:
        one.putpalette(palette.getpalette())
    durations = [1000 // FRAMES_PER_S] * (len(files) - 1) + [round(1000 * END_S)]
    files[0].save(file, save_all=True, append_images=files[1:], duration=durations, loop=0, transparency=transparent,
                  disposal=1, optimize=False)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("file")
    options = parser.parse_args()
    recorder = Recorder()
    bench = Bench(SEED, recorder, person=PatientPerson(random.Random(SEED)))
    result = bench.run()
    save(images(Picture(bench), recorder.moments), options.file)
    print(f"{result.held_s:.0f} s, {result.conclusion.refusal or 'a table was written'}")


if __name__ == "__main__":
    main()
