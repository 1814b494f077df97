"""The generated messages. Run by itself: src at the front of PYTHONPATH would hide them."""
from car_interface import msg

# MD5s of the definitions that the cars' recordings were made with, computed by genmsg from the text that published
# those, not from ours: a message of another MD5 cannot read them.
RECORDED_MD5 = {"Pong": "0f02efd03d1d1f46e33aa3d1b2af71dc", "OneWheel": "98df788f1bd7aed98c1861548c43954c",
                "Wheel": "bb5360e179840ac339c94f4d4c9fc46c", "Distance": "45abb0b55c88a60236ca57d539768f04",
                "Error": "b842ab179c7e706bfe56fe0bfe9698cb"}
# What others build against to command this car: pinned as they are now.
ORIGINAL_MD5 = {"Control": "1bb3cb4d25a786e534f73e74ca23645c", "Lateral": "59e415aef28e1bcb8f7d1b80727dd2a9",
                "Longitudinal": "d9552e85245f62e814bff51f7d788995",
                "Float64Stamped": "176463c696aec75591f61a77cde70a71"}


def test_md5s_are_those_of_old_recordings_and_of_the_original_interfaces():
    expected = {**RECORDED_MD5, **ORIGINAL_MD5}
    assert {name: getattr(msg, name)._md5sum for name in expected} == expected


def test_constants_are_the_values_on_the_wire_and_locked_is_the_default():
    direction, state = msg.WheelDirection, msg.SteeringState
    assert [direction.FORWARD, direction.BACKWARD, direction.NONE, direction.ERROR] == [0, 1, 2, 3]
    assert [state.LOCKED, state.NO_HUMAN, state.NEUTRAL, state.TELEOP, state.PLANNER] == [0, 1, 2, 3, 4]
    assert state().source == state.LOCKED
