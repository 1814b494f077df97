"""The folder of the black box: the names of its recordings, which one is the newest, and which have to go."""
from __future__ import annotations

import os
import re
import shlex
from contextlib import suppress
from dataclasses import dataclass
from typing import NamedTuple

from car_interface.common import atomic_file, causes, declared
from car_interface.common.own_files import make_folder

MAX_FILES, MAX_BYTES = 10, 50_000_000
TIME_FORMAT = "%Y-%m-%d_%H-%M-%S"
NAME = re.compile(r"\d{4}-\d\d-\d\d_\d\d-\d\d-\d\d_([a-z0-9_]+)(?:-\d+)?\.bag")
NEW = "black_box.bag"  # a recording that isn't complete yet; what a killed process leaves of it the next one removes
MINUTE_S, HOUR_S, DAY_S = 60, 3600, 86400


@dataclass(frozen=True)
class BlackBoxConfig:
    folder: str | None = declared.path("folder", None, "of the recordings",
                                       default_text="`~/.ros/car_interface/black_box`")


class Recording(NamedTuple):
    path: str
    cause: str  # of the stop
    written_s: float  # when, by the file system: the computer's clock may have been set since
    size_bytes: int

    @property
    def command(self) -> str:
        """Return the line to type for its report."""
        return f"rosrun car_interface bag_report {shlex.quote(self.path)}"

    def describe(self, now_s: float) -> str:
        """Return what it is of and how old: ``odometry silent, 12 minutes ago``."""
        age_s = now_s - self.written_s
        for unit_s, unit in ((DAY_S, "day"), (HOUR_S, "hour"), (MINUTE_S, "minute")):
            if age_s >= unit_s:
                count = int(age_s // unit_s)
                return f"{self.cause}, {count} {unit}{'s' if count > 1 else ''} ago"
        return f"{self.cause}, {'just now' if age_s >= 0 else 'by a clock that was set back since'}"


def default_folder(name: str = "black_box") -> str:
    """Return the folder of this user for recordings of some kind: below ROS_HOME, or ~/.ros."""
    home = os.environ.get("ROS_HOME") or os.path.join(os.path.expanduser("~"), ".ros")
    return os.path.join(home, "car_interface", name)


def recordings(folder: str) -> list[Recording]:
    """Return the black box's recordings in a folder, oldest first; none where it can't be read.

    A recording that was renamed is its owner's: it is neither counted nor removed.
    """
    found = []
    with suppress(OSError):
        for entry in os.scandir(folder):
            is_ours = NAME.fullmatch(entry.name)
            with suppress(OSError):  # removed just now
                if is_ours and entry.is_file(follow_symlinks=False):
                    status = entry.stat(follow_symlinks=False)
                    found.append(Recording(entry.path, _cause(is_ours[1]), status.st_mtime, status.st_size))
    return sorted(found, key=lambda one: (one.written_s, one.path))


def newest(folder: str) -> Recording | None:
    """Return the newest recording of a folder; ``None`` = there is none."""
    found = recordings(folder)
    return found[-1] if found else None


def store(folder: str, time_text: str, cause: str, data: bytes) -> str:
    """Write a recording, whole or not at all, and remove the oldest ones beyond 10, and beyond 50 MB in all.

    Args:
        time_text: of the stop, in TIME_FORMAT.

    Returns:
        Its path.

    Raises:
        OSError: it can't be written, and the others are still there.
    """
    make_folder(folder)
    new_path, path = os.path.join(folder, NEW), _free_path(folder, f"{time_text}_{_slug(cause)}")
    atomic_file.replace(new_path, data, keeps_old=False)
    os.replace(new_path, path)
    # The new one stays even if the others have later times: the clock may have been set back.
    others = [one for one in recordings(folder) if one.path != path]
    while others and (len(others) >= MAX_FILES or sum(one.size_bytes for one in others) + len(data) > MAX_BYTES):
        with suppress(OSError):  # somebody else removed it, or it isn't ours: the next one goes then
            os.unlink(others[0].path)
        del others[0]
    return path


def _free_path(folder, stem):
    path, count = os.path.join(folder, f"{stem}.bag"), 1
    while os.path.lexists(path):
        count += 1
        path = os.path.join(folder, f"{stem}-{count}.bag")
    return path


def _slug(cause):
    return re.sub("[^a-z0-9]+", "_", cause.lower())


def _cause(slug):
    return CAUSES.get(slug, slug.replace("_", " "))


CAUSES = {_slug(cause): cause for cause in (*causes.LOSSES, "turn_arb silent", "throttle_arb silent")}
