"""One session with a Teensy: bytes and ``now_ns`` in; events, and bytes to send, out.

``Session`` joins the parts of the link: decoder, pinger, health, reboot detector and counters. It opens no port and
reads no clock. The owner of the port reports its state (``opened``, ``health.port_failed``), passes in the bytes that
it read (``receive``), calls ``expire`` at the pinger's ``next_event_ns``, and sends a ``ping`` from its ``due_ns`` on.
"""
from __future__ import annotations

import math
from typing import NamedTuple, Union

from car_interface.teensy.link.framing import RESYNC_FILLER, FrameDecoder, encode
from car_interface.teensy.link.health import Counts, LinkHealth, Verdict
from car_interface.teensy.link.pinging import Answer, Pinger
from car_interface.teensy.link.protocol import ErrorCount, Malformed, Pong, SonarStatus, WheelStatus, decode
from car_interface.teensy.link.reboot import RebootDetector

MAX_COUNTERS = 64  # the firmware has 27; noise that passes for counters must not add more and more of them


class PongReceived(NamedTuple):
    record: Pong
    answer: Answer | None  # the ping that it answers; None = no ping of ours waits for it


class Rebooted(NamedTuple):
    description: str  # of how the Teensy's clock went back; the event after this one is the record that showed it


# The events of ``receive``. Sonar and wheel reports and the Teensy's counters are events themselves.
Received = Union[PongReceived, SonarStatus, WheelStatus, ErrorCount, Malformed, Rebooted]


class Session:
    """The link to one Teensy, over any number of times that its port is opened.

    Args:
        checksum: which one the Teensy's receiver wants: ``SHIPPED``, ``CORRECTED``, or ``AUTO`` = find out.
    """

    def __init__(self, baud: int, ping_period_ns: int, checksum: str, now_ns: int):
        self._decoder = FrameDecoder()
        self.tally = self._decoder.tally
        self.pinger = Pinger(ping_period_ns, checksum, now_ns)
        self.health = LinkHealth(baud)
        self._reboot_detector = RebootDetector()
        self._records_at_expiry = 0
        self._must_resync = False
        self.openings = 0  # of the port
        self.reboots = 0  # how often the Teensy's clock went back
        self.malformed = 0  # frames with the right checksum whose content makes no sense
        self.unknown_commands = 0  # of these, whose command the firmware doesn't send
        self.counters: dict[str, int] = {}  # the Teensy's own, by name, as it last sent them
        self.round_trip_ns = math.nan  # of the newest answered ping; NaN = none was answered yet

    # The port

    def opened(self, now_ns: int) -> None:
        """Take note that the port was opened: the first ping is due now, behind the filler for the receiver."""
        self.openings += 1
        self._must_resync = True
        self._decoder.reset()
        self.health.opened(self.counts(), now_ns)
        self.pinger.restart(now_ns)

    # From the Teensy

    def receive(self, data: bytes, now_ns: int) -> list[Received]:
        """Return the events in bytes that were read from the port, in order."""
        events: list = []
        for body in self._decoder.feed(data):
            event = decode(body)
            if isinstance(event, Pong):
                event = self._on_pong(event, now_ns, events)
            elif isinstance(event, SonarStatus):
                self._on_tick(event.when, now_ns, events)
            elif isinstance(event, ErrorCount):
                if event.name in self.counters or len(self.counters) < MAX_COUNTERS:
                    self.counters[event.name] = event.count
            elif isinstance(event, Malformed):
                self.malformed += 1
                self.unknown_commands += event.is_unknown_command
            events.append(event)
        return events

    def _on_pong(self, pong, now_ns, events):
        answer = self.pinger.pong(pong.timestamp1, now_ns)
        if answer is not None:
            self.round_trip_ns = answer.round_trip_ns
        self._on_tick(pong.timestamp2, now_ns, events, None if answer is None else answer.sent_ns)
        return PongReceived(pong, answer)

    def _on_tick(self, tick, now_ns, events, sent_ns=None):
        description = self._reboot_detector.update(tick, now_ns, sent_ns)
        if description is not None:
            self.reboots += 1
            self.health.rebooted(description, now_ns)
            self.pinger.retry_now()
            events.append(Rebooted(description))

    # To the Teensy

    def expire(self, now_ns: int) -> list[int]:
        """Give up on the pings that have waited too long, and return their timestamps; may change the checksum."""
        records = self.counts().records
        # An unanswered ping shows nothing about the checksum while nothing at all comes from the Teensy.
        expired = self.pinger.expire(now_ns, is_alive=records > self._records_at_expiry)
        if expired:
            self._records_at_expiry = records
        return expired

    def ping(self, timestamp1: int, now_ns: int) -> bytes:
        """Return the bytes of a ping, due or not; ``timestamp1`` comes back in its pong."""
        filler = RESYNC_FILLER if self._must_resync else b""
        self._must_resync = False
        return filler + self.pinger.ping(timestamp1, now_ns)

    def encode(self, body: bytes) -> bytes:
        """Return the frame of a command, with the checksum that the Teensy's receiver seems to want."""
        return encode(body, self.pinger.checksum)

    # Health of the link

    def judge(self, now_ns: int) -> Verdict:
        """Return the link's verdict by the present counters; call it about once a second."""
        return self.health.judge(self.counts(), now_ns)

    def counts(self) -> Counts:
        """Return the counters by which the health of the link is judged."""
        tally = self.tally
        return Counts(bytes_in=tally.bytes_in, records=tally.frames - self.malformed, bad_frames=tally.bad_frames,
                      bad_checksums=tally.bad_checksum, pings_in_vain=self.pinger.unanswered_in_a_row)

    @property
    def resyncs(self) -> int:
        """Return how often the Teensy's receiver was resynchronised: as the port opened, and after unanswered pings."""
        return self.openings + self.pinger.resyncs
