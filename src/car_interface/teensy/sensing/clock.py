"""Translates the Teensy's ticks to times of this computer's monotonic clock, each with its uncertainty.

Pongs and ticks bound the line of host time over the Teensy's time: ``ClockLines`` finds the lines that are left.
``Clock`` keeps the tightest bounds of a window, rejects contradictions, detects a clock that jumped, and translates.

Tick k means that the Teensy's clock was somewhere in [k, k + 1) ms. Over a minute crystals run evenly, so that host
time is a line over the Teensy's time, which is bounded:

- the Teensy answers a ping after its last byte has come: line(k + 1) ≥ sent + the ping's time on the wire;
- it reads its clock before the first byte of a frame leaves: line(k) ≤ received − the frame's time on the wire.

The lines that no bound forbids are a convex polygon in the plane of offset and skew: each bound cuts off a half-plane.
The polygon's corners give the earliest and the latest time of any tick. These are strict bounds, not statistics: they
hold for any time that a frame waits in a buffer.

Nothing but pings goes to the Teensy, so the lower bounds are tight to the tick, while the answers queue up. So the
line is chosen that lies lowest over the middle of the pings, where the sum of the delays is smallest: a linear program,
whose optimum is a corner of the polygon (S. Moon, P. Skelly, D. Towsley, "Estimation and removal of clock skew from
network delay measurements", INFOCOM 1999). The truth lies above it: the line is moved towards the centre of the
polygon by the delay that is to be expected with this number of pings, and never beyond the centre.

Temperature bends the line: a bound of age τ is loosened by ½ wander τ², the largest distance between the truth and the
line that is right now. So old bounds fade by themselves, and times far from the last pings are uncertain.

Pure: ticks and monotonic nanoseconds in, the same out.
"""
from __future__ import annotations

import math
from typing import NamedTuple

from car_interface.common.units import NS_PER_MS, NS_PER_S
from car_interface.teensy.link.protocol import ahead

BITS_PER_BYTE = 10  # start bit, eight, stop bit
# Bytes in the Teensy's buffers go first: some 2 kB, 0.2 s at 115200 baud; then the host takes its time.
ONE_WAY_UNCERTAINTY_NS = 250 * NS_PER_MS
UNKNOWN_NS = 1 << 62  # the uncertainty of a time of which nothing is known
CONVERGED_PONGS = 5  # the quick pings of the first second: see ``pinging``
CONVERGED_AFTER_MS = 900  # over a shorter time a tick of 1 ms bounds the skew less than the crystals' data sheets
SENDING_NS = 100_000  # about the time from reading the clock until the first bit is on the wire
AGREEING = 3  # pongs in a row that overrule the ones before them
# A ping is used for 60 s. Each bucket keeps its tightest bounds: neither memory nor time grows with the rate of pings.
BUCKETS, BUCKET_NS = 120, NS_PER_S // 2
KEPT_BUCKETS = 5  # with pongs, of any age: old bounds fade, and are better than none when pings are rare or paused
MAX_SKEW_PPM = 500.0  # the largest difference of the clocks' rates; crystals have up to 100 each
WANDER_PPM_PER_H = 100.0  # the largest change of that in an hour; a car that warms up makes 20
BEND = 0.5 * 1e-6 / 3600 * 1e-6 * 1e9 * WANDER_PPM_PER_H  # of ½ wander τ² in ns, τ in ms

# Why a pong isn't used.
TOO_SOON = "a pong sooner than ping and pong take on the line"
FASTER_LINE = "one pong after the other sooner than the line takes: it has no baud rate, as on USB; no more wire time"
CONTRADICTION = "a pong that contradicts the ones before it"
# Why a pong that is used is notable.
ONE_WAS_WRONG = "three pongs in a row say that one before them was wrong"
BEGUN_ANEW = "three pongs in a row contradict those before them: a clock jumped or stood still"


class Stamp(NamedTuple):
    """The time of a tick on the monotonic clock."""

    time_ns: int  # the middle of its millisecond
    uncertainty_ns: int  # an event at that tick was at most this much sooner or later


class Sync(NamedTuple):
    """The relation of the two clocks after a pong."""

    offset_ns: int  # monotonic time at which the Teensy's clock, unwrapped, is at 0
    skew_ppm: float  # how much faster the Teensy's clock runs; 0 until converged
    uncertainty_ns: int  # of the pong's tick
    round_trip_ns: int
    converged: bool
    used: bool
    reason: str  # why it isn't used, or what is notable; empty for most


class Clock:
    """Learns the relation of the Teensy's clock to the host's from pongs, and translates its ticks.

    Args:
        baud: bits per second on the line.

    Attributes:
        newest: tick, unwrapped; ``None`` before the first.
        converged: the pongs are enough for a line; before that, times are estimated by the newest tick.
    """

    def __init__(self, baud: int = 115200):
        self._byte_ns = BITS_PER_BYTE * NS_PER_S / baud
        self._too_soon = 0  # pongs in a row
        self.restart()

    def restart(self) -> None:
        """Begin anew: the Teensy's clock restarted."""
        self.newest: int | None = None
        self._newest_ns = 0  # when it was, at the latest
        self._buckets: dict = {}  # number of the bucket, counted in host time → its bounds
        self._suspects: list = []  # the last pongs, if they contradict those before them and not each other
        self._lines = None
        self.converged = False

    def pong(self, tick: int, sent_ns: int, sent_bytes: int, received_ns: int, received_bytes: int) -> Sync:
        """Take a pong that answers a ping of ours.

        Args:
            tick: the Teensy's clock in it, ms modulo 2**32.
            sent_ns: monotonic time, taken before its ping was written.
            sent_bytes: all that were written with it, filler too.
            received_ns: monotonic time, taken after the pong was read.
            received_bytes: its smallest number of bytes on the line.
        """
        sent_by_ns = sent_ns + self._wire_ns(sent_bytes)
        latest_ns = received_ns - self._wire_ns(received_bytes)
        tick = self._update_last(tick, latest_ns)
        used, reason = self._take(PongBounds(Bound(tick + 1, sent_by_ns), Bound(tick, latest_ns)))
        uncertainty_ns = self._stamp(tick, latest_ns).uncertainty_ns
        if self.converged:
            offset_ns, skew_ppm = self._lines.offset_and_skew()
        else:
            offset_ns, skew_ppm = self._newest_ns - self.newest * NS_PER_MS - NS_PER_MS // 2, 0.0
        return Sync(offset_ns, skew_ppm, uncertainty_ns, received_ns - sent_ns, self.converged, used, reason)

    def update_tick(self, tick: int, received_ns: int, received_bytes: int) -> None:
        """Take another tick that was new when its frame was queued, such as a sonar's: it can't have been later.

        A wheel's can't be used: the last pulse may be long ago.
        """
        latest_ns = received_ns - self._wire_ns(received_bytes)
        bound = Bound(self._update_last(tick, latest_ns), latest_ns)
        if self._lines is not None and self._lines.admit(None, bound):  # else it can't have been yet
            self._bucket(latest_ns).tighten(None, bound, self._lines.slope)

    def translate(self, tick: int, received_ns: float = math.inf, received_bytes: int = 0) -> Stamp:
        """Return when a tick was. With the same bounds and receipt, a later tick never comes out earlier.

        Args:
            tick: ms modulo 2**32, less than 24.8 days from the newest tick.
            received_ns: monotonic time, taken after the frame that had it was read; it was no later.
            received_bytes: that frame's smallest number of bytes on the line.
        """
        return self._stamp(self.unwrap(tick), received_ns - self._wire_ns(received_bytes))

    def unwrap(self, tick: int) -> int:
        """Return the tick without its wraps: of all that it may stand for, the one nearest to the newest tick."""
        return tick if self.newest is None else self.newest + ahead(tick, self.newest)

    def tick_at(self, host_ns: int) -> float:
        """Return the Teensy's clock at a monotonic time: ms, unwrapped, with their fraction; after the first tick."""
        if self.converged:
            return self._lines.tick_at(host_ns)
        return self.newest + 0.5 + (host_ns - self._newest_ns) / NS_PER_MS

    def _wire_ns(self, byte_count):
        return round(byte_count * self._byte_ns)

    def _update_last(self, tick, latest_ns):
        self.newest, self._newest_ns = self.unwrap(tick), latest_ns
        return self.newest

    def _stamp(self, tick, latest_ns):
        if not self.converged:
            return self._one_way_stamp(tick, latest_ns)
        time_ns, earliest_ns, end_ns = self._lines.translate(tick)
        if latest_ns < earliest_ns:
            # A clock has jumped or stood still, and three pongs haven't confirmed it yet.
            return Stamp(latest_ns, self._one_way_stamp(tick, latest_ns).uncertainty_ns)
        end_ns = min(end_ns, latest_ns)
        time_ns = min(time_ns, end_ns)
        return Stamp(time_ns, max(time_ns - earliest_ns, end_ns - time_ns))

    def _one_way_stamp(self, tick, latest_ns):
        if self.newest is None:
            return Stamp(latest_ns, UNKNOWN_NS)
        apart_ms = tick - self.newest
        time_ns = self._newest_ns + apart_ms * NS_PER_MS
        uncertainty_ns = ONE_WAY_UNCERTAINTY_NS + NS_PER_MS + math.ceil(abs(apart_ms) * MAX_SKEW_PPM)
        late_ns = max(0, time_ns - latest_ns)
        return Stamp(time_ns - late_ns, uncertainty_ns + late_ns)

    def _take(self, pong):
        """Return whether a pong was used, and why not or what is notable."""
        if pong.earliest.ns > pong.latest.ns:
            self._too_soon += 1
            if self._too_soon < AGREEING:
                return False, TOO_SOON
            self._byte_ns = 0.0
            return False, FASTER_LINE
        self._too_soon = 0
        if self._lines is None or self._lines.admit(*pong):
            self._suspects.clear()
            bucket = self._bucket(pong.latest.ns)
            bucket.count(pong, self._lines.slope if self._lines else NS_PER_MS)
            if bucket.pongs == 1:
                self._rebuild(pong)
            self._settle(pong)
            return True, ""
        lines = ClockLines(pong)
        if not all(lines.admit(*suspect) for suspect in self._suspects):
            self._suspects.clear()
        self._suspects.append(pong)
        if len(self._suspects) < min(AGREEING, 1 + self._pongs()):
            return False, CONTRADICTION
        suspects, self._suspects = self._suspects, []
        for suspect in suspects:
            self._buckets.pop(suspect.latest.ns // BUCKET_NS, None)
        for suspect in suspects:
            self._bucket(suspect.latest.ns).count(suspect, NS_PER_MS)
        goes_on = self._rebuild(pong)
        self._settle(pong)
        return True, ONE_WAS_WRONG if goes_on else BEGUN_ANEW

    def _rebuild(self, pong):
        """Find the lines again, from the newest bounds back; return whether the older ones agree with them.

        A bucket that doesn't is left out; after the second one in a row, so is everything before it.
        """
        self._lines = ClockLines(pong)
        contradictions = 0
        for key in sorted(self._buckets, reverse=True):
            bucket = self._buckets[key]
            if contradictions < 2 and self._lines.admit(bucket.earliest, bucket.latest):
                contradictions = 0
            else:
                contradictions += 1
                del self._buckets[key]
        return contradictions < 2

    def _settle(self, pong):
        """Choose the line, and whether there are enough pongs for it."""
        buckets = [bucket for bucket in self._buckets.values() if bucket.pongs]
        ticks = [bucket.earliest.tick for bucket in buckets] or [pong.earliest.tick]
        count = self._pongs()
        # The shortest of n delays of up to a tick is a tick / (n + 1), on average; a line is bounded by two of them.
        self._lines.choose(sum(ticks) / len(ticks), 2 * NS_PER_MS / (count + 1) + SENDING_NS)
        span_ms = pong.latest.tick - min((bucket.first_tick for bucket in buckets), default=pong.latest.tick)
        self.converged = count >= CONVERGED_PONGS and span_ms >= CONVERGED_AFTER_MS

    def _pongs(self):
        return sum(bucket.pongs for bucket in self._buckets.values())

    def _bucket(self, host_ns):
        """Return the bucket of this time. A new one drops those that are too old."""
        key = host_ns // BUCKET_NS
        if key not in self._buckets:
            kept = set([key for key, bucket in self._buckets.items() if bucket.pongs][-KEPT_BUCKETS:])
            self._buckets = {old: bucket for old, bucket in self._buckets.items() if old > key - BUCKETS or old in kept}
            self._buckets[key] = _Bucket()
        return self._buckets[key]


class _Bucket:
    """The tightest bounds within one bucket of time."""

    def __init__(self):
        self.earliest = None
        self.latest = None
        self.pongs = 0
        self.first_tick = 0  # of the pongs

    def count(self, pong, slope):
        """Take a pong."""
        if not self.pongs:
            self.first_tick = pong.latest.tick
        self.pongs += 1
        self.tighten(*pong, slope)

    def tighten(self, earliest, latest, slope):
        """Take bounds, and keep the tighter of two by ``slope`` of the line, ns per ms."""
        if earliest and (self.earliest is None or rise_ns(self.earliest, earliest, slope) > 0):
            self.earliest = earliest
        if latest and (self.latest is None or rise_ns(self.latest, latest, slope) < 0):
            self.latest = latest


class Bound(NamedTuple):
    """The line was at ``tick`` not before, or not after ``ns``."""

    tick: int
    ns: int


class PongBounds(NamedTuple):
    """The bounds of a pong."""

    earliest: Bound
    latest: Bound


class ClockLines:
    """All lines from ticks to host time that no bound forbids.

    x ms after the reference a line is at the reference + 10**6 x + offset + skew x: 1 ns per ms is 1 ppm. The corners
    (offset, skew) of the polygon go around it.
    """

    def __init__(self, pong: PongBounds):
        self._tick, self._ns = pong.latest
        min_ns = pong.earliest.ns - self._ns - 2 * NS_PER_MS  # below the pong's own bound at any skew
        self._corners = [(min_ns, -MAX_SKEW_PPM), (0.0, -MAX_SKEW_PPM), (0.0, MAX_SKEW_PPM), (min_ns, MAX_SKEW_PPM)]
        self._middle = 0.0
        self._gap_ns = 0.0
        self._chosen = None
        self.admit(*pong)

    def admit(self, earliest: Bound | None, latest: Bound | None) -> bool:
        """Clip the lines that these bounds forbid; if none would be left, change nothing and return False."""
        corners = self._corners
        if earliest:
            corners = _clip(corners, *self._place(earliest, -1), 1)
        if latest:
            corners = _clip(corners, *self._place(latest, 1), -1)
        if not corners:
            return False
        if corners is not self._corners:
            self._corners = corners
            self._chosen = None
        return True

    def choose(self, middle_tick: float, gap_ns: float) -> None:
        """Choose the line that is lowest at this tick, raised by the gap towards the centre, and not beyond it."""
        self._middle = middle_tick - self._tick
        self._gap_ns = gap_ns
        self._chosen = None

    @property
    def slope(self) -> float:
        """The chosen line's slope, ns per ms."""
        return NS_PER_MS + self._line()[1]

    def offset_and_skew(self) -> tuple[int, float]:
        """Return when (ns) the Teensy's clock is at 0, and how much faster (ppm) it runs, by the chosen line."""
        offset, skew = self._line()
        return (self._ns - self._tick * NS_PER_MS + round(offset - skew * self._tick),
                1e6 * (NS_PER_MS / self.slope - 1))

    def tick_at(self, host_ns: int) -> float:
        """Return the Teensy's clock, ms, by the inverse of the chosen line."""
        offset, skew = self._line()
        return self._tick + (host_ns - self._ns - offset) / (NS_PER_MS + skew)

    def translate(self, tick: int) -> tuple[int, int, int]:
        """Return the middle of a tick by the chosen line, and its earliest beginning and latest end by all lines."""
        offset, skew = self._line()
        x = tick - self._tick
        base_ns = self._ns + x * NS_PER_MS
        low = min([offset + skew * x for offset, skew in self._corners])
        high = max([offset + skew * (x + 1) for offset, skew in self._corners])
        bend_ns = BEND * (abs(x) + 1) ** 2
        return (base_ns + NS_PER_MS // 2 + round(offset + skew * (x + 0.5)), base_ns + math.floor(low - bend_ns),
                base_ns + NS_PER_MS + math.ceil(high + bend_ns))

    def _line(self):
        if self._chosen is None:
            middle = self._middle
            lowest = min(self._corners, key=lambda line: line[0] + line[1] * middle)
            center = _center(self._corners)
            rise_ns = center[0] - lowest[0] + (center[1] - lowest[1]) * middle
            ratio = self._gap_ns / rise_ns if rise_ns > self._gap_ns else 1.0
            self._chosen = tuple(low + ratio * (high - low) for low, high in zip(lowest, center))
        return self._chosen

    def _place(self, bound, side):
        """Return a bound relative to the reference, loosened up (1) or down (-1) by the largest bend of the truth."""
        x = bound.tick - self._tick
        return x, bound.ns - self._ns - x * NS_PER_MS + side * BEND * x * x


def rise_ns(before: Bound, after: Bound, slope: float) -> float:
    """Return how far one bound lies over the line of this slope through another."""
    return after.ns - before.ns - slope * (after.tick - before.tick)


def _clip(corners, x, y, side):
    """Clip a convex polygon: the part of the lines (offset, skew) that at x pass above y (side 1) or below (-1)."""
    heights = [side * (offset + skew * x - y) for offset, skew in corners]
    if not heights or min(heights) >= 0:
        return corners
    left = []
    before, height_before = corners[-1], heights[-1]
    for corner, height in zip(corners, heights):
        if (height < 0) != (height_before < 0):
            ratio = height_before / (height_before - height)
            left.append((before[0] + ratio * (corner[0] - before[0]), before[1] + ratio * (corner[1] - before[1])))
        if height >= 0:
            left.append(corner)
        before, height_before = corner, height
    return left


def _center(corners):
    """Return the centre of a polygon's area."""
    first_offset, first_skew = corners[0]
    area = offset = skew = 0.0
    for before, after in zip(corners[1:], corners[2:]):
        # The triangle of these two and the first corner.
        u, v = before[0] - first_offset, before[1] - first_skew
        w, z = after[0] - first_offset, after[1] - first_skew
        double = u * z - v * w
        area += double
        offset += double * (u + w)
        skew += double * (v + z)
    if not area:
        return tuple(sum(ends) / len(corners) for ends in zip(*corners))
    return first_offset + offset / (3 * area), first_skew + skew / (3 * area)
