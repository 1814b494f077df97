"""The simulated Teensy's transmitter: packets become frames, which leave the UART at the pace of the line."""
from __future__ import annotations

from collections import deque

from car_interface.sim import teensy_packets as packets
from car_interface.sim.teensy_clock import AT_ONCE_NS, NEVER_NS
from car_interface.sim.teensy_packets import BITS_PER_BYTE_S, FLAG, PacketPool
from car_interface.sim.teensy_sonars import SONARS

BOOT_BYTE = 0xC1  # of the frame that the firmware makes of a packet that isn't there, before its complement


class Transmitter:
    """Queues packets and frames them for the line.

    Answers go first. The newest wheel report and the newest report of each sonar wait for the rest of the line; a newer
    one replaces one that still waits, which is counted. Two frames share a flag when the second one already waits while
    the first is being closed; otherwise each has its own two.

    It first sends the frame that the firmware makes of a packet that isn't there.
    """

    def __init__(self, line: OutgoingLine, pool: PacketPool, counters: dict[str, int]):
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

    def queue_wheels(self, report: bytes):
        packet = self._reports[0]
        if packet is not None:
            self._counters["txInfoWheelDrop"] += 1
        else:
            packet = self._pool.acquire()
            if packet is None:
                self._counters["txErrorNoBuf"] += 1
                return
        packet[:4] = bytes((packets.RPI, packets.TEENSY, packets.WHEEL_STATUS, 0))
        packet[4 : 4 + len(report)] = report
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


class OutgoingLine:
    """The UART's buffer and the wire behind it: bytes leave in order, ten bits each, never sooner.

    Args:
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

    def free_bytes(self, now_ns: int) -> int:
        """Return how many bytes the buffer takes now."""
        waiting = -(-(self._free_ns - now_ns) * self._baud // BITS_PER_BYTE_S)
        return min(self._buffer_size, self._buffer_size + 1 - waiting)

    def free_at_ns(self, count: int, now_ns: int) -> int:
        """Return when the buffer takes ``count`` bytes, at most its size."""
        spare = self._buffer_size + 1 - min(count, self._buffer_size)
        return max(now_ns, self._free_ns - spare * BITS_PER_BYTE_S // self._baud)

    def collect(self, now_ns: int) -> bytes:
        """Return the bytes whose last bit is out by ``now_ns`` and that weren't collected yet."""
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
        """Lose the bytes that haven't left the wire yet."""
        self._saved = self.collect(now_ns)
        self._chunks.clear()
        self._collected = 0
        self._free_ns = now_ns


def message_length(packet: bytearray) -> int:
    """Return the bytes of a message that the firmware sends, with the header and without the checksum."""
    if packet[2] == packets.WHEEL_STATUS:
        return packets.MESSAGE_MAX
    if packet[2] == packets.ERROR_COUNT:
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
