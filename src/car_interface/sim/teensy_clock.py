"""The simulated Teensy's clock, and deadlines as its firmware compares them.

True time is ``int`` nanoseconds and never runs back; "tick" is the firmware's own millisecond count, not wrapped;
``millis()`` and ``micros()`` are wrapped at 2**32.
"""
from __future__ import annotations

NS_PER_US, NS_PER_MS = 1_000, 1_000_000
NEVER_NS = 1 << 63
AT_ONCE_NS = -NEVER_NS
UINT32 = 0xFFFFFFFF


class Clock:
    """``millis()`` and ``micros()`` of a crystal that is a little off.

    Args:
        start_ms: its value at ``start_ns``.
        drift_ppm: how much too fast it runs at that time.
        ramp_ppm_per_h: how much faster still it runs each hour after.
    """

    def __init__(self, start_ms: int, drift_ppm: float, ramp_ppm_per_h: float, start_ns: int):
        self._start_device_ns = start_ms * NS_PER_MS
        self._drift_ppb = round(drift_ppm * 1000)
        self._half_ramp_per_ns = 0.5 * ramp_ppm_per_h * 1e-6 / 3600e9
        self._start_ns = start_ns

    def device_ns(self, now_ns: int) -> int:
        elapsed_ns = now_ns - self._start_ns
        gained_ns = elapsed_ns * self._drift_ppb // 1_000_000_000
        if self._half_ramp_per_ns:
            gained_ns += int(self._half_ramp_per_ns * elapsed_ns * elapsed_ns)
        return self._start_device_ns + elapsed_ns + gained_ns

    def tick(self, now_ns: int) -> int:
        return self.device_ns(now_ns) // NS_PER_MS

    def millis(self, now_ns: int) -> int:
        return self.tick(now_ns) & UINT32

    def micros(self, now_ns: int) -> int:
        """Return whole microseconds, modulo 2**32: wraps every 71.58 minutes."""
        return self.device_ns(now_ns) // NS_PER_US & UINT32

    def reaches_ns(self, tick: int, now_ns: int) -> int:
        """Return the first true time from ``now_ns`` on at which the clock is at ``tick`` or past it."""
        return self.after_ns(tick * NS_PER_MS - self.device_ns(now_ns), now_ns)

    def after_ns(self, span_ns: int, now_ns: int) -> int:
        """Return the first true time at which ``span_ns`` of the clock's own have passed since ``now_ns``."""
        target_ns = self.device_ns(now_ns) + span_ns
        at_ns = now_ns
        # Each round shrinks the error by the drift, some 1e-4: three leave less than 1 ns of any wait.
        for _ in range(3):
            at_ns += target_ns - self.device_ns(at_ns)
        while self.device_ns(at_ns) < target_ns:
            at_ns += 1
        return at_ns

    def passes_ns(self, deadline_ms: int, now_ns: int) -> int:
        """Return when ``millis() > deadline_ms`` becomes true.

        The firmware compares like this: a deadline beyond the wrap has passed already.
        """
        left_ms = deadline_ms - self.millis(now_ns)
        if left_ms < 0:
            return now_ns
        if deadline_ms == UINT32:
            return NEVER_NS
        return self.reaches_ns(self.tick(now_ns) + left_ms + 1, now_ns)


class Deadline:
    """A time that the loop waits for, compared with ``millis()`` as the firmware compares."""

    def __init__(self, clock: Clock, wait_ms: int, now_ns: int):
        self._clock = clock
        self._deadline_ms = clock.millis(now_ns) + wait_ms & UINT32
        self.due_ns = clock.passes_ns(self._deadline_ms, now_ns)  # when it will have passed; the loop checks then

    def has_passed(self, now_ns: int) -> bool:
        """Return whether it has passed. Beyond the wrap it seems so until ``millis()`` has wrapped as well."""
        if now_ns >= self.due_ns:
            self.due_ns = self._clock.passes_ns(self._deadline_ms, now_ns)
        return now_ns >= self.due_ns
