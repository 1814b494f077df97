"""The Teensy's deployed firmware as seen from its serial line: every byte, every fault, every millisecond.

Consumes the bytes that a host writes, the pulses of two wheels and the echoes of six sonars; produces the bytes that
leave the UART, each no earlier than the line carries it. It knows what a frame *is* on its own and shares no code with
the host's side of the protocol.

The receiver's four faults, the boot frame, the filler that is never filled and the starving packet pool are kept on
purpose: a host that works with this one works with the ones in the cars.

All times are true time in nanoseconds (``int``) and never run back; "tick" is the firmware's own millisecond count.
"""

from __future__ import annotations

import random
import struct
from collections import deque
from dataclasses import dataclass
from typing import Callable

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
SPEED_PULSES = 10  # the speed is an average over so many pulse intervals

COUNTER_NAMES = (
    "rxErrorChecksum", "rxErrorTooShort", "rxErrorTooLong", "rxErrorBuffer", "rxErrorDropped", "rxErrorUnknown",
    "txErrorNoBuf", "txInfoSonarDrop", "txInfoWheelDrop", "txBytes", "txPackets", "rxBytes", "rxPackets",
    "pingFail", "badSeqCommand", "badSonarId", "unknownCommand", "badSeqLen", "badSonarIdx",
    "rotBufFull", "rotUpdSkip", "errPing0", "errPing1", "errPing2", "errPing3", "errPing4", "errPing5",
)  # fmt: skip

NS_PER_US, NS_PER_MS = 1_000, 1_000_000
NEVER_NS = 1 << 63
BITS_PER_BYTE_S = 10 * 1_000_000_000  # 8N1 sends ten bits a byte; times nanoseconds a second

U32 = struct.Struct("<I")
SONAR_ECHO = struct.Struct("<HI")  # echo µs, when: what follows the sensor and the byte that nobody fills
WHEEL = struct.Struct("<HBBIII")  # speed, direction, reserved, when, dist, dist_abs


@dataclass(frozen=True)
class FirmwareConfig:
    """What one simulated Teensy is like; the defaults are the one in the cars.

    Attributes:
        baud: bits a second on the line, both ways.
        clock_start_ms: what ``millis()`` says at power-up; near 2**32 the wrap comes soon. After ``reboot`` it is 0.
        clock_drift_ppm: how much the Teensy's crystal is too fast (positive) or too slow.
        clock_ramp_ppm_per_h: how much that changes in an hour (a car that warms up).
        sonar_wait_ms: from an echo to the next sonar's ping, until SONAR_WAIT says otherwise.
        sonar_sequence: the sonars' order, until SET_SONAR_SEQ says otherwise.
        sonar_listen_us: how long a sonar listens before it reports that nothing came back (0).
        wheel_min_ms: no wheel report sooner than this after the one before.
        wheel_max_ms: a wheel report at the latest so long after the one before.
        corrected_checksum: True for a firmware whose receiver sums with carry over unescaped bytes. Its other
            faults stay.
        pool_size: packets that receiver, queues and transmitter share.
        uart_buffer: bytes that the serial driver holds in front of the line.
        boot_byte: the X of the boot frame.
        seed: of the garbage that the packets' memory holds at power-up; None for zeros.

    Raises:
        ConfigError: a value that no Teensy could have.
    """

    baud: int = 115200
    clock_start_ms: int = 0
    clock_drift_ppm: float = 0.0
    clock_ramp_ppm_per_h: float = 0.0
    sonar_wait_ms: int = 50
    sonar_sequence: tuple[int, ...] = (0, 1, 2, 3, 4, 5)
    sonar_listen_us: int = 11428
    wheel_min_ms: int = 5
    wheel_max_ms: int = 200
    corrected_checksum: bool = False
    pool_size: int = 32
    uart_buffer: int = 64
    boot_byte: int = 0xC1
    seed: int | None = None

    def __post_init__(self):
        require(self.baud > 0, "baud", self.baud, "more than 0")
        require(0 <= self.clock_start_ms < 1 << 32, "clock_start_ms", self.clock_start_ms, "0 to 2**32 - 1")
        require(abs(self.clock_drift_ppm) <= 10_000, "clock_drift_ppm", self.clock_drift_ppm, "-10000 to 10000")
        require(self.sonar_wait_ms >= 0, "sonar_wait_ms", self.sonar_wait_ms, "0 or more")
        require(0 < self.sonar_listen_us < 1 << 16, "sonar_listen_us", self.sonar_listen_us, "1 to 65535")
        require(0 < self.wheel_min_ms <= self.wheel_max_ms, "wheel_min_ms", self.wheel_min_ms, "1 to wheel_max_ms")
        require(self.pool_size > 0, "pool_size", self.pool_size, "more than 0")
        require(self.uart_buffer > 0, "uart_buffer", self.uart_buffer, "more than 0")
        require(0 <= self.boot_byte <= 0xFF, "boot_byte", self.boot_byte, "0 to 255")
        sequence = self.sonar_sequence
        sensors_exist = all(0 <= sensor < SONARS for sensor in sequence)
        fine = 0 < len(sequence) <= SEQUENCE_MAX and sensors_exist
        require(fine, "sonar_sequence", sequence, "1 to 24 sensors from 0 to 5")


class TeensyFirmware:
    """A powered Teensy with two wheels and six sonars on it.

    Args:
        config: what it is like.
        echo_us: ``(sensor, at_ns) -> µs`` from a ping to its echo, 0 for none; an attribute too. Without one no sonar
            ever hears anything.
        power_up_ns: the true time at which it is switched on.

    Attributes:
        counters: every counter that GET_COUNTERS can report, by name.
    """

    def __init__(
        self,
        config: FirmwareConfig,
        echo_us: Callable[[int, int], int] | None = None,
        power_up_ns: int = 0,
    ):
        self.echo_us = echo_us or (lambda sensor, at_ns: 0)
        self._config = config
        self._incoming = IncomingLine(config.baud)
        self._outgoing = OutgoingLine(config.baud, config.uart_buffer)
        self._now_ns = power_up_ns
        self._power_up(config.clock_start_ms)

    def _power_up(self, clock_start_ms: int):
        config = self._config
        self._clock = Clock(clock_start_ms, config.clock_drift_ppm, config.clock_ramp_ppm_per_h, self._now_ns)
        self.counters: dict[str, int] = dict.fromkeys(COUNTER_NAMES, 0)
        self._pool = PacketPool(config.pool_size, config.seed)
        self._receiver = Receiver(self._pool.take, self.counters, config.corrected_checksum)
        self._transmitter = Transmitter(self._outgoing, self._pool, self.counters)
        self._axle = Axle(config.wheel_min_ms, config.wheel_max_ms, self.counters)
        self._sonars = SonarArray(config.sonar_sequence, config.sonar_wait_ms, config.sonar_listen_us, self.counters)
        self._commands = {
            PONG_RESP: self._ignore,
            SET_SONAR_SEQ: self._set_sonar_sequence,
            SONAR_STOP: self._stop_sonars,
            SONAR_START: self._start_sonars,
            WHEEL_RESET: self._reset_wheels,
            GET_COUNTERS: self._send_counters,
            SONAR_WAIT: self._set_sonar_wait,
        }
        self._sonars.fire(self._now_ns, self.echo_us)
        # Counted from tick 0 the first wheel report may be overdue: then it waits before the boot frame is closed.
        self._schedule_wheel_report()
        self._transmitter.begin(self._config.boot_byte, self._now_ns)

    def advance(self, now_ns: int):
        """Lives on until ``now_ns``. A time that has passed already changes nothing."""
        while True:
            at_ns = self.next_event_ns
            if at_ns > now_ns:
                break
            self._now_ns = max(at_ns, self._now_ns)
            if at_ns == self._wheel_report_ns:
                self._report_wheels()
            elif at_ns == self._sonars.next_ns:
                self._attend_to_sonars()
            elif at_ns == self._incoming.next_ns:
                self._receive_byte(self._incoming.take())
            else:
                self._transmitter.close_frame(self._now_ns)
        self._now_ns = max(now_ns, self._now_ns)

    def receive(self, data: bytes, now_ns: int):
        """Takes what the host began to write at ``now_ns``; its bytes arrive one after the other at the line's pace."""
        self.advance(now_ns)
        self._incoming.write(data, self._now_ns)

    def receive_backlog(self, now_ns: int) -> int:
        """Bytes that the host has written and that the line hasn't carried yet: whoever feeds a flood waits on this."""
        self.advance(now_ns)
        return self._incoming.backlog

    def transmit(self, now_ns: int) -> bytes:
        """Lives on until ``now_ns`` and returns the bytes that have left the UART by then, each one once."""
        self.advance(now_ns)
        return self._outgoing.collect(self._now_ns)

    def wheel_pulse(self, side: int, direction: int, at_ns: int):
        """Counts a pulse of one rear wheel.

        Args:
            side: LEFT or RIGHT.
            direction: FORWARD or BACKWARD.
            at_ns: its true time; pulses come in order, one that is late counts as of now.
        """
        self.advance(at_ns)
        if self._axle.pulse(side, direction, self._clock.tick(self._now_ns)):
            self._send_wheel_report()

    def reboot(self, now_ns: int):
        """Switches it off and on: a frame on the line is cut, clock and odometers are zero, a boot frame follows."""
        self.advance(now_ns)
        self._outgoing.cut(self._now_ns)
        self._power_up(clock_start_ms=0)

    def millis(self, now_ns: int) -> int:
        """The firmware's clock at ``now_ns``: whole milliseconds, modulo 2**32. Looks only, lives nothing."""
        return self._clock.millis(now_ns)

    def device_ns(self, now_ns: int) -> int:
        """The same clock in nanoseconds, neither truncated nor wrapped: what an estimate of it is scored against."""
        return self._clock.device_ns(now_ns)

    @property
    def next_event_ns(self) -> int:
        """When something will happen by itself; until then ``advance`` has nothing to do. Bytes may leave sooner."""
        return min(self._wheel_report_ns, self._sonars.next_ns, self._incoming.next_ns, self._transmitter.flag_ns)

    # Wheels and sonars

    def _schedule_wheel_report(self):
        self._wheel_report_ns = self._clock.reaches_ns(self._axle.due_tick, self._now_ns)

    def _report_wheels(self):
        self._axle.stand_still(self._clock.tick(self._now_ns))
        self._send_wheel_report()

    def _send_wheel_report(self):
        self._transmitter.queue_wheels(self._axle.report(), self._now_ns)
        self._schedule_wheel_report()

    def _attend_to_sonars(self):
        if self._sonars.echo_ns > self._now_ns:
            self._sonars.fire_next(self._now_ns, self.echo_us)
            return
        sensor, echo_us = self._sonars.hear()
        packet = self._pool.take()
        if packet is None:
            # The firmware schedules the next ping when it handles the report. No packet, no report, no next ping:
            # the sonars stay silent until SONAR_START.
            self.counters["txErrorNoBuf"] += 1
            return
        packet[:5] = bytes((RPI, TEENSY, SONAR_STATUS, 0, sensor))
        SONAR_ECHO.pack_into(packet, 6, echo_us, self._clock.millis(self._now_ns))
        self._transmitter.queue_sonar(sensor, packet, self._now_ns)
        # The firmware waits until its tick is *past* echo + wait, hence the 1.
        ping_tick = self._clock.tick(self._now_ns) + self._sonars.wait_ms + 1
        self._sonars.ping_at(self._clock.reaches_ns(ping_tick, self._now_ns))

    # What the host asks for

    def _receive_byte(self, byte: int):
        packet = self._receiver.byte(byte)
        if packet is None:
            return
        if packet[0] == TEENSY and packet[2] == PING_QUERY:
            self._pong(packet)
            return
        if packet[0] == TEENSY:
            self._commands.get(packet[2], self._count_unknown)(packet)
        self._pool.give(packet)

    def _pong(self, packet: bytearray):
        """Turns the ping itself into its answer, as the firmware does: whatever was in it stays in it."""
        packet[:3] = bytes((packet[1], TEENSY, PONG_RESP))
        U32.pack_into(packet, 8, self._clock.millis(self._now_ns))
        self._transmitter.queue_first(packet, self._now_ns)

    def _ignore(self, packet: bytearray):
        """Does nothing: a pong is known to the firmware, and it never asked for one."""

    def _count_unknown(self, packet: bytearray):
        self.counters["rxErrorUnknown"] += 1

    def _set_sonar_sequence(self, packet: bytearray):
        self._sonars.set_sequence(packet[4], packet[5 : 5 + SEQUENCE_MAX])

    def _stop_sonars(self, packet: bytearray):
        self._sonars.running = False

    def _start_sonars(self, packet: bytearray):
        self._sonars.running = True
        self._sonars.fire_next(self._now_ns, self.echo_us)

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
            U32.pack_into(answer, 4, count & 0xFFFFFFFF)
            answer[8:32] = name.encode("ascii").ljust(24, b"\0")
            self._transmitter.queue_first(answer, self._now_ns)


class Clock:
    """``millis()`` over a crystal that is a little off.

    Args:
        start_ms: what it says at ``power_up_ns``.
        drift_ppm: how much too fast it runs then.
        ramp_ppm_per_h: how much faster still it runs each hour after.
        power_up_ns: true time at which it starts.
    """

    def __init__(self, start_ms: int, drift_ppm: float, ramp_ppm_per_h: float, power_up_ns: int):
        self._start_ns = start_ms * NS_PER_MS
        self._drift_ppb = round(drift_ppm * 1000)
        self._half_ramp_per_ns = 0.5 * ramp_ppm_per_h * 1e-6 / 3600e9
        self._power_up_ns = power_up_ns

    def device_ns(self, now_ns: int) -> int:
        elapsed_ns = now_ns - self._power_up_ns
        gained_ns = elapsed_ns * self._drift_ppb // 1_000_000_000
        if self._half_ramp_per_ns:
            gained_ns += int(self._half_ramp_per_ns * elapsed_ns * elapsed_ns)
        return self._start_ns + elapsed_ns + gained_ns

    def tick(self, now_ns: int) -> int:
        """Whole milliseconds, not wrapped."""
        return self.device_ns(now_ns) // NS_PER_MS

    def millis(self, now_ns: int) -> int:
        """Whole milliseconds, modulo 2**32."""
        return self.tick(now_ns) & 0xFFFFFFFF

    def reaches_ns(self, tick: int, now_ns: int) -> int:
        """The first true time at which the clock is at ``tick`` or past it, sought from ``now_ns`` on."""
        target_ns = tick * NS_PER_MS
        at_ns = now_ns
        # Each round shrinks the error by the drift, some 1e-4: three leave less than 1 ns of any wait.
        for _ in range(3):
            at_ns += target_ns - self.device_ns(at_ns)
        while self.device_ns(at_ns) < target_ns:
            at_ns += 1
        return at_ns


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
    """

    def __init__(self, line: OutgoingLine, pool: PacketPool, counters: dict[str, int]):
        self._line = line
        self._pool = pool
        self._counters = counters
        self._first: deque[bytearray] = deque()
        self._reports: list[bytearray | None] = [None] * (1 + SONARS)  # wheels, then each sonar
        self._turn = 0
        self._sending: bytearray | None = None
        self.flag_ns = 0  # when the flag that closes the frame under way finds room; NEVER_NS when idle

    def begin(self, boot_byte: int, now_ns: int):
        """Sends the frame that the firmware makes of a packet that isn't there."""
        self._write(bytes([FLAG]) + stuff(bytes([boot_byte, boot_byte ^ 0xFF])), now_ns)

    def queue_first(self, packet: bytearray, now_ns: int):
        self._first.append(packet)
        self._wake(now_ns)

    def queue_wheels(self, report: bytes, now_ns: int):
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
        self._wake(now_ns)

    def queue_sonar(self, sensor: int, packet: bytearray, now_ns: int):
        waiting = self._reports[1 + sensor]
        if waiting is not None:
            self._counters["txInfoSonarDrop"] += 1
            self._pool.give(waiting)
        self._reports[1 + sensor] = packet
        self._wake(now_ns)

    def close_frame(self, now_ns: int):
        """Writes the closing flag, and behind it at once the next packet if there is one."""
        self._line.write(bytes([FLAG]), now_ns)
        self._counters["txBytes"] += 1
        if self._sending is not None:
            self._pool.give(self._sending)
            self._sending = None
            self._counters["txPackets"] += 1
        self.flag_ns = NEVER_NS
        packet = self._next()
        if packet is not None:
            self._send(packet, b"", now_ns)

    def _wake(self, now_ns: int):
        if self.flag_ns != NEVER_NS:
            return
        packet = self._next()
        if packet is not None:
            self._send(packet, bytes([FLAG]), now_ns)

    def _next(self) -> bytearray | None:
        if self._first:
            return self._first.popleft()
        for _ in self._reports:
            packet, self._reports[self._turn] = self._reports[self._turn], None
            if packet is not None:
                return packet
            self._turn = (self._turn + 1) % len(self._reports)
        return None

    def _send(self, packet: bytearray, opening: bytes, now_ns: int):
        self._sending = packet
        self._write(opening + frame_body(bytes(packet[: message_length(packet)])), now_ns)

    def _write(self, data: bytes, now_ns: int):
        self._line.write(data, now_ns)
        self._counters["txBytes"] += len(data)
        self.flag_ns = self._line.room_ns(now_ns)


class OutgoingLine:
    """The UART's buffer and the wire behind it: bytes leave in order, ten bits each, never sooner.

    Args:
        baud: bits a second.
        buffer_size: bytes that wait in front of the wire before a writer has to.
    """

    def __init__(self, baud: int, buffer_size: int):
        self._baud = baud
        self._buffer_ns = buffer_size * BITS_PER_BYTE_S // baud
        self._chunks: deque[tuple[int, bytes]] = deque()  # when its first bit goes out, its bytes
        self._collected = 0  # of the first chunk
        self._saved = b""  # from before a cut
        self._free_ns = 0

    def write(self, data: bytes, now_ns: int):
        start_ns = max(now_ns, self._free_ns)
        self._chunks.append((start_ns, data))
        self._free_ns = start_ns - (-len(data) * BITS_PER_BYTE_S // self._baud)  # rounded up: never too fast

    def room_ns(self, now_ns: int) -> int:
        """When the buffer takes one more byte."""
        return max(now_ns, self._free_ns - self._buffer_ns)

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

    def _byte_ns(self, count: int) -> int:
        return self._burst_ns - (-count * BITS_PER_BYTE_S // self._baud)

    def _look_ahead(self):
        self.next_ns = self._byte_ns(self._taken + 1) if self._bytes else NEVER_NS


class Wheel:
    """One wheel's odometer."""

    def __init__(self):
        self._when_tick = 0
        self.reset()

    def reset(self):
        """Zeroes the odometer; the time of the last pulse stays."""
        self._dist_abs = 0
        self._dist = 0
        self._direction = NO_DIRECTION
        self._window: deque[tuple[int, int]] = deque(maxlen=SPEED_PULSES + 1)  # (tick, pulses then)

    def pulse(self, direction: int, tick: int):
        self._dist_abs += 1
        if direction != self._direction:
            self._window.clear()
            self._direction = direction
            self._dist = self._dist_abs
        self._window.append((tick, self._dist_abs))
        self._when_tick = tick

    def stand_still(self, tick: int):
        """Notes that no pulse came: the average falls to zero over a few reports, not at once."""
        if self._window:
            self._window.append((tick, self._dist_abs))

    def report(self) -> bytes:
        return WHEEL.pack(
            self._speed() & 0xFFFF, self._direction, 0, self._when_tick & 0xFFFFFFFF,
            self._dist & 0xFFFFFFFF, self._dist_abs & 0xFFFFFFFF,
        )  # fmt: skip

    def _speed(self) -> int:
        """Pulses a second, truncated, over the window; 0 with one pulse, or with all of them in one tick."""
        if len(self._window) < 2:
            return 0
        (first_tick, first_count), (last_tick, last_count) = self._window[0], self._window[-1]
        if first_tick == last_tick:
            return 0
        return 1000 * (last_count - first_count) // (last_tick - first_tick)


class Axle:
    """Both rear wheels, and when they are worth a report: with a pulse, but not too often; without one, now and then.

    A pulse sooner than ``min_ms`` after a report is not reported later either: it waits for the next pulse or for
    the regular report, and counts as rotUpdSkip.
    """

    def __init__(self, min_ms: int, max_ms: int, counters: dict[str, int]):
        self._wheels = (Wheel(), Wheel())
        self._min_ms = min_ms
        self._max_ms = max_ms
        self._counters = counters
        self._reported_tick = 0

    @property
    def due_tick(self) -> int:
        return self._reported_tick + self._max_ms

    def reset(self):
        for wheel in self._wheels:
            wheel.reset()

    def pulse(self, side: int, direction: int, tick: int) -> bool:
        """Counts a pulse; says whether a report is to be sent now."""
        self._wheels[side].pulse(direction, tick)
        if tick - self._reported_tick < self._min_ms:
            self._counters["rotUpdSkip"] += 1
            return False
        self._reported_tick = tick
        return True

    def stand_still(self, tick: int):
        """Prepares the regular report of an axle without pulses."""
        for wheel in self._wheels:
            wheel.stand_still(tick)
        self._reported_tick = tick

    def report(self) -> bytes:
        return self._wheels[LEFT].report() + self._wheels[RIGHT].report()


class SonarArray:
    """Six sonars of which one at a time pings, listens and reports; then comes a wait, then the next in the sequence.

    Attributes:
        running: False after SONAR_STOP: the sonar that listens still reports, none follows it.
        wait_ms: from a report to the next ping.
        echo_ns: when the sonar that listens will report.
    """

    def __init__(self, sequence: tuple[int, ...], wait_ms: int, listen_us: int, counters: dict[str, int]):
        self._sequence = list(sequence) + [0] * (SEQUENCE_MAX - len(sequence))
        self._length = len(sequence)
        self._index = 0
        self._listen_us = listen_us
        self._counters = counters
        self._heard = (0, 0)
        self._ping_ns = NEVER_NS
        self.echo_ns = NEVER_NS
        self.wait_ms = wait_ms
        self.running = True

    @property
    def next_ns(self) -> int:
        return min(self.echo_ns, self._ping_ns)

    def fire(self, now_ns: int, echo_us: Callable[[int, int], int]):
        """Sends the ping of the present sensor and notes when what will be heard."""
        sensor = self._sequence[self._index]
        heard_us = echo_us(sensor, now_ns)
        if not 0 < heard_us <= self._listen_us:
            heard_us = 0
        self._heard = sensor, heard_us
        self._ping_ns = NEVER_NS
        self.echo_ns = now_ns + (heard_us or self._listen_us) * NS_PER_US

    def fire_next(self, now_ns: int, echo_us: Callable[[int, int], int]):
        """Goes on to the next sensor, unless stopped."""
        self._ping_ns = NEVER_NS
        if self.running:
            self._index = self._index + 1 if self._index + 1 < self._length else 0
            self.fire(now_ns, echo_us)

    def hear(self) -> tuple[int, int]:
        """Returns (sensor, echo µs) and listens no more."""
        self.echo_ns = NEVER_NS
        return self._heard

    def ping_at(self, at_ns: int):
        self._ping_ns = at_ns

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
