"""The golden capture's frames, and a serial line on which they are sent."""
from __future__ import annotations

import json
import os
import tty
from pathlib import Path
from typing import Iterator

DATA = Path(__file__).resolve().parents[1] / "data"
WHEELS, SONAR = 7, 6  # the firmware's commands
MAX_SONAR_FRAME = 26  # bytes, each escaped


def captured(*commands: int) -> Iterator[bytes]:
    """Yield the capture's frames of these commands, each with both its flags."""
    capture = (DATA / "capture_mixed.bin").read_bytes()
    for text in (DATA / "capture_mixed.jsonl").read_text(encoding="utf-8").splitlines():
        frame = json.loads(text)
        if frame["cmd"] in commands:
            yield capture[frame["start"]:frame["end"] + 1]


class Line:
    """A pseudo-terminal at a link. When its reader is too slow bytes are lost, as on a real line."""

    def __init__(self, link: str):
        self._near, self._far = os.openpty()
        tty.setraw(self._far)
        os.set_blocking(self._near, False)
        if os.path.islink(link):
            os.unlink(link)
        os.symlink(os.ttyname(self._far), link)

    def send(self, data: bytes) -> None:
        try:
            os.write(self._near, data)
        except BlockingIOError:
            pass

    def drain(self) -> None:
        try:
            os.read(self._near, 4096)
        except BlockingIOError:
            pass
