"""One recording as a row of the table of drives: what to compare from drive to drive."""
from __future__ import annotations

import math
from collections import Counter
from typing import Any, NamedTuple

from car_interface.report.faults import ERROR
from car_interface.report.summary import Summary
from car_interface.steering.arbiter import PLANNER, TELEOP

VERSION = 2  # of a row's content: rows of another version are computed again
MIN_SAMPLES = 30  # for a median


class Row(NamedTuple):
    """A recording. ``None``: the recording can't tell; all types are JSON's.

    Attributes:
        path: relative to the folder.
        error: why it can't be read; empty: it was read.
        start_ns, duration_s, distance_m: when, how long, how far by odometry.
        gamepad_s, planner_s: how long which of them steered.
        losses: how often something was lost or locked while somebody drove, by cause.
        straight_per_m: the curvature that the car drove when sent straight on, left positive: the center is off.
        left_ratio, right_ratio: the driven curvature to the sent one.
        drive_mps2, hold_mps2, brake_mps2: by how much the car accelerated more than the planner requested, where that
            was to drive, to hold the speed, to brake: the value map is off.
        frames, corrupt, reopened, reboots, unanswered: of the Teensy's link: good and corrupt frames, how often the
            port was opened again, how often the Teensy started anew, pings without an answer.
        faults, errors: how many, and how many of them are errors.
        lacks: what was not recorded, or not all of the time.
        notes: which topics were guessed.
    """

    path: str
    error: str = ""
    start_ns: int | None = None
    duration_s: float | None = None
    distance_m: float | None = None
    gamepad_s: float | None = None
    planner_s: float | None = None
    losses: Any = None
    straight_per_m: float | None = None
    left_ratio: float | None = None
    right_ratio: float | None = None
    drive_mps2: float | None = None
    hold_mps2: float | None = None
    brake_mps2: float | None = None
    frames: int | None = None
    corrupt: int | None = None
    reopened: int | None = None
    reboots: int | None = None
    unanswered: int | None = None
    faults: int | None = None
    errors: int | None = None
    lacks: Any = ()
    notes: Any = ()


def row(drive: Summary, path: str) -> Row:
    """The row of a summarized recording, which is shown as ``path``."""
    has_state, has_odom = bool(drive.steering.episodes), "odom" in drive.present
    source_s = drive.steering.source_s
    left, right = map(_median, drive.motion.by_tables.ratios())
    driving, holding, braking = map(_median, drive.motion.accelerating.differences_mps2())
    return Row(
        path=path, start_ns=drive.start_ns, duration_s=drive.duration_s,
        distance_m=drive.motion.distance_m if has_odom else None,
        gamepad_s=source_s[TELEOP] if has_state else None, planner_s=source_s[PLANNER] if has_state else None,
        losses=_losses(drive) if has_state or drive.throttle.episodes else None,
        straight_per_m=_median(drive.motion.by_tables.straight_per_m()), left_ratio=left, right_ratio=right,
        drive_mps2=driving, hold_mps2=holding, brake_mps2=braking, **_link(drive.teensy),
        **_faults(drive),
        lacks=[gap.lacks if math.isnan(gap.start_s) else f"{gap.lacks} for {gap.end_s - gap.start_s:.0f} s"
               for gap in drive.coverage.gaps()],
        notes=list(drive.notes))


def _losses(drive):
    """How often something was lost or locked, by cause."""
    lost = [*drive.steering.losses(), *drive.throttle.losses()]
    return dict(Counter(one.cause or one.reason for one in lost))


def _faults(drive):
    """How many faults there were; nobody knows where nothing was recorded that would tell of any."""
    found = drive.faults.entries
    if not found and drive.coverage.is_blind:
        return {}
    return {"faults": sum(fault.times for fault in found) + drive.faults.dropped,
            "errors": sum(fault.times for fault in found if fault.level == ERROR)}


def _link(teensy):
    """The columns of the Teensy's link."""
    first, last = teensy.first_link, teensy.link
    if last is None:
        return {}
    change = {name: getattr(last, field) - getattr(first, field) for name, field in (
        ("frames", "frames"), ("corrupt", "bad_frames"), ("reopened", "reconnects"), ("reboots", "reboots"),
        ("pings", "pings"), ("pongs", "pongs"))}
    # The newest ping may still be on its way.
    change["unanswered"] = max(0, change.pop("pings") - change.pop("pongs") - 1)
    return {name: int(count) for name, count in change.items()}


def _median(found):
    """A median in five decimals, no -0.0, if there are enough samples."""
    return round(found.median, 5) + 0.0 if found.samples >= MIN_SAMPLES else None
