"""Gates between the Teensy's records and what is made of them: odometry, clock and ranges.

A checksum of eight bits lets some wrong frames past. Each record that made sense is judged here against those before
it: device ticks against device ticks and pulses against pulses, never against the host's clock. The answer says
whether it may be used, why not, and how many pulses it adds to the way.

Three rules keep one wrong record from doing harm, and a true jump from being locked out:

- A report of the wheels that brings more pulses than the wheel's own speed explains by ``SURPRISE_PULSES`` waits until
  others confirm it. So a wrong one that is taken moves a wheel by at most that many pulses, 4.5 cm.
- A record that contradicts the one before it, but follows from the one before that, is taken, and what the wrong one
  had added is taken back.
- Any other contradiction is a jump: the Teensy rebooted, its odometers were reset, or much was lost. It is taken up
  with the third of ``CONSISTENT`` records in a row each of which follows from the one before it; none of the pulses
  between these is lost. Odometers at zero that have no direction yet are taken up at once: no other state looks so.

What a healthy firmware sends is never refused. So:

- A wheel's ``when`` is the tick of its last pulse *or repeat*: a standing car repeats its report with a new ``when``
  for both wheels. Only a change of ``dist_abs`` is a pulse.
- ``when`` is 0 until the first pulse after power-up: that is no reading of the clock. WHEEL_RESET keeps it.
- At power-up the firmware takes both pins of a hall sensor for low and then learns one of them with each pulse. So the
  direction of a wheel's first two pulses is worth nothing: it may be wrong, or still missing while ``dist_abs`` grows.
  They are ``unproven``; whoever counts them must find their direction elsewhere. WHEEL_RESET keeps the pins' states, so
  that it makes none.

Pure: neither a clock nor a device.
"""
from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass
from typing import NamedTuple

from car_interface.common.errors import ConfigError
from car_interface.teensy.link.protocol import (
    BACKWARD,
    DIRECTION_ERROR,
    FORWARD,
    NO_DIRECTION,
    UINT32,
    Pong,
    SonarStatus,
    Wheel,
    WheelStatus,
)

CONSISTENT = 3
SURPRISE_PULSES = 3  # at 1.5 cm: wrong by 4.5 cm at most, and two reports in a row may be lost from a crawl
TRUSTED_MS = 100  # how long after a wheel's last pulse its speed still explains pulses
# Answers overtake sonar reports in the Teensy's buffers, which hold 0.2 s of the line.
OVERTAKEN_MS = 250
QUANTUM_MS = 1  # of the ticks
PULSES_OF_JITTER = 2  # the magnets of an encoder wheel aren't spaced evenly
# From here on a wheel needs time to turn round: ten times what tyres hold, for a wheel in the air may be braked harder.
SLOW_MPS = 1.0
BRAKING_MPS2 = 100.0
SPEED_OF_ONE_TICK = 1000  # pulses per second: two pulses, one tick apart

LEARNING_PULSES = 2  # of a wheel after power-up, until the firmware knows both pins of its hall sensor
YOUNG_MS = 2_000  # a Teensy that runs for less may have rebooted a moment ago

# What may be wrong with a record, in words.
NOT_OUR_PING = "a pong that answers no ping of ours"
TICK_BACK = "a tick that goes back"
TICK_AHEAD = "a tick that jumps ahead"
SENSOR_ERROR = "a wheel whose direction sensor reports an error (direction 3)"
COUNTS_DISAGREE = "a wheel whose direction and counts disagree"
SPEED_TOO_HIGH = "a wheel's speed above the top speed"
COUNT_BACK = "a wheel's count that goes back"
PULSE_BACK = "a wheel's last pulse that goes back in time"
CHANGE_WITHOUT_PULSE = "a change of direction in a wheel that made no pulse"
REPEAT_ALONE = "a wheel's time that changes without a pulse or a repeat"
TOO_MANY_PULSES = "more pulses than the top speed allows"
TURNED_WRONGLY = "a direction that doesn't go with the counts"
TURNED_AT_SPEED = "a direction that changes at speed"
SURPRISING = "more pulses at once than the wheel's speed explains"
PULSE_AHEAD = "a pulse ahead of the Teensy's clock"
# What may be worth a word about one that is accepted.
FIRST = "the first of its kind"
TAKEN_BACK = "the one before it was wrong"
CAUGHT_UP = "taken up after a gap"
CLOCK_RESTARTED = "taken up after the Teensy's clock went back: it rebooted"
ODOMETERS_RESTARTED = "taken up after a jump of the odometers"
ODOMETERS_RESET = "odometers that were reset"


@dataclass(frozen=True)
class GateConfig:
    """What the gates take for possible.

    Args:
        top_speed_mps: of a wheel, its spinning included.
        pulse_m: a wheel's way from pulse to pulse; 20 on the circumference of a 9.5 cm wheel.
        max_gap_ms: between ticks of a line that is whole; at least two periods of the pings, of which one may be
            lost.

    Raises:
        ConfigError: when one of them isn't a number above 0.
    """

    top_speed_mps: float = 20.0
    pulse_m: float = math.pi * 0.095 / 20
    max_gap_ms: int = 2_000

    def __post_init__(self):
        for name, value in vars(self).items():
            if not 0 < value < math.inf:
                raise ConfigError(name, value, "a number above 0")


class Verdict(NamedTuple):
    """What became of a record.

    Attributes:
        accepted: whether it may be used.
        reason: why not, or what is worth a word; empty for most.
        pulses: to add to the distance of the left and the right wheel, signed.
        restarted: what was there before it doesn't count any more.
        unproven: further pulses of the left and the right wheel, made before those of ``pulses``, whose direction the
            firmware could not know yet.
        boot_tick: a tick of the clock after a reboot that this report of the wheels reveals; else ``None``.
    """

    accepted: bool
    reason: str
    pulses: tuple[int, int] = (0, 0)
    restarted: bool = False
    unproven: tuple[int, int] = (0, 0)
    boot_tick: int | None = None


class Gates:
    """Judges the records of one Teensy, in the order in which they came.

    ``counts`` has the refused ones by reason, and the accepted ones that were worth a word.
    """

    def __init__(self, config: GateConfig = GateConfig()):
        self.counts: Counter = Counter()
        self.accepted = 0
        self.refused = 0
        self._ticks = _TickGate(config.max_gap_ms)
        self._wheels = _WheelGate(config)

    def pong(self, record: Pong, is_ours: bool) -> Verdict:
        """Judge a pong; ``is_ours``: it answers a ping that waited (a duplicate answers none)."""
        if not is_ours:
            return self._counted(Verdict(False, NOT_OUR_PING))
        return self._counted(self._judge_tick(record.timestamp2))

    def sonar(self, record: SonarStatus) -> Verdict:
        """Judge a sonar's report, by its tick: any echo time may come, see ``ranging``."""
        return self._counted(self._judge_tick(record.when))

    def wheels(self, record: WheelStatus) -> Verdict:
        """Judge a report of the wheels. Wheels that turn in opposite directions are nothing odd: a car may spin."""
        verdict = self._wheels.judge(record, self._ticks.newest, self._ticks.restarts)
        if verdict.boot_tick is not None:
            self._ticks.restart(verdict.boot_tick)
            self.counts[CLOCK_RESTARTED] += 1
        return self._counted(verdict)

    def _judge_tick(self, tick):
        if self._wheels.is_zero_again and self._ticks.is_young_again(tick):
            self._ticks.restart(tick)
            return Verdict(True, CLOCK_RESTARTED, restarted=True)
        return self._ticks.judge(tick)

    def _counted(self, verdict):
        if verdict.accepted:
            self.accepted += 1
        else:
            self.refused += 1
        if verdict.reason:
            self.counts[verdict.reason] += 1
        return verdict


def signed_pulses(before: Wheel, now: Wheel) -> int:
    """The way from one report of a wheel to a later one, in pulses, backward negative.

    The pulse before ``now.dist`` was made in the other direction. Where a wheel turned round twice in between, nobody
    knows how the pulses before that were shared: they count as none.
    """
    sign = 1 if now.direction == FORWARD else -1
    pulses = ahead(now.dist_abs, before.dist_abs)
    if now.dist == before.dist and now.direction == before.direction or now.direction == NO_DIRECTION:
        return sign * pulses
    earlier = max(0, ahead(now.dist, before.dist_abs) - 1)
    return sign * (pulses - earlier) - (sign * earlier if now.direction != before.direction else 0)


def has_pulsed(wheel: Wheel) -> bool:
    """Whether its ``when`` is a reading of the clock: until the first pulse it is 0, and so is it with a wrap."""
    return bool(wheel.when or wheel.speed)


def ahead(later: int, earlier: int) -> int:
    """How far one 32-bit counter is ahead of another, which wraps: −2**31 .. 2**31 − 1."""
    return (later - earlier + UINT32 // 2) % UINT32 - UINT32 // 2


class _TickGate:
    """Ticks of the Teensy's clock as pongs and sonars carry them; nearly in order."""

    def __init__(self, max_gap_ms):
        self._max_gap_ms = max_gap_ms
        self.newest = None
        self.restarts = 0  # how often the clock was found to have begun anew
        self._before = None  # the newest before that
        self._candidates: list = []

    def restart(self, tick):
        """The Teensy rebooted, and this is a tick of its new clock."""
        self.restarts += 1
        self._before, self.newest = None, tick
        self._candidates.clear()

    def is_young_again(self, tick):
        """Whether it can be that of a Teensy which rebooted a moment ago."""
        return self.newest is not None and tick < YOUNG_MS and ahead(tick, self.newest) < -OVERTAKEN_MS

    def judge(self, tick):
        if self.newest is None:
            self.newest = tick
            return Verdict(True, FIRST, restarted=True)
        fault = self._fault(self.newest, tick)
        if not fault:
            if ahead(tick, self.newest) > 0:
                self._before, self.newest = self.newest, tick
            self._candidates.clear()
            return _FINE
        if self._before is not None and not self._fault(self._before, tick):
            self.newest = tick
            self._candidates.clear()
            return Verdict(True, TAKEN_BACK)
        if self._candidates and self._fault(self._candidates[-1], tick):
            self._candidates.clear()
        self._candidates.append(tick)
        return self._take_up() if len(self._candidates) == CONSISTENT else Verdict(False, fault)

    def _fault(self, before, tick):
        gap_ms = ahead(tick, before)
        if gap_ms < -OVERTAKEN_MS:
            return TICK_BACK
        return TICK_AHEAD if gap_ms > self._max_gap_ms else ""

    def _take_up(self):
        rebooted = ahead(self._candidates[0], self.newest) < 0
        newest = self._candidates[-1]
        self.restart(newest)
        self.restarts -= not rebooted
        return Verdict(True, CLOCK_RESTARTED if rebooted else CAUGHT_UP, restarted=rebooted)


class _WheelGate:
    """Reports of the wheels, which come in order."""

    def __init__(self, config):
        self._pulse_m = config.pulse_m
        self._max_gap_ms = config.max_gap_ms
        self._top_per_ms = config.top_speed_mps / config.pulse_m / 1000
        self._top_speed = 2000 * self._top_per_ms + SPEED_OF_ONE_TICK  # as a report may give it
        self._last = None
        self._before = None  # accepted before the last one
        self._candidates: list = []
        self._jumped = False  # the candidates can't follow the last one
        self._per_ms = (0.0, 0.0)  # each wheel's speed when it made its last pulse
        self._pulse_ticks: tuple = (None, None)  # of the last pulses; ``when`` may be that of a repeat
        self._learns = True  # pulses of small number are unproven
        self._zero = None  # (newest tick, restarts of the clock) when both odometers went back to zero

    @property
    def is_zero_again(self):
        """Whether both odometers have gone back to zero: two pieces of evidence prove a reboot, this and the clock."""
        return self._zero is not None and self._before is None

    def judge(self, record, newest_tick, clock_restarts):
        fault = self._impossible(record.left) or self._impossible(record.right)
        if fault:
            return Verdict(False, fault)
        boot_tick = self._find_boot(record, newest_tick, clock_restarts)
        verdict = self._judge(record, newest_tick if boot_tick is None else boot_tick)
        if verdict.reason == ODOMETERS_RESET:
            self._zero = (newest_tick, clock_restarts)
            self._learns = not any(wheel.when for wheel in record if not wheel.dist_abs)
            boot_tick = self._find_boot(record, newest_tick, clock_restarts)
            way = self._way(_NOTHING_YET, record)
            verdict = verdict._replace(pulses=way[:2], unproven=way[2:])
        elif verdict.reason == ODOMETERS_RESTARTED and self._learns:
            boot_tick = _tick_gone_back(record, newest_tick)
        if not verdict.accepted:
            return verdict
        if not _is_zero(record):
            self._zero = None
            self._learns = self._learns and any(wheel.dist_abs <= LEARNING_PULSES for wheel in record)
        elif verdict.reason == FIRST:
            self._learns = not any(wheel.when for wheel in record)  # which WHEEL_RESET keeps
        return verdict if boot_tick is None else verdict._replace(boot_tick=boot_tick)

    def _find_boot(self, record, newest_tick, clock_restarts):
        """The first pulse after zero shows whether that was a reset; if not, the answer is a tick of the new clock."""
        if self._zero is None or _is_zero(record) or newest_tick is None:
            return None
        tick_at_zero, restarts_at_zero = self._zero
        if not self._learns or clock_restarts != restarts_at_zero or (tick_at_zero or 0) < YOUNG_MS:
            return None
        boot_tick = _tick_gone_back(record, newest_tick)
        if boot_tick is None:
            self._learns = False  # the clock goes on: it was WHEEL_RESET, and the pins' states are known
        return boot_tick

    def _judge(self, record, newest_tick):
        if self._last is None:
            return self._restart(record, FIRST)
        fault = self._fault(self._last, record, self._per_ms)
        doubt = fault or self._doubt(record, newest_tick)
        if not doubt:
            return self._accept(record, "", self._way(self._last, record), before=self._last)
        if fault and self._before is not None and not self._fault(self._before, record, self._per_ms):
            way = _difference(self._way(self._before, record), self._way(self._before, self._last))
            if max(map(abs, way)) <= SURPRISE_PULSES:
                return self._accept(record, TAKEN_BACK, way, before=self._before)
        if fault and _is_fresh(record):
            return self._restart(record, ODOMETERS_RESET)
        return self._consider(record, doubt, bool(fault))

    def _accept(self, record, reason, way, before):
        for_each_wheel = zip(self._last, record, self._per_ms, self._pulse_ticks)
        self._per_ms, self._pulse_ticks = zip(*(self._speed(*wheel) for wheel in for_each_wheel))
        self._before, self._last = before, record
        self._candidates.clear()
        return Verdict(True, reason, way[:2], unproven=way[2:]) if reason or any(way) else _FINE

    def _restart(self, record, reason):
        self._before, self._last = None, record
        self._per_ms = (0.0, 0.0)
        self._pulse_ticks = (None, None)
        self._zero = None
        self._candidates.clear()
        return Verdict(True, reason, restarted=True)

    def _consider(self, record, doubt, jumped):
        """Wait for others like it; with the last of them, take all of them up."""
        chain = self._candidates
        # What may follow the last one puts an end to a jump that nothing has confirmed yet.
        if chain and (jumped != self._jumped or self._fault(chain[-1], record, (0.0, 0.0))):
            chain.clear()
        self._jumped = jumped
        chain.append(record)
        if len(chain) < CONSISTENT:
            return Verdict(False, doubt)
        reason, known, wrong = CAUGHT_UP, [self._last, *chain], (0, 0, 0, 0)
        if jumped:
            if self._before is not None and not self._fault(self._before, chain[0], self._per_ms):
                reason, known, wrong = TAKEN_BACK, [self._before, *chain], self._way(self._before, self._last)
            else:
                reason, known = ODOMETERS_RESTARTED, list(chain)
                self._learns = any(ahead(now.when, last.when) < 0 for now, last in zip(chain[0], self._last))
        way = _difference([sum(ways) for ways in zip(*map(self._way, known, known[1:]))], wrong)
        self._last = chain[-2]
        self._pulse_ticks = tuple(now.when if now.dist_abs != before.dist_abs else None
                                  for before, now in zip(chain[-3], chain[-2]))
        self._accept(record, "", way, before=chain[-2])
        return Verdict(True, reason, way[:2], restarted=reason == ODOMETERS_RESTARTED, unproven=way[2:])

    def _way(self, before, now):
        """Signed proven pulses of left and right, and unproven ones of both."""
        if not self._learns or min(before.left.dist_abs, before.right.dist_abs) >= LEARNING_PULSES:
            return signed_pulses(before.left, now.left), signed_pulses(before.right, now.right), 0, 0
        left, right = _learning_pulses(before.left, now.left), _learning_pulses(before.right, now.right)
        return left[0], right[0], left[1], right[1]

    def _impossible(self, wheel):
        """What is wrong with a wheel by itself."""
        if wheel.direction == DIRECTION_ERROR:
            return SENSOR_ERROR
        if wheel.direction == NO_DIRECTION:
            if wheel.dist or wheel.dist_abs > LEARNING_PULSES:
                return COUNTS_DISAGREE
        elif ahead(wheel.dist_abs, wheel.dist) < 0:
            return COUNTS_DISAGREE
        return SPEED_TOO_HIGH if wheel.speed > self._top_speed else ""

    def _fault(self, before, now, per_ms):
        """Why one report can't follow another, whatever was lost in between; empty when it can."""
        return (self._wheel_fault(before.left, now.left, per_ms[0])
                or self._wheel_fault(before.right, now.right, per_ms[1])
                or _repeat_fault(before, now))

    def _wheel_fault(self, before, now, per_ms):
        pulses = ahead(now.dist_abs, before.dist_abs)
        has_tick = has_pulsed(before) and has_pulsed(now)
        moved_ms = ahead(now.when, before.when) if has_tick else 0
        if pulses < 0:
            return COUNT_BACK
        if moved_ms < 0:
            return PULSE_BACK
        if pulses == 0:
            return "" if (now.direction, now.dist) == (before.direction, before.dist) else CHANGE_WITHOUT_PULSE
        if has_tick and pulses > self._top_per_ms * (moved_ms + QUANTUM_MS) + PULSES_OF_JITTER:
            return TOO_MANY_PULSES
        if now.dist == before.dist:
            return "" if now.direction == before.direction else TURNED_WRONGLY
        least = 2 if now.direction == before.direction else 1  # turned round twice: a pulse lies between
        if not least <= ahead(now.dist, before.dist_abs) <= pulses:
            return TURNED_WRONGLY
        if self._learns and now.dist <= LEARNING_PULSES + 1:
            return ""
        speed_mps = 1000 * per_ms * self._pulse_m
        return TURNED_AT_SPEED if speed_mps - BRAKING_MPS2 * moved_ms / 1000 > SLOW_MPS else ""

    def _doubt(self, record, newest_tick):
        """Why a report that may follow the last one had better be confirmed."""
        for before, now, per_ms in zip(self._last, record, self._per_ms):
            pulses = ahead(now.dist_abs, before.dist_abs)
            moved_ms = ahead(now.when, before.when) if has_pulsed(before) else 0
            if pulses > SURPRISE_PULSES + per_ms * min(moved_ms, TRUSTED_MS):
                return SURPRISING
            if newest_tick is not None and min(moved_ms, ahead(now.when, newest_tick)) > self._max_gap_ms:
                return PULSE_AHEAD
        return ""

    def _speed(self, before, now, per_ms, pulse_tick):
        """A wheel's speed in pulses per ms between its last two pulses' reports, rather too low than too high."""
        pulses = ahead(now.dist_abs, before.dist_abs)
        if pulses <= 0:
            return per_ms, pulse_tick
        moved_ms = -1 if pulse_tick is None else ahead(now.when, pulse_tick)
        return min(self._top_per_ms, pulses / (moved_ms + QUANTUM_MS)) if moved_ms >= 0 else 0.0, now.when


_FINE = Verdict(True, "")
_NOTHING_YET = WheelStatus(*2 * (Wheel(0, NO_DIRECTION, 0, 0, 0),))


def _tick_gone_back(record, newest_tick):
    """The newest pulse's tick, if it can only be of a clock that began anew; else ``None``."""
    when = max((wheel.when for wheel in record if wheel.dist_abs), default=None)
    if when is None or newest_tick is None:
        return None
    return when if when < newest_tick and ahead(when, newest_tick) < -OVERTAKEN_MS else None


def _repeat_fault(before, now):
    """Why a wheel without a pulse can't have its new ``when``: a repeat renews both wheels', to the same tick."""
    renewed = [wheel for wheel, old in zip(now, before) if wheel.dist_abs == old.dist_abs and wheel.when != old.when]
    if not renewed:
        return ""
    others = [wheel for wheel in now if wheel.dist_abs and wheel not in renewed]
    # Beside a wheel that has pulsed since, the repeat itself was lost: it lay between the report before and that pulse.
    fits = (all(ahead(renewed[0].when, old.when) > 0 for old in before if has_pulsed(old))
            and all(ahead(other.when, renewed[0].when) >= 0 for other in others)
            and renewed[0].when == renewed[-1].when)
    return "" if fits else REPEAT_ALONE


def _learning_pulses(before, now):
    """(signed proven, unproven) pulses of a wheel whose Teensy may not have known its hall sensor's pins yet.

    A direction that begins with the second pulse, after a first one without any, is right: both pins are known then.
    """
    learning = 1 if now.direction != NO_DIRECTION and now.dist == 2 else LEARNING_PULSES
    unproven = max(0, min(now.dist_abs, learning) - before.dist_abs)
    if not unproven:
        return signed_pulses(before, now), 0
    if now.dist_abs <= learning:
        return 0, unproven
    if now.dist <= learning:
        return signed_pulses(now._replace(dist_abs=learning), now), unproven
    other = BACKWARD if now.direction == FORWARD else FORWARD
    return signed_pulses(Wheel(0, other, 0, 0, learning), now), unproven


def _difference(way, other):
    return tuple(one - another for one, another in zip(way, other))


def _is_zero(record):
    """Both odometers as they stand after power-up and after a reset."""
    return all(wheel.direction == NO_DIRECTION and not wheel.dist_abs for wheel in record)


def _is_fresh(record):
    """Both odometers counted from zero a moment ago, and one of them has no direction yet."""
    return (any(wheel.direction == NO_DIRECTION for wheel in record)
            and all(wheel.dist_abs <= SURPRISE_PULSES for wheel in record))
