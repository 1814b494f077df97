"""The vector of duties that everything on /servo/… speaks: its length, its range, and how to set one channel.

A duty is 0..65535 of the PWM period; −1 leaves a channel alone.
"""
from __future__ import annotations

CHANNELS = 16
MAX_DUTY = 65535
UNCHANGED = -1


def one_channel(channel: int, duty: int) -> list[int]:
    """The vector that gives one channel, 0..15, a duty and leaves the others alone."""
    vector = [UNCHANGED] * CHANNELS
    vector[channel] = duty
    return vector
