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
    """The verdict on a record; of two numbers the first is the left wheel's."""

    accepted: bool  # it may be used
    reason: str  # why not, or why it is notable; empty for most
    pulses: tuple[int, int] = (0, 0)  # to add to the distance of each wheel, signed
    restarted: bool = False  # the state before it no longer holds
    # Further pulses, made before those of ``pulses``, whose direction the firmware could not know yet.
    unproven: tuple[int, int] = (0, 0)
    unsplit: tuple[int, int] = (0, 0)  # of ``pulses`` those before the wheel's last reversal; see ``unseen_path``
    since_boot: bool = False  # ``pulses`` and ``unproven`` are all that were counted since the Teensy's boot
    boot_tick: int | None = None  # of the clock after a reboot that this report of the wheels reveals


FINE = Verdict(True, "")
