"""A program in a terminal of its own: what it shows, what is typed, and the terminal's settings."""
from __future__ import annotations

import os
import pty
import re
import select
import subprocess
import termios
import threading
from contextlib import suppress

from waiting import Record, eventually

POLL_S = 0.1  # what a program has printed is readable by so long after its end


class Terminal:
    """A program that is the foreground process of a terminal of its own.

    Args:
        command: program and arguments.
        env: what its environment has besides, or in place of, the test's.
    """

    def __init__(self, *command: str, env: dict[str, str] | None = None):
        self.lines = Record(f"terminal of {command[0]}")
        self._master, terminal = pty.openpty()
        self.settings_before = self.settings()
        # setsid makes the terminal the program's own: this process has threads, and can't fork.
        self._process = subprocess.Popen(["setsid", "--ctty", *command], stdin=terminal, stdout=terminal,
                                         stderr=terminal, env={**os.environ, **(env or {})})
        os.close(terminal)
        self.pid = self._process.pid
        self._hangs_up, self._is_read = threading.Event(), threading.Event()
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def settings(self):
        return termios.tcgetattr(self._master)

    def wait_for_line(self, pattern, since=0):
        """The first line, from ``since`` on, in which the pattern is found."""
        return self.lines.wait_for(lambda line: re.search(pattern, line), since).what

    def type(self, keys):
        os.write(self._master, keys)

    def hang_up(self):
        """As if its window was closed."""
        self._hangs_up.set()
        self._reader.join()  # it is no hang-up while a read is under way, and the next terminal may get the number
        os.close(self._master)
        self._master = None

    def wait_for_exit(self, keys=b""):
        """The exit code; −n for signal n. All that the program has printed is read by then.

        ``keys`` are typed until then, over and over: the keyboard's node drops what was typed while it stood still.
        """
        def ended():
            is_running = self._process.poll() is None
            if keys and is_running:
                with suppress(OSError):  # it has closed the terminal
                    self.type(keys)
            return not is_running
        eventually(ended, f"the end of {self.lines.name}")
        self._is_read.wait()
        return self._process.returncode

    def clean_up(self):
        if self._process.poll() is None:
            self._process.kill()
            self.wait_for_exit()
        if self._master is not None:
            self.hang_up()

    def _read(self):
        rest, has_ended = b"", False
        while not self._hangs_up.is_set():
            if select.select([self._master], [], [], POLL_S)[0]:
                try:
                    data = os.read(self._master, 4096)
                except OSError:  # nobody has the terminal open any more
                    break
                *lines, rest = (rest + data).split(b"\n")
                for line in lines:
                    self.lines.add(line.decode(errors="replace").rstrip("\r"))
            elif has_ended:  # though another process of the program's still has the terminal
                self._is_read.set()
            else:
                has_ended = self._process.poll() is not None
        self._is_read.set()
