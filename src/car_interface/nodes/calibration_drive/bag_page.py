"""Closes a bag and has bag_report make its page, beside a node that goes on meanwhile."""
from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from pathlib import Path

from car_interface.nodes.calibration_drive.bag_recording import BagRecording

# Where rosbags isn't among the system's libraries, as on Debian 12: docs/recordings.md, Install the tools.
TOOLS = "~/car_tools/bin/car-interface"


class BagPage:
    """The end of a recording: ``step`` until it says that it is over."""

    def __init__(self, recording: BagRecording):
        self._recording = recording
        self._process: subprocess.Popen | None = None
        self._output = None
        recording.begin_stop()

    def step(self) -> list[str] | None:
        """Go on; where bag and page are, once both are; ``None`` = not yet."""
        if not self._recording.has_ended:
            return None
        if not os.path.exists(self._recording.path):
            return ["no recording: rosbag wrote none (rosrun rosbag record says why)"]
        if self._process is None:
            self._output = tempfile.TemporaryFile()  # noqa: SIM115 - it is read once the process has ended
            self._process = subprocess.Popen([*_command(), self._recording.path], stdin=subprocess.DEVNULL,
                                             stdout=self._output, stderr=subprocess.STDOUT)
        if self._process.poll() is None:
            return None
        return [f"recording: {self._recording.path}", self._page_line()]

    def close(self) -> None:
        """Close the bag; no page any more, where it isn't there yet."""
        if self._process is not None and self._process.poll() is None:
            self._process.terminate()
        self._recording.stop()

    def _page_line(self):
        page = Path(self._recording.path).with_suffix(".html")
        if self._process.returncode == 0 and page.exists():
            return f"report: {page}"
        self._output.seek(0)
        lines = self._output.read().decode(errors="replace").strip().splitlines()
        return f"no report: {lines[-1] if lines else 'bag_report failed'}"


def _command():
    tools = os.path.expanduser(TOOLS)
    found = shutil.which("car-interface") or (tools if os.access(tools, os.X_OK) else None)
    return [found, "bag_report"] if found else ["rosrun", "car_interface", "bag_report"]
