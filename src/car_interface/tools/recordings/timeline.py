"""The time scale of a recording: seconds since its first message that never run back."""
from __future__ import annotations

from car_interface.common.units import NS_PER_S

STEP_BACK_S = 1.0  # the recorder's own time goes back by more only when the computer's clock was set
BREAK_S = 10.0  # from what was recorded before such a step to what was recorded after it


class Timeline:
    """Converts ROS time to seconds since the first message.

    Where the clock was set back, all that follows is moved behind what was recorded before.

    Attributes:
        start_ns: ROS time of the first message.
        last_s: of the newest message.
    """

    def __init__(self):
        self.start_ns = 0
        self.last_s = 0.0
        self._shift_s = 0.0
        self._steps = []  # (time in s, step back in s)
        self._has_started = False

    def recorded_s(self, time_ns: int) -> float:
        """The time at which a message was recorded; called once for each message, in order."""
        if not self._has_started:
            self.start_ns, self._has_started = time_ns, True
        now_s = (time_ns - self.start_ns) / NS_PER_S + self._shift_s
        if now_s < self.last_s - STEP_BACK_S:
            self._steps.append((self.last_s, self.last_s - now_s))
            self._shift_s += self.last_s - now_s + BREAK_S
            now_s = self.last_s + BREAK_S
        self.last_s = max(self.last_s, now_s)
        return now_s

    def stamped_s(self, time_ns: int) -> float:
        """The time of a stamp in the newest message."""
        return (time_ns - self.start_ns) / NS_PER_S + self._shift_s

    def notes(self) -> tuple[str, ...]:
        """A line for each time that the clock was set back."""
        return tuple(f"the computer's clock was set back by {back_s:.1f} s, {at_s:.1f} s after the start: what follows "
                     "counts as another drive" for at_s, back_s in self._steps)
