"""The recordings in a folder, and how to tell whether one has changed."""
from __future__ import annotations

import os
from typing import NamedTuple

from car_interface.tools.recordings.recording import METADATA, ROS2_SUFFIXES

# A bag that is being recorded, or whose recorder was killed, has the second one.
ROS1_SUFFIXES = (".bag", ".bag.active")
ORIGINAL = ".orig"  # rosbag reindex keeps a damaged a.bag as a.orig.bag


class Fingerprint(NamedTuple):
    """A recording with another one has changed."""

    size: int  # bytes
    mtime_ns: int


def find_recordings(folder: str) -> list[str]:
    """The paths of all recordings in a folder and below it, relative to it, in order.

    A ROS 2 bag is its folder, or a file that lies in no such folder. Left out are hidden folders, and what rosbag
    reindex has kept of a recording that it repaired.

    Raises:
        OSError: the folder can't be read.
    """
    found = []
    for place, folders, files in os.walk(folder, onerror=_raise_for(folder)):
        if METADATA in files and any(name.endswith(ROS2_SUFFIXES) for name in files):
            found.append(os.path.relpath(place, folder))
            folders.clear()
            continue
        folders[:] = [name for name in folders if not name.startswith(".")]
        found += [os.path.relpath(os.path.join(place, name), folder) for name in files
                  if name.endswith((*ROS1_SUFFIXES, *ROS2_SUFFIXES)) and not _is_original(name, files)]
    return sorted(found)


def fingerprint(path: str) -> Fingerprint:
    """Size and time of change of a recording: of a folder those of all its files together.

    Raises:
        OSError: it is gone.
    """
    paths = [path]
    if os.path.isdir(path):
        paths = [os.path.join(path, name) for name in sorted(os.listdir(path))]
    stats = [os.stat(one) for one in paths]
    return Fingerprint(sum(one.st_size for one in stats), max((one.st_mtime_ns for one in stats), default=0))


def _is_original(name, files):
    """Whether the repaired recording lies beside it."""
    stem, suffix = os.path.splitext(name)
    return stem.endswith(ORIGINAL) and stem[:-len(ORIGINAL)] + suffix in files


def _raise_for(folder):
    """What os.walk does on a folder that it can't read: below the first one it goes on with the others."""
    def on_error(error):
        if error.filename == folder:
            raise error
    return on_error
