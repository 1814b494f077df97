"""How often a node reads parameters that it refuses again, and when it logs that. Pure."""
from __future__ import annotations

from car_interface.common.units import NS_PER_S

FIRST_PAUSE_S, MAX_PAUSE_S = 1, 30
LOG_PERIOD_NS = 300 * NS_PER_S


class RefusedParameters:
    """The refusals of one start: pauses that double from 1 s to 30 s, and a line when the reason changes.

    The line comes again every five minutes, for those who look at a terminal on which other lines followed.
    """

    def __init__(self):
        self._text = ""
        self._log_ns = 0
        self._pause_s = FIRST_PAUSE_S
        self.due_ns = 0  # when to read the parameters again

    def update(self, text: str, now_ns: int) -> str:
        """Note that the parameters were refused at ``now_ns`` for this reason; the line to log, or an empty one.

        A new reason means that somebody is repairing them: the pauses begin anew.
        """
        is_new = text != self._text
        if is_new:
            self._text, self._pause_s = text, FIRST_PAUSE_S
        pause_s = self._pause_s
        self.due_ns = now_ns + pause_s * NS_PER_S
        self._pause_s = min(2 * pause_s, MAX_PAUSE_S)
        if not is_new and now_ns < self._log_ns:
            return ""
        self._log_ns = now_ns + LOG_PERIOD_NS
        later = f", later every {MAX_PAUSE_S} s" if pause_s < MAX_PAUSE_S else ""
        return f"{text}. This node waits, and reads its parameters again in {pause_s} s{later}"
