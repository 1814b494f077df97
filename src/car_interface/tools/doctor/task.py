"""A probe in a thread of its own, so that one that hangs doesn't block the doctor."""
from __future__ import annotations

import threading
import time
from typing import Any, Callable

from car_interface.tools.doctor.checks.findings import BAD, Finding


class Task:
    """Runs one probe in a thread of its own.

    Args:
        subject: of the finding when it hangs or fails.
        probe: returns the result.
        arguments: what ``probe`` takes.
    """

    def __init__(self, subject: str, probe: Callable[..., Any], *arguments: Any):
        self._subject = subject
        self._result: Any = None
        self._fault: Exception | None = None
        self._probe = lambda: probe(*arguments)
        self._ended = threading.Event()
        threading.Thread(target=self._run, name=subject, daemon=True).start()

    def _run(self):
        try:
            self._result = self._probe()
        except Exception as error:  # no fault of one probe may end the others
            self._fault = error
        self._ended.set()

    def wait(self, deadline_s: float) -> tuple[Any, list[Finding]]:
        """The result, or ``None`` and what went wrong, at the latest when the monotonic clock reaches the deadline."""
        while not self._ended.wait(0.02):
            if time.monotonic() >= deadline_s:
                return None, [Finding(BAD, self._subject, "no answer in time: given up",
                                      "See whether this computer is overloaded or a device hangs: top, dmesg")]
        if self._fault is not None:
            return None, [Finding(BAD, self._subject, f"the doctor couldn't look at it: {type(self._fault).__name__}: "
                                                      f"{self._fault}", "See the line of the versions first")]
        return self._result, []

    def findings(self, deadline_s: float) -> list[Finding]:
        """The result of a probe that returns findings, or what went wrong."""
        result, trouble = self.wait(deadline_s)
        return trouble or result
