"""The recordings that a phone begins and ends, their reports, and which files of the folder a page may have."""
from __future__ import annotations

import os
import shutil
from contextlib import suppress
from typing import Any, Callable

from car_interface.common.errors import CarInterfaceError
from car_interface.common.units import NS_PER_S
from car_interface.nodes.bag_recording import TOPICS, BagPage, BagRecording
from car_interface.ros.inbox import Inbox
from car_interface.teleop.phone_messages import FILE_NAME, number

# Beside what a calibration's recording has: who asks for what.
ALL_TOPICS = (*TOPICS, "drive", "cmd_vel", "av_turnrad_req", "control/command/control_cmd", "control/command/gear_cmd",
              "battery_state")
# A full disk ends more than the recording: 0.1 MB a second, so that an hour is left.
MIN_FREE_BYTES = 500_000_000
MAX_SHOWN = 12
MB = 1e6
OFF, STARTING, ON, CLOSING, REPORT = "off", "starting", "on", "closing", "report"


def default_folder() -> str:
    """Return the folder of this user: below ROS_HOME, or ~/.ros."""
    home = os.environ.get("ROS_HOME") or os.path.join(os.path.expanduser("~"), ".ros")
    return os.path.join(home, "car_interface", "recordings")


class Recordings:
    """The folder, and what is being recorded; ``free_bytes`` are those of the disk with a folder."""

    def __init__(self, folder: str, inbox: Inbox, make_recording=BagRecording, make_page=BagPage,
                 free_bytes: Callable[[str], int] = lambda folder: shutil.disk_usage(folder).free):
        self._folder, self._inbox = folder, inbox
        self._make_recording, self._make_page, self._free_bytes = make_recording, make_page, free_bytes
        self._recording: Any = None
        self._page: Any = None
        self._begun_ns = 0
        self._text = ""

    def begin(self, now_ns: int) -> str:
        """Begin a recording; return a line about it.

        Raises:
            CarInterfaceError: it can't begin.
        """
        if self._recording is not None:
            raise CarInterfaceError("a recording is running already" if self._page is None else
                                    "the last one is being closed")
        try:
            os.makedirs(self._folder, exist_ok=True)
            self._check_disk()
            topics = [self._inbox.resolve_name(topic) for topic in dict.fromkeys(ALL_TOPICS)]
            self._recording = self._make_recording(self._folder, topics)
        except OSError as error:
            raise CarInterfaceError(f"no recording: {error}") from error
        self._begun_ns, self._text = now_ns, ""
        return f"recording {self._name}"

    def end(self) -> str:
        """End the recording, and have its report made; return a line about it.

        Raises:
            CarInterfaceError: there is none.
        """
        if self._recording is None or self._page is not None:
            raise CarInterfaceError("no recording is running")
        self._page = self._make_page(self._recording)
        return f"{self._name} is being closed; its report follows"

    def step(self) -> None:
        """Look how far it is; to be called some times a second."""
        if self._page is not None:
            lines = self._page.step()
            if lines is not None:
                self._text = "; ".join(filter(None, (self._text, lines[-1])))
                self._recording = self._page = None
        elif self._recording is not None and self._recording.has_ended:
            self._text = "the recording has ended by itself: rosrun rosbag record says why"
            self._recording = None
        elif self._recording is not None:
            try:
                self._check_disk()
            except (CarInterfaceError, OSError) as error:
                self.end()
                self._text = str(error)

    def close(self) -> None:
        """End the recording, without a report that isn't there yet. To be called at the node's end."""
        if self._page is not None:
            self._page.close()
        elif self._recording is not None:
            self._recording.stop()

    def state(self, now_ns: int) -> dict[str, Any]:
        """Return how far it is, as JSON has it."""
        if self._recording is None:
            return {"state": OFF, "name": "", "age": None, "size": None, "text": self._text}
        size = _size(self._recording.path + ".active") or _size(self._recording.path)
        if self._page is None:
            state, text = (STARTING, "rosbag starts") if size is None else (ON, "recording")
        else:
            state, text = ((REPORT, "the report is being made") if self._recording.has_ended else
                           (CLOSING, "it is being closed"))
        return {"state": state, "name": self._name, "age": (now_ns - self._begun_ns) // NS_PER_S,
                "size": None if size is None else number(size / MB, 1), "text": text}

    def files(self) -> list[dict[str, Any]]:
        """Return the newest recordings that are closed, and their reports."""
        found = []
        with suppress(OSError):
            for entry in os.scandir(self._folder):
                if FILE_NAME.fullmatch(entry.name) and entry.is_file(follow_symlinks=False):
                    found.append((entry.stat(follow_symlinks=False), entry.name))
        names = {name for _, name in found}
        bags = sorted(((status.st_mtime, name, status.st_size) for status, name in found if name.endswith(".bag")),
                      reverse=True)
        return [{"name": name, "size": number(size / MB, 1),
                 "report": report if (report := f"{name[:-len('.bag')]}.html") in names else ""}
                for _, name, size in bags[:MAX_SHOWN]]

    def path_of(self, name: str) -> str | None:
        """Return where a file of the folder is; None: there is none, or it is a link."""
        path = os.path.join(self._folder, name)
        return path if FILE_NAME.fullmatch(name) and os.path.isfile(path) and not os.path.islink(path) else None

    @property
    def _name(self):
        return os.path.basename(self._recording.path)

    def _check_disk(self):
        if self._free_bytes(self._folder) < MIN_FREE_BYTES:
            raise CarInterfaceError("the disk is nearly full: nothing is recorded")


def _size(path):
    try:
        return os.path.getsize(path)
    except OSError:
        return None
