"""The terminal that a node runs in: single keys from it, and lines on it that are drawn over when they change."""
from __future__ import annotations

import os
import select
import shutil
import signal
import sys
import termios
import threading
import tty
from typing import Sequence

from car_interface.ros.logs import LogStream

UP_AND_CLEAR = "\r\x1b[{}A\x1b[J"  # ECMA-48: cursor up, erase to the end of the screen
CLEAR = "\r\x1b[J"
NO_FD = -1  # standard input is closed


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


class Keys:
    """Reads keys without Enter while the node is its terminal's foreground process group.

    Under roslaunch it isn't, although its standard input is a terminal: then nothing is read or changed.
    """

    def __init__(self):
        self._fd = NO_FD if sys.stdin is None else sys.stdin.fileno()
        self._saved = None
        self._continued = False  # after Ctrl-Z and fg the shell has reset the terminal's mode

    def start(self) -> bool:
        """Switch the terminal to single keys; return whether it can be. It can't for a node that shares its process."""
        if threading.current_thread() is not threading.main_thread() or not self._in_foreground():
            return False
        self._saved = termios.tcgetattr(self._fd)
        tty.setcbreak(self._fd)
        signal.signal(signal.SIGCONT, lambda *_: setattr(self, "_continued", True))
        return True

    def fileno(self) -> int:
        return self._fd

    def read(self) -> str | None:
        """Return the keys typed since the last call; ``None`` = the terminal hung up or is another program's by now."""
        if not self._in_foreground():
            return None
        try:
            if self._continued:
                self._continued = False
                tty.setcbreak(self._fd)
            waiting, _, _ = select.select([self._fd], [], [], 0)  # reading a terminal blocks until a key is typed
            if not waiting:
                return ""
            data = os.read(self._fd, 64)
            return data.decode("ascii", "ignore") if data else None
        except OSError:
            return None

    def is_closed(self) -> bool:
        """Return whether the terminal hung up, as opposed to being another program's for a while."""
        return not os.isatty(self._fd)

    def restore(self) -> None:
        if self._saved is not None and self._in_foreground():
            termios.tcsetattr(self._fd, termios.TCSADRAIN, self._saved)
        self._saved = None

    def _in_foreground(self):
        try:
            return os.isatty(self._fd) and os.tcgetpgrp(self._fd) == os.getpgrp()
        except OSError:
            return False
