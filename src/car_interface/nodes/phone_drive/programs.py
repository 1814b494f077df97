"""What a driver begins on the page beside driving: recordings with their reports, and calibration_drive.

Both are programs beside the node, which see the car by its topics.
"""
from __future__ import annotations

import math
import os
import shutil
from contextlib import suppress
from typing import Any, Callable

from std_msgs.msg import Empty

from car_interface.common.errors import CarInterfaceError
from car_interface.common.units import NS_PER_S
from car_interface.msg import CalibrationState
from car_interface.nodes.bag_recording import PLANNERS, TOPICS, BagRecording, Program
from car_interface.ros.inbox import Inbox
from car_interface.ros.topics import advertise, listen
from car_interface.teleop.phone_messages import FILE_NAME, number

# A full disk ends more than the recording: 0.1 MB a second, so that an hour is left.
MIN_FREE_BYTES = 500_000_000
MAX_SHOWN = 12
MB = 1e6
OFF, STARTING, ON, CLOSING, REPORT, OVER = "off", "starting", "on", "closing", "report", "over"
# The driver has confirmed on the page that the table is replaced; the old one is kept beside it.
CALIBRATION_DRIVE = ("rosrun", "car_interface", "calibration_drive", "--yes")
TAIL_LINES = 8
SILENT_S = 1.0  # of calibration_drive, which repeats its state 5 times a second


class Recordings:
    """The folder, and what is being recorded; ``free_bytes`` are those of the disk with a folder."""

    def __init__(self, folder: str, inbox: Inbox, make_recording=BagRecording,
                 free_bytes: Callable[[str], int] = lambda folder: shutil.disk_usage(folder).free):
        self._folder, self._inbox = folder, inbox
        self._make_recording, self._free_bytes = make_recording, free_bytes
        self._recording: Any = None
        self._begun_ns = 0
        self._text = ""

    def begin(self, now_ns: int) -> str:
        """Begin a recording; return a line about it.

        Raises:
            CarInterfaceError: it can't begin.
        """
        if self._recording is not None:
            raise CarInterfaceError("the last one is being closed" if self._recording.is_ending else
                                    "a recording is running already")
        try:
            os.makedirs(self._folder, exist_ok=True)
            self._check_disk()
            topics = list(map(self._inbox.resolve_name, (*TOPICS, *PLANNERS)))
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
        if self._recording is None or self._recording.is_ending:
            raise CarInterfaceError("no recording is running")
        self._recording.end()
        return f"{self._name} is being closed; its report follows"

    def step(self) -> None:
        """Look how far it is; to be called some times a second."""
        recording = self._recording
        if recording is None:
            return
        if recording.is_ending:
            lines = recording.report()
            if lines is not None:
                self._text, self._recording = "; ".join(filter(None, (self._text, lines[-1]))), None
        elif recording.has_ended:
            self._text, self._recording = "the recording has ended by itself: rosrun rosbag record says why", None
        else:
            try:
                self._check_disk()
            except (CarInterfaceError, OSError) as error:
                self.end()
                self._text = str(error)

    def close(self) -> None:
        """End the recording, without a report that isn't there yet. To be called at the node's end."""
        if self._recording is not None:
            self._recording.stop()

    def state(self, now_ns: int) -> dict[str, Any]:
        """Return how far it is, as JSON has it."""
        if self._recording is None:
            return {"state": OFF, "name": "", "age": None, "size": None, "text": self._text}
        size = _size(self._recording.path + ".active") or _size(self._recording.path)
        if not self._recording.is_ending:
            state, text = (STARTING, "rosbag starts") if size is None else (ON, "recording")
        else:
            state, text = ((REPORT, "the report is being made") if self._recording.has_ended else
                           (CLOSING, "it is being closed"))
        return {"state": state, "name": self._name, "age": (now_ns - self._begun_ns) // NS_PER_S,
                "size": None if size is None else number(size / MB, 1), "text": text}

    def files(self) -> list[dict[str, Any]]:
        """Return the newest recordings that are closed, and their reports."""
        found = {}
        with suppress(OSError):
            found = {name: os.stat(path) for name in os.listdir(self._folder) if (path := self.path_of(name))}
        bags = sorted((name for name in found if name.endswith(".bag")),
                      key=lambda name: (found[name].st_mtime, name), reverse=True)
        return [{"name": name, "size": number(found[name].st_size / MB, 1),
                 "report": report if (report := f"{name[:-len('.bag')]}.html") in found else ""}
                for name in bags[:MAX_SHOWN]]

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


class CalibrationProgram:
    """Begins and ends calibration_drive, and shows how far it is, also of one that was begun in a terminal."""

    def __init__(self, inbox: Inbox, make_program=Program):
        self._inbox, self._make_program = inbox, make_program
        self._program: Any = None
        self._text = ""  # how the last one ended
        self._state = listen("calibration_drive/state", CalibrationState, inbox, SILENT_S, wakes=False)
        self._is_seen = self._awaits_silence = False  # its state; of one that has ended
        self._has_written = False  # a table that turn_arb doesn't have yet
        self._finish = advertise("calibration_drive/finish", Empty, inbox)

    @property
    def _runs(self):
        return self._program is not None or self._is_seen

    def begin(self) -> str:
        """Begin it; return a line about it.

        Raises:
            CarInterfaceError: it can't begin.
        """
        if self._runs:
            raise CarInterfaceError("calibration_drive is running already")
        try:
            self._program = self._make_program([*CALIBRATION_DRIVE, f"odom:={self._inbox.resolve_name('odom')}"],
                                               ROS_NAMESPACE=self._inbox.graph.namespace())
        except OSError as error:
            raise CarInterfaceError(f"calibration_drive can't be started: {error}") from error
        self._text = ""
        return "calibration_drive starts"

    def finish(self) -> str:
        """Have it end with what is known; return a line about it."""
        self._check_running()
        self._finish.publish(Empty())
        return "it finishes with what is known"

    def give_up(self) -> str:
        """End it; return a line about it."""
        self._check_running()
        if self._program is None:
            raise CarInterfaceError("it was begun in a terminal: give it up there, with Q")
        self._program.interrupt()
        return "calibration_drive ends; nothing is written"

    def step(self, now_ns: int) -> dict[str, Any]:
        """Return how far it is, as JSON has it, by its own newest state."""
        state = self._state.fresh(now_ns)
        self._is_seen = state is not None
        if self._program is not None and self._program.exit_code is not None:
            self._has_written = self._has_written or self._program.exit_code == 0
            self._text, self._program = self._program.tail(TAIL_LINES), None
            self._awaits_silence = True
        self._awaits_silence = self._awaits_silence and self._is_seen
        if state is not None and not self._awaits_silence:
            self._text = ""
            return _shown(ON, state)
        kind, text = OVER if self._text else OFF, self._text
        if self._program is not None:
            kind, text = STARTING, "calibration_drive starts"
        return _shown(kind, CalibrationState(text=text, driven=math.nan, left=math.nan))

    def check_tuning(self) -> None:
        """Check that center and neutral may be changed.

        Raises:
            CarInterfaceError: it would spoil a calibration: one that is running plans by the center that it began with.
        """
        if self._runs:
            raise CarInterfaceError("calibration_drive is running: trim before it or after it")

    def check_saving(self) -> None:
        """Check that the tuned values may be saved.

        Raises:
            CarInterfaceError: it would spoil a calibration: with the center turn_arb saves the table that it runs on.
        """
        self.check_tuning()
        if self._has_written:
            raise CarInterfaceError("the file has a new table, which turn_arb would replace by its own: launch again "
                                    "first")

    def close(self) -> None:
        """End it with the node."""
        if self._program is not None:
            self._program.interrupt()

    def _check_running(self):
        if not self._runs:
            raise CarInterfaceError("calibration_drive is not running")


def _shown(kind, state):
    return {"state": kind, "phase": state.phase, "text": state.text, "fraction": number(state.fraction, 3),
            "known": list(state.known), "missing": list(state.missing), "driven": number(state.driven, 0),
            "left": number(state.left, 0)}
