"""The simulated Teensy's serial port: packets, the pool that all parts share, and both directions of the line.

Bytes from the host, at the line's pace, become packets; packets become frames, which leave at the pace of the line.
"""
from __future__ import annotations

from collections import deque
from random import Random
from typing import Callable

from car_interface.sim.teensy_clock import AT_ONCE_NS, NEVER_NS

FLAG, ESCAPE, ESCAPE_XOR = 0x7E, 0x7D, 0x20
RPI, TEENSY = 1, 2
SONARS = 6

PING_QUERY, PONG_RESP, SET_SONAR_SEQ, SONAR_STOP, SONAR_START, SONAR_STATUS = 1, 2, 3, 4, 5, 6
WHEEL_STATUS, WHEEL_RESET, ERROR_COUNT, GET_COUNTERS, SONAR_WAIT = 7, 8, 9, 10, 12

HEADER_SIZE = 4
MESSAGE_MAX = 36  # header + WHEEL_STATUS, the longest message; the checksum follows it
PACKET_SIZE = MESSAGE_MAX + 4
COUNTER_NAMES = (
    "rxErrorChecksum", "rxErrorTooShort", "rxErrorTooLong", "rxErrorBuffer", "rxErrorDropped", "rxErrorUnknown",
    "txErrorNoBuf", "txInfoSonarDrop", "txInfoWheelDrop", "txBytes", "txPackets", "rxBytes", "rxPackets",
    "pingFail", "badSeqCommand", "badSonarId", "unknownCommand", "badSeqLen", "badSonarIdx",
    "rotBufFull", "rotUpdSkip", "errPing0", "errPing1", "errPing2", "errPing3", "errPing4", "errPing5",
)

BAUD = 115200  # bits a second on the line, both ways
BITS_PER_BYTE_S = 10 * 1_000_000_000  # 8N1 sends ten bits a byte; times nanoseconds a second
BUFFER_SIZE = 62  # bytes that wait in front of the line before a writer has to: of its 64 the firmware leaves 2 free
POOL_SIZE = 32  # packets that receiver, queues and transmitter share
BOOT_BYTE = 0xC1  # of the frame that the firmware makes of a packet that isn't there, before its complement


class PoolEmpty(Exception):
    """The firmware wrote through a null pointer, to a packet that it didn't get."""


class PacketPool:
    """The packets that all parts share. A used one keeps its content, which later shows in the filler byte."""

    def __init__(self, seed: int | None):
        memory = bytes(POOL_SIZE * PACKET_SIZE)
        if seed is not None:
            memory = Random(seed).getrandbits(8 * len(memory)).to_bytes(len(memory), "little")
        chunks = (memory[start : start + PACKET_SIZE] for start in range(0, len(memory), PACKET_SIZE))
        self._free: deque[bytearray] = deque(bytearray(chunk) for chunk in chunks)

    def acquire(self) -> bytearray | None:
        """Return the packet that has been free for longest, or None when all are in use."""
        return self._free.popleft() if self._free else None

    def release(self, packet: bytearray):
        self._free.append(packet)


class Receiver:
    """Assembles packets from the host's bytes, with the four faults of the original.

    Args:
        corrected_checksum: True to sum with carry, over the unescaped bytes.
    """

    WAITING, DATA, ESCAPED = "waiting", "data", "escaped"  # for an opening flag; in a frame; for an escaped byte

    def __init__(self, acquire: Callable[[], bytearray | None], counters: dict[str, int],
                 corrected_checksum: bool = False):
        self._acquire = acquire
        self._counters = counters
        self._corrected = corrected_checksum
        self._packet: bytearray | None = None
        self._restart()

    def byte(self, byte: int) -> bytearray | None:
        """Take one byte; return the packet that it completed, checksum included, or None."""
        if self._packet is None:
            self._packet = self._acquire()
            if self._packet is None:
                self._counters["rxErrorBuffer"] += 1
                return None
        self._counters["rxBytes"] += 1
        if self._phase == self.WAITING and byte == FLAG:
            self._phase = self.DATA
        elif self._phase == self.WAITING:
            self._counters["rxErrorDropped"] += 1
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
        self._filled = self._sum = 0

    def _undo_escape(self, byte: int):
        """Store the unescaped byte, and add the escaped one to the sum.

        The phase is DATA afterwards in any case, even when the packet was full and thrown away: only this state, full
        and escaped, takes 39 bytes of 00 to leave.
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
        """Judge the frame. Its closing flag opens no other, so an odd flag swaps opening and closing for good."""
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
        return packet


class Transmitter:
    """Queues packets and frames them for the line.

    Answers go first. The newest wheel report and the newest report of each sonar wait for the rest of the line; a newer
    one replaces one that still waits, which is counted. Two frames share a flag when the second one already waits while
    the first is being closed; otherwise each has its own two.

    It first sends the frame that the firmware makes of a packet that isn't there.
    """

    def __init__(self, line: Wire, pool: PacketPool, counters: dict[str, int]):
        self._line = line
        self._pool = pool
        self._counters = counters
        self._first: deque[bytearray] = deque()
        self._reports: list[bytearray | None] = [None] * (1 + SONARS)  # wheels, then each sonar
        self._next_index = 0
        self._sending: bytearray | None = None
        self._unsent = bytes([FLAG]) + stuff(bytes([BOOT_BYTE, BOOT_BYTE ^ 0xFF])) + bytes([FLAG])
        self.due_ns = AT_ONCE_NS  # when there is space for the next bytes; NEVER_NS when there is nothing to send

    def queue_first(self, packet: bytearray):
        self._first.append(packet)
        self._wake()

    def new_packet(self, kind: int) -> bytearray | None:
        """Return a free packet with its header; None, which is counted, when all are in use."""
        packet = self._pool.acquire()
        if packet is None:
            self._counters["txErrorNoBuf"] += 1
        else:
            packet[:HEADER_SIZE] = bytes((RPI, TEENSY, kind, 0))
        return packet

    def queue_wheels(self, report: bytes):
        packet = self._reports[0]
        if packet is not None:
            self._counters["txInfoWheelDrop"] += 1
        else:
            packet = self.new_packet(WHEEL_STATUS)
        if packet is not None:
            packet[HEADER_SIZE : HEADER_SIZE + len(report)] = report
            self._reports[0] = packet
            self._wake()

    def queue_sonar(self, sensor: int, packet: bytearray):
        waiting = self._reports[1 + sensor]
        if waiting is not None:
            self._counters["txInfoSonarDrop"] += 1
            self._pool.release(waiting)
        self._reports[1 + sensor] = packet
        self._wake()

    def poll(self, now_ns: int):
        """Write as much as the buffer takes, beyond the end of the frame under way."""
        is_open = False  # the last byte written was a frame's closing flag
        while True:
            if not self._unsent:
                packet = self._next()
                if packet is None:
                    self.due_ns = NEVER_NS
                    return
                self._sending = packet
                body = frame_body(bytes(packet[: message_length(packet)])) + bytes([FLAG])
                self._unsent = body if is_open else bytes([FLAG]) + body
            count = min(len(self._unsent), self._line.free_bytes(now_ns))
            self._line.write(self._unsent[:count], now_ns)
            self._counters["txBytes"] += count
            self._unsent = self._unsent[count:]
            if self._unsent:
                # There is space for all of it before the line runs dry: the buffer is longer than a frame.
                self.due_ns = self._line.free_at_ns(len(self._unsent), now_ns)
                return
            is_open = True
            if self._sending is not None:
                self._pool.release(self._sending)
                self._sending = None
                self._counters["txPackets"] += 1

    def _wake(self):
        if self.due_ns == NEVER_NS:
            self.due_ns = AT_ONCE_NS

    def _next(self) -> bytearray | None:
        if self._first:
            return self._first.popleft()
        for _ in self._reports:
            packet, self._reports[self._next_index] = self._reports[self._next_index], None
            if packet is not None:
                return packet
            self._next_index = (self._next_index + 1) % len(self._reports)
        return None


class Wire:
    """One direction of the line, with the sender's buffer: bytes arrive in order, ten bits each, never sooner."""

    def __init__(self):
        self._bytes: deque[tuple[int, int]] = deque()  # when its last bit is out, and which it is
        self._free_ns = AT_ONCE_NS

    @property
    def backlog(self) -> int:
        return len(self._bytes)

    @property
    def next_ns(self) -> int:
        """Return when the next byte has arrived; NEVER_NS when none is on the wire."""
        return self._bytes[0][0] if self._bytes else NEVER_NS

    def write(self, data: bytes, now_ns: int):
        start_ns = max(now_ns, self._free_ns)
        self._bytes.extend((start_ns + line_ns(count), byte) for count, byte in enumerate(data, 1))
        self._free_ns = start_ns + line_ns(len(data))

    def free_bytes(self, now_ns: int) -> int:
        """Return how many bytes the buffer takes now."""
        waiting = -(-(self._free_ns - now_ns) * BAUD // BITS_PER_BYTE_S)
        return min(BUFFER_SIZE, BUFFER_SIZE + 1 - waiting)

    def free_at_ns(self, count: int, now_ns: int) -> int:
        """Return when the buffer takes ``count`` bytes, at most its size."""
        spare = BUFFER_SIZE + 1 - min(count, BUFFER_SIZE)
        return max(now_ns, self._free_ns - spare * BITS_PER_BYTE_S // BAUD)

    def pop(self) -> int:
        return self._bytes.popleft()[1]

    def collect(self, now_ns: int) -> bytes:
        """Return the bytes whose last bit is out by ``now_ns`` and that weren't collected yet."""
        out = bytearray()
        while self.next_ns <= now_ns:
            out.append(self.pop())
        return bytes(out)

    def cut(self, now_ns: int):
        """Lose the bytes that haven't left the wire yet."""
        self._bytes = deque(each for each in self._bytes if each[0] <= now_ns)
        self._free_ns = now_ns


def line_ns(count: int) -> int:
    """Return how long so many bytes take on the line, rounded up: never too fast."""
    return -(-count * BITS_PER_BYTE_S // BAUD)


def message_length(packet: bytearray) -> int:
    """Return the bytes of a message that the firmware sends, with the header and without the checksum."""
    if packet[2] == WHEEL_STATUS:
        return MESSAGE_MAX
    if packet[2] == ERROR_COUNT:
        return packet.index(0, 8) + 1
    return 12  # a pong or a sonar's report


def frame_body(message: bytes) -> bytes:
    """Return the bytes between a frame's flags: the message and its one's-complement checksum, stuffed.

    The sum adds its carry back in, so it's the sum modulo 255 with 255 in the place of a 0 that isn't all zeros
    (RFC 1071 has the same sum over 16 bits). Headers are never all zeros.
    """
    return stuff(message + bytes([0xFF - ((sum(message) - 1) % 0xFF + 1)]))


def stuff(data: bytes) -> bytes:
    """Return bytes with flags and escapes stuffed; escapes go first, or the escapes of flags would be stuffed, too."""
    return data.replace(b"\x7d", b"\x7d\x5d").replace(b"\x7e", b"\x7d\x5e")
