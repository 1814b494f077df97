"""The plausibility gates' verdict on a record, and its reasons."""
from __future__ import annotations

from typing import NamedTuple

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
    """The verdict on a record.

    Attributes:
        accepted: it may be used.
        reason: why not, or why it is notable; empty for most.
        pulses: to add to the distance of the left and the right wheel, signed.
        restarted: the state before it no longer holds.
        unproven: further pulses of the left and the right wheel, made before those of ``pulses``, whose direction the
            firmware could not know yet.
        unsplit: those of ``pulses`` that were made before a wheel's last reversal, left and right; see
            ``unseen_path``.
        since_boot: ``pulses`` and ``unproven`` are all that were counted since the Teensy's boot.
        boot_tick: a tick of the clock after a reboot that this report of the wheels reveals; else ``None``.
    """

    accepted: bool
    reason: str
    pulses: tuple[int, int] = (0, 0)
    restarted: bool = False
    unproven: tuple[int, int] = (0, 0)
    unsplit: tuple[int, int] = (0, 0)
    since_boot: bool = False
    boot_tick: int | None = None


FINE = Verdict(True, "")
