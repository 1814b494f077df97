"""Single key presses from the terminal that a node runs in, if it is in the foreground there."""
from __future__ import annotations

import os
import select
import signal
import sys
import termios
import threading
import tty

NO_FD = -1  # standard input is closed


class Keys:
    """Reads keys without Enter while the node is its terminal's foreground process group.

    Under roslaunch it isn't, although its standard input is a terminal: then nothing is read or changed.
    """

    def __init__(self, fd: int | None = None):
        if fd is None:
            fd = sys.stdin.fileno() if sys.stdin is not None else NO_FD
        self._fd = fd
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
