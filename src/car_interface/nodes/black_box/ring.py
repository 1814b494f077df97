"""The newest messages of some topics, as they came over the wire, bounded in time and memory."""
from __future__ import annotations

from collections import Counter, deque
from typing import Mapping, NamedTuple

from car_interface.common.units import NS_PER_S

SPAN_NS = 60 * NS_PER_S
MAX_BYTES = 20_000_000
# Of a message in memory beside its bytes: the tuple, the time and the header of the bytes object (sys.getsizeof, 64-bit
# Python 3.11: 64, 32 and 33).
OVERHEAD_BYTES = 130
# What is larger is no state or command: the largest of a car's own are /diagnostics with some 4 kB.
MAX_MESSAGE_BYTES = 16_384
# A topic that floods must not push the others out. An IMU at 200 Hz passes.
MAX_PER_S = 300


class Message(NamedTuple):
    """A serialized message, and where it came from."""

    at_ns: int  # of the monotonic clock, at its arrival
    topic: str
    header: Mapping[str, str]  # of its connection: type, md5sum, message_definition, callerid, latching
    data: bytes


class Ring:
    """Keeps the messages of the last 60 s, and of each latched topic the last one before those.

    Attributes:
        size_bytes: what it holds, with Python's overhead.
        dropped: how many messages were too large, or more than their topic may send.
    """

    def __init__(self, span_ns: int = SPAN_NS, max_bytes: int = MAX_BYTES):
        self.size_bytes = self.dropped = 0
        self._span_ns, self._max_bytes = span_ns, max_bytes
        self._messages: deque[Message] = deque()
        self._latched: dict[tuple[str, str], Message] = {}  # by topic and sender, of those that left the ring
        self._second, self._counts = 0, Counter()  # of the messages by topic in the second of the monotonic clock

    def add(self, message: Message) -> None:
        """Keep a message, and let go what is too old or too much."""
        second = message.at_ns // NS_PER_S
        if second != self._second:
            self._second, self._counts = second, Counter()
        self._counts[message.topic] += 1
        if len(message.data) > MAX_MESSAGE_BYTES or self._counts[message.topic] > MAX_PER_S:
            self.dropped += 1
            return
        self._messages.append(message)
        self.size_bytes += len(message.data) + OVERHEAD_BYTES
        while self.size_bytes > self._max_bytes or self._messages[0].at_ns < message.at_ns - self._span_ns:
            self._drop_oldest()

    def _drop_oldest(self):
        oldest = self._messages.popleft()
        self.size_bytes -= len(oldest.data) + OVERHEAD_BYTES
        if oldest.header.get("latching") == "1":
            self._latched[oldest.topic, oldest.header.get("callerid", "")] = oldest

    def messages(self) -> list[Message]:
        """Return all of it, oldest first; a latched message that is older than the rest has the time of the oldest."""
        kept = list(self._messages)
        senders = {(message.topic, message.header.get("callerid", "")) for message in kept}
        return [message._replace(at_ns=kept[0].at_ns) for key, message in self._latched.items()
                if kept and key not in senders] + kept
