"""Shows the table of all drives: as a page of HTML with trends, and as CSV."""
from __future__ import annotations

import math
import time
from collections import Counter
from types import MappingProxyType
from typing import Mapping, Sequence

from car_interface.common.units import NS_PER_S
from car_interface.tools.report.drives_row import Row
from car_interface.tools.report.html import MIN_DATE_NS, date_text, ratio_text, render, span_text

CSV_COLUMNS = ("recording", "start_utc", "duration_s", "distance_km", "gamepad_s", "planner_s", "losses",
               "losses_by_cause", "straight_per_m", "left_ratio", "right_ratio", "map_drive_mps2", "map_hold_mps2",
               "map_brake_mps2", "battery_min_v", "frames", "corrupt_frames", "port_reopened", "teensy_reboots",
               "pings_unanswered",
               "faults", "errors", "cant_tell", "notes", "error")
# A spreadsheet takes a cell that begins with one of these for a formula (OWASP, CSV Injection), and names and causes
# come from other people's recordings. The last five: the full-width = + - @ of Japanese keyboards, and the minus sign.
FORMULA_STARTS = ("=", "+", "-", "@", "\t", "\r", "\n", "\uff1d", "\uff0b", "\uff0d", "\uff20", "\u2212")
TEXT_MARK = "'"  # in a spreadsheet: what follows is text


def in_order(rows: Sequence[Row]) -> list[Row]:
    """Return the rows by date; those that couldn't be read come last."""
    return sorted(rows, key=lambda row: (row.start_ns is None, row.start_ns or 0, row.path))


def page(folder: str, rows: Sequence[Row], trends: str,
         reports: Mapping[str, str] = MappingProxyType({})) -> str:
    """Return the page on a folder, by rows in order, trends as SVG (empty = none), and the URLs of the pages about
    recordings, by their paths.
    """
    drives = [row for row in rows if not row.error]
    bad = [row for row in rows if row.error]
    dates = [date_text(row.start_ns) for row in drives if row.start_ns >= MIN_DATE_NS]
    return render("drives.html", title=f"Drives in {folder}", dates=dict.fromkeys(dates[:1] + dates[-1:]),
                  figures=_figures(drives), drives=[(row, _cells(row)) for row in reversed(drives)], bad=bad,
                  trends=trends, reports={row.path: reports[row.path] for row in drives if row.path in reports})


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
    return [[date_text(row.start_ns)[:-len(":00 UTC")] if row.start_ns >= MIN_DATE_NS else "no date"],
            [*distance, span_text(row.duration_s)],
            unknown if row.gamepad_s is None else drivers or ["nobody"],
            unknown if row.losses is None else losses or ["none"],
            [*_steering(row)] or unknown, by_map or unknown,
            unknown if row.battery_v is None else [f"{row.battery_v:.2f} V"],
            unknown if row.frames is None else [*_link(row)]]


def _steering(row):
    if row.straight_per_m is not None:
        side = "" if abs(row.straight_per_m) < 0.0005 else " left" if row.straight_per_m > 0 else " right"
        yield f"straight on: {abs(row.straight_per_m):.3f} 1/m{side}"
    for side, ratio in (("left", row.left_ratio), ("right", row.right_ratio)):
        if ratio is not None:
            wider = 1 / ratio if ratio else math.inf  # 0: it went straight on
            yield f"{side}: {ratio_text(wider, 'the tables', 'wider', 'tighter').replace(' than the tables', '')}"


def _link(row):
    yield f"{row.corrupt} of {row.frames + row.corrupt} frames corrupt"
    for count, what in ((row.reopened, "port opened again"), (row.reboots, "Teensy started anew"),
                        (row.unanswered, "pings unanswered")):
        if count:
            yield f"{what}: {count}"


def csv_text(rows: Sequence[Row]) -> str:
    """Return the rows as CSV; an empty cell = the recording can't tell.

    Texts are in quotation marks, and none is a formula for a spreadsheet: see FORMULA_STARTS. Numbers are neither
    quoted nor marked.
    """
    lines = [",".join(CSV_COLUMNS)]
    for row in rows:
        losses = row.losses
        has_date = row.start_ns is not None and row.start_ns >= MIN_DATE_NS
        lines.append(",".join(map(_csv_cell, (
            row.path, time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime(row.start_ns / NS_PER_S)) if has_date else None,
            _rounded(row.duration_s, 3), _rounded(row.distance_m and row.distance_m / 1000, 6),
            _rounded(row.gamepad_s, 3), _rounded(row.planner_s, 3), None if losses is None else sum(losses.values()),
            None if losses is None else "; ".join(f"{cause}: {count}" for cause, count in sorted(losses.items())),
            row.straight_per_m, row.left_ratio, row.right_ratio, row.drive_mps2, row.hold_mps2, row.brake_mps2,
            row.battery_v, row.frames, row.corrupt, row.reopened, row.reboots, row.unanswered, row.faults, row.errors,
            "; ".join(row.lacks), "; ".join(row.notes), row.error))))
    return "\n".join(lines) + "\n"


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
