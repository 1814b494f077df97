"""Builds the messages about servo channels."""
from __future__ import annotations

from functools import lru_cache

from std_msgs.msg import Int32MultiArray, MultiArrayDimension, MultiArrayLayout

from car_interface.common.units import CHANNELS, one_channel

_LAYOUT = MultiArrayLayout(dim=[MultiArrayDimension(label="pwm_channel", size=CHANNELS, stride=1)], data_offset=0)


def duty_vector(duties) -> Int32MultiArray:
    """A vector of 16 duties, with the layout that the original servo commands carry."""
    return Int32MultiArray(layout=_LAYOUT, data=duties)


@lru_cache(maxsize=256)
def one_channel_duty(channel: int, duty: int) -> Int32MultiArray:
    """The vector that sets one channel. The newest are kept, so that a command that comes again isn't built again."""
    return duty_vector(one_channel(channel, duty))
