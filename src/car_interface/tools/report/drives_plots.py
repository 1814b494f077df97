"""Draws how a car changed from drive to drive: trends over its recordings, as the text of an SVG."""
from __future__ import annotations

import time
from collections import Counter
from typing import Sequence

import matplotlib
import numpy as np
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

from car_interface.common.units import NS_PER_S
from car_interface.tools.report.drives_row import Row
from car_interface.tools.report.figures import (
    BAD,
    FAINT,
    REQUESTED,
    SENT,
    STYLE,
    WIDTH_IN,
    label_text,
    legend,
    svg_text,
    title,
)
from car_interface.tools.report.html import MIN_DATE_NS

NAME, DESCRIPTION = "trends", "distance, losses, steering, value map and link errors from drive to drive"
MAX_LABELS = 8  # of drives
MAX_CAUSES = 5  # that have a colour of their own
MAP_COLUMNS = {"drive_mps2": ("driving", SENT), "hold_mps2": ("holding the speed", FAINT),
               "brake_mps2": ("braking", BAD)}
CAUSE_COLOURS = ("#c0392b", "#d9822b", "#2f6fb3", "#1b9e77", "#8e5ea2", "#b8bfc7")


def trends(rows: Sequence[Row]) -> str:
    """Return the SVG of at least two drives, in the order of ``rows``; empty where there is nothing to draw."""
    panels = [draw for draw, is_known in (
        (_distance, lambda row: row.distance_m is not None), (_losses, lambda row: row.losses is not None),
        (_center, lambda row: row.straight_per_m is not None),
        (_sides, lambda row: row.left_ratio is not None or row.right_ratio is not None),
        (_map, lambda row: any(getattr(row, name) is not None for name in MAP_COLUMNS)),
        (_link, lambda row: row.frames is not None)) if any(map(is_known, rows))]
    if len(rows) < 2 or not panels:
        return ""
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH_IN, 1.75 * len(panels) + 0.7), constrained_layout=True)
        FigureCanvasSVG(figure)
        all_axes = figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
        for draw, axes in zip(panels, all_axes):
            draw(axes, rows)
        _label(all_axes[-1], rows)
        return svg_text(figure, NAME, DESCRIPTION)


def _distance(axes, rows):
    title(axes, "Distance in m")
    heights = _column(rows, lambda row: row.distance_m)
    axes.bar(range(len(rows)), heights, color=SENT, width=0.7)
    _mark_zeros(axes, heights)
    axes.set_ylim(0, max(1.0, 1.08 * float(np.nanmax(heights))))


def _losses(axes, rows):
    title(axes, "Lost or locked while somebody drove, times")
    total = sum((Counter(row.losses or {}) for row in rows), Counter())
    shown = [cause for cause, _ in total.most_common(MAX_CAUSES)]
    bottom = np.zeros(len(rows))
    for cause, colour in zip([*shown, None], CAUSE_COLOURS):
        heights = np.array([sum(count for name, count in (row.losses or {}).items()
                                if name == cause or cause is None and name not in shown) for row in rows], float)
        if heights.any():
            axes.bar(range(len(rows)), heights, bottom=bottom, color=colour, width=0.7,
                     label=label_text(cause or "others"))
            bottom += heights
    _mark_zeros(axes, np.where([row.losses is None for row in rows], np.nan, bottom))
    axes.set_ylim(0, max(1.0, 1.15 * bottom.max()))
    axes.yaxis.get_major_locator().set_params(integer=True)
    legend(axes)


def _mark_zeros(axes, heights):
    """Draw a point where a bar would have no height; without a bar and a point nothing is known (NaN)."""
    at = np.flatnonzero(heights == 0)
    if at.size:  # not clipped and empty would have no place for the layout
        axes.plot(at, np.zeros(at.size), color=FAINT, marker="o", markersize=3, linestyle="none", clip_on=False)


def _center(axes, rows):
    title(axes, "Driven when sent straight on: 1/radius in 1/m, left up")
    _line(axes, rows, lambda row: row.straight_per_m, SENT, "", least=0.01)


def _sides(axes, rows):
    title(axes, "Tighter than the tables say, in % of the radius")
    for colour, side, name in ((SENT, "left", "left_ratio"), (REQUESTED, "right", "right_ratio")):
        _line(axes, rows, lambda row, name=name: _tighter_percent(getattr(row, name)), colour, side, least=3.0)
    legend(axes)


def _map(axes, rows):
    title(axes, "Acceleration beyond what the planner requested, in m/s²")
    for name, (label, colour) in MAP_COLUMNS.items():
        _line(axes, rows, lambda row, name=name: getattr(row, name), colour, label, least=0.1)
    legend(axes)


def _link(axes, rows):
    title(axes, "Corrupt frames of the Teensy's link, in %; x: its port was opened again, or it started anew")
    ratios = _column(rows, lambda row: None if row.frames is None else
                     100 * row.corrupt / max(row.frames + row.corrupt, 1))
    axes.plot(range(len(rows)), ratios, color=SENT, marker="o", markersize=3.5)
    again = [index for index, row in enumerate(rows) if (row.reopened or 0) + (row.reboots or 0) > 0]
    axes.plot(again, ratios[again], color=BAD, marker="x", linestyle="none", markersize=7)
    axes.set_ylim(0, max(0.1, 1.2 * float(np.nanmax(ratios))))


def _line(axes, rows, number, colour, label, least):
    """Draw a line through what is known; the axis reaches at least as far as ``least`` to both sides of 0."""
    values = _column(rows, number)
    known = np.flatnonzero(~np.isnan(values))
    axes.axhline(0, color=FAINT, linewidth=0.9)
    if not known.size:
        return
    axes.plot(known, values[known], color=colour, marker="o", markersize=3.5, label=label or "_")
    largest = max(least, *np.abs(axes.get_ylim()), 1.15 * np.abs(values[known]).max())
    axes.set_ylim(-largest, largest)


def _label(axes, rows):
    """Put dates below some of the drives."""
    axes.set_xlim(-0.6, len(rows) - 0.4)
    step = -(-len(rows) // MAX_LABELS)
    shown = np.arange(len(rows) - 1, -1, -step)[::-1]  # evenly, so that none covers its neighbour; the newest has one
    axes.set_xticks(shown)
    axes.set_xticklabels([_date(rows[index]) for index in shown])


def _date(row):
    if row.start_ns is None or row.start_ns < MIN_DATE_NS:
        return "no date"
    return time.strftime("%Y-%m-%d\n%H:%M", time.gmtime(row.start_ns / NS_PER_S))


def _column(rows, number):
    """Return a number of each row (N,), NaN where it isn't known."""
    values = [number(row) for row in rows]
    return np.array([np.nan if value is None else value for value in values], float)


def _tighter_percent(ratio):
    """Return by how much the radius is less than the tables'; the table of drives has the same number.

    A car that hardly turns is drawn as 100 % wider, for the other drives to be seen.
    """
    if ratio is None:
        return None
    return max(-100.0, 100 * (1 - 1 / ratio)) if ratio else -100.0
