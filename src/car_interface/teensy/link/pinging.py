"""Plans the pings, matches pongs with them, and finds out which checksum the Teensy's receiver wants."""
from __future__ import annotations

from typing import NamedTuple

from car_interface.common.units import NS_PER_S
from car_interface.teensy.link.framing import CORRECTED, RESYNC_FILLER, SHIPPED, encode
from car_interface.teensy.link.protocol import ping

AUTO = "auto"
# A pong waits at most behind the Teensy's full transmit buffers: some 2 kB, 0.2 s at 115200 baud.
ANSWER_WITHIN_NS = NS_PER_S // 2
UNANSWERED_BEFORE_SWITCH = 5
# Each ping is moved within the period by up to this: pings with a period of whole ms would always meet the Teensy's
# ticks at the same phase, and the clock estimate would be off by that phase.
DITHER_NS = 10_000_000
DITHER_RATIO = 10  # at most the tenth part of the period
# Multiples of the golden section, modulo 1, fill an interval evenly at any number of them; random numbers don't.
GOLDEN_SECTION = (5 ** 0.5 - 1) / 2
# Once a Teensy answers, some pings come faster, so that its clock is known within a second.
QUICK_PINGS = 5
QUICKER = 5
QUICK_PERIOD_NS = NS_PER_S // 5  # five pings within the second; faster isn't needed


class Answer(NamedTuple):
    sent_ns: int
    round_trip_ns: int
    sent_bytes: int  # all that were written with it, filler too


class Pinger:
    """Keeps the pings that wait for an answer.

    Args:
        period_ns: the mean time from one ping to the next.
        checksum: ``framing.SHIPPED``, ``framing.CORRECTED``, or ``AUTO``: shipped first, and the other one whenever
            five pings in a row go unanswered while other frames come from the Teensy.
    """

    def __init__(self, period_ns: int, checksum: str, now_ns: int):
        self._period_ns = period_ns
        self._quick_period_ns = max(period_ns // QUICKER, min(period_ns, QUICK_PERIOD_NS))
        self._dither_ns = min(DITHER_NS, period_ns // DITHER_RATIO)
        self._auto = checksum == AUTO
        self.checksum = SHIPPED if self._auto else checksum  # of the pings to come
        self.answered_checksum: str | None = None  # of the newest ping that was answered
        self._waiting: dict = {}  # timestamp1 → (when it was sent, bytes written, checksum)
        self.sent = self.answered = 0
        self.resyncs = 0  # pings behind the filler
        self._dithered = 0  # how many pings were moved
        self.restart(now_ns)

    def restart(self, now_ns: int) -> None:
        """Begin with a line that was opened: waiting pings won't be answered, and the next one is due now."""
        self._waiting.clear()
        self.unanswered_in_a_row = self._missed_pings_of_live_link = 0
        self._plan(now_ns)
        self.retry_now()

    def retry_now(self) -> None:
        """Ping faster for a while if pings are answered: the Teensy's clock has to be learned."""
        self._quick = QUICK_PINGS

    def next_event_ns(self) -> int:
        """Return when the next ping is due, or the oldest one has waited too long."""
        return min([self.due_ns, *(sent_ns + ANSWER_WITHIN_NS for sent_ns, _, _ in self._waiting.values())])

    def expire(self, now_ns: int, is_alive: bool = True) -> list[int]:
        """Give up on pings that have waited too long and return their timestamps. May change ``checksum``.

        Args:
            is_alive: other frames came from the Teensy in that time. When nothing gets through, or it is unplugged, an
                unanswered ping shows nothing about the checksum.
        """
        expired = [token for token, (sent_ns, _, _) in self._waiting.items() if now_ns - sent_ns >= ANSWER_WITHIN_NS]
        for token in expired:
            del self._waiting[token]
            self.unanswered_in_a_row += 1
            self._missed_pings_of_live_link += is_alive
            if self._auto and self._missed_pings_of_live_link == UNANSWERED_BEFORE_SWITCH:
                self._missed_pings_of_live_link = 0
                self.checksum = CORRECTED if self.checksum == SHIPPED else SHIPPED
        if expired:
            self._plan(now_ns)  # don't wait out the period: the receiver may be out of step
        return expired

    def ping(self, timestamp1: int, now_ns: int) -> bytes:
        """Return the bytes of a ping; after an unanswered one, behind the filler that resynchronises the receiver.

        Of two pings with the same timestamp, a pong is taken for the answer to the first one: it can't be older.
        """
        self.sent += 1
        if now_ns >= self.due_ns:
            next_ns = self._planned_ns + self._period_ns
            self._plan(next_ns if next_ns > now_ns else now_ns + self._period_ns, self._dither())
        filler = RESYNC_FILLER if self.unanswered_in_a_row else b""
        self.resyncs += bool(filler)
        data = filler + encode(ping(timestamp1), self.checksum)
        self._waiting.setdefault(timestamp1, (now_ns, len(data), self.checksum))
        return data

    def pong(self, timestamp1: int, now_ns: int) -> Answer | None:
        """Take a pong; return the ping that it answers, or ``None``."""
        sent_ns, sent_bytes, checksum = self._waiting.pop(timestamp1, (None, 0, ""))
        if sent_ns is None:
            return None
        self.answered_checksum = checksum
        self.unanswered_in_a_row = self._missed_pings_of_live_link = 0
        self.answered += 1
        if self._quick:
            self._quick -= 1
            if now_ns + self._quick_period_ns < self._planned_ns:
                self._plan(now_ns + self._quick_period_ns, self._dither())
        return Answer(sent_ns, now_ns - sent_ns, sent_bytes)

    def _plan(self, at_ns, dither_ns=0):
        """Plan the next ping for this time; later ones keep to this place in the period, but not to its dither."""
        self._planned_ns = at_ns
        self.due_ns = at_ns + dither_ns  # when to send it

    def _dither(self):
        self._dithered += 1
        return int(self._dithered * GOLDEN_SECTION % 1 * self._dither_ns)
