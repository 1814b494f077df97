"""The generated messages. Run by itself: src at the front of PYTHONPATH would hide them."""
from __future__ import annotations

from car_interface import msg

# MD5s of the definitions that the cars' recordings were made with, computed by genmsg from the text that published
# those, not from ours: a message of another MD5 cannot read them.
RECORDED_MD5 = {"Pong": "0f02efd03d1d1f46e33aa3d1b2af71dc", "OneWheel": "98df788f1bd7aed98c1861548c43954c",
                "Wheel": "bb5360e179840ac339c94f4d4c9fc46c", "Distance": "45abb0b55c88a60236ca57d539768f04",
                "Error": "b842ab179c7e706bfe56fe0bfe9698cb"}
FIELDS = {
    "Control": "stamp control_time lateral longitudinal",
    "Lateral": "stamp control_time steering_tire_angle steering_tire_rotation_rate "
               "is_defined_steering_tire_rotation_rate",
    "Longitudinal": "stamp control_time velocity acceleration jerk is_defined_acceleration is_defined_jerk",
    "Float64Stamped": "stamp data",
    "SteeringState": "stamp source cause reason duty turn_radius e_stop_age human_age teleop_age planner_age "
                     "odometry_age speed limit limit_reason asked_radius max_speed cuts channel",
    "TeleopState": "stamp human_in_loop cause reason joy_age steering_stick throttle_stick"}


def test_md5s_are_those_of_old_recordings():
    assert {name: getattr(msg, name)._md5sum for name in RECORDED_MD5} == RECORDED_MD5


def test_fields_are_in_the_promised_order_and_a_control_command_s_reals_of_single_precision():
    assert {name: " ".join(getattr(msg, name).__slots__) for name in FIELDS} == FIELDS
    for half in (msg.Lateral, msg.Longitudinal):
        assert {kind for kind in half._slot_types if kind.startswith("float")} == {"float32"}


def test_constants_are_the_values_on_the_wire_and_locked_is_the_default():
    direction, state = msg.WheelDirection, msg.SteeringState
    assert [direction.FORWARD, direction.BACKWARD, direction.NONE, direction.ERROR] == [0, 1, 2, 3]
    assert [state.LOCKED, state.NO_HUMAN, state.NEUTRAL, state.TELEOP, state.PLANNER] == [0, 1, 2, 3, 4]
    assert state().source == state.LOCKED
