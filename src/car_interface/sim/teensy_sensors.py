"""What the simulated Teensy senses with: hall pins and odometers of two wheels, and six sonars that ping in turn."""
from __future__ import annotations

import struct
from collections import deque
from random import Random
from typing import Callable, Generator

from car_interface.sim.teensy_clock import AT_ONCE_NS, NEVER_NS, NS_PER_US, UINT32, Clock, Deadline
from car_interface.sim.teensy_uart import SONARS, PacketPool, PoolEmpty

LEFT, RIGHT = 0, 1
FORWARD, BACKWARD, NO_DIRECTION = 0, 1, 2

SPEED_INTERVALS = 10  # the speed is an average over this many intervals between pulses
# The levels of a wheel's two hall pins (pin one + 2 × pin two) by the pulses modulo 4: a Gray code.
HALL_PINS = (0b00, 0b01, 0b11, 0b10)
MIN_REPORT_MS = 5  # no wheel report sooner than this after the one before
STANDING_CHECK_MS = 200  # a check whether the wheels stand comes when more than this has passed since the last one
WHEEL = struct.Struct("<HBBIII")  # speed, direction, reserved, when, dist, dist_abs

SEQUENCE_MAX = 4 * SONARS

# In µs of the Teensy's clock
TRIGGER_US = 15  # a ping's trigger pulse
LISTEN_US = 11_428  # 200 cm; the library is meant to give up after it
PING_START_US = 18_000  # with LISTEN_US the time that the library gives a sensor to raise its echo pin
PING_OVERHEAD_US = 13  # the library subtracts it from an echo
TIMER_MAX_US = 178_956_970  # of the interval timer: 2**32 periods of 24 MHz; for longer it is not armed
SONAR_RETRY_MS = 1000  # between attempts at a first ping that failed at power-up
# In µs of true time
ECHO_RISE_US = 449  # from the trigger to the echo pin's rise
ECHO_MIN_US = 116  # 2 cm, the nearest that an HC-SR04 measures

CLONE_PULSE_US = 200_000  # of some clones without an echo
BLINK_MIN_NS, BLINK_MAX_NS = 1_500_000_000, 2_000_000_000  # of a loose echo wire

SONAR_CONDITIONS = SONAR_FINE, SONAR_MISSING, SONAR_STUCK, SONAR_BLINK, SONAR_CLONE = (
    "fine", "missing", "stuck", "blink", "clone")

# A part of the loop that may be held up: it yields when it will go on (ns), is then sent the time, and returns the time
# at which it has ended.
Held = Generator[int, int, int]


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


class SonarSensor:
    """One sensor: raises its echo pin after a trigger and lowers it with the echo, or by itself.

    Args:
        pulse_end_us: the time after which it lowers the pin by itself.
        echo_us: ``at_ns -> µs``: the echo of a ping at that time; 0 for none.
        rng: for how long its pin is high when it blinks.
    """

    def __init__(self, pulse_end_us: int, echo_us: Callable[[int], float], rng: Random):
        self._pulse_end_us = pulse_end_us
        self._rng = rng
        self._echo_us = echo_us
        self._condition = SONAR_FINE
        self.rise_ns = self.fall_ns = AT_ONCE_NS  # of its last pulse

    def set_condition(self, condition: str, now_ns: int):
        """Set one of SONAR_CONDITIONS; a blink raises the pin at once, and is over by itself."""
        is_high = now_ns < self.fall_ns  # or will be
        self._condition = SONAR_FINE if condition == SONAR_BLINK else condition
        if condition == SONAR_BLINK:
            self.rise_ns = min(self.rise_ns, now_ns) if is_high else now_ns
            self.fall_ns = now_ns + self._rng.randint(BLINK_MIN_NS, BLINK_MAX_NS)
        elif condition == SONAR_MISSING and is_high or condition != SONAR_STUCK and self.fall_ns == NEVER_NS:
            self.rise_ns = min(self.rise_ns, now_ns)
            self.fall_ns = now_ns

    def is_high(self, now_ns: int) -> bool:
        return self.rise_ns <= now_ns < self.fall_ns

    def trigger(self, now_ns: int):
        """Begin a pulse, unless one is still under way."""
        if self._condition == SONAR_MISSING or now_ns < self.fall_ns:
            return
        self.rise_ns = now_ns + ECHO_RISE_US * NS_PER_US
        self.fall_ns = NEVER_NS
        if self._condition != SONAR_STUCK:
            end_us = CLONE_PULSE_US if self._condition == SONAR_CLONE else self._pulse_end_us
            pulse_us = min(max(ECHO_MIN_US, self._echo_us(now_ns) or end_us), end_us)
            self.fall_ns = self.rise_ns + round(pulse_us * NS_PER_US)


class SonarArray:
    """Six sonars of which one at a time pings, listens and reports; then comes a wait, then the next in the sequence.

    A ping holds the loop up until the sensor has raised its echo pin, 0.46 ms; 29.4 ms when it doesn't, and the sensor
    is skipped. The pin's fall interrupts, and so does a timer that is meant for the end of a listening time and set to
    the absolute time of that end: it comes after about the uptime. Beyond 178.9 s it can't be set, and never comes.

    There is one start time, one "present sensor" and one timer for all sensors. So a ping while another sensor still
    listens (SONAR_START) takes the other's echo for its own.
    """

    def __init__(self, sequence: tuple[int, ...], wait_ms: int, sensors: list[SonarSensor], clock: Clock,
                 pool: PacketPool, counters: dict[str, int]):
        self._sequence = list(sequence) + [0] * (SEQUENCE_MAX - len(sequence))
        self._length = len(sequence)
        self._index = 0
        self._sensors = sensors
        self._clock = clock
        self._pool = pool
        self._counters = counters
        self._attached: set[int] = set()  # sensors whose pin's fall interrupts
        self._is_listening = False
        self._start_us = 0
        self._timer_ns = NEVER_NS
        self.echo: tuple[int, int, int] | None = None  # to be reported, once: sensor, µs, millis
        self._wait: Deadline | None = None  # of the wait for the next ping
        self._attempt: Deadline | None = None  # of the next attempt at a first ping that failed
        self._retry: bytearray | None = None  # the packet by which the firmware reminds itself
        self.wait_ms = wait_ms  # from a report to the next ping. 2**31 and more: none.
        self.running = True  # False after SONAR_STOP: the sonar that listens still reports, none follows it
        self.interrupt_ns = NEVER_NS  # when the next interrupt comes

    @property
    def due_ns(self) -> int:
        """Return when the loop has something to do here."""
        if self.echo is not None or self._retry is not None:
            return AT_ONCE_NS
        if not self.running:
            return NEVER_NS
        return min(deadline.due_ns if deadline else NEVER_NS for deadline in (self._wait, self._attempt))

    # Pings, which hold the loop up

    def begin(self, now_ns: int) -> Held:
        """Send the first ping, before the loop begins. When it fails, only this ping is repeated."""
        now_ns, has_begun = yield from self._ping(now_ns)
        if not has_begun:
            self._attempt = Deadline(self._clock, -1, now_ns)
        return now_ns

    def start(self, now_ns: int) -> Held:
        """Act on SONAR_START: ping with the present sensor, and at once with the next one as well."""
        self.running = True
        self._attempt = self._wait = None
        now_ns, _ = yield from self._ping(now_ns)
        self._step()
        return (yield from self._ping_one_of_two(now_ns))

    def retry(self, now_ns: int) -> Held:
        """Go on, in the pass after that in which two sensors in a row failed, with the second one."""
        if self._retry is not None:
            self._pool.release(self._retry)
            self._retry = None
            if self.running:
                now_ns = yield from self._ping_one_of_two(now_ns)
        return now_ns

    def ping_when_due(self, now_ns: int) -> Held:
        if not self.running:
            return now_ns
        if self._attempt is not None and self._attempt.has_passed(now_ns):
            self._attempt = Deadline(self._clock, SONAR_RETRY_MS, now_ns)
            now_ns, has_begun = yield from self._ping(now_ns)
            if has_begun:
                self._attempt = None
        elif self._wait is not None and self._wait.has_passed(now_ns):
            self._wait = None
            self._step()
            now_ns = yield from self._ping_one_of_two(now_ns)
        return now_ns

    def _ping_one_of_two(self, now_ns: int) -> Held:
        now_ns, has_begun = yield from self._ping(now_ns)
        if not has_begun:
            self._step()
            now_ns, has_begun = yield from self._ping(now_ns)
        if not has_begun:
            self._retry = self._pool.acquire()
            if self._retry is None:
                raise PoolEmpty
        return now_ns

    def _step(self):
        self._index = self._index + 1 if self._index + 1 < self._length else 0

    def _ping(self, now_ns: int) -> Generator[int, int, tuple[int, bool]]:
        """Return (time, whether the present sensor has raised its pin, or had it still high)."""
        number = self._sequence[self._index]
        sensor, clock = self._sensors[number], self._clock
        now_ns = yield clock.after_ns(TRIGGER_US * NS_PER_US, now_ns)
        sensor.trigger(now_ns)
        # One variable is first the deadline of the wait for the pin and then the end of the listening time. Until the
        # pin rises the start, which is computed from it, lies ahead: an echo that ends before that is below zero.
        now_us = clock.micros(now_ns)
        self._start_us = now_us + PING_START_US
        deadline_us = now_us + PING_START_US + LISTEN_US & UINT32
        # Beyond the wrap of micros() the deadline seems to have passed already.
        give_up_ns = now_ns
        if deadline_us >= now_us:
            give_up_ns = clock.after_ns((deadline_us + 1 - now_us) * NS_PER_US, now_ns)
        if sensor.is_high(now_ns):
            now_ns = yield min(sensor.fall_ns, give_up_ns)
        if not sensor.is_high(now_ns):
            rise_ns = sensor.rise_ns if sensor.rise_ns > now_ns else NEVER_NS
            now_ns = yield min(rise_ns, give_up_ns)
        if not sensor.is_high(now_ns):
            self._counters["pingFail"] += 1
            self._counters[f"errPing{number}"] += 1
            return now_ns, False
        self._start_us = clock.micros(now_ns)
        self._attached.add(number)
        self._is_listening = True
        timer_us = self._start_us + LISTEN_US & UINT32
        self._timer_ns = clock.after_ns(timer_us * NS_PER_US, now_ns) if 0 < timer_us <= TIMER_MAX_US else NEVER_NS
        self.schedule()
        return now_ns, True

    # Interrupts

    def schedule(self):
        """Compute when the next interrupt comes."""
        self.interrupt_ns = min([self._timer_ns, *(self._sensors[number].fall_ns for number in self._attached)])

    def interrupt(self, now_ns: int):
        """Handle a pin that falls, or the timer's end."""
        present = self._sequence[self._index]
        if now_ns >= self._timer_ns:
            self.echo = present, 0, self._clock.millis(now_ns)
        else:
            self._attached = {number for number in self._attached if self._sensors[number].fall_ns > now_ns}
            if self._is_listening:
                echo_us = self._clock.micros(now_ns) - self._start_us - PING_OVERHEAD_US & 0xFFFF
                self.echo = present, echo_us, self._clock.millis(now_ns)
        self._attached.discard(present)
        self._is_listening = False
        self._timer_ns = NEVER_NS
        self.schedule()

    # What is set from outside

    def wait(self, now_ns: int):
        self._wait = Deadline(self._clock, self.wait_ms if self.wait_ms < 1 << 31 else -1, now_ns)

    def set_sequence(self, length: int, sensors: bytes):
        """Take a new sequence; an entry that is no sensor keeps its old value."""
        if length > SEQUENCE_MAX:
            self._counters["badSeqCommand"] += 1
            return
        if length == 0:
            self._counters["badSeqLen"] += 1
            return
        self._length = length
        for index, sensor in enumerate(sensors[:length]):
            if sensor < SONARS:
                self._sequence[index] = sensor
            else:
                self._counters["badSonarIdx"] += 1
