"""calibration_drive, begun and ended by a phone: a program beside the node, which is seen by its topics."""
from __future__ import annotations

import os
import re
import signal
import subprocess
import tempfile
from typing import Any, Sequence

from std_msgs.msg import Empty

from car_interface.common.errors import CarInterfaceError
from car_interface.msg import CalibrationState
from car_interface.nodes.bag_recording import ending_with_parent
from car_interface.ros.inbox import Inbox
from car_interface.ros.topics import advertise
from car_interface.teleop.phone_messages import number

OFF, STARTING, ON, OVER = "off", "starting", "on", "over"
# The driver has confirmed on the page that the table is replaced; the old one is kept beside it.
COMMAND = ("rosrun", "car_interface", "calibration_drive", "--yes")
TAIL_BYTES, TAIL_LINES = 4000, 8
LOG_PREFIX = re.compile(r"^(\x1b\[\d+m)?\[[A-Z]+\] \[[\d.]+\]: ", re.M)  # of rospy, in a terminal's colours
NOTHING_KNOWN = {"phase": "", "fraction": 0.0, "known": [], "missing": [], "driven": None, "left": None}


class Program:
    """A program, its newest output, and its end. It ends with this process, however that ends."""

    def __init__(self, command: Sequence[str], namespace: str):
        self._output = tempfile.TemporaryFile()  # noqa: SIM115 - it is read once the program has ended
        self._process = subprocess.Popen(
            [*ending_with_parent(), *command], stdin=subprocess.DEVNULL, stdout=self._output, stderr=subprocess.STDOUT,
            start_new_session=True, env={**os.environ, "ROS_NAMESPACE": namespace})

    @property
    def exit_code(self) -> int | None:
        """Return it; None while it runs."""
        return self._process.poll()

    def interrupt(self) -> None:
        """End it as Ctrl-C does; it closes its recording."""
        if self.exit_code is None:
            self._process.send_signal(signal.SIGINT)

    def tail(self) -> str:
        """Return the last lines of its output."""
        size = self._output.seek(0, os.SEEK_END)
        self._output.seek(max(0, size - TAIL_BYTES))
        lines = LOG_PREFIX.sub("", self._output.read().decode(errors="replace")).strip().splitlines()
        return "\n".join(lines[-TAIL_LINES:])


class CalibrationProgram:
    """Begins and ends calibration_drive, and shows how far it is, also of one that was begun in a terminal."""

    def __init__(self, inbox: Inbox, make_program=Program):
        self._inbox, self._make_program = inbox, make_program
        self._program: Any = None
        self._text = ""  # how the last one ended
        self._is_seen = self._awaits_silence = False  # its state; of one that has ended
        self._has_written = False  # a table that turn_arb doesn't have yet
        self._finish = advertise("calibration_drive/finish", Empty, inbox)

    def begin(self) -> str:
        """Begin it; return a line about it.

        Raises:
            CarInterfaceError: it can't begin.
        """
        if self._program is not None or self._is_seen:
            raise CarInterfaceError("calibration_drive is running already")
        try:
            self._program = self._make_program(
                [*COMMAND, f"odom:={self._inbox.resolve_name('odom')}"], self._inbox.graph.namespace())
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

    def step(self, state: CalibrationState | None) -> dict[str, Any]:
        """Return how far it is, as JSON has it, by its own newest state; None: it is silent."""
        self._is_seen = state is not None
        if self._program is not None and self._program.exit_code is not None:
            self._has_written = self._has_written or self._program.exit_code == 0
            self._text, self._program = self._program.tail(), None
            self._awaits_silence = True
        self._awaits_silence = self._awaits_silence and self._is_seen
        if state is not None and not self._awaits_silence:
            self._text = ""
            return {"state": ON, "phase": state.phase, "text": state.text, "fraction": number(state.fraction, 3),
                    "known": list(state.known), "missing": list(state.missing), "driven": number(state.driven, 0),
                    "left": number(state.left, 0)}
        if self._program is not None:
            return {**NOTHING_KNOWN, "state": STARTING, "text": "calibration_drive starts"}
        return {**NOTHING_KNOWN, "state": OVER if self._text else OFF, "text": self._text}

    def check_tuning(self) -> None:
        """Check that center and neutral may be changed.

        Raises:
            CarInterfaceError: it would spoil a calibration: one that is running plans by the center that it began with.
        """
        if self._program is not None or self._is_seen:
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
        if self._program is None and not self._is_seen:
            raise CarInterfaceError("calibration_drive is not running")
