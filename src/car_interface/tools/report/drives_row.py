"""Makes a recording a row of the table of drives: what to compare from drive to drive."""
from __future__ import annotations

import math
from collections import Counter
from typing import Any, NamedTuple, Sequence

from car_interface.common.sources import PLANNER, TELEOP
from car_interface.tools.report.faults import ERROR
from car_interface.tools.report.summary import Summary

VERSION = 4  # of a row's content: rows of another version are computed again
COUNT_BITS = 64  # times in ns, and the counters of messages, have no more
MAX_FIGURE = 1e12  # above any distance, duration or ratio that a car can have; page and plots can show so much


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
    left_ratio: float | None = None  # the driven curvature to the sent one
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


LENGTHS = ("duration_s", "distance_m", "gamepad_s", "planner_s", "battery_v")  # 0 or more, or unknown
LINK = ("frames", "corrupt", "reopened", "reboots", "unanswered")  # all known, or none


def _is_count(value):
    return type(value) is int and value.bit_length() <= COUNT_BITS  # not a bool, which is an int, too


def _is_figure(value):
    return type(value) in (int, float) and abs(value) <= MAX_FIGURE  # which NaN isn't


def _are_texts(value):
    return isinstance(value, list) and all(isinstance(text, str) for text in value)


IS_VALID = {  # what JSON may have for a field, if not null; the others are figures
    **dict.fromkeys(("start_ns", *LINK, "faults", "errors"), _is_count), "lacks": _are_texts, "notes": _are_texts,
    "losses": lambda value: isinstance(value, dict) and all(map(_is_count, value.values())),
}


def stored_row(values: Any, path: str) -> Row | None:
    """Return the row of ``path``, a recording that could be read, out of JSON; ``None``: it is no such row."""
    if not isinstance(values, list) or len(values) != len(Row._fields):
        return None
    known = {name: value for name, value in zip(Row._fields[2:], values[2:]) if value is not None}
    is_row = (values[:2] == [path, ""] and known.keys() >= {"start_ns", "duration_s", "lacks", "notes"}
              and all(IS_VALID.get(name, _is_figure)(value) for name, value in known.items())
              and all(known.get(name, 0) >= 0 for name in LENGTHS)
              and len(known.keys() & {*LINK}) in (0, len(LINK)) and ("faults" in known) == ("errors" in known))
    return Row(*values) if is_row else None


def row(drive: Summary, path: str) -> Row:
    """Return the row of a summarized recording, which is shown as ``path``."""
    has_state, has_odom = bool(drive.steering.episodes), "odom" in drive.present
    source_s = drive.steering.source_s
    turns, accelerating = drive.motion.by_tables, drive.motion.accelerating
    left, right, straight = map(_median, (turns.left, turns.right, turns.straight_per_m))
    lost, battery = [*drive.steering.losses(), *drive.throttle.losses()], drive.traces["battery voltage"]
    notes = list(drive.notes)
    if drive.calibration is not None:  # it drove by the table before
        left = right = straight = None
        notes.append("a calibration drive")
    return Row(
        path=path, start_ns=drive.start_ns, duration_s=drive.duration_s,
        distance_m=_possible(drive.motion.distance_m) if has_odom else None,
        gamepad_s=source_s[TELEOP] if has_state else None, planner_s=source_s[PLANNER] if has_state else None,
        losses=dict(Counter(one.cause or one.reason for one in lost)) if has_state or drive.throttle.episodes else None,
        straight_per_m=straight, left_ratio=left, right_ratio=right,
        drive_mps2=_median(accelerating.driving), hold_mps2=_median(accelerating.holding),
        brake_mps2=_median(accelerating.braking),
        battery_v=_possible(round(battery.minimum, 3)) if battery.count else None, **_link(drive.teensy),
        **_faults(drive),
        lacks=[gap.lacks if math.isnan(gap.start_s) else f"{gap.lacks} for {gap.end_s - gap.start_s:.0f} s"
               for gap in drive.coverage.gaps()],
        notes=notes)


def _faults(drive):
    """Return how many faults there were; unknown where nothing was recorded that reports any."""
    found = drive.faults.entries
    if not found and drive.coverage.is_blind:
        return {}
    return {"faults": sum(fault.times for fault in found) + drive.faults.dropped,
            "errors": sum(fault.times for fault in found if fault.level == ERROR)}


def _link(teensy):
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
    return None if median is None else _possible(round(median, 5) + 0.0)


def _possible(figure):
    """Return a figure; ``None`` instead of one that no car can have: its odometry is garbage."""
    return figure if _is_figure(figure) else None
