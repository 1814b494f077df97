"""Builds the messages about servo channels."""
from __future__ import annotations

from std_msgs.msg import Int32MultiArray, MultiArrayDimension, MultiArrayLayout

from car_interface.common.servo_channels import CHANNELS

_LAYOUT = MultiArrayLayout(dim=[MultiArrayDimension(label="pwm_channel", size=CHANNELS, stride=1)], data_offset=0)


def duty_vector(duties) -> Int32MultiArray:
    """A vector of 16 duties, with the layout that the original servo commands carry."""
    return Int32MultiArray(layout=_LAYOUT, data=duties)
