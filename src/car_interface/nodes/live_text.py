"""Lines on a terminal that are drawn over when they change, below those that stay."""
from __future__ import annotations

import shutil
import sys
from typing import Sequence

from car_interface.ros.logs import LogStream

UP_AND_CLEAR = "\r\x1b[{}A\x1b[J"  # ECMA-48: cursor up, erase to the end of the screen
CLEAR = "\r\x1b[J"


class LiveText:
    """A block of lines at the end of the output. Where that is no terminal, only the lines that stay are printed.

    A block below which something else was printed, such as a line of the log, is left as it is.
    """

    def __init__(self):
        self.is_live = sys.stdout.isatty()
        self._drawn: list[str] = []
        self._writes = _writes()  # by whomever, after this one's last

    @property
    def width(self) -> int:
        """Return the columns of the terminal."""
        return shutil.get_terminal_size().columns

    def show(self, lines: Sequence[str]) -> None:
        """Draw the block anew, if it has changed. A block that is taller than the terminal is cut."""
        lines = list(lines)[:max(1, shutil.get_terminal_size().lines - 1)]
        erasure = self._erasure()
        if self.is_live and lines != self._drawn:
            self._write(erasure + "".join(f"{line}\n" for line in lines))
            self._drawn = lines

    def say(self, text: str) -> None:
        """Print lines that stay, above the block; it is drawn again by the next ``show``."""
        self._write((self._erasure() if self.is_live else "") + f"{text}\n")
        self._drawn = []

    def keep(self) -> None:
        """Leave the block as it is, and go on below."""
        self._drawn = []

    def _write(self, text):
        sys.stdout.write(text)
        self._writes = _writes()

    def _erasure(self):
        if _writes() != self._writes:
            self._drawn = []
        return UP_AND_CLEAR.format(len(self._drawn)) if self._drawn else CLEAR


def _writes():
    """Return how often this process has written to its terminal."""
    streams = [stream for stream in (sys.stdout, sys.stderr) if isinstance(stream, LogStream) and stream.isatty()]
    return sum(stream.written for stream in streams)
