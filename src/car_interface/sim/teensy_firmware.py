"""The Teensy's deployed firmware as seen from its serial line: every byte, every fault, every millisecond.

Consumes the bytes that a host writes, the pulses of two wheels and the echoes of six sonars; produces the bytes that
leave the UART, each no earlier than the line carries it. It knows what a frame *is* on its own and shares no code with
the host's side of the protocol.

What the original does wrong is done wrong here as well, on purpose: a host that works with this one works with the ones
in the cars. The faults: the receiver's four, the boot frame, the filler that is never filled, the starving packet pool,
the hall pins that are never read, echoes without a limit, pings that hold the loop up, deadlines that don't survive the
clock's wrap. Frames, times and fields are held against captures of the original in test/unit/test_sim_captures.py.

The firmware is one loop. Here it is a generator that yields when it goes on: at the next pass with something to do, or,
while a ping holds it up, when that ends. Interrupts (pulses, the ends of echoes, the timer) happen meanwhile.

All times are true time in nanoseconds (``int``) and never run back; "tick" is the firmware's own millisecond count, not
wrapped; ``millis()`` and ``micros()`` are wrapped at 2**32.
"""

from __future__ import annotations

import random
import struct
from collections import deque
from dataclasses import dataclass
from typing import Callable, Generator

from car_interface.sim.checks import require

FLAG, ESCAPE, ESCAPE_XOR = 0x7E, 0x7D, 0x20
RPI, TEENSY = 1, 2

PING_QUERY, PONG_RESP, SET_SONAR_SEQ, SONAR_STOP, SONAR_START, SONAR_STATUS = 1, 2, 3, 4, 5, 6
WHEEL_STATUS, WHEEL_RESET, ERROR_COUNT, GET_COUNTERS, SONAR_WAIT = 7, 8, 9, 10, 12

LEFT, RIGHT = 0, 1
FORWARD, BACKWARD, NO_DIRECTION = 0, 1, 2

SONARS = 6
SEQUENCE_MAX = 4 * SONARS
HEADER_SIZE = 4
MESSAGE_MAX = 36  # header + WHEEL_STATUS, the longest message; the checksum follows it
PACKET_SIZE = MESSAGE_MAX + 4
SPEED_INTERVALS = 10  # the speed is an average over so many intervals between pulses

# The levels of a wheel's two hall pins (pin one + 2 × pin two) after so many pulses modulo 4: a Gray code.
HALL_PINS = (0b00, 0b01, 0b11, 0b10)

# Sonars, in µs of the Teensy's clock
TRIGGER_US = 15  # a ping's trigger pulse
LISTEN_US = 11_428  # 200 cm; the library means to give up after it
PING_START_US = 18_000  # the library gives a sensor so long on top of LISTEN_US to raise its echo pin
PING_OVERHEAD_US = 13  # what the library takes off an echo
TIMER_MAX_US = 178_956_970  # of the interval timer: 2**32 periods of 24 MHz; beyond it, it is not armed
SONAR_RETRY_MS = 1000  # between attempts at a first ping that failed at power-up
# Sonars, in µs of true time
ECHO_RISE_US = 449  # from the trigger to the echo pin's rise
ECHO_MIN_US = 116  # 2 cm, the nearest that an HC-SR04 measures

MIN_REPORT_MS = 5  # no wheel report sooner than this after the one before
STANDING_CHECK_MS = 200  # a check whether the wheels stand comes when more than this has passed since the last one
BOOT_MS = 300  # what millis() says when a Teensy begins with the firmware's own code

COUNTER_NAMES = (
    "rxErrorChecksum", "rxErrorTooShort", "rxErrorTooLong", "rxErrorBuffer", "rxErrorDropped", "rxErrorUnknown",
    "txErrorNoBuf", "txInfoSonarDrop", "txInfoWheelDrop", "txBytes", "txPackets", "rxBytes", "rxPackets",
    "pingFail", "badSeqCommand", "badSonarId", "unknownCommand", "badSeqLen", "badSonarIdx",
    "rotBufFull", "rotUpdSkip", "errPing0", "errPing1", "errPing2", "errPing3", "errPing4", "errPing5",
)  # fmt: skip

NS_PER_US, NS_PER_MS = 1_000, 1_000_000
NEVER_NS = 1 << 63
AT_ONCE_NS = -NEVER_NS
BITS_PER_BYTE_S = 10 * 1_000_000_000  # 8N1 sends ten bits a byte; times nanoseconds a second
UINT32 = 0xFFFFFFFF

U32 = struct.Struct("<I")
SONAR_ECHO = struct.Struct("<HI")  # echo µs, when: what follows the sensor and the byte that nobody fills
WHEEL = struct.Struct("<HBBIII")  # speed, direction, reserved, when, dist, dist_abs

# A part of the loop that may be held up: it yields when it will go on (ns), is sent the time then, and returns the time
# at which it has ended.
Held = Generator[int, int, int]

SONAR_CONDITIONS = SONAR_FINE, SONAR_MISSING, SONAR_STUCK = "fine", "missing", "stuck"


@dataclass(frozen=True)
class FirmwareConfig:
    """What one simulated Teensy is like; the defaults are the one in the cars.

    Attributes:
        baud: bits a second on the line, both ways.
        clock_start_ms: what ``millis()`` says at power-up, when the boot has ended; near 2**32 the wrap comes soon.
            After ``reboot`` it is 300.
        clock_drift_ppm: how much the Teensy's crystal is too fast (positive) or too slow.
        clock_ramp_ppm_per_h: how much that changes in an hour (a car that warms up).
        loop_us: the loop passes once in so many µs of true time. How long the original's passes take is not known.
        sonar_wait_ms: from an echo to the next sonar's ping, until SONAR_WAIT says otherwise.
        sonar_sequence: the sonars' order, until SET_SONAR_SEQ says otherwise.
        sonar_pulse_end_us: so long a sensor holds its echo pin high when it hears nothing: 38 ms with an HC-SR04,
            200 ms with some clones.
        sonars_missing: the sensors that are not connected at power-up; see ``set_sonar``.
        wheel_positions: where the wheels (left, right) stand at power-up, in pulses: sets the levels of the hall pins.
        odometer_start: what both dist and dist_abs of both wheels say at power-up. Not 0: then they have turned
            forward. After ``reboot`` it is 0.
        corrected_checksum: True for a firmware whose receiver sums with carry over unescaped bytes. Its other
            faults stay.
        pool_size: packets that receiver, queues and transmitter share.
        uart_buffer: bytes that wait in front of the line: of the 64 that find room there the firmware leaves 2 free.
        boot_byte: the X of the boot frame.
        seed: of the garbage that the packets' memory holds at power-up; None for zeros.

    Raises:
        ConfigError: a value that no Teensy could have.
    """

    baud: int = 115200
    clock_start_ms: int = BOOT_MS
    clock_drift_ppm: float = 0.0
    clock_ramp_ppm_per_h: float = 0.0
    loop_us: int = 50
    sonar_wait_ms: int = 50
    sonar_sequence: tuple[int, ...] = (0, 1, 2, 3, 4, 5)
    sonar_pulse_end_us: int = 38_000
    sonars_missing: tuple[int, ...] = ()
    wheel_positions: tuple[int, int] = (0, 0)
    odometer_start: int = 0
    corrected_checksum: bool = False
    pool_size: int = 32
    uart_buffer: int = 62
    boot_byte: int = 0xC1
    seed: int | None = None

    def __post_init__(self):
        require(self.baud > 0, "baud", self.baud, "more than 0")
        require(0 <= self.clock_start_ms < 1 << 32, "clock_start_ms", self.clock_start_ms, "0 to 2**32 - 1")
        require(abs(self.clock_drift_ppm) <= 10_000, "clock_drift_ppm", self.clock_drift_ppm, "-10000 to 10000")
        require(0 < self.loop_us <= 1000, "loop_us", self.loop_us, "1 to 1000")
        require(0 <= self.sonar_wait_ms < 1 << 32, "sonar_wait_ms", self.sonar_wait_ms, "0 to 2**32 - 1")
        require(
            LISTEN_US < self.sonar_pulse_end_us <= 1_000_000,
            "sonar_pulse_end_us", self.sonar_pulse_end_us, "more than 11428, up to 1000000",
        )  # fmt: skip
        require(self.pool_size > 0, "pool_size", self.pool_size, "more than 0")
        require(self.uart_buffer > 0, "uart_buffer", self.uart_buffer, "more than 0")
        require(0 <= self.boot_byte <= 0xFF, "boot_byte", self.boot_byte, "0 to 255")
        require(0 <= self.odometer_start < 1 << 32, "odometer_start", self.odometer_start, "0 to 2**32 - 1")
        sequence = self.sonar_sequence
        fine = 0 < len(sequence) <= SEQUENCE_MAX and set(sequence) <= set(range(SONARS))
        require(fine, "sonar_sequence", sequence, "1 to 24 sensors from 0 to 5")
        missing = self.sonars_missing
        require(set(missing) <= set(range(SONARS)), "sonars_missing", missing, "sensors from 0 to 5")


class TeensyFirmware:
    """A powered Teensy with two wheels and six sonars on it.

    Args:
        config: what it is like.
        echo_us: ``(sensor, at_ns) -> µs`` from a ping to its echo; 0 when nothing is near enough for one: then the
            sensor ends its pulse by itself. An attribute too. Without one no sonar ever hears anything.
        power_up_ns: the true time at which its boot ends and it begins to work.

    Attributes:
        counters: every counter that GET_COUNTERS can report, by name.
        hung: True once it has come to a point from which only a reboot leads on.
    """

    def __init__(
        self,
        config: FirmwareConfig,
        echo_us: Callable[[int, int], float] | None = None,
        power_up_ns: int = 0,
    ):
        self.echo_us = echo_us or (lambda sensor, at_ns: 0)
        self._config = config
        self._period_ns = config.loop_us * NS_PER_US
        self._incoming = IncomingLine(config.baud)
        self._outgoing = OutgoingLine(config.baud, config.uart_buffer)
        self._sensors = [self._sensor(number) for number in range(SONARS)]
        for sensor in config.sonars_missing:
            self._sensors[sensor].set_condition(SONAR_MISSING, power_up_ns)
        self._positions = list(config.wheel_positions)
        self._now_ns = power_up_ns
        self._switch_on(config.clock_start_ms, power_up_ns, power_up_ns)
        for wheel in self._axle.wheels if config.odometer_start else ():
            wheel.preset(config.odometer_start)

    def _sensor(self, number: int) -> SonarSensor:
        return SonarSensor(self._config.sonar_pulse_end_us, lambda at_ns: self.echo_us(number, at_ns))

    def _switch_on(self, clock_start_ms: int, clock_start_ns: int, boot_end_ns: int):
        config = self._config
        self._clock = Clock(clock_start_ms, config.clock_drift_ppm, config.clock_ramp_ppm_per_h, clock_start_ns)
        self.counters: dict[str, int] = dict.fromkeys(COUNTER_NAMES, 0)
        self.hung = False
        self._pool = PacketPool(config.pool_size, config.seed)
        self._receiver = Receiver(self._pool.take, self.counters, config.corrected_checksum)
        self._transmitter = Transmitter(self._outgoing, self._pool, self.counters, config.boot_byte)
        self._axle = Axle(self.counters)
        self._sonars = SonarArray(
            config.sonar_sequence, config.sonar_wait_ms, self._sensors, self._clock, self._pool, self.counters
        )
        self._commands = {
            PONG_RESP: self._ignore,
            SET_SONAR_SEQ: self._set_sonar_sequence,
            SONAR_STOP: self._stop_sonars,
            WHEEL_RESET: self._reset_wheels,
            GET_COUNTERS: self._send_counters,
            SONAR_WAIT: self._set_sonar_wait,
        }
        self._is_booting = True
        self._is_between_passes = False
        self._resume_ns = boot_end_ns
        self._loop = self._run()
        next(self._loop)

    def advance(self, now_ns: int):
        """Lives on until ``now_ns``. A time that has passed already changes nothing."""
        while True:
            interrupt_ns = self._sonars.interrupt_ns
            at_ns = min(interrupt_ns, self._resume_ns)
            if at_ns > now_ns:
                break
            self._now_ns = max(at_ns, self._now_ns)
            if at_ns == interrupt_ns:
                self._sonars.interrupt(self._now_ns)
                self._wake(self._now_ns)
            else:
                self._resume()
        self._now_ns = max(now_ns, self._now_ns)

    def receive(self, data: bytes, now_ns: int):
        """Takes what the host began to write at ``now_ns``; its bytes arrive one after the other at the line's pace."""
        self.advance(now_ns)
        self._incoming.write(data, self._now_ns)
        self._wake(self._incoming.next_ns)

    def receive_backlog(self, now_ns: int) -> int:
        """Bytes that the host has written and that the line hasn't carried yet: whoever feeds a flood waits on this."""
        self.advance(now_ns)
        return self._incoming.backlog

    def transmit(self, now_ns: int) -> bytes:
        """Lives on until ``now_ns`` and returns the bytes that have left the UART by then, each one once."""
        self.advance(now_ns)
        return self._outgoing.collect(self._now_ns)

    def wheel_pulse(self, side: int, direction: int, at_ns: int):
        """One rear wheel turns from one of its magnets' fields into the next: one of its two hall pins changes.

        Args:
            side: LEFT or RIGHT.
            direction: FORWARD or BACKWARD.
            at_ns: its true time; pulses come in order, one that is late counts as of now.
        """
        self.advance(at_ns)
        before = HALL_PINS[self._positions[side] % 4]
        self._positions[side] += 1 if direction == FORWARD else -1
        pins = HALL_PINS[self._positions[side] % 4]
        if self._is_booting or self.hung:
            return
        self._axle.interrupt(side, before ^ pins, pins, self._clock.tick(self._now_ns))
        self._wake(self._now_ns)

    def reboot(self, now_ns: int, off_ns: int = 0):
        """Cuts its power for ``off_ns``. It boots for 300 ms then.

        A frame on the line is cut. Until the boot has ended the wheels turn uncounted and bytes from the host are lost.
        Clock, odometers and counters begin anew, and so do the sonars with the first one of their sequence.
        """
        self.advance(now_ns)
        self._outgoing.cut(self._now_ns)
        clock_start_ns = self._now_ns + off_ns
        self._switch_on(0, clock_start_ns, clock_start_ns)
        self._resume_ns = self._clock.reaches_ns(BOOT_MS, clock_start_ns)

    def set_sonar(self, sensor: int, condition: str, now_ns: int):
        """From now on a sensor is SONAR_FINE, SONAR_MISSING (not connected) or SONAR_STUCK.

        One that is stuck raises its echo pin at its next ping and holds it high until it is fine again.

        Raises:
            ConfigError: no such sensor, no such condition.
        """
        require(sensor in range(SONARS), "sonar", sensor, "a sensor from 0 to 5")
        self.advance(now_ns)
        self._sensors[int(sensor)].set_condition(condition, self._now_ns)
        self._sonars.schedule()

    def millis(self, now_ns: int) -> int:
        """The firmware's clock at ``now_ns``: whole milliseconds, modulo 2**32. Looks only, lives nothing."""
        return self._clock.millis(now_ns)

    def device_ns(self, now_ns: int) -> int:
        """The same clock in nanoseconds, neither truncated nor wrapped: what an estimate of it is scored against."""
        return self._clock.device_ns(now_ns)

    @property
    def next_event_ns(self) -> int:
        """When something will happen by itself; until then ``advance`` has nothing to do. Bytes may leave sooner."""
        return min(self._resume_ns, self._sonars.interrupt_ns)

    # The loop

    def _run(self) -> Generator[int, int, None]:
        """setup() and loop()."""
        now_ns = yield self._resume_ns
        self._is_booting = False
        self._incoming.drop(now_ns)
        now_ns = yield from self._sonars.begin(now_ns)
        self._axle.begin(self._clock, now_ns)
        while True:
            now_ns = yield from self._read_line(now_ns)
            now_ns = yield from self._sonars.ping_when_due(now_ns)
            report = self._axle.report_when_due(self._clock, now_ns)
            if report is not None:
                self._transmitter.queue_wheels(report)
            self._transmitter.poll(now_ns)
            self._report_echo(now_ns)
            now_ns = yield self._next_pass_ns(now_ns)

    def _resume(self):
        self._is_between_passes = False
        try:
            self._resume_ns = self._loop.send(self._now_ns)
        except PoolEmpty:
            self.hung = True
            self._resume_ns = NEVER_NS

    def _next_pass_ns(self, now_ns: int) -> int:
        """The next pass that finds something to do."""
        self._is_between_passes = True
        wanted_ns = min(
            self._incoming.next_ns, self._sonars.due_ns, self._axle.due_ns, self._transmitter.due_ns,
        )  # fmt: skip
        return max(self._pass_ns(wanted_ns), self._pass_ns(now_ns + 1))

    def _pass_ns(self, at_ns: int) -> int:
        """The first pass then or after."""
        return -(-at_ns // self._period_ns) * self._period_ns

    def _wake(self, at_ns: int):
        """Something to do has come up. While the loop is held up it finds it by itself."""
        if self._is_between_passes:
            self._resume_ns = min(self._resume_ns, self._pass_ns(at_ns))

    def _read_line(self, now_ns: int) -> Held:
        if self._sonars.is_retrying:
            now_ns = yield from self._sonars.retry(now_ns)
        while self._incoming.next_ns <= now_ns:
            packet = self._receiver.byte(self._incoming.take())
            if packet is None:
                continue
            if packet[0] == TEENSY and packet[2] == PING_QUERY:
                self._pong(packet, now_ns)
                continue
            if packet[0] == TEENSY and packet[2] == SONAR_START:
                now_ns = yield from self._sonars.start(now_ns)
            elif packet[0] == TEENSY:
                self._commands.get(packet[2], self._count_unknown)(packet)
            self._pool.give(packet)
        return now_ns

    def _report_echo(self, now_ns: int):
        echo = self._sonars.take_echo()
        if echo is None:
            return
        packet = self._pool.take()
        if packet is None:
            # The firmware schedules the next ping when it handles the report. No packet, no report, no next ping:
            # the sonars stay silent until SONAR_START.
            self.counters["txErrorNoBuf"] += 1
            return
        sensor, echo_us, when = echo
        packet[:5] = bytes((RPI, TEENSY, SONAR_STATUS, 0, sensor))
        SONAR_ECHO.pack_into(packet, 6, echo_us, when)
        self._transmitter.queue_sonar(sensor, packet)
        self._sonars.wait(now_ns)

    # What the host asks for

    def _pong(self, packet: bytearray, now_ns: int):
        """Turns the ping itself into its answer, as the firmware does: whatever was in it stays in it."""
        packet[:3] = bytes((packet[1], TEENSY, PONG_RESP))
        U32.pack_into(packet, 8, self._clock.millis(now_ns))
        self._transmitter.queue_first(packet)

    def _ignore(self, packet: bytearray):
        """Does nothing: a pong is known to the firmware, and it never asked for one."""

    def _count_unknown(self, packet: bytearray):
        self.counters["rxErrorUnknown"] += 1

    def _set_sonar_sequence(self, packet: bytearray):
        self._sonars.set_sequence(packet[4], packet[5 : 5 + SEQUENCE_MAX])

    def _stop_sonars(self, packet: bytearray):
        self._sonars.running = False

    def _set_sonar_wait(self, packet: bytearray):
        (self._sonars.wait_ms,) = U32.unpack_from(packet, 4)

    def _reset_wheels(self, packet: bytearray):
        self._axle.reset()

    def _send_counters(self, packet: bytearray):
        for name, count in [item for item in self.counters.items() if item[1]]:
            answer = self._pool.take()
            if answer is None:
                self.counters["txErrorNoBuf"] += 1
                continue
            answer[:4] = bytes((RPI, TEENSY, ERROR_COUNT, 0))
            U32.pack_into(answer, 4, count & UINT32)
            answer[8:32] = name.encode("ascii").ljust(24, b"\0")
            self._transmitter.queue_first(answer)


class Clock:
    """``millis()`` and ``micros()`` over a crystal that is a little off.

    Args:
        start_ms: what it says at ``start_ns``.
        drift_ppm: how much too fast it runs then.
        ramp_ppm_per_h: how much faster still it runs each hour after.
        start_ns: true time at which it starts.
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
        """Whole milliseconds, not wrapped."""
        return self.device_ns(now_ns) // NS_PER_MS

    def millis(self, now_ns: int) -> int:
        """Whole milliseconds, modulo 2**32."""
        return self.tick(now_ns) & UINT32

    def micros(self, now_ns: int) -> int:
        """Whole microseconds, modulo 2**32: wraps every 71.58 minutes."""
        return self.device_ns(now_ns) // NS_PER_US & UINT32

    def reaches_ns(self, tick: int, now_ns: int) -> int:
        """The first true time at which the clock is at ``tick`` or past it, sought from ``now_ns`` on."""
        return self.after_ns(tick * NS_PER_MS - self.device_ns(now_ns), now_ns)

    def after_ns(self, span_ns: int, now_ns: int) -> int:
        """The first true time at which ``span_ns`` of the clock's own have passed since ``now_ns``."""
        target_ns = self.device_ns(now_ns) + span_ns
        at_ns = now_ns
        # Each round shrinks the error by the drift, some 1e-4: three leave less than 1 ns of any wait.
        for _ in range(3):
            at_ns += target_ns - self.device_ns(at_ns)
        while self.device_ns(at_ns) < target_ns:
            at_ns += 1
        return at_ns

    def passes_ns(self, deadline_ms: int, now_ns: int) -> int:
        """When ``millis() > deadline_ms`` becomes true.

        The firmware compares like this: a deadline beyond the wrap counts as passed already.
        """
        left_ms = deadline_ms - self.millis(now_ns)
        if left_ms < 0:
            return now_ns
        if deadline_ms == UINT32:
            return NEVER_NS
        return self.reaches_ns(self.tick(now_ns) + left_ms + 1, now_ns)


class Deadline:
    """What the loop waits for until ``millis()`` is past it, compared as the firmware compares.

    Attributes:
        due_ns: when it will be, if nothing but time passes; the loop looks then.
    """

    def __init__(self, clock: Clock, wait_ms: int, now_ns: int):
        self._clock = clock
        self._deadline_ms = clock.millis(now_ns) + wait_ms & UINT32
        self.due_ns = clock.passes_ns(self._deadline_ms, now_ns)

    def has_passed(self, now_ns: int) -> bool:
        """Whether it has. Beyond the wrap it seems to have until ``millis()`` has wrapped as well."""
        if now_ns >= self.due_ns:
            self.due_ns = self._clock.passes_ns(self._deadline_ms, now_ns)
        return now_ns >= self.due_ns


class PoolEmpty(Exception):
    """The firmware wrote a packet that it had not got, through a null pointer."""


class PacketPool:
    """The packets that everything shares. A used one comes back with what was in it; that is what fills the filler."""

    def __init__(self, size: int, seed: int | None):
        memory = bytes(size * PACKET_SIZE)
        if seed is not None:
            memory = random.Random(seed).getrandbits(8 * len(memory)).to_bytes(len(memory), "little")
        chunks = (memory[start : start + PACKET_SIZE] for start in range(0, len(memory), PACKET_SIZE))
        self._free: deque[bytearray] = deque(bytearray(chunk) for chunk in chunks)

    def take(self) -> bytearray | None:
        """Returns the packet that has lain free for longest, or None when all are in use."""
        return self._free.popleft() if self._free else None

    def give(self, packet: bytearray):
        self._free.append(packet)


class Receiver:
    """Bytes from the host → packets, with the four faults of the original.

    Args:
        take: gets an empty packet, or None.
        counters: counted into.
        corrected_checksum: True to sum with carry, over what the bytes meant.
    """

    IDLE, WAITING, DATA, ESCAPED = "idle", "waiting", "data", "escaped"

    def __init__(
        self, take: Callable[[], bytearray | None], counters: dict[str, int], corrected_checksum: bool = False
    ):
        self._take = take
        self._counters = counters
        self._corrected = corrected_checksum
        self._packet: bytearray | None = None
        self._phase = self.IDLE
        self._filled = 0
        self._sum = 0

    @property
    def state(self) -> tuple[str, int]:
        """(phase, bytes in the packet). IDLE holds no packet yet, WAITING does and looks for an opening flag."""
        return self._phase, self._filled

    def byte(self, byte: int) -> bytearray | None:
        """Takes one byte; returns the packet that it completed, checksum included, or None."""
        if self._packet is None:
            self._packet = self._take()
            if self._packet is None:
                self._counters["rxErrorBuffer"] += 1
                return None
            self._restart()
        self._counters["rxBytes"] += 1
        if self._phase == self.WAITING:
            self._wait_for_flag(byte)
        elif self._phase == self.ESCAPED:
            self._undo_escape(byte)
        elif byte == FLAG:
            return self._close()
        elif byte == ESCAPE:
            self._phase = self.ESCAPED
        else:
            self._add(byte)
            self._store(byte)
        return None

    def _restart(self):
        self._phase = self.WAITING
        self._filled = 0
        self._sum = 0

    def _wait_for_flag(self, byte: int):
        if byte == FLAG:
            self._phase = self.DATA
        else:
            self._counters["rxErrorDropped"] += 1

    def _undo_escape(self, byte: int):
        """Stores what the byte meant and adds what it was.

        The phase is DATA afterwards whatever happened, even when the packet was full and thrown away: of all states
        only this one, full and escaped, takes 39 bytes of 00 to get out of.
        """
        self._store(byte ^ ESCAPE_XOR)
        self._add(byte ^ ESCAPE_XOR if self._corrected else byte)
        self._phase = self.DATA

    def _add(self, byte: int):
        self._sum += byte
        if self._sum > 0xFF:
            self._sum -= 0xFF if self._corrected else 0x100

    def _store(self, byte: int):
        if self._filled > MESSAGE_MAX:
            self._counters["rxErrorTooLong"] += 1
            self._restart()
            return
        self._packet[self._filled] = byte
        self._filled += 1

    def _close(self) -> bytearray | None:
        """Judges the frame. The flag that closed it opens nothing, so an odd one swaps opening and closing for good."""
        packet, filled, good = self._packet, self._filled, self._sum == 0xFF
        self._restart()
        if not good:
            self._counters["rxErrorChecksum"] += 1
            return None
        if filled <= HEADER_SIZE:
            self._counters["rxErrorTooShort"] += 1
            return None
        self._counters["rxPackets"] += 1
        self._packet = None
        self._phase = self.IDLE
        return packet


class Transmitter:
    """Queues and frames: what goes out next, and how it looks on the wire.

    Answers go first. The newest wheel report and the newest report of each sonar wait for the rest of the line; a
    newer one takes the place of one that still waits, and is counted. Two frames share a flag when the second one
    waits already while the first is being closed; otherwise each has its own two.

    The first thing that it sends is the frame that the firmware makes of a packet that isn't there.
    """

    def __init__(self, line: OutgoingLine, pool: PacketPool, counters: dict[str, int], boot_byte: int):
        self._line = line
        self._pool = pool
        self._counters = counters
        self._first: deque[bytearray] = deque()
        self._reports: list[bytearray | None] = [None] * (1 + SONARS)  # wheels, then each sonar
        self._turn = 0
        self._sending: bytearray | None = None
        self._unsent = bytes([FLAG]) + stuff(bytes([boot_byte, boot_byte ^ 0xFF])) + bytes([FLAG])
        self.due_ns = AT_ONCE_NS  # when what is to be sent finds room; NEVER_NS when there is nothing

    def queue_first(self, packet: bytearray):
        self._first.append(packet)
        self._look_up()

    def queue_wheels(self, report: bytes):
        packet = self._reports[0]
        if packet is not None:
            self._counters["txInfoWheelDrop"] += 1
        else:
            packet = self._pool.take()
            if packet is None:
                self._counters["txErrorNoBuf"] += 1
                return
        packet[:4] = bytes((RPI, TEENSY, WHEEL_STATUS, 0))
        packet[4 : 4 + len(report)] = report
        self._reports[0] = packet
        self._look_up()

    def queue_sonar(self, sensor: int, packet: bytearray):
        waiting = self._reports[1 + sensor]
        if waiting is not None:
            self._counters["txInfoSonarDrop"] += 1
            self._pool.give(waiting)
        self._reports[1 + sensor] = packet
        self._look_up()

    def poll(self, now_ns: int):
        """Writes what finds room, to the end of the frame under way and on."""
        is_open = False  # the last frame's closing flag is the last thing written
        while True:
            if not self._unsent:
                packet = self._next()
                if packet is None:
                    self.due_ns = NEVER_NS
                    return
                self._sending = packet
                body = frame_body(bytes(packet[: message_length(packet)])) + bytes([FLAG])
                self._unsent = body if is_open else bytes([FLAG]) + body
            count = min(len(self._unsent), self._line.room(now_ns))
            self._line.write(self._unsent[:count], now_ns)
            self._counters["txBytes"] += count
            self._unsent = self._unsent[count:]
            if self._unsent:
                # All of it finds room before the line runs dry: the buffer is longer than a frame.
                self.due_ns = self._line.room_ns(len(self._unsent), now_ns)
                return
            is_open = True
            if self._sending is not None:
                self._pool.give(self._sending)
                self._sending = None
                self._counters["txPackets"] += 1

    def _look_up(self):
        if self.due_ns == NEVER_NS:
            self.due_ns = AT_ONCE_NS

    def _next(self) -> bytearray | None:
        if self._first:
            return self._first.popleft()
        if not any(self._reports):
            return None
        for _ in self._reports:
            packet, self._reports[self._turn] = self._reports[self._turn], None
            if packet is not None:
                return packet
            self._turn = (self._turn + 1) % len(self._reports)
        return None


class OutgoingLine:
    """The UART's buffer and the wire behind it: bytes leave in order, ten bits each, never sooner.

    Args:
        baud: bits a second.
        buffer_size: bytes that wait in front of the wire before a writer has to.
    """

    def __init__(self, baud: int, buffer_size: int):
        self._baud = baud
        self._buffer_size = buffer_size
        self._chunks: deque[tuple[int, bytes]] = deque()  # when its first bit goes out, its bytes
        self._collected = 0  # of the first chunk
        self._saved = b""  # from before a cut
        self._free_ns = AT_ONCE_NS

    def write(self, data: bytes, now_ns: int):
        start_ns = max(now_ns, self._free_ns)
        self._chunks.append((start_ns, data))
        self._free_ns = start_ns - (-len(data) * BITS_PER_BYTE_S // self._baud)  # rounded up: never too fast

    def room(self, now_ns: int) -> int:
        """How many bytes the buffer takes now."""
        waiting = -(-(self._free_ns - now_ns) * self._baud // BITS_PER_BYTE_S)
        return min(self._buffer_size, self._buffer_size + 1 - waiting)

    def room_ns(self, count: int, now_ns: int) -> int:
        """When the buffer takes ``count`` bytes, at most its size."""
        spare = self._buffer_size + 1 - min(count, self._buffer_size)
        return max(now_ns, self._free_ns - spare * BITS_PER_BYTE_S // self._baud)

    def collect(self, now_ns: int) -> bytes:
        """Returns the bytes whose last bit is out by ``now_ns`` and that nobody has collected yet."""
        out, self._saved = self._saved, b""
        while self._chunks:
            start_ns, data = self._chunks[0]
            gone = max(0, (now_ns - start_ns) * self._baud // BITS_PER_BYTE_S)
            out += data[self._collected : gone]
            if gone < len(data):
                self._collected = max(gone, self._collected)
                break
            self._collected = 0
            self._chunks.popleft()
        return out

    def cut(self, now_ns: int):
        """Loses what hasn't left the wire yet."""
        self._saved = self.collect(now_ns)
        self._chunks.clear()
        self._collected = 0
        self._free_ns = now_ns


class IncomingLine:
    """The wire from the host: bytes arrive in order, ten bits each, and are taken one at a time.

    Args:
        baud: bits a second.

    Attributes:
        next_ns: when the next byte is complete; NEVER_NS when the wire is silent.
    """

    def __init__(self, baud: int):
        self._baud = baud
        self._bytes: deque[int] = deque()
        self._burst_ns = 0
        self._taken = 0  # since the burst began
        self.next_ns = NEVER_NS

    @property
    def backlog(self) -> int:
        return len(self._bytes)

    def write(self, data: bytes, now_ns: int):
        if not self._bytes:
            self._burst_ns = now_ns
            self._taken = 0
        self._bytes.extend(data)
        self._look_ahead()

    def take(self) -> int:
        byte = self._bytes.popleft()
        self._taken += 1
        self._look_ahead()
        return byte

    def drop(self, now_ns: int):
        """Loses what has arrived by now: nobody listened."""
        while self.next_ns <= now_ns:
            self.take()

    def _byte_ns(self, count: int) -> int:
        return self._burst_ns - (-count * BITS_PER_BYTE_S // self._baud)

    def _look_ahead(self):
        self.next_ns = self._byte_ns(self._taken + 1) if self._bytes else NEVER_NS


class Wheel:
    """One wheel's odometer."""

    def __init__(self):
        self._pins = HALL_PINS[0]  # taken for this at power-up, whatever they are
        self._when_tick = 0
        self.reset()

    def reset(self):
        """Zeroes the odometer; the tick of the last pulse or repeat stays."""
        self._dist_abs = 0
        self._dist = 0
        self._direction = NO_DIRECTION
        self._window: deque[tuple[int, int]] = deque(maxlen=SPEED_INTERVALS + 1)  # (tick, pulses then)

    def preset(self, count: int):
        """Makes it a wheel that has turned forward so many pulses, long ago."""
        self._dist_abs = self._dist = count
        self._direction = FORWARD

    def interrupt(self, pin: int, levels: int, tick: int):
        """One pin has changed: only its own bit is read, the other one is what it was at its own last interrupt.

        Where the pins stood otherwise than taken for at power-up the first interrupts may change nothing: such a pulse
        counts in the direction that was, also when there was none. Or they seem to turn the wheel the wrong way round.
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
        """Enters the newest entry once more: the average falls to zero over a few repeats, not at once."""
        if self._window:
            self._window.append((tick, self._dist_abs))
            self._when_tick = tick

    def report(self) -> bytes:
        return WHEEL.pack(
            self._speed() & 0xFFFF, self._direction, 0, self._when_tick & UINT32,
            self._dist & UINT32, self._dist_abs & UINT32,
        )  # fmt: skip

    def _speed(self) -> int:
        """Pulses a second, truncated, over the window; 0 with one entry, or with all of them in one tick."""
        if len(self._window) < 2:
            return 0
        (first_tick, first_count), (last_tick, last_count) = self._window[0], self._window[-1]
        if first_tick == last_tick:
            return 0
        return 1000 * (last_count - first_count) // (last_tick - first_tick)


class Axle:
    """Both rear wheels, and when they are worth a report: with a pulse, but not too often; standing, now and then.

    A pulse sooner than 5 ms after the last one that was reported is not reported later either: it waits for the next
    one or for a repeat, and counts as rotUpdSkip. Every 201 ms it is looked whether that is more than 200 ms ago; then
    both wheels' newest entries are repeated. So the first repeat comes 201 to 402 ms after the last pulse's report.
    """

    def __init__(self, counters: dict[str, int]):
        self.wheels = (Wheel(), Wheel())
        self._counters = counters
        self._reported_tick = 0  # of the pulse or repeat that the last report was for
        self._has_news = True
        self._is_first = True
        self._check: Deadline | None = None

    @property
    def due_ns(self) -> int:
        """When the loop has something to do here."""
        return AT_ONCE_NS if self._has_news else self._check.due_ns

    def reset(self):
        for wheel in self.wheels:
            wheel.reset()

    def interrupt(self, side: int, pin: int, levels: int, tick: int):
        """A hall pin of one wheel has changed."""
        self.wheels[side].interrupt(pin, levels, tick)
        if tick - self._reported_tick < MIN_REPORT_MS:
            self._counters["rotUpdSkip"] += 1
        else:
            self._announce(tick)

    def begin(self, clock: Clock, now_ns: int):
        """Begins the checks for wheels that stand."""
        self._check = Deadline(clock, STANDING_CHECK_MS, now_ns)

    def report_when_due(self, clock: Clock, now_ns: int) -> bytes | None:
        tick = clock.tick(now_ns)
        if self._is_first:
            self._is_first = False
            self._announce(tick)
        if self._check.has_passed(now_ns):
            self.begin(clock, now_ns)
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
        pulse_end_us: after so long it does so by itself.
        echo_us: ``at_ns -> µs``: what a ping then would hear; 0 for nothing.
    """

    def __init__(self, pulse_end_us: int, echo_us: Callable[[int], float]):
        self._pulse_end_us = pulse_end_us
        self._echo_us = echo_us
        self._condition = SONAR_FINE
        self.rise_ns = self.fall_ns = AT_ONCE_NS  # of its last pulse

    def set_condition(self, condition: str, now_ns: int):
        """SONAR_FINE, SONAR_MISSING or SONAR_STUCK.

        Raises:
            ConfigError: another one.
        """
        require(condition in SONAR_CONDITIONS, "sonar condition", condition, "fine, missing or stuck")
        self._condition = condition
        is_unplugged = condition == SONAR_MISSING and now_ns < self.fall_ns
        is_released = condition == SONAR_FINE and self.fall_ns == NEVER_NS
        if is_unplugged or is_released:
            self.rise_ns = min(self.rise_ns, now_ns)
            self.fall_ns = now_ns

    def is_high(self, now_ns: int) -> bool:
        """Whether its echo pin is."""
        return self.rise_ns <= now_ns < self.fall_ns

    def trigger(self, now_ns: int):
        """Begins a pulse, unless one is still under way."""
        if self._condition == SONAR_MISSING or now_ns < self.fall_ns:
            return
        self.rise_ns = now_ns + ECHO_RISE_US * NS_PER_US
        self.fall_ns = NEVER_NS
        if self._condition == SONAR_FINE:
            echo_us = self._echo_us(now_ns) or self._pulse_end_us
            pulse_us = min(max(ECHO_MIN_US, echo_us), self._pulse_end_us)
            self.fall_ns = self.rise_ns + round(pulse_us * NS_PER_US)


class SonarArray:
    """Six sonars of which one at a time pings, listens and reports; then comes a wait, then the next in the sequence.

    A ping holds the loop up until the sensor has raised its echo pin, 0.46 ms; 29.4 ms when it doesn't, and that one is
    left out. The pin's fall interrupts, and so does a timer that is meant for the end of a listening time and set to
    the absolute time of that end: it comes after about the uptime. Beyond 178.9 s it can't be set, and never comes.

    There is one start time, one "present sensor" and one timer for all of them. So a ping while another sensor still
    listens (SONAR_START) takes that one's echo for its own.

    Attributes:
        running: False after SONAR_STOP: the sonar that listens still reports, none follows it.
        wait_ms: from a report to the next ping. 2**31 and more: none.
        interrupt_ns: when the next interrupt comes.
        is_retrying: two sensors in a row have failed: the loop goes on with the second one in its next pass.
    """

    def __init__(
        self, sequence: tuple[int, ...], wait_ms: int, sensors: list[SonarSensor], clock: Clock, pool: PacketPool,
        counters: dict[str, int],
    ):  # fmt: skip
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
        self._echo: tuple[int, int, int] | None = None  # sensor, µs, millis
        self._wait: Deadline | None = None  # of the wait for the next ping
        self._attempt: Deadline | None = None  # of the next attempt at a first ping that failed
        self._retry: bytearray | None = None  # the packet by which the firmware reminds itself
        self.wait_ms = wait_ms
        self.running = True
        self.interrupt_ns = NEVER_NS

    @property
    def due_ns(self) -> int:
        """When the loop has something to do here."""
        if self._echo is not None or self._retry is not None:
            return AT_ONCE_NS
        if not self.running:
            return NEVER_NS
        return min(deadline.due_ns if deadline else NEVER_NS for deadline in (self._wait, self._attempt))

    @property
    def is_retrying(self) -> bool:
        return self._retry is not None

    # Pings, which hold the loop up

    def begin(self, now_ns: int) -> Held:
        """The first ping, before the loop begins. When it fails, it alone is tried again and again."""
        now_ns, has_begun = yield from self._ping(now_ns)
        if not has_begun:
            self._attempt = Deadline(self._clock, -1, now_ns)
        return now_ns

    def start(self, now_ns: int) -> Held:
        """SONAR_START: pings with the present sensor, and at once with the next one as well."""
        self.running = True
        self._attempt = self._wait = None
        now_ns, _ = yield from self._ping(now_ns)
        return (yield from self._ping_next(now_ns))

    def retry(self, now_ns: int) -> Held:
        """Goes on after two that failed."""
        self._pool.give(self._retry)
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
            now_ns = yield from self._ping_next(now_ns)
        return now_ns

    def _ping_next(self, now_ns: int) -> Held:
        self._step()
        return (yield from self._ping_one_of_two(now_ns))

    def _ping_one_of_two(self, now_ns: int) -> Held:
        now_ns, has_begun = yield from self._ping(now_ns)
        if not has_begun:
            self._step()
            now_ns, has_begun = yield from self._ping(now_ns)
        if not has_begun:
            self._retry = self._pool.take()
            if self._retry is None:
                raise PoolEmpty
        return now_ns

    def _step(self):
        self._index = self._index + 1 if self._index + 1 < self._length else 0

    def _ping(self, now_ns: int) -> Generator[int, int, tuple[int, bool]]:
        """Returns (time, whether the present sensor has raised its pin, or had it still high)."""
        number = self._sequence[self._index]
        sensor, clock = self._sensors[number], self._clock
        now_ns = yield clock.after_ns(TRIGGER_US * NS_PER_US, now_ns)
        sensor.trigger(now_ns)
        # One variable is first the deadline of the wait for the pin and then the end of the listening time. Until the
        # pin rises the start, which is worked out from it, lies ahead: an echo that ends meanwhile is below zero.
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
        """Works out when the next interrupt comes."""
        self.interrupt_ns = min([self._timer_ns, *(self._sensors[number].fall_ns for number in self._attached)])

    def interrupt(self, now_ns: int):
        """A pin falls, or the timer ends."""
        present = self._sequence[self._index]
        if now_ns >= self._timer_ns:
            self._echo = present, 0, self._clock.millis(now_ns)
        else:
            self._attached = {number for number in self._attached if self._sensors[number].fall_ns > now_ns}
            if self._is_listening:
                echo_us = self._clock.micros(now_ns) - self._start_us - PING_OVERHEAD_US & 0xFFFF
                self._echo = present, echo_us, self._clock.millis(now_ns)
        self._attached.discard(present)
        self._is_listening = False
        self._timer_ns = NEVER_NS
        self.schedule()

    # Echoes

    def take_echo(self) -> tuple[int, int, int] | None:
        """Returns (sensor, echo µs, millis) once."""
        echo, self._echo = self._echo, None
        return echo

    def wait(self, now_ns: int):
        """Begins the wait for the next ping."""
        self._wait = Deadline(self._clock, self.wait_ms if self.wait_ms < 1 << 31 else -1, now_ns)

    def set_sequence(self, length: int, sensors: bytes):
        """Takes a new sequence; of an entry that is no sensor the old one stays."""
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


def message_length(packet: bytearray) -> int:
    """Bytes of a message that the firmware sends, header included, checksum not."""
    if packet[2] == WHEEL_STATUS:
        return MESSAGE_MAX
    if packet[2] == ERROR_COUNT:
        return packet.index(0, 8) + 1
    return 12  # a pong or a sonar's report


def frame_body(message: bytes) -> bytes:
    """What stands between a frame's flags: the message and its one's-complement checksum, stuffed.

    The sum adds its carry back in, so it's the sum modulo 255 with 255 in the place of a 0 that isn't all zeros
    (RFC 1071 has the same sum over 16 bits). Headers are never all zeros.
    """
    return stuff(message + bytes([0xFF - ((sum(message) - 1) % 0xFF + 1)]))


def stuff(data: bytes) -> bytes:
    """Hides flags and escapes: the escape goes first, or it would hide its own work."""
    return data.replace(b"\x7d", b"\x7d\x5d").replace(b"\x7e", b"\x7d\x5e")
