"""Compares drives: a row of numbers for each recording, shown as a page of HTML, as CSV, and as trends."""
from __future__ import annotations

import math
import time
from collections import Counter
from functools import partial
from typing import Mapping, NamedTuple, Sequence

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from car_interface.common.sources import PLANNER, TELEOP
from car_interface.common.units import NS_PER_S
from car_interface.tools.report import plots
from car_interface.tools.report.faults import ERROR
from car_interface.tools.report.html import MIN_DATE_NS, date_text, ratio_text, render, span_text
from car_interface.tools.report.summary import Summary

VERSION = 4  # of a row's content: rows of another version are computed again
# A spreadsheet takes a cell that begins with one of these for a formula (OWASP, CSV Injection), and names and causes
# come from other people's recordings. The last five: the full-width = + - @ of Japanese keyboards, and the minus sign.
FORMULA_STARTS = ("=", "+", "-", "@", "\t", "\r", "\n", "\uff1d", "\uff0b", "\uff0d", "\uff20", "\u2212")
TEXT_MARK = "'"  # in a spreadsheet: what follows is text
MAX_LABELS = 8  # of drives in the trends
MAX_CAUSES = 5  # that have a colour of their own
CAUSE_COLOURS = ("#c0392b", "#d9822b", "#2f6fb3", "#1b9e77", "#8e5ea2", "#b8bfc7")
# Trends that are lines: title, how far from 0 the axis reaches at least, and label and colour by the row's field.
LINES = (
    ("Driven when sent straight on: 1/radius in 1/m, left up", 0.01, {"straight_per_m": ("", plots.SENT)}),
    ("Tighter than the tables say, in % of the radius", 3.0, {"left_ratio": ("left", plots.SENT),
                                                              "right_ratio": ("right", plots.REQUESTED)}),
    ("Acceleration beyond what the planner requested, in m/s²", 0.1, {
        "drive_mps2": ("driving", plots.SENT), "hold_mps2": ("holding the speed", plots.FAINT),
        "brake_mps2": ("braking", plots.BAD)}))


class Row(NamedTuple):
    """A recording. ``None``: the recording can't tell; all types are JSON's."""

    path: str  # relative to the folder
    error: str = ""  # why it can't be read; empty: it was read
    start_ns: int | None = None
    duration_s: float | None = None
    distance_m: float | None = None  # by odometry
    gamepad_s: float | None = None  # how long the gamepad steered
    planner_s: float | None = None
    losses: dict | None = None  # how often something was lost or locked while somebody drove, by cause
    straight_per_m: float | None = None  # the curvature driven when sent straight on, left positive: the center is off
    left_ratio: float | None = None  # the driven curvature to the sent one, never 0
    right_ratio: float | None = None
    # By how much the car accelerated more than the planner requested, where that was to drive, to hold the speed, to
    # brake: the value map is off.
    drive_mps2: float | None = None
    hold_mps2: float | None = None
    brake_mps2: float | None = None
    battery_v: float | None = None  # the least voltage
    frames: int | None = None  # good ones of the Teensy's link
    corrupt: int | None = None
    reopened: int | None = None  # how often the port was opened again
    reboots: int | None = None  # how often the Teensy started again
    unanswered: int | None = None  # pings
    faults: int | None = None
    errors: int | None = None  # among the faults
    lacks: Sequence[str] = ()  # what was not recorded, or not all of the time
    notes: Sequence[str] = ()  # which topics were guessed


# --- a recording's row ---


def row(drive: Summary, path: str) -> Row:
    """Return the row of a summarized recording, which is shown as ``path``."""
    has_state, has_odom = bool(drive.steering.episodes), "odom" in drive.present
    source_s = drive.steering.source_s
    turns, accelerating = drive.motion.by_tables, drive.motion.accelerating
    lost, battery = [*drive.steering.losses(), *drive.throttle.losses()], drive.traces["battery voltage"]
    faults = drive.faults
    can_tell = faults.entries or not drive.coverage.is_blind  # whether anything was recorded that reports a fault
    return Row(
        path=path, start_ns=drive.start_ns, duration_s=drive.duration_s,
        distance_m=drive.motion.distance_m if has_odom else None,
        gamepad_s=source_s[TELEOP] if has_state else None, planner_s=source_s[PLANNER] if has_state else None,
        losses=dict(Counter(one.why for one in lost)) if has_state or drive.throttle.episodes else None,
        straight_per_m=_median(turns.straight_per_m), left_ratio=_median(turns.left), right_ratio=_median(turns.right),
        drive_mps2=_median(accelerating.driving), hold_mps2=_median(accelerating.holding),
        brake_mps2=_median(accelerating.braking),
        battery_v=round(battery.minimum, 3) if battery.count else None, **_link_counts(drive.teensy),
        faults=sum(fault.times for fault in faults.entries) + faults.dropped if can_tell else None,
        errors=sum(fault.times for fault in faults.entries if fault.level == ERROR) if can_tell else None,
        lacks=[gap.lacks if math.isnan(gap.start_s) else f"{gap.lacks} for {gap.end_s - gap.start_s:.0f} s"
               for gap in drive.coverage.gaps()],
        notes=[*drive.notes, *(["a calibration drive"] if drive.calibration else [])])


def _link_counts(teensy):
    """Return the columns of the Teensy's link."""
    first, last = teensy.first_link, teensy.link
    if last is None:
        return {}

    def change(name):
        return int(getattr(last, name) - getattr(first, name))
    return {"frames": change("frames"), "corrupt": change("bad_frames"), "reopened": change("reconnects"),
            "reboots": change("reboots"),
            "unanswered": max(0, change("pings") - change("pongs") - 1)}  # the newest may still be on its way


def _median(bins):
    """Return a median in five decimals, no -0.0, if it is known."""
    median = bins.median()
    return None if median is None else round(median, 5) + 0.0


# --- page and CSV ---


def in_order(rows: Sequence[Row]) -> list[Row]:
    """Return the rows by date; those that couldn't be read come last."""
    return sorted(rows, key=lambda row: (row.start_ns is None, row.start_ns or 0, row.path))


def page(folder: str, rows: Sequence[Row], trends: str, reports: Mapping[str, str]) -> str:
    """Return the page on a folder, by rows in order, trends as SVG (empty = none), and the URLs of the pages about
    recordings that could be read, by their paths.
    """
    drives = [row for row in rows if not row.error]
    bad = [row for row in rows if row.error]
    dates = [date_text(row.start_ns) for row in drives if row.start_ns >= MIN_DATE_NS]
    return render("drives.html", title=f"Drives in {folder}", dates=dict.fromkeys(dates[:1] + dates[-1:]),
                  figures=_figures(drives), drives=[(row, _cells(row)) for row in reversed(drives)], bad=bad,
                  trends=trends, reports=reports)


def _figures(drives):
    """Yield the most important numbers: text, and what it is."""
    known = [row.distance_m for row in drives if row.distance_m is not None]
    if known:
        yield f"{sum(known) / 1000:.2f} km", "driven"
    yield span_text(sum(row.duration_s for row in drives)), "recorded"
    losses = [sum(row.losses.values()) for row in drives if row.losses is not None]
    if losses:
        yield str(sum(losses)), "times lost or locked"


def _cells(row):
    """Return the cells of a row between its recording and its faults, each a list of lines."""
    unknown = ["can't tell"]
    distance = [] if row.distance_m is None else [f"{row.distance_m / 1000:.3f} km"]
    drivers = [f"{name} {span_text(seconds)}" for name, seconds in (
        ("gamepad", row.gamepad_s), ("planner", row.planner_s)) if seconds]
    losses = [f"{cause} ({count}×)" if count > 1 else cause for cause, count in Counter(row.losses).most_common()]
    by_map = [f"{what}: {difference:+.2f} m/s²" for what, difference in (
        ("driving", row.drive_mps2), ("holding", row.hold_mps2), ("braking", row.brake_mps2)) if difference is not None]
    return [[_date(row)], [*distance, span_text(row.duration_s)],
            unknown if row.gamepad_s is None else drivers or ["nobody"],
            unknown if row.losses is None else losses or ["none"],
            [*_steering(row)] or unknown, by_map or unknown,
            unknown if row.battery_v is None else [f"{row.battery_v:.2f} V"],
            unknown if row.frames is None else [*_link(row)]]


def _date(row, between=" "):
    has_date = row.start_ns >= MIN_DATE_NS
    return date_text(row.start_ns)[:-len(":00 UTC")].replace(" ", between) if has_date else "no date"


def _steering(row):
    if row.straight_per_m is not None:
        side = "" if abs(row.straight_per_m) < 0.0005 else " left" if row.straight_per_m > 0 else " right"
        yield f"straight on: {abs(row.straight_per_m):.3f} 1/m{side}"
    for side, ratio in (("left", row.left_ratio), ("right", row.right_ratio)):
        if ratio is not None:
            yield f"{side}: {ratio_text(1 / ratio, 'the tables', 'wider', 'tighter').replace(' than the tables', '')}"


def _link(row):
    yield f"{row.corrupt} of {row.frames + row.corrupt} frames corrupt"
    for count, what in ((row.reopened, "port opened again"), (row.reboots, "Teensy started anew"),
                        (row.unanswered, "pings unanswered")):
        if count:
            yield f"{what}: {count}"


def csv_text(rows: Sequence[Row]) -> str:
    """Return the rows, one at least, as CSV; an empty cell = the recording can't tell.

    Texts are in quotation marks, and none is a formula for a spreadsheet: see FORMULA_STARTS. Numbers are neither
    quoted nor marked.
    """
    named = [_csv_columns(row) for row in rows]
    return "".join(",".join(cells) + "\n" for cells in (named[0], *(map(_csv_cell, one.values()) for one in named)))


def _csv_columns(row):
    """Return what the CSV says of a row by the names of its columns."""
    losses, has_date = row.losses, row.start_ns is not None and row.start_ns >= MIN_DATE_NS
    return {
        "recording": row.path,
        "start_utc": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime(row.start_ns / NS_PER_S)) if has_date else None,
        "duration_s": _rounded(row.duration_s, 3), "distance_km": _rounded(row.distance_m and row.distance_m / 1000, 6),
        "gamepad_s": _rounded(row.gamepad_s, 3), "planner_s": _rounded(row.planner_s, 3),
        "losses": None if losses is None else sum(losses.values()),
        "losses_by_cause": "; ".join(f"{cause}: {count}" for cause, count in sorted((losses or {}).items())),
        "straight_per_m": row.straight_per_m, "left_ratio": row.left_ratio, "right_ratio": row.right_ratio,
        "map_drive_mps2": row.drive_mps2, "map_hold_mps2": row.hold_mps2, "map_brake_mps2": row.brake_mps2,
        "battery_min_v": row.battery_v, "frames": row.frames, "corrupt_frames": row.corrupt,
        "port_reopened": row.reopened, "teensy_reboots": row.reboots, "pings_unanswered": row.unanswered,
        "faults": row.faults, "errors": row.errors, "cant_tell": "; ".join(row.lacks), "notes": "; ".join(row.notes),
        "error": row.error}


def _csv_cell(value):
    """Return a cell. A text is always quoted: a spreadsheet that separates cells by ; would find others within it."""
    if value is None or value == "":
        return ""
    if not isinstance(value, str):
        return str(value)
    mark = TEXT_MARK if value.startswith(FORMULA_STARTS) else ""
    text = value.replace('"', '""').replace("\0", "�")  # with a zero byte many programs read no further
    return f'"{mark}{text}"'


def _rounded(number, digits):
    return None if number is None else round(number, digits)

# --- trends ---


def trends(rows: Sequence[Row]) -> str:
    """Return the SVG of at least two drives, in the order of ``rows``; empty where there is nothing to draw."""
    panels = [draw for names, draw in (
        (("distance_m",), _distance), (("losses",), _losses),
        *((lines[-1], partial(_lines, *lines)) for lines in LINES), (("frames",), _frames))
        if any(getattr(row, name) is not None for row in rows for name in names)]
    if len(rows) < 2 or not panels:
        return ""
    with matplotlib.rc_context(plots.STYLE):
        figure = Figure(figsize=(plots.WIDTH_IN, 1.75 * len(panels) + 0.7), constrained_layout=True)
        all_axes = figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
        for draw, axes in zip(panels, all_axes):
            draw(axes=axes, rows=rows)
        step = -(-len(rows) // MAX_LABELS)
        shown = np.arange(len(rows) - 1, -1, -step)[::-1]  # evenly: none covers its neighbour; the newest has a date
        all_axes[-1].set(xlim=(-0.6, len(rows) - 0.4), xticks=shown)
        all_axes[-1].set_xticklabels([_date(rows[index], "\n") for index in shown])
        return plots.svg_text(figure, "trends",
                              "distance, losses, steering, value map and link errors from drive to drive")


def _distance(axes, rows):
    plots.title(axes, "Distance in m")
    heights = np.array([row.distance_m for row in rows], float)  # None is NaN
    axes.bar(range(len(rows)), heights, color=plots.SENT, width=0.7)
    _mark_zeros(axes, heights)
    axes.set_ylim(0, max(1.0, 1.08 * float(np.nanmax(heights))))


def _losses(axes, rows):
    plots.title(axes, "Lost or locked while somebody drove, times")
    total = sum((Counter(row.losses or {}) for row in rows), Counter())
    shown = [cause for cause, _ in total.most_common(MAX_CAUSES)]
    bottom = np.zeros(len(rows))
    for cause, colour in zip([*shown, None], CAUSE_COLOURS):
        heights = np.array([sum(count for name, count in (row.losses or {}).items()
                                if name == cause or cause is None and name not in shown) for row in rows], float)
        if heights.any():
            axes.bar(range(len(rows)), heights, bottom=bottom, color=colour, width=0.7,
                     label=plots.label_text(cause or "others"))
            bottom += heights
    _mark_zeros(axes, np.where([row.losses is None for row in rows], np.nan, bottom))
    axes.set_ylim(0, max(1.0, 1.15 * bottom.max()))
    axes.yaxis.get_major_locator().set_params(integer=True)
    plots.legend(axes)


def _mark_zeros(axes, heights):
    """Draw a point where a bar would have no height; without a bar and a point nothing is known (NaN)."""
    at = np.flatnonzero(heights == 0)
    if at.size:  # not clipped and empty would have no place for the layout
        axes.plot(at, np.zeros(at.size), color=plots.FAINT, marker="o", markersize=3, linestyle="none", clip_on=False)


def _lines(text, least, columns, axes, rows):
    """Draw a line through what is known of each column; the axis reaches at least as far as ``least`` beside 0."""
    plots.title(axes, text)
    for name, (label, colour) in columns.items():
        values = np.array([getattr(row, name) for row in rows], float)
        if name.endswith("_ratio"):  # in % of the radius, as in the table of drives; at most 100 % wider, to see others
            values = np.maximum(-100.0, 100 * (1 - 1 / values))
        known = np.flatnonzero(~np.isnan(values))
        axes.axhline(0, color=plots.FAINT, linewidth=0.9)
        if known.size:
            axes.plot(known, values[known], color=colour, marker="o", markersize=3.5, label=label or "_")
            largest = max(least, *np.abs(axes.get_ylim()), 1.15 * np.abs(values[known]).max())
            axes.set_ylim(-largest, largest)
    plots.legend(axes)


def _frames(axes, rows):
    plots.title(axes, "Corrupt frames of the Teensy's link, in %; x: its port was opened again, or it started anew")
    ratios = np.array([None if row.frames is None else 100 * row.corrupt / max(row.frames + row.corrupt, 1)
                       for row in rows], float)
    axes.plot(range(len(rows)), ratios, color=plots.SENT, marker="o", markersize=3.5)
    again = [index for index, row in enumerate(rows) if (row.reopened or 0) + (row.reboots or 0) > 0]
    axes.plot(again, ratios[again], color=plots.BAD, marker="x", linestyle="none", markersize=7)
    axes.set_ylim(0, max(0.1, 1.2 * float(np.nanmax(ratios))))
