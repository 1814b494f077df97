"""The simulated Teensy's receiver: bytes from the host, at the line's pace, become packets."""
from __future__ import annotations

from collections import deque
from typing import Callable

from car_interface.sim.teensy_clock import NEVER_NS
from car_interface.sim.teensy_packets import BITS_PER_BYTE_S, ESCAPE, ESCAPE_XOR, FLAG, HEADER_SIZE, MESSAGE_MAX


class Receiver:
    """Assembles packets from the host's bytes, with the four faults of the original.

    Args:
        corrected_checksum: True to sum with carry, over the unescaped bytes.
    """

    IDLE, WAITING, DATA, ESCAPED = "idle", "waiting", "data", "escaped"

    def __init__(self, acquire: Callable[[], bytearray | None], counters: dict[str, int],
                 corrected_checksum: bool = False):
        self._acquire = acquire
        self._counters = counters
        self._corrected = corrected_checksum
        self._packet: bytearray | None = None
        self._phase = self.IDLE
        self._filled = 0
        self._sum = 0

    @property
    def state(self) -> tuple[str, int]:
        """(phase, bytes in the packet). IDLE holds no packet yet, WAITING does and waits for an opening flag."""
        return self._phase, self._filled

    def byte(self, byte: int) -> bytearray | None:
        """Take one byte; return the packet that it completed, checksum included, or None."""
        if self._packet is None:
            self._packet = self._acquire()
            if self._packet is None:
                self._counters["rxErrorBuffer"] += 1
                return None
            self._restart()
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
        self._filled = 0
        self._sum = 0

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
        self._phase = self.IDLE
        return packet


class IncomingLine:
    """The wire from the host: bytes arrive in order, ten bits each, and are taken one at a time.

    Attributes:
        next_ns: when the next byte is complete; NEVER_NS when none is on the wire.
    """

    def __init__(self, baud: int):
        self._baud = baud
        self._bytes: deque[int] = deque()
        self._burst_ns = 0
        self._popped = 0  # since the burst began
        self.next_ns = NEVER_NS

    @property
    def backlog(self) -> int:
        return len(self._bytes)

    def write(self, data: bytes, now_ns: int):
        if not self._bytes:
            self._burst_ns = now_ns
            self._popped = 0
        self._bytes.extend(data)
        self._schedule_next()

    def pop(self) -> int:
        byte = self._bytes.popleft()
        self._popped += 1
        self._schedule_next()
        return byte

    def drop(self, now_ns: int):
        """Discard the bytes that have arrived by now, as while it boots."""
        while self.next_ns <= now_ns:
            self.pop()

    def _byte_ns(self, count: int) -> int:
        return self._burst_ns - (-count * BITS_PER_BYTE_S // self._baud)

    def _schedule_next(self):
        self.next_ns = self._byte_ns(self._popped + 1) if self._bytes else NEVER_NS
