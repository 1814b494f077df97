"""Stamps of messages that can't be right. Freshness is measured by arrival; an odd stamp is only reported."""
from __future__ import annotations

import rospy

ODD_STAMP_S = 10.0  # this far from now


def odd_stamp(stamp: rospy.Time, now: rospy.Time) -> str:
    """What is odd about a stamp, in words: ``is 60 s in the future``; empty = nothing."""
    offset_s = (stamp - now).to_sec()
    if abs(offset_s) <= ODD_STAMP_S:
        return ""
    if stamp.is_zero():
        return "is zero"
    return f"is {abs(offset_s):.0f} s in the {'future' if offset_s > 0 else 'past'}"
