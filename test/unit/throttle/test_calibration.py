"""The ESC's table: value → request, request ↔ duty, and what is refused."""

import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from car_interface.common.errors import ConfigError
from car_interface.throttle.calibration import ThrottleCalibration, trimmed

SHIPPED = ThrottleCalibration(channel=1, value_axis=[-5.0, 0.0, 3.0], duty_table=[3277, 4915, 6554], neutral=4915)
FALLING = replace(SHIPPED, duty_table=[6554, 4915, 3277])
FORWARD_ONLY = replace(SHIPPED, value_axis=[0.0, 3.0], duty_table=[4915, 6554])
BACKWARD_ONLY = replace(SHIPPED, value_axis=[-5.0, 0.0], duty_table=[3277, 4915])


@pytest.mark.parametrize("value, duty", [
    (-5.0, 3277), (0.0, 4915), (1.5, 5735), (3.0, 6554), (-9.0, 3277), (9.0, 6554)])  # half throttle is 5734.5
def test_value_makes_the_duty_of_the_table(value, duty):
    assert SHIPPED.duty(SHIPPED.request_of_value(value)) == duty
    assert math.isnan(SHIPPED.request_of_value(math.nan))


@pytest.mark.parametrize("calibration, request_, duty", [
    (SHIPPED, 0.0, 4915), (SHIPPED, -1.0, 3277), (SHIPPED, 2.0, 6554), (SHIPPED, -0.5, 4096),
    (SHIPPED, 0.3, 5407),  # 4915 + 0.3 · 1639
    (FALLING, 1.0, 3277), (FALLING, -1.0, 6554), (FORWARD_ONLY, -1.0, 4915), (FORWARD_ONLY, 1.0, 6554),
    (replace(SHIPPED, duty_table=[4915, 4915, 6554]), -1.0, 4915),
    (replace(FALLING, duty_table=[6554, 4915, 4915]), -1.0, 6554),
    (replace(SHIPPED, neutral=3277), 0.0, 3277), (replace(SHIPPED, neutral=6554), 0.0, 6554),
    (replace(SHIPPED, duty_table=[0, 100, 200], neutral=0), 0.0, 0),
])
def test_request_makes_a_duty(calibration, request_, duty):
    assert calibration.duty(request_) == duty


@pytest.mark.once
@pytest.mark.parametrize("calibration", [SHIPPED, FALLING, FORWARD_ONLY])
@given(request_=st.floats(-1, 1))
def test_duty_stands_for_the_request_that_made_it(calibration, request_):
    back = calibration.request_of_duty(calibration.duty(request_))
    expected = max(0.0, request_) if calibration is FORWARD_ONLY else request_
    assert back == pytest.approx(expected, abs=0.6 / 1638)


@pytest.mark.parametrize("calibration, duty, request_", [(SHIPPED, 6963, 1.25), (SHIPPED, 3000, -1.169),
                                                         (FORWARD_ONLY, 3276, -1.0), (SHIPPED, 1, -3.0),
                                                         (BACKWARD_ONLY, 6553, 1.0), (BACKWARD_ONLY, 4096, -0.5),
                                                         (replace(SHIPPED, neutral=6553), 6554, 1.0)])
def test_duty_beyond_the_table_stands_for_more_than_1(calibration, duty, request_):
    """Another program, or the board's own timeout value, may have put it there."""
    assert calibration.request_of_duty(duty) == pytest.approx(request_, abs=0.001)


@pytest.mark.parametrize("duty", [-1, 0, 65535])
def test_what_is_no_pulse_stands_for_no_request_and_neutral_is_no_negative_zero(duty):
    assert SHIPPED.request_of_duty(duty) is None
    assert math.copysign(1, SHIPPED.request_of_duty(4915)) == 1


@pytest.mark.parametrize("changes, message", [
    ({"neutral": 3276}, "servo/neutral is 3276; accepted: a duty within the range of servo/duty_table"),
    ({"neutral": 6555}, "servo/neutral is 6555; accepted: a duty within"),
    ({"value_axis": [0.0, 3.0, 2.0]}, r"servo/value_axis\[2\] is 2.0; accepted: more than"),
    ({"duty_table": [3277, 6554]}, r"servo/duty_table is \[3277, 6554\]; accepted: 3 numbers"),
    ({"duty_table": [3277, 6554, 4915]},
     r"servo/duty_table is \[3277, 6554, 4915\]; accepted: duties that only rise, or only fall"),
    ({"duty_table": [4915, 4915, 4915]}, "accepted: duties that only rise, or only fall"),
])
def test_calibration_with_a_fault_is_refused_naming_the_parameter(changes, message):
    with pytest.raises(ConfigError, match=message):
        replace(SHIPPED, **changes)


def test_table_moves_along_with_its_neutral_as_far_as_there_are_duties():
    moved = trimmed(SHIPPED, 4950)
    assert (moved.neutral, moved.duty_table) == (4950, [3312, 4950, 6589])
    assert trimmed(replace(SHIPPED, duty_table=[10, 4915, 65530]), 4895).duty_table == [0, 4895, 65510]
    assert trimmed(replace(SHIPPED, duty_table=[10, 4915, 65530]), 4935).duty_table == [30, 4935, 65535]
