"""The vector of duties."""
from __future__ import annotations

from car_interface.common.servo_channels import one_channel


def test_one_channel_sets_one_channel_of_sixteen_and_leaves_the_others_alone():
    assert one_channel(0, 5100) == [5100] + [-1] * 15
    assert one_channel(15, 0) == [-1] * 15 + [0]
