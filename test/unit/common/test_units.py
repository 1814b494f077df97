"""Stamps and orientations of rospy's messages and of rosbags', which name their fields differently; duties."""
import math
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from car_interface.common.units import NS_PER_MS, NS_PER_S, one_channel, stamp_ns, yaw_rad


def test_stamp_of_rospy_and_of_rosbags_is_exact_nanoseconds():
    for stamp in (SimpleNamespace(secs=1_700_000_000, nsecs=123_456_789),
                  SimpleNamespace(sec=1_700_000_000, nanosec=123_456_789)):
        assert stamp_ns(stamp) == 1_700_000_000_123_456_789
    assert NS_PER_S == 1000 * NS_PER_MS


@pytest.mark.once
@given(st.floats(-math.pi + 1e-6, math.pi - 1e-6), st.floats(-0.5, 0.5), st.floats(-0.5, 0.5))
def test_yaw_is_that_of_the_quaternion_whatever_pitch_and_roll(yaw, pitch, roll):
    cy, sy, cp, sp, cr, sr = (f(angle / 2) for angle in (yaw, pitch, roll) for f in (math.cos, math.sin))
    quaternion = SimpleNamespace(x=sr * cp * cy - cr * sp * sy, y=cr * sp * cy + sr * cp * sy,
                                 z=cr * cp * sy - sr * sp * cy, w=cr * cp * cy + sr * sp * sy)
    assert yaw_rad(quaternion) == pytest.approx(yaw, abs=1e-9)


def test_one_channel_sets_one_channel_of_sixteen_and_leaves_the_others_alone():
    assert one_channel(0, 5100) == [5100] + [-1] * 15
    assert one_channel(15, 0) == [-1] * 15 + [0]
