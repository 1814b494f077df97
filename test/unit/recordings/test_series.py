"""The signals of a recording: what the board output at a time."""
from __future__ import annotations

import numpy as np
import pytest

from car_interface.recordings.series import Imu, Odom, Output, Pulses, Value

NEVER = [-1] * 14
OUTPUT = Output(np.array([1.0, 2.0, 2.5]),
                np.array([[5104, -1, *NEVER], [3808, -1, *NEVER], [3808, 4912, *NEVER]]))


@pytest.mark.parametrize("channel, t_s, duty", [
    pytest.param(0, 0.999, -1, id="before_the_first_row"),
    pytest.param(0, 1.0, 5104, id="at_the_time_of_a_row"),
    pytest.param(0, 1.999, 5104, id="until_the_next_row"),
    pytest.param(0, 2.0, 3808, id="at_the_next_row"),
    pytest.param(0, 1e9, 3808, id="after_the_last_row"),
    pytest.param(1, 2.49, -1, id="channel_not_set_yet"),
    pytest.param(1, 2.5, 4912, id="channel_set_later"),
    pytest.param(15, 9.0, -1, id="channel_never_set"),
])
def test_duty_of_a_channel_is_that_of_the_newest_row(channel, t_s, duty):
    assert OUTPUT.at(channel, np.array([t_s])).tolist() == [duty]


def test_duties_have_the_shape_of_the_times_and_are_integers():
    duties = OUTPUT.at(0, np.array([2.0, 0.0, 1.0]))
    assert duties.tolist() == [3808, -1, 5104] and duties.dtype.kind == "i"
    assert OUTPUT.at(0, np.array([])).shape == (0,)


def test_of_rows_with_the_same_time_the_last_one_counts():
    output = Output(np.array([1.0, 1.0]), np.array([[100] * 16, [200] * 16]))
    assert output.at(3, np.array([1.0])).tolist() == [200]


@pytest.mark.parametrize("signal, fields", [
    (Odom, ("t_s", "x_m", "y_m", "yaw_rad", "speed_mps", "yaw_rate_radps")),
    (Output, ("t_s", "duties")),
    (Imu, ("t_s", "yaw_rate_radps", "acceleration_mps2", "pitch_rad")),
    (Value, ("t_s", "value")),
    (Pulses, ("t_s", "count")),
])
def test_every_signal_begins_with_its_times(signal, fields):
    assert signal._fields == fields
