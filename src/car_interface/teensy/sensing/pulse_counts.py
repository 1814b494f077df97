"""Computes signed pulses from two reports of a wheel, and which of them have a direction that the firmware could know.

At power-up the firmware takes both pins of a hall sensor for low and then learns one of them with each pulse. So the
direction of a wheel's first two pulses means nothing: it may be wrong, or still missing while ``dist_abs`` grows. These
pulses are unproven. Pure.
"""
from __future__ import annotations

from car_interface.teensy.link.protocol import BACKWARD, FORWARD, NO_DIRECTION, Wheel, ahead

LEARNING_PULSES = 2  # of a wheel after power-up, until the firmware knows both pins of its hall sensor


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
    if not unproven:
        return signed_pulses(before, now), 0
    if now.dist_abs <= learning:
        return 0, unproven
    if now.dist <= learning:
        return signed_pulses(now._replace(dist_abs=learning), now), unproven
    other = BACKWARD if now.direction == FORWARD else FORWARD
    return signed_pulses(Wheel(0, other, 0, 0, learning), now), unproven
