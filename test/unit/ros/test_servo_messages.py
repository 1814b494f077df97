"""Messages about servo channels."""
from __future__ import annotations

import io

import pytest

pytest.importorskip("std_msgs")

from car_interface.ros.servo_messages import duty_vector, one_channel_duty


def serialised(message):
    buffer = io.BytesIO()
    message.serialize(buffer)
    return buffer.getvalue()


def test_command_of_one_channel_leaves_the_others_unchanged_and_is_not_built_again_when_it_comes_again():
    assert one_channel_duty(2, 5100).data == [-1, -1, 5100] + [-1] * 13
    assert one_channel_duty(0, 5101).data == [5101] + [-1] * 15
    assert one_channel_duty(0, 4000) is one_channel_duty(0, 4000)


def test_layout_says_that_the_vector_has_sixteen_channels():
    message = one_channel_duty(0, 5100)
    assert [(dim.label, dim.size, dim.stride) for dim in message.layout.dim] == [("pwm_channel", 16, 1)]
    assert serialised(message) == serialised(duty_vector([5100] + [-1] * 15))
