"""Judges the reports of the wheels.

Reports of a healthy firmware are never refused:

- A wheel's ``when`` is the tick of its last pulse *or repeat*: a standing car repeats its report with a new ``when``
  for both wheels. Only a change of ``dist_abs`` is a pulse.
- ``when`` is 0 until the first pulse after power-up: this is no reading of the clock. WHEEL_RESET keeps ``when``.
- The first two pulses of a wheel after power-up are ``unproven`` (see ``pulse_counts``): their direction must be found
  elsewhere. WHEEL_RESET keeps the pins' states, so that no pulse is unproven after it.

Pure.
"""
from __future__ import annotations

from car_interface.teensy.link.protocol import DIRECTION_ERROR, FORWARD, NO_DIRECTION, Wheel, WheelStatus, ahead
from car_interface.teensy.sensing.pulse_counts import (
    LEARNING_PULSES,
    has_pulsed,
    learning_pulses,
    signed_pulses,
    unsplit_pulses,
)
from car_interface.teensy.sensing.tick_gate import CONSISTENT, OVERTAKEN_MS, YOUNG_MS
from car_interface.teensy.sensing.verdicts import (
    AFTER_GAP,
    CHANGE_WITHOUT_PULSE,
    COUNT_BACK,
    COUNTS_DISAGREE,
    FINE,
    FIRST,
    ODOMETERS_RESET,
    ODOMETERS_RESTARTED,
    PREVIOUS_WRONG,
    PULSE_AHEAD,
    PULSE_BACK,
    REPEAT_ALONE,
    REVERSED_AT_SPEED,
    SENSOR_ERROR,
    SPEED_TOO_HIGH,
    SURPRISING,
    TOO_MANY_PULSES,
    WRONG_DIRECTION,
    Verdict,
)

SURPRISE_PULSES = 3  # of 1.5 cm: an error of 4.5 cm at most; two reports in a row may be lost at a crawl
TRUSTED_MS = 100  # after a wheel's last pulse; later its speed no longer explains pulses
QUANTUM_MS = 1  # of the ticks
PULSES_OF_JITTER = 2  # the magnets of an encoder wheel aren't spaced evenly
# A faster wheel needs time to reverse: at ten times the grip of tyres, as a wheel in the air may be braked harder.
SLOW_MPS = 1.0
BRAKING_MPS2 = 100.0
SPEED_OF_ONE_TICK = 1000  # pulses per second: two pulses, one tick apart

_NOTHING_YET = WheelStatus(*2 * (Wheel(0, NO_DIRECTION, 0, 0, 0),))


class WheelGate:
    """Judges the reports of the wheels, which come in order.

    Args:
        pulse_m: a wheel's distance from pulse to pulse.
        max_gap_ms: between ticks of a line that is whole.
        top_speed_mps: of a wheel, its spinning included.
    """

    def __init__(self, pulse_m: float, max_gap_ms: float, top_speed_mps: float):
        self._pulse_m = pulse_m
        self._max_gap_ms = max_gap_ms
        self._top_per_ms = top_speed_mps / pulse_m / 1000
        self._top_speed = 2000 * self._top_per_ms + SPEED_OF_ONE_TICK  # as a report may give it
        self._last = None
        self._before = None  # accepted before the last one
        self._candidates: list = []
        self._jumped = False  # the candidates can't follow the last one
        self._per_ms = (0.0, 0.0)  # each wheel's speed when it made its last pulse
        self._pulse_ticks: tuple = (None, None)  # of the last pulses; ``when`` may be that of a repeat
        self._learns = True  # the first pulses are unproven
        self._clock_restarts = 0  # of the clock, by the last accepted report
        self._zero = None  # (newest tick, restarts of the clock) when both odometers went back to zero

    @property
    def is_zero_again(self):
        """Return whether both odometers have gone back to zero; this and the clock prove a reboot."""
        return self._zero is not None and self._before is None

    def judge(self, record: WheelStatus, newest_tick: int | None, clock_restarts: int) -> Verdict:
        """Judge the next report, given the newest tick of the clock and how often the clock restarted."""
        fault = self._impossible(record.left) or self._impossible(record.right)
        if fault:
            return Verdict(False, fault)
        boot_tick = self._find_boot(record, newest_tick, clock_restarts)
        verdict = self._judge(record, newest_tick if boot_tick is None else boot_tick, clock_restarts)
        if verdict.reason == ODOMETERS_RESET:
            self._zero = (newest_tick, clock_restarts)
            self._learns = not any(wheel.when for wheel in record if not wheel.dist_abs)
            boot_tick = self._find_boot(record, newest_tick, clock_restarts)
            pulses = self._pulses_between(_NOTHING_YET, record)
            verdict = verdict._replace(pulses=pulses[:2], unproven=pulses[2:4], unsplit=pulses[4:])
        elif verdict.reason == ODOMETERS_RESTARTED and self._learns:
            boot_tick = _tick_gone_back(record, newest_tick)
        if not verdict.accepted:
            return verdict
        self._clock_restarts = clock_restarts + (boot_tick is not None)
        if not _is_zero(record):
            self._zero = None
        elif verdict.restarted:
            self._learns = not any(wheel.when for wheel in record)  # which WHEEL_RESET keeps
        return verdict if boot_tick is None else verdict._replace(boot_tick=boot_tick)

    def _find_boot(self, record, newest_tick, clock_restarts):
        """Return a tick of the new clock if the first pulse after zero shows that it was no reset, else ``None``."""
        if self._zero is None or _is_zero(record) or newest_tick is None:
            return None
        tick_at_zero, restarts_at_zero = self._zero
        if not self._learns or clock_restarts != restarts_at_zero or (tick_at_zero or 0) < YOUNG_MS:
            return None
        boot_tick = _tick_gone_back(record, newest_tick)
        if boot_tick is None:
            self._learns = False  # the clock goes on: it was WHEEL_RESET, and the pins' states are known
        return boot_tick

    def _judge(self, record, newest_tick, clock_restarts):
        if self._last is None:
            return self._restart(record, FIRST)
        fault = self._fault(self._last, record, self._per_ms)
        is_boot = clock_restarts != self._clock_restarts or _tick_gone_back(record, newest_tick) is not None
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
        self._before, self._last = None, record
        self._per_ms = (0.0, 0.0)
        self._pulse_ticks = (None, None)
        self._zero = None
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
        if not self._learns or min(before.left.dist_abs, before.right.dist_abs) >= LEARNING_PULSES:
            pulses = [signed_pulses(old, new) for old, new in zip(before, now)]
            unsplit = [unsplit_pulses(old, new) for old, new in zip(before, now)]
            pulses, unsplit = _settled(pulses, unsplit, before, before, now)
            return (*pulses, 0, 0, *unsplit)
        learnt = [learning_pulses(old, new) for old, new in zip(before, now)]
        unsplit = [unsplit_pulses(old._replace(dist_abs=max(old.dist_abs, LEARNING_PULSES)), new)
                   for old, new in zip(before, now)]
        pulses, unsplit = _settled([proven for proven, _ in learnt], unsplit, before, self._last or before, now)
        return (*pulses, learnt[0][1], learnt[1][1], *unsplit)

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
            if newest_tick is not None and min(elapsed_ms, ahead(now.when, newest_tick)) > self._max_gap_ms:
                return PULSE_AHEAD
        return ""

    def _speed(self, before, now, per_ms, pulse_tick):
        """Return a wheel's speed, pulses per ms, between its last two pulses' reports; rather too low than too high."""
        pulses = ahead(now.dist_abs, before.dist_abs)
        if pulses <= 0:
            return per_ms, pulse_tick
        elapsed_ms = -1 if pulse_tick is None else ahead(now.when, pulse_tick)
        return min(self._top_per_ms, pulses / (elapsed_ms + QUANTUM_MS)) if elapsed_ms >= 0 else 0.0, now.when


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
