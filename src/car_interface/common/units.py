"""Units and conversions that several parts use: nanoseconds, stamps, yaw, and the servo board's vector of duties.

Messages are taken by their fields, so that those of rospy and those of rosbags both work. Pure, and without ``typing``,
which would cost the guard of the servo board 2 MB.
"""
from __future__ import annotations

import math

NS_PER_MS = 1_000_000
NS_PER_S = 1_000_000_000

# The vector in /servo/cmdVector, /servo/output and servo/neutral, as the original turn_arb and pca9685 nodes have it.
CHANNELS = 16  # of a PCA9685
MAX_DUTY = 65535  # a duty is 0..65535 of the PWM period
UNCHANGED = -1  # in the vector: leave the channel alone


def stamp_ns(stamp) -> int:
    """Return a message's time or duration in nanoseconds.

    Args:
        stamp: with the fields ``secs`` and ``nsecs``, as rospy has them, or ``sec`` and ``nanosec``, as rosbags and
            ROS 2 have them.
    """
    if hasattr(stamp, "secs"):
        return stamp.secs * NS_PER_S + stamp.nsecs
    return stamp.sec * NS_PER_S + stamp.nanosec


def yaw_rad(orientation) -> float:
    """Return the yaw of a quaternion with the fields x, y, z, w: rad, −π to π, counterclockwise positive (REP-103)."""
    x, y, z, w = orientation.x, orientation.y, orientation.z, orientation.w
    return math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


def one_channel(channel: int, duty: int) -> list[int]:
    """Return the vector that sets one channel, 0..15, and leaves the others unchanged."""
    vector = [UNCHANGED] * CHANNELS
    vector[channel] = duty
    return vector
