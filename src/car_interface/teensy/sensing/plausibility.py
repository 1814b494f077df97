"""Judges the Teensy's records before odometry, clock and ranges use them.

A checksum of eight bits lets some wrong frames past. Each well-formed record is judged here against earlier ones:
device ticks against device ticks and pulses against pulses, and against the host's clock in one thing only: a pong is
younger than its ping. The verdict has whether it may be used, why not, and how many pulses it adds to the distance.

Three rules keep one wrong record from doing harm, and a true jump from being locked out:

- A report of the wheels that brings more pulses than the wheel's own speed explains by ``SURPRISE_PULSES`` waits until
  others confirm it. So a wrong report that is accepted moves a wheel by at most that many pulses, 4.5 cm.
- A record that contradicts the one before it, but follows from the one before that, is accepted, and the pulses of the
  wrong one are taken back.
- Any other contradiction is a jump: the Teensy rebooted, its odometers were reset, or many reports were lost. It is
  accepted with the third of ``CONSISTENT`` records in a row each of which follows from the one before it; none of the
  pulses between these is lost. Odometers at zero that have no direction yet are accepted at once: no other state looks
  like that.

Records of a healthy firmware are never refused. Pure.
"""
from __future__ import annotations

import math
from collections import Counter
from typing import NamedTuple

from car_interface.common.vehicle_geometry import PULSES_PER_REVOLUTION, WHEEL_DIAMETER_M
from car_interface.teensy.link.protocol import (
    BACKWARD,
    DIRECTION_ERROR,
    FORWARD,
    NO_DIRECTION,
    Pong,
    SonarStatus,
    Wheel,
    WheelStatus,
    ahead,
)
from car_interface.teensy.link.reboot import MAX_LAG_MS

CONSISTENT = 3  # ticks in a row that agree with each other end a contradiction
# Answers overtake sonar reports in the Teensy's buffers, which hold 0.2 s of the line.
OVERTAKEN_MS = 250
YOUNG_MS = 2_000  # a Teensy with a shorter uptime may have just rebooted
# At power-up the firmware takes both pins of a hall sensor for low and then learns one of them with each pulse. So the
# direction of a wheel's first two pulses means nothing: it may be wrong, or still missing while ``dist_abs`` grows.
LEARNING_PULSES = 2
SURPRISE_PULSES = 3  # of 1.5 cm: an error of 4.5 cm at most; two reports in a row may be lost at a crawl
TRUSTED_MS = 100  # after a wheel's last pulse; later its speed no longer explains pulses
QUANTUM_MS = 1  # of the ticks
PULSES_OF_JITTER = 2  # the magnets of an encoder wheel aren't spaced evenly
# A faster wheel needs time to reverse: at ten times the grip of tyres, as a wheel in the air may be braked harder.
SLOW_MPS = 1.0
BRAKING_MPS2 = 100.0
TOP_SPEED_MPS = 20.0  # of a wheel, its spinning included
MAX_GAP_MS = 2_000  # between ticks of a line that is whole; at least two periods of the pings, of which one may be lost
PULSE_M = math.pi * WHEEL_DIAMETER_M / PULSES_PER_REVOLUTION  # a wheel's distance from pulse to pulse
SPEED_OF_ONE_TICK = 1000  # pulses per second: two pulses, one tick apart

# Why a record is refused.
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
WRONG_DIRECTION = "a direction that doesn't go with the counts"
REVERSED_AT_SPEED = "a direction that changes at speed"
SURPRISING = "more pulses at once than the wheel's speed explains"
PULSE_AHEAD = "a pulse ahead of the Teensy's clock"
# Why an accepted record is notable.
FIRST = "the first of its kind"
PREVIOUS_WRONG = "the one before it was wrong"
AFTER_GAP = "taken up after a gap"
CLOCK_RESTARTED = "taken up after the Teensy's clock went back: it rebooted"
ODOMETERS_RESTARTED = "taken up after a jump of the odometers"
ODOMETERS_RESET = "odometers that were reset"


class Verdict(NamedTuple):
    """The verdict on a record; of two numbers the first is the left wheel's."""

    accepted: bool  # it may be used
    reason: str  # why not, or why it is notable; empty for most
    pulses: tuple[int, int] = (0, 0)  # to add to the distance of each wheel, signed
    restarted: bool = False  # the state before it no longer holds
    # Further pulses, made before those of ``pulses``, whose direction the firmware could not know yet.
    unproven: tuple[int, int] = (0, 0)
    unsplit: tuple[int, int] = (0, 0)  # of ``pulses`` those before the wheel's last reversal; see ``pose``
    since_boot: bool = False  # ``pulses`` and ``unproven`` are all that were counted since the Teensy's boot
    boot_tick: int | None = None  # of the clock after a reboot that this report of the wheels reveals


FINE = Verdict(True, "")
_NOTHING_YET = WheelStatus(*2 * (Wheel(0, NO_DIRECTION, 0, 0, 0),))


class Gates:
    """Judges the records of one Teensy, in the order in which they arrived.

    Attributes:
        counts: of the refused records and the notable accepted ones, by reason.
    """

    def __init__(self, pulse_m: float = PULSE_M, top_speed_mps: float = TOP_SPEED_MPS, max_gap_ms: float = MAX_GAP_MS):
        self.counts: Counter = Counter()
        self.accepted = 0
        self.refused = 0
        self._ticks = TickGate(max_gap_ms)
        self._wheels = WheelGate(self._ticks, pulse_m, top_speed_mps)

    def pong(self, record: Pong, is_ours: bool, reached: int | None = None) -> Verdict:
        """Judge a pong.

        Args:
            is_ours: it answers a ping that waited (a duplicate answers none).
            reached: when that ping was sent, the clock had passed this tick, unless it restarted; ``None`` = unknown.
        """
        if not is_ours:
            return self._counted(Verdict(False, NOT_OUR_PING))
        return self._counted(self._judge_tick(record.timestamp2, reached))

    def sonar(self, record: SonarStatus) -> Verdict:
        """Judge a sonar's report by its tick: any echo time is possible, see ``ranging``."""
        return self._counted(self._judge_tick(record.when))

    def wheels(self, record: WheelStatus) -> Verdict:
        """Judge a report of the wheels. They may turn in opposite directions: a car can spin."""
        verdict = self._wheels.judge(record)
        if verdict.boot_tick is not None:
            self.counts[CLOCK_RESTARTED] += 1
        return self._counted(verdict)

    def _judge_tick(self, tick, reached=None):
        if self._wheels.is_zero_again and self._ticks.is_young_again(tick):
            self._ticks.restart(tick)
            return Verdict(True, CLOCK_RESTARTED, restarted=True)
        return self._ticks.judge(tick, reached)

    def _counted(self, verdict):
        self.accepted += verdict.accepted
        self.refused += not verdict.accepted
        if verdict.reason:
            self.counts[verdict.reason] += 1
        return verdict


class TickGate:
    """Judges ticks, which come nearly in order: ``max_gap_ms`` lies between two of a line that is whole."""

    def __init__(self, max_gap_ms: float):
        self.max_gap_ms = max_gap_ms
        self.newest: int | None = None  # accepted tick
        self.restarts = 0  # of the clock
        self._before = None  # the newest before that
        self._candidates: list = []

    def restart(self, tick: int) -> None:
        """Begin with a tick of the new clock: the Teensy rebooted."""
        self.restarts += 1
        self._before, self.newest = None, tick
        self._candidates.clear()

    def is_young_again(self, tick: int) -> bool:
        """Return whether a tick can come from a Teensy that has just rebooted."""
        return self.newest is not None and tick < YOUNG_MS and ahead(tick, self.newest) < -OVERTAKEN_MS

    def judge(self, tick: int, reached: int | None = None) -> Verdict:
        """Judge the next tick, ms modulo 2**32.

        Args:
            reached: the clock has passed this tick, unless it restarted; ``None`` = unknown.
        """
        if self.newest is None:
            self.newest = tick
            return Verdict(True, FIRST, restarted=True)
        if reached is not None and ahead(reached, tick) > MAX_LAG_MS:
            self._before, self.newest = None, reached
        fault = self._fault(self.newest, tick)
        if not fault:
            if ahead(tick, self.newest) > 0:
                self._before, self.newest = self.newest, tick
            self._candidates.clear()
            return FINE
        if self._before is not None and not self._fault(self._before, tick):
            self.newest = tick
            self._candidates.clear()
            return Verdict(True, PREVIOUS_WRONG)
        if self._candidates and self._fault(self._candidates[-1], tick):
            self._candidates.clear()
        self._candidates.append(tick)
        if len(self._candidates) < CONSISTENT:
            return Verdict(False, fault)
        rebooted = ahead(self._candidates[0], self.newest) < 0
        self.restart(tick)
        self.restarts -= not rebooted
        return Verdict(True, CLOCK_RESTARTED if rebooted else AFTER_GAP, restarted=rebooted)

    def _fault(self, before, tick):
        gap_ms = ahead(tick, before)
        if gap_ms < -OVERTAKEN_MS:
            return TICK_BACK
        return TICK_AHEAD if gap_ms > self.max_gap_ms else ""


class WheelGate:
    """Judges the reports of the wheels, which come in order, and tells ``ticks`` of a reboot that one reveals.

    Reports of a healthy firmware are never refused:

    - A wheel's ``when`` is the tick of its last pulse *or repeat*: a standing car repeats its report with a new
      ``when`` for both wheels. Only a change of ``dist_abs`` is a pulse.
    - ``when`` is 0 until the first pulse after power-up: this is no reading of the clock. WHEEL_RESET keeps ``when``.
    - The first two pulses of a wheel after power-up are ``unproven``: their direction must be found elsewhere.
      WHEEL_RESET keeps the pins' states, so that no pulse is unproven after it.
    """

    def __init__(self, ticks: TickGate, pulse_m: float, top_speed_mps: float):
        self._ticks = ticks
        self._pulse_m = pulse_m
        self._top_per_ms = top_speed_mps / pulse_m / 1000
        self._top_speed = 2000 * self._top_per_ms + SPEED_OF_ONE_TICK  # as a report may give it
        self._candidates: list = []
        self._jumped = False  # the candidates can't follow the last one
        self._learns = True  # the first pulses are unproven
        self._clock_restarts = 0  # of the clock, by the last accepted report
        self._restart(None, FIRST)

    @property
    def is_zero_again(self):
        """Return whether both odometers have gone back to zero; this and the clock prove a reboot."""
        return self._zero is not None and self._before is None

    def judge(self, record: WheelStatus) -> Verdict:
        """Judge the next report."""
        fault = self._impossible(record.left) or self._impossible(record.right)
        if fault:
            return Verdict(False, fault)
        newest_tick = self._ticks.newest
        boot_tick = self._find_boot(record, newest_tick)
        verdict = self._judge(record, newest_tick if boot_tick is None else boot_tick)
        if verdict.reason == ODOMETERS_RESET:
            self._zero = (newest_tick, self._ticks.restarts)
            self._learns = not any(wheel.when for wheel in record if not wheel.dist_abs)
            boot_tick = self._find_boot(record, newest_tick)
            pulses = self._pulses_between(_NOTHING_YET, record)
            verdict = verdict._replace(pulses=pulses[:2], unproven=pulses[2:4], unsplit=pulses[4:])
        elif verdict.reason == ODOMETERS_RESTARTED and self._learns:
            boot_tick = _tick_gone_back(record, newest_tick)
        if not verdict.accepted:
            return verdict
        if boot_tick is not None:
            self._ticks.restart(boot_tick)
            verdict = verdict._replace(boot_tick=boot_tick)
        self._clock_restarts = self._ticks.restarts
        if not _is_zero(record):
            self._zero = None
        elif verdict.restarted:
            self._learns = not any(wheel.when for wheel in record)  # which WHEEL_RESET keeps
        return verdict

    def _find_boot(self, record, newest_tick):
        """Return a tick of the new clock if the first pulse after zero shows that it was no reset, else ``None``."""
        if self._zero is None or _is_zero(record) or newest_tick is None:
            return None
        tick_at_zero, restarts_at_zero = self._zero
        if not self._learns or self._ticks.restarts != restarts_at_zero or (tick_at_zero or 0) < YOUNG_MS:
            return None
        boot_tick = _tick_gone_back(record, newest_tick)
        if boot_tick is None:
            self._learns = False  # the clock goes on: it was WHEEL_RESET, and the pins' states are known
        return boot_tick

    def _judge(self, record, newest_tick):
        if self._last is None:
            return self._restart(record, FIRST)
        fault = self._fault(self._last, record, self._per_ms)
        is_boot = self._ticks.restarts != self._clock_restarts or _tick_gone_back(record, newest_tick) is not None
        # Of a car that hasn't moved since it was switched on only the clock shows that it was switched on again.
        is_hidden = is_boot and self._zero is None and _is_zero(self._last)
        if is_hidden and _is_zero(record):
            return self._restart(record, ODOMETERS_RESTARTED)._replace(since_boot=True)
        doubt = fault or self._doubt(record, newest_tick) or (is_hidden and PULSE_BACK)
        if not doubt:
            return self._accept(record, "", self._pulses_between(self._last, record), before=self._last)
        if is_boot:
            self._before = None  # the last report wasn't wrong, though the counts alone may follow from that before
        if fault and self._before is not None and not self._fault(self._before, record, self._per_ms):
            pulses = _difference(self._pulses_between(self._before, record),
                                 self._pulses_between(self._before, self._last))
            if max(map(abs, pulses)) <= SURPRISE_PULSES:
                return self._accept(record, PREVIOUS_WRONG, pulses, before=self._before)
        if fault and _is_fresh(record):
            return self._restart(record, ODOMETERS_RESET)
        return self._consider(record, doubt, bool(fault) or is_boot, is_boot)

    def _accept(self, record, reason, pulses, before):
        for_each_wheel = zip(self._last, record, self._per_ms, self._pulse_ticks)
        self._per_ms, self._pulse_ticks = zip(*(self._speed(*wheel) for wheel in for_each_wheel))
        self._before, self._last = before, record
        self._candidates.clear()
        return Verdict(True, reason, pulses[:2], False, pulses[2:4], pulses[4:]) if reason or any(pulses) else FINE

    def _restart(self, record, reason):
        self._before, self._last = None, record  # the last two accepted ones
        self._per_ms = (0.0, 0.0)  # each wheel's speed when it made its last pulse
        self._pulse_ticks = (None, None)  # of the last pulses; ``when`` may be that of a repeat
        self._zero = None  # (newest tick, restarts of the clock) when both odometers went back to zero
        self._candidates.clear()
        return Verdict(True, reason, restarted=True)

    def _consider(self, record, doubt, jumped, is_boot):
        """Wait for reports that agree with this one; accept all of them with the last."""
        chain = self._candidates
        # A report that may follow the last one ends a jump that nothing has confirmed yet.
        if chain and (jumped != self._jumped or self._fault(chain[-1], record, (0.0, 0.0))):
            chain.clear()
        self._jumped = jumped
        chain.append(record)
        if len(chain) < CONSISTENT:
            return Verdict(False, doubt)
        since_boot = False
        reason, known, wrong = AFTER_GAP, [self._last, *chain], (0,) * 6
        if jumped:
            if self._before is not None and not self._fault(self._before, chain[0], self._per_ms):
                reason, known = PREVIOUS_WRONG, [self._before, *chain]
                wrong = self._pulses_between(self._before, self._last)
            else:
                reason, known = ODOMETERS_RESTARTED, list(chain)
                self._learns = is_boot or any(ahead(now.when, last.when) < 0
                                              for now, last in zip(chain[0], self._last))
                since_boot = self._learns and is_boot
                if since_boot:
                    known.insert(0, _NOTHING_YET)  # nothing was lost: counts begin with the boot
        pulses = _difference([sum(counts) for counts in zip(*map(self._pulses_between, known, known[1:]))], wrong)
        self._last = chain[-2]
        self._pulse_ticks = tuple(now.when if now.dist_abs != before.dist_abs else None
                                  for before, now in zip(chain[-3], chain[-2]))
        self._accept(record, "", pulses, before=chain[-2])
        return Verdict(True, reason, pulses[:2], reason == ODOMETERS_RESTARTED, pulses[2:4], pulses[4:], since_boot)

    def _pulses_between(self, before, now):
        """Return signed proven pulses of left and right, unproven ones of both, and unsplit ones of both."""
        learns = self._learns and min(before.left.dist_abs, before.right.dist_abs) < LEARNING_PULSES
        proven, unproven = zip(*(learning_pulses(old, new) if learns else (signed_pulses(old, new), 0)
                                 for old, new in zip(before, now)))
        unsplit = [unsplit_pulses(old._replace(dist_abs=max(old.dist_abs, LEARNING_PULSES)) if learns else old, new)
                   for old, new in zip(before, now)]
        rolled = self._last if learns and self._last else before
        pulses, unsplit = _settled(proven, unsplit, before, rolled, now)
        return (*pulses, *unproven, *unsplit)

    def _impossible(self, wheel):
        """Return what is wrong with a wheel's report by itself."""
        if wheel.direction == DIRECTION_ERROR:
            return SENSOR_ERROR
        if wheel.direction == NO_DIRECTION:
            if wheel.dist or wheel.dist_abs > LEARNING_PULSES:
                return COUNTS_DISAGREE
        elif ahead(wheel.dist_abs, wheel.dist) < 0:
            return COUNTS_DISAGREE
        return SPEED_TOO_HIGH if wheel.speed > self._top_speed else ""

    def _fault(self, before, now, per_ms):
        """Return why one report can't follow another, whatever was lost in between; empty when it can."""
        return (self._wheel_fault(before.left, now.left, per_ms[0])
                or self._wheel_fault(before.right, now.right, per_ms[1])
                or _repeat_fault(before, now))

    def _wheel_fault(self, before, now, per_ms):
        pulses = ahead(now.dist_abs, before.dist_abs)
        has_tick = has_pulsed(before) and has_pulsed(now)
        elapsed_ms = ahead(now.when, before.when) if has_tick else 0
        if pulses < 0:
            return COUNT_BACK
        if elapsed_ms < 0:
            return PULSE_BACK
        if pulses == 0:
            return "" if (now.direction, now.dist) == (before.direction, before.dist) else CHANGE_WITHOUT_PULSE
        if has_tick and pulses > self._top_per_ms * (elapsed_ms + QUANTUM_MS) + PULSES_OF_JITTER:
            return TOO_MANY_PULSES
        if now.dist == before.dist:
            return "" if now.direction == before.direction else WRONG_DIRECTION
        minimum = 2 if now.direction == before.direction else 1  # turned round twice: a pulse lies between
        if not minimum <= ahead(now.dist, before.dist_abs) <= pulses:
            return WRONG_DIRECTION
        if self._learns and now.dist <= LEARNING_PULSES + 1:
            return ""
        speed_mps = 1000 * per_ms * self._pulse_m
        return REVERSED_AT_SPEED if speed_mps - BRAKING_MPS2 * elapsed_ms / 1000 > SLOW_MPS else ""

    def _doubt(self, record, newest_tick):
        """Return why a report that may follow the last one should be confirmed first."""
        for before, now, per_ms in zip(self._last, record, self._per_ms):
            pulses = ahead(now.dist_abs, before.dist_abs)
            elapsed_ms = ahead(now.when, before.when) if has_pulsed(before) else 0
            if pulses > SURPRISE_PULSES + per_ms * min(elapsed_ms, TRUSTED_MS):
                return SURPRISING
            if newest_tick is not None and min(elapsed_ms, ahead(now.when, newest_tick)) > self._ticks.max_gap_ms:
                return PULSE_AHEAD
        return ""

    def _speed(self, before, now, per_ms, pulse_tick):
        """Return a wheel's speed, pulses per ms, between its last two pulses' reports; rather too low than too high."""
        pulses = ahead(now.dist_abs, before.dist_abs)
        if pulses <= 0:
            return per_ms, pulse_tick
        elapsed_ms = -1 if pulse_tick is None else ahead(now.when, pulse_tick)
        return min(self._top_per_ms, pulses / (elapsed_ms + QUANTUM_MS)) if elapsed_ms >= 0 else 0.0, now.when


def has_pulsed(wheel: Wheel) -> bool:
    """Return whether ``when`` is a reading of the clock; it is 0 until the first pulse, but also at a wrap."""
    return bool(wheel.when or wheel.speed)


def signed_pulses(before: Wheel, now: Wheel) -> int:
    """Return the pulses from one report of a wheel to a later one, backward negative.

    The pulse before ``now.dist`` was made in the other direction. If a wheel reversed twice in between, it is unknown
    how many of the earlier pulses went in which direction: all but that one are taken to cancel out.
    """
    sign = 1 if now.direction == FORWARD else -1
    pulses = ahead(now.dist_abs, before.dist_abs)
    earlier = unsplit_pulses(before, now)
    return sign * (pulses - earlier) - sign * (earlier if now.direction != before.direction else min(earlier, 1))


def unsplit_pulses(before: Wheel, now: Wheel) -> int:
    """Return the pulses before a wheel's last reversal: with an earlier reversal too, their directions are unknown."""
    if now.dist == before.dist and now.direction == before.direction or now.direction == NO_DIRECTION:
        return 0
    return max(0, ahead(now.dist, before.dist_abs) - 1)


def learning_pulses(before: Wheel, now: Wheel) -> tuple[int, int]:
    """Return (signed proven, unproven) pulses of a wheel whose Teensy may not have known its hall sensor's pins yet.

    A direction that begins with the second pulse, after a first one without any, is right: both pins are known then.
    """
    learning = 1 if now.direction != NO_DIRECTION and now.dist == 2 else LEARNING_PULSES
    unproven = max(0, min(now.dist_abs, learning) - before.dist_abs)
    if unproven:  # those that follow began in the other direction if the wheel has reversed since
        other = BACKWARD if now.direction == FORWARD else FORWARD
        before = before._replace(direction=other, dist_abs=before.dist_abs + unproven)
    return signed_pulses(before, now), unproven


def _settled(pulses, unsplit, before, rolled, now):
    """Return pulses and unsplit ones, by what both wheels show together.

    Args:
        pulses: signed, as each wheel alone counts them from ``before`` to ``now``.
        unsplit: of these, the ones before a wheel's last reversal.
        rolled: the report with the directions in which the wheels rolled before.
    """
    settled, open_ = list(pulses), list(unsplit)
    for side, other in ((0, 1), (1, 0)):
        earlier, direction = unsplit[side], now[side].direction
        sign = 1 if direction == FORWARD else -1
        counted = -sign * (min(earlier, 1) if before[side].direction == direction else earlier)
        if rolled[side].direction != direction or not earlier:
            continue  # a single reversal
        if not unsplit[other] and abs(pulses[other]) > earlier / 2:
            # The other wheel didn't reverse: this one went back over a single magnet; or it has just reversed, before
            # the other one does.
            settled[side] += (sign * (earlier - 2) if sign * pulses[other] > 0 else -sign * earlier) - counted
            open_[side] = 0
        else:
            settled[side] += -sign - counted
    return settled, open_


def _tick_gone_back(record, newest_tick):
    """Return the newest pulse's tick if it can only come from a restarted clock, else ``None``."""
    when = max((wheel.when for wheel in record if wheel.dist_abs), default=None)
    if when is None or newest_tick is None:
        return None
    return when if when < newest_tick and ahead(when, newest_tick) < -OVERTAKEN_MS else None


def _repeat_fault(before, now):
    """Return why a wheel without a pulse can't have its new ``when``: a repeat sets both wheels' to the same tick."""
    renewed = [wheel for wheel, old in zip(now, before) if wheel.dist_abs == old.dist_abs and wheel.when != old.when]
    if not renewed:
        return ""
    others = [wheel for wheel in now if wheel.dist_abs and wheel not in renewed]
    # If the other wheel has pulsed since, the repeat itself was lost: it lay between the last report and that pulse.
    fits = (all(ahead(renewed[0].when, old.when) > 0 for old in before if has_pulsed(old))
            and all(ahead(other.when, renewed[0].when) >= 0 for other in others)
            and renewed[0].when == renewed[-1].when)
    return "" if fits else REPEAT_ALONE


def _difference(pulses, other):
    return tuple(one - another for one, another in zip(pulses, other))


def _is_zero(record):
    """Return whether both odometers are as after power-up or a reset."""
    return all(wheel.direction == NO_DIRECTION and not wheel.dist_abs for wheel in record)


def _is_fresh(record):
    """Return whether both odometers have just counted from zero, and one of them has no direction yet."""
    return (any(wheel.direction == NO_DIRECTION for wheel in record)
            and all(wheel.dist_abs <= SURPRISE_PULSES for wheel in record))
