"""The simulated Teensy's wheels: hall pins, odometers, and the times of the firmware's reports."""
from __future__ import annotations

import struct
from collections import deque

from car_interface.sim.teensy_clock import AT_ONCE_NS, UINT32, Clock, Deadline

LEFT, RIGHT = 0, 1
FORWARD, BACKWARD, NO_DIRECTION = 0, 1, 2

SPEED_INTERVALS = 10  # the speed is an average over this many intervals between pulses
# The levels of a wheel's two hall pins (pin one + 2 × pin two) by the pulses modulo 4: a Gray code.
HALL_PINS = (0b00, 0b01, 0b11, 0b10)
MIN_REPORT_MS = 5  # no wheel report sooner than this after the one before
STANDING_CHECK_MS = 200  # a check whether the wheels stand comes when more than this has passed since the last one
WHEEL = struct.Struct("<HBBIII")  # speed, direction, reserved, when, dist, dist_abs


class Wheel:
    def __init__(self):
        self._pins = HALL_PINS[0]  # assumed at power-up, without reading them
        self._when_tick = 0
        self.reset()

    def reset(self):
        """Zero the odometer; the tick of the last pulse or repeat stays."""
        self._dist_abs = 0
        self._dist = 0
        self._direction = NO_DIRECTION
        self._window: deque[tuple[int, int]] = deque(maxlen=SPEED_INTERVALS + 1)  # (tick, pulses at that time)

    def interrupt(self, pin: int, levels: int, tick: int):
        """Handle a change of one pin: only its own bit is read, the other one keeps the value of its last interrupt.

        If the pins' true levels differ from the ones assumed at power-up, the first interrupts may change nothing: such
        a pulse counts in the last direction, also when there was none. Or they seem to turn the wheel the wrong way.
        """
        pins = self._pins & ~pin | levels & pin
        step = (HALL_PINS.index(pins) - HALL_PINS.index(self._pins)) % 4
        self._pins = pins
        self._dist_abs += 1
        direction = {1: FORWARD, 3: BACKWARD}.get(step, self._direction)
        if direction != self._direction:
            self._window.clear()
            self._direction = direction
            self._dist = self._dist_abs
        self._window.append((tick, self._dist_abs))
        self._when_tick = tick

    def repeat(self, tick: int):
        """Repeat the newest entry: the average falls to zero over a few repeats, not at once."""
        if self._window:
            self._window.append((tick, self._dist_abs))
            self._when_tick = tick

    def report(self) -> bytes:
        return WHEEL.pack(self._speed() & 0xFFFF, self._direction, 0, self._when_tick & UINT32, self._dist & UINT32,
                          self._dist_abs & UINT32)

    def _speed(self) -> int:
        """Return pulses a second, truncated, over the window; 0 with one entry, or with all of them in one tick."""
        if len(self._window) < 2:
            return 0
        (first_tick, first_count), (last_tick, last_count) = self._window[0], self._window[-1]
        if first_tick == last_tick:
            return 0
        return 1000 * (last_count - first_count) // (last_tick - first_tick)


class Axle:
    """Both rear wheels, and the times of their reports: with a pulse, but not too often; while standing, now and then.

    A pulse sooner than 5 ms after the last reported one has no report of its own: it waits for the next pulse or a
    repeat, and is counted as rotUpdSkip. Every 201 ms there is a check whether the last report is more than 200 ms old;
    then both wheels' newest entries are repeated. So the first repeat comes 201 to 402 ms after the last report.
    """

    def __init__(self, clock: Clock, counters: dict[str, int]):
        self.wheels = (Wheel(), Wheel())
        self._clock = clock
        self._counters = counters
        self._reported_tick = 0  # of the pulse or repeat that the last report was for
        self._has_news = True
        self._is_first = True
        self._check: Deadline | None = None

    @property
    def due_ns(self) -> int:
        """Return when the loop has something to do here."""
        return AT_ONCE_NS if self._has_news else self._check.due_ns

    def reset(self):
        for wheel in self.wheels:
            wheel.reset()

    def interrupt(self, side: int, pin: int, levels: int, tick: int):
        """Handle a change of a hall pin of one wheel."""
        self.wheels[side].interrupt(pin, levels, tick)
        if tick - self._reported_tick < MIN_REPORT_MS:
            self._counters["rotUpdSkip"] += 1
        else:
            self._announce(tick)

    def begin(self, now_ns: int):
        self._check = Deadline(self._clock, STANDING_CHECK_MS, now_ns)

    def report_when_due(self, now_ns: int) -> bytes | None:
        tick = self._clock.tick(now_ns)
        if self._is_first:
            self._is_first = False
            self._announce(tick)
        if self._check.has_passed(now_ns):
            self.begin(now_ns)
            if tick - self._reported_tick > STANDING_CHECK_MS:
                for wheel in self.wheels:
                    wheel.repeat(tick)
                self._announce(tick)
        if not self._has_news:
            return None
        self._has_news = False
        return self.wheels[LEFT].report() + self.wheels[RIGHT].report()

    def _announce(self, tick: int):
        self._reported_tick = tick
        self._has_news = True
