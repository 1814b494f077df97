"""The generated messages. Run by itself: src at the front of PYTHONPATH would hide them."""
from __future__ import annotations

import pytest

from car_interface import msg, srv

# MD5s of the definitions that the cars' recordings were made with, computed by genmsg from the text that published
# those, not from ours: a message of another MD5 cannot read them.
RECORDED_MD5 = {
    "Pong": "0f02efd03d1d1f46e33aa3d1b2af71dc",
    "OneWheel": "98df788f1bd7aed98c1861548c43954c",
    "Wheel": "bb5360e179840ac339c94f4d4c9fc46c",
    "Distance": "45abb0b55c88a60236ca57d539768f04",
    "Error": "b842ab179c7e706bfe56fe0bfe9698cb",
}


@pytest.mark.parametrize("name", sorted(RECORDED_MD5))
def test_md5_is_that_of_old_recordings(name):
    assert getattr(msg, name)._md5sum == RECORDED_MD5[name]


@pytest.mark.parametrize(
    ("name", "fields"),
    [
        ("Control", "stamp control_time lateral longitudinal"),
        (
            "Lateral",
            "stamp control_time steering_tire_angle steering_tire_rotation_rate is_defined_steering_tire_rotation_rate",
        ),
        (
            "Longitudinal",
            "stamp control_time velocity acceleration jerk is_defined_acceleration is_defined_jerk",
        ),
        ("Float64Stamped", "stamp data"),
        (
            "SteeringState",
            (
                "stamp source cause reason duty turn_radius e_stop_age human_age teleop_age planner_age odometry_age "
                "speed limit limit_reason asked_radius max_speed cuts channel"
            ),
        ),
        ("TeleopState", "stamp human_in_loop cause reason joy_age steering_stick throttle_stick"),
    ],
)
def test_fields_are_in_the_promised_order(name, fields):
    assert getattr(msg, name).__slots__ == fields.split()


def test_reals_of_a_control_command_are_single_precision():
    for half in (msg.Lateral, msg.Longitudinal):
        assert {kind for kind in half._slot_types if kind.startswith("float")} == {"float32"}


def test_wheel_direction_names_the_values_on_the_wire():
    assert (
        msg.WheelDirection.FORWARD,
        msg.WheelDirection.BACKWARD,
        msg.WheelDirection.NONE,
        msg.WheelDirection.ERROR,
    ) == (0, 1, 2, 3)


def test_steering_state_sources_are_distinct_and_locked_is_the_default():
    state = msg.SteeringState
    assert [state.LOCKED, state.NO_HUMAN, state.NEUTRAL, state.TELEOP, state.PLANNER] == [0, 1, 2, 3, 4]
    assert state().source == state.LOCKED


@pytest.mark.parametrize("bad", [-1, 6, 2**31 - 1])
def test_sonar_sequence_carries_a_bad_sensor_number_to_the_node(bad):
    request = srv.SetSonarSequenceRequest(sequence=[bad])
    request._check_types()
    assert request.sequence == [bad]


@pytest.mark.parametrize("bad", [-1, 2**32, 2**63 - 1])
def test_sonar_wait_carries_a_bad_number_to_the_node(bad):
    request = srv.SetSonarWaitRequest(wait_ms=bad)
    request._check_types()
    assert request.wait_ms == bad
