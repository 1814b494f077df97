"""Messages about servo channels."""
import io

import pytest

pytest.importorskip("rospy")

from car_interface.ros.topics import duty_vector, one_channel_duty


def test_command_of_one_channel_leaves_the_others_unchanged_and_is_not_built_again_when_it_comes_again():
    assert one_channel_duty(2, 5100).data == [-1, -1, 5100] + [-1] * 13
    assert one_channel_duty(0, 5101).data == [5101] + [-1] * 15
    assert one_channel_duty(0, 4000) is one_channel_duty(0, 4000)
    found = one_channel_duty(0, 5100)
    assert [(dim.label, dim.size, dim.stride) for dim in found.layout.dim] == [("pwm_channel", 16, 1)]
    buffers = [io.BytesIO() for _ in range(2)]
    for message, buffer in zip((found, duty_vector([5100] + [-1] * 15)), buffers):
        message.serialize(buffer)
    assert buffers[0].getvalue() == buffers[1].getvalue()
