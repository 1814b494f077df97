"""The ESC's table: value → request, request ↔ duty, and what is refused."""
from __future__ import annotations

import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from car_interface.common.errors import ConfigError
from car_interface.common.params import Params
from car_interface.throttle.calibration import DutyMap, ThrottleCalibration, read_calibration, trimmed

SHIPPED = ThrottleCalibration(channel=1, value_axis=[-5.0, 0.0, 3.0], duty_table=[3277, 4915, 6554], neutral=4915)
FALLING = replace(SHIPPED, duty_table=[6554, 4915, 3277])
FORWARD_ONLY = replace(SHIPPED, value_axis=[0.0, 3.0], duty_table=[4915, 6554])


@pytest.mark.parametrize("value, duty", [
    pytest.param(-5.0, 3277, id="full_brake"),
    pytest.param(0.0, 4915, id="neither"),
    pytest.param(1.5, 5735, id="half_throttle_rounded_up"),  # 5734.5
    pytest.param(3.0, 6554, id="full_throttle"),
    pytest.param(-9.0, 3277, id="below_the_axis_saturates"),
    pytest.param(9.0, 6554, id="above_the_axis_saturates"),
])
def test_value_makes_the_duty_of_the_table(value, duty):
    duties = DutyMap(SHIPPED)
    assert duties.duty(duties.request_of_value(value)) == duty


@pytest.mark.parametrize("calibration, request_, duty", [
    pytest.param(SHIPPED, 0.0, 4915, id="neutral"),
    pytest.param(SHIPPED, 1.0, 6554, id="full_forward"),
    pytest.param(SHIPPED, -1.0, 3277, id="full_brake"),
    pytest.param(SHIPPED, 2.0, 6554, id="beyond_1_saturates"),
    pytest.param(SHIPPED, 0.3, 5407, id="a_share_of_the_forward_side"),  # 4915 + 0.3 · 1639
    pytest.param(SHIPPED, -0.5, 4096, id="a_share_of_the_other_side"),
    pytest.param(FALLING, 1.0, 3277, id="falling_table_forward"),
    pytest.param(FALLING, -1.0, 6554, id="falling_table_brake"),
    pytest.param(FORWARD_ONLY, -1.0, 4915, id="nothing_behind_neutral"),
    pytest.param(FORWARD_ONLY, 1.0, 6554, id="forward_of_that_one"),
])
def test_request_makes_a_duty(calibration, request_, duty):
    assert DutyMap(calibration).duty(request_) == duty


@pytest.mark.parametrize("calibration", [SHIPPED, FALLING, FORWARD_ONLY])
@given(request_=st.floats(-1, 1))
def test_duty_stands_for_the_request_that_made_it(calibration, request_):
    duties = DutyMap(calibration)
    back = duties.request_of_duty(duties.duty(request_))
    expected = max(0.0, request_) if calibration is FORWARD_ONLY else request_
    assert back == pytest.approx(expected, abs=0.6 / 1638)


@pytest.mark.parametrize("calibration, duty, request_", [
    pytest.param(SHIPPED, 6963, 1.25, id="beyond_the_table_forward"),
    pytest.param(SHIPPED, 3000, -1.169, id="beyond_the_table_behind"),
    pytest.param(FORWARD_ONLY, 3276, -1.0, id="behind_neutral_where_the_table_has_nothing"),
])
def test_duty_beyond_the_table_stands_for_more_than_1(calibration, duty, request_):
    """Another program, or the board's own timeout value, may have put it there."""
    assert DutyMap(calibration).request_of_duty(duty) == pytest.approx(request_, abs=0.001)


@pytest.mark.parametrize("duty", [-1, 0, 65535], ids=["never_set", "off", "on"])
def test_what_is_no_pulse_stands_for_no_request(duty):
    assert DutyMap(SHIPPED).request_of_duty(duty) is None


def test_neutral_is_no_negative_zero():
    assert math.copysign(1, DutyMap(SHIPPED).request_of_duty(4915)) == 1


def test_value_that_is_no_number_makes_no_request():
    assert math.isnan(DutyMap(SHIPPED).request_of_value(math.nan))


@pytest.mark.parametrize("changes, message", [
    pytest.param({"neutral": 3276}, "servo/neutral is 3276; accepted: a duty within the range of servo/duty_table",
                 id="neutral_below_the_table"),
    pytest.param({"neutral": 6555}, "servo/neutral is 6555; accepted: a duty within", id="neutral_above_the_table"),
    pytest.param({"value_axis": [0.0]}, r"servo/value_axis is \[0.0\]; accepted: at least two", id="axis_too_short"),
    pytest.param({"value_axis": [0.0, 3.0, 2.0]}, r"servo/value_axis\[2\] is 2.0; accepted: more than",
                 id="axis_that_falls"),
    pytest.param({"duty_table": [3277, 6554]}, r"servo/duty_table is \[3277, 6554\]; accepted: 3 numbers",
                 id="table_too_short"),
    pytest.param({"duty_table": []}, r"servo/duty_table is \[\]; accepted: 3 numbers", id="table_empty"),
    pytest.param({"duty_table": [3277, 6554, 4915]},
                 r"servo/duty_table is \[3277, 6554, 4915\]; accepted: duties that only rise, or only fall",
                 id="table_that_turns_round"),
    pytest.param({"duty_table": [4915, 4915, 4915]}, "accepted: duties that only rise, or only fall", id="table_level"),
])
def test_calibration_with_a_fault_is_refused_naming_the_parameter(changes, message):
    with pytest.raises(ConfigError, match=message):
        replace(SHIPPED, **changes)


@pytest.mark.parametrize("neutral", [3277, 6554], ids=["lowest", "highest"])
def test_neutral_at_an_end_of_the_table_is_accepted(neutral):
    assert DutyMap(replace(SHIPPED, neutral=neutral)).duty(0.0) == neutral


def test_level_part_of_a_table_is_accepted():
    assert DutyMap(replace(SHIPPED, duty_table=[4915, 4915, 6554])).duty(-1.0) == 4915


def test_table_moves_along_with_its_neutral():
    moved = trimmed(SHIPPED, 4950)
    assert (moved.neutral, moved.duty_table) == (4950, [3312, 4950, 6589])


def test_table_ends_where_duties_do():
    assert trimmed(replace(SHIPPED, duty_table=[10, 4915, 65530]), 4895).duty_table == [0, 4895, 65510]
    assert trimmed(replace(SHIPPED, duty_table=[10, 4915, 65530]), 4935).duty_table == [30, 4935, 65535]


def test_parameters_are_those_below_servo():
    assert read_calibration(Params({"servo": {"channel": 1, "value_axis": [-5, 0, 3], "duty_table": [3277, 4915, 6554],
                                              "neutral": 4915}})) == SHIPPED


def test_channel_is_required():
    with pytest.raises(ConfigError, match="servo/channel is missing"):
        read_calibration(Params({}))
