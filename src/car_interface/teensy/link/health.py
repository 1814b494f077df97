"""Judges what is wrong with the link to the Teensy, and what to do next.

``LinkHealth`` takes the state of the port and, about once a second, the link's counters; it returns a ``Verdict``.
Its memory doesn't grow.
"""
from __future__ import annotations

from collections import deque
from typing import NamedTuple

from car_interface.common.units import NS_PER_MS, NS_PER_S

OK, WARN, ERROR = range(3)  # as in diagnostic_msgs/DiagnosticStatus

# Faults of a port that can't be opened.
ABSENT, NO_PERMISSION, BUSY, NO_PORT, FAILING = (
    "port absent", "no permission", "port busy", "not a serial port", "port fails")
PORT_FAULTS = frozenset({ABSENT, NO_PERMISSION, BUSY, NO_PORT, FAILING})
# States of an open port.
WAITING, SILENT, NO_FRAMES, BAD_CHECKSUMS, NO_PONGS, REBOOTED, FINE = (
    "waiting", "silent", "no frames", "bad checksums", "no pongs", "rebooted", "fine")
LINK_REPORT = "Teensy link"  # the report on /diagnostics with the content of the topic link
CLOCK_REPORT = "Teensy clock"  # the report on its clock, which no ping reaches while the link has a fault
SONAR_FAULT = "sonar fault"  # of a link without a fault of its own

SHORTEST_SPAN_NS = 800 * NS_PER_MS  # less has too few frames to judge: there may be 5 a second
WINDOW = 10  # spans: of the ratio of bad frames
REPORT_REBOOT_NS = 10 * NS_PER_S
BITS_PER_BYTE = 10  # 8N1
FEWEST_BAD, MAX_BAD_RATIO, MAX_BAD = 3, 0.01, 0.5  # a good line has none: 1 % is reported
# 1 in 255 wrong frames gets past the checksum: a smaller ratio of good frames than this doesn't prove a Teensy.
GOOD_RATIO = 0.05
# A Teensy's frames have 12 to 74 bytes. Noise has a flag every 256 bytes, and one in eight gaps between is as short.
BYTES_PER_FRAME = 100
PINGS_IN_VAIN = 3


class Counts(NamedTuple):
    """The link's counters; all but the last only grow."""

    bytes_in: int
    records: int  # frames with a record
    bad_frames: int  # corrupt ones of all kinds
    bad_checksums: int  # the ones among these that have a frame's length
    pings_in_vain: int  # unanswered since the newest pong


class Verdict(NamedTuple):
    """The health of the link."""

    state: str  # one of the names above
    level: int  # OK, WARN or ERROR
    description: str  # what is wrong, or that nothing is
    next_step: str  # what its owner can do or type; empty = nothing


class LinkHealth:
    """Judges the link by the changes from second to second.

    An open port's verdict changes when two spans in a row contradict it, and then to the verdict of the second one: a
    fault begins in the middle of a span, and a second that is half good shows little. A port that opens or closes, the
    first good second, and a reboot change it at once.
    """

    def __init__(self, baud: int):
        self._baud = baud
        self._samples: deque = deque(maxlen=WINDOW + 1)  # (ns, counts)
        self._doubted = False  # the span before this one contradicted the verdict
        self._reboot: Verdict | None = None  # of the newest one
        self._reboot_ns = 0
        self.verdict = Verdict(ABSENT, ERROR, "the port was not opened yet", "")

    def port_failed(self, state: str, cause: str, remedy: str) -> None:
        """Take note that the port couldn't be opened or was lost; that is the verdict."""
        self._samples.clear()
        self.verdict = Verdict(state, ERROR, cause, remedy)

    def opened(self, counts: Counts, now_ns: int) -> None:
        """Take note that the port is open; the judgement starts over."""
        self._samples.clear()
        self._samples.append((now_ns, counts))
        self._doubted = False
        self.verdict = Verdict(WAITING, WARN, "the port is open, nothing is known about the Teensy yet", "")

    def rebooted(self, description: str, now_ns: int) -> None:
        """Take note that the Teensy's clock went back; ``description`` names both readings."""
        self._reboot_ns = now_ns
        self._reboot = Verdict(
            REBOOTED, WARN, f"the Teensy rebooted: {description}",
            "Check its power supply; its odometers began at 0 and its sonars' order and wait are the firmware's again")
        if self.verdict.state == FINE:
            self.verdict = self._reboot

    def judge(self, counts: Counts, now_ns: int) -> Verdict:
        """Return the verdict by the present counters. A call too soon after the one before changes nothing."""
        if not self._samples or now_ns - self._samples[-1][0] < SHORTEST_SPAN_NS:
            return self.verdict
        self._samples.append((now_ns, counts))
        found = self._find(now_ns)
        is_news = _kind(found) != _kind(self.verdict)
        at_once = self.verdict.state == WAITING and found.level == OK
        if is_news and not self._doubted and not at_once:
            self._doubted = True
            if self.verdict.level != OK:
                self._restart_window()  # the end of one fault must not pass for another
            return self.verdict
        self._doubted = False
        self.verdict = found
        return found

    def _restart_window(self):
        newest = self._samples.pop()
        self._samples.clear()
        self._samples.append(newest)

    def _find(self, now_ns) -> Verdict:
        (before_ns, before), (_, newest) = self._samples[-2], self._samples[-1]
        span_s = (now_ns - before_ns) / NS_PER_S
        bytes_in, records, bad, bad_checksums = (
            new - old for new, old in zip(newest[:4], before[:4]))
        if not records or records < GOOD_RATIO * (records + bad):
            self._restart_window()
            return self._no_frames(bytes_in, bytes_in / span_s, bad_checksums)
        ratio, bad = self._bad_ratio()
        corrupt = bad >= FEWEST_BAD and ratio >= MAX_BAD_RATIO
        in_vain = newest.pings_in_vain
        if in_vain >= PINGS_IN_VAIN and not (corrupt and ratio >= MAX_BAD):
            return Verdict(NO_PONGS, WARN, f"frames come, but none of the last {in_vain} pings was answered",
                           "Check the wire from this port's TX to the Teensy's RX, and ~firmware_checksum: auto tries "
                           "both of them")
        if corrupt:
            return Verdict(BAD_CHECKSUMS, ERROR if ratio >= MAX_BAD else WARN,
                           f"frames come, but {100 * ratio:.0f} % of them are corrupt",
                           "Check ground, length and plugs of the serial cable, and that no other program reads the "
                           "port: fuser -v on it")
        if self._reboot is not None and now_ns - self._reboot_ns < REPORT_REBOOT_NS:
            return self._reboot
        return Verdict(FINE, OK, f"fine: {records / span_s:.0f} frames a second", "")

    def _no_frames(self, bytes_in, per_s, bad_checksums) -> Verdict:
        if not bytes_in:
            return Verdict(SILENT, ERROR, "the port is open, but nothing comes from it",
                           "Check the Teensy's power and that its TX leads to this port's RX; is it the right ~port?")
        if bad_checksums * BYTES_PER_FRAME >= bytes_in:
            return Verdict(BAD_CHECKSUMS, ERROR, "frames come, but the checksum of almost none of them is right",
                           "Check ground, length and plugs of the serial cable; is it this firmware that runs?")
        too_many = (f", more than {self._baud} baud can carry" if per_s > 1.5 * self._baud / BITS_PER_BYTE else "")
        return Verdict(NO_FRAMES, ERROR, f"{per_s:.0f} bytes a second come, but no frames{too_many}",
                       f"Is the Teensy's rate another one than ~baud {self._baud}? Is it a Teensy at all?")

    def _bad_ratio(self):
        """Return the ratio of bad frames over the window, and their number."""
        (_, oldest), (_, newest) = self._samples[0], self._samples[-1]
        bad = newest.bad_frames - oldest.bad_frames
        return bad / max(1, bad + newest.records - oldest.records), bad


def with_sonars(verdict: Verdict, description: str, next_step: str) -> Verdict:
    """Return the verdict on the link and its faulty sonars: neither hides the other.

    The state stays that of a faulty link, without which little is known about sonars.
    """
    if verdict.state == FINE:
        return Verdict(SONAR_FAULT, WARN, description, next_step)
    state = SONAR_FAULT if verdict.state == REBOOTED else verdict.state
    next_steps = ". ".join(step for step in (verdict.next_step, next_step) if step)
    return Verdict(state, verdict.level, f"{verdict.description}; {description}", next_steps)


def _kind(verdict):
    """Return its state; a link over which a reboot was noticed is FINE."""
    return FINE if verdict.state == REBOOTED else verdict.state
