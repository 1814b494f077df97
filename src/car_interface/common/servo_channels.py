"""The vector of duties in /servo/cmdVector, /servo/output and servo/neutral.

It has 16 channels. A duty is 0..65535 of the PWM period; −1 leaves a channel unchanged.
"""
from __future__ import annotations

CHANNELS = 16
MAX_DUTY = 65535
UNCHANGED = -1


def one_channel(channel: int, duty: int) -> list[int]:
    """The vector that sets one channel, 0..15, and leaves the others unchanged."""
    vector = [UNCHANGED] * CHANNELS
    vector[channel] = duty
    return vector
