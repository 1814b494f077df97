"""Refuses recordings that contain the same driving: a calibration would count its evidence twice."""
from __future__ import annotations

import os
from typing import NamedTuple, Sequence

import numpy as np

from car_interface.tools.recordings.recording import NoRecording
from car_interface.tools.recordings.signals import Signals

SAME_TIME_S = 1e-5  # odometry of two recordings at the same place within this time is the same message
MIN_SAME = 50  # so many messages alike are no coincidence


class Trail(NamedTuple):
    """Where the car was, on the computer's clock; all columns have the shape (N,)."""

    path: str
    t_s: np.ndarray  # ROS time
    x_m: np.ndarray
    y_m: np.ndarray


def trail(signals: Signals) -> Trail:
    """Return the trail of a recording with odometry, without the samples at which the car stood still."""
    odom = signals.odom
    moves = np.concatenate(([False], (np.diff(odom.x_m) != 0) | (np.diff(odom.y_m) != 0)))
    return Trail(signals.path, *(column[moves] for column in (signals.start_s + odom.t_s, odom.x_m, odom.y_m)))


def check_paths_differ(paths: Sequence[str]) -> None:
    """Raise NoRecording with both names when a file is given twice."""
    seen: dict = {}
    for path in paths:
        real = os.path.realpath(path)
        if real in seen:
            raise NoRecording(f"{seen[real]} and {path} are the same recording: it would count twice")
        seen[real] = path


def check_no_overlap(trails: Sequence[Trail]) -> None:
    """Raise NoRecording with the names of two that have driving in common, such as a copy or a part of another one.

    Times alone don't show it: a computer without a battery-backed clock may start at the same time again.
    """
    for index, one in enumerate(trails):
        for other in trails[:index]:
            same = _count_same(one, other)
            if same >= MIN_SAME:
                raise NoRecording(f"{other.path} and {one.path} have the same driving in them, at {same} moments "
                                  "of odometry: it would count twice")


def _count_same(one, other):
    if not (one.t_s.size and other.t_s.size):
        return 0
    nearest = np.clip(np.searchsorted(other.t_s, one.t_s - SAME_TIME_S), 0, other.t_s.size - 1)
    same = ((np.abs(other.t_s[nearest] - one.t_s) <= SAME_TIME_S) & (other.x_m[nearest] == one.x_m)
            & (other.y_m[nearest] == one.y_m))
    return int(same.sum())
