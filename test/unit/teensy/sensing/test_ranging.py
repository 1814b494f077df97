"""Echoes in microseconds to ranges in metres: there and back, nothing, too near, too far, and the median."""
from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from car_interface.common.errors import ConfigError
from car_interface.sim.world import Box, World, WorldConfig
from car_interface.teensy.link.protocol import SONARS
from car_interface.teensy.sensing.ranging import (
    DISTRUSTED,
    INF,
    MAX_RANGE,
    MICROS_WRAP,
    STUCK,
    Ranging,
    RangingConfig,
    speed_of_sound_mps,
)

INFINITE = math.inf
SENSOR = 1
TICK = 60_000
NONE_US = 38_001  # of an HC-SR04 that hears nothing; as seen in test/data/firmware
# At 20 °C sound travels 343.42 m/s: 1 m and back takes 5823.8 µs, 2 cm 116.5 µs, 2 m 11647.5 µs.
ONE_METRE_US = 5824
HALF_A_US_M = 0.5e-6 * 343.42 / 2


def echo_us(distance_m, temperature_c):
    """What a sonar's pulse lasts, in whole microseconds."""
    return round(2 * distance_m / (331.3 + 0.606 * temperature_c) * 1e6)


def ranges(ranging, *echoes_us, sensor=SENSOR):
    """Of pulses that last so long: the firmware reports 13 µs less, and without an echo its sensor's 38 ms."""
    return [ranging.range(sensor, echo - 13, TICK) for echo in echoes_us]


# --- one echo ---


@pytest.mark.parametrize("echo, temperature_c, range_m", [
    pytest.param(10_000, 0.0, 1.6565, id="freezing"),
    pytest.param(10_000, 20.0, 1.7171, id="20_degrees"),
    pytest.param(10_000, 40.0, 1.7777, id="40_degrees"),
    pytest.param(10_000, -50.0, 1.505, id="the_coldest_that_is_taken"),
    pytest.param(10_000, 60.0, 1.8383, id="the_hottest_that_is_taken"),
    pytest.param(ONE_METRE_US, 20.0, 1.0, id="one_metre"),
    pytest.param(117, 20.0, 0.02009, id="just_far_enough"),
    pytest.param(11_647, 20.0, 1.99991, id="just_near_enough"),
])
def test_echo_is_half_its_time_at_the_speed_of_sound(echo, temperature_c, range_m):
    ranging = Ranging(RangingConfig(temperature_c=temperature_c))
    assert ranges(ranging, echo) == [pytest.approx(range_m, rel=1e-4)]


@given(st.floats(0.0205, 1.9995), st.floats(-50, 60))
def test_range_of_an_echo_and_back_is_the_same_to_half_a_microsecond(distance_m, temperature_c):
    ranging = Ranging(RangingConfig(temperature_c=temperature_c))
    range_m, = ranges(ranging, echo_us(distance_m, temperature_c))
    assert range_m == pytest.approx(distance_m, abs=0.5e-6 * 370 / 2 + 1e-12)
    assert echo_us(range_m, temperature_c) == echo_us(distance_m, temperature_c)


@given(st.floats(0.05, 1.9))
def test_range_is_what_the_virtual_car_s_sonar_has_before_it(distance_m):
    wall = Box(x_m=0.42 + distance_m + 0.5, y_m=0.0, length_m=1.0, width_m=4.0)
    world = World(WorldConfig(boxes=(wall,), posts=(), rays=1))
    assert ranges(Ranging(), world.echo_us((0.0, 0.0, 0.0), SENSOR)) == [pytest.approx(distance_m, abs=HALF_A_US_M)]


def test_speed_of_sound_is_near_that_of_an_ideal_gas():
    for temperature_c in range(-20, 41):
        assert speed_of_sound_mps(temperature_c) == pytest.approx(
            331.3 * math.sqrt(1 + temperature_c / 273.15), rel=0.0023)


# --- what is no distance ---


@pytest.mark.parametrize("no_echo, echo, range_m", [
    pytest.param(INF, NONE_US, INFINITE, id="no_echo_is_infinite"),
    pytest.param(INF, 11_648, INFINITE, id="an_echo_from_beyond_counts_as_none"),
    pytest.param(INF, 65_535, INFINITE, id="the_longest_echo_counts_as_none"),
    pytest.param(INF, 116, -INFINITE, id="an_echo_from_too_near_is_minus_infinite"),
    pytest.param(INF, 14, -INFINITE, id="the_shortest_echo_is_too_near"),
    pytest.param(MAX_RANGE, NONE_US, 2.0, id="or_no_echo_is_the_maximum"),
    pytest.param(MAX_RANGE, 65_535, 2.0, id="and_so_is_one_from_beyond"),
    pytest.param(MAX_RANGE, 14, 0.02, id="and_one_from_too_near_is_the_minimum"),
])
def test_echo_without_a_distance_is_said_as_asked_for(no_echo, echo, range_m):
    assert ranges(Ranging(RangingConfig(no_echo=no_echo)), echo) == [range_m]


@given(st.lists(st.tuples(st.sampled_from(range(len(SONARS))), st.integers(1, 2 ** 16 - 1)), max_size=20),
       st.sampled_from((INF, MAX_RANGE)), st.booleans(), st.floats(-50, 60))
def test_range_of_any_echoes_is_within_the_limits_or_infinite_and_never_nan(echoes, no_echo, median, temperature_c):
    ranging = Ranging(RangingConfig(temperature_c=temperature_c, no_echo=no_echo, median=median))
    for sensor, echo in echoes:
        range_m = ranging.range(sensor, echo, TICK)
        assert 0.02 <= range_m <= 2.0 or no_echo == INF and math.isinf(range_m)


def test_minimum_of_zero_takes_every_echo():
    assert Ranging(RangingConfig(min_range_m=0.0)).range(SENSOR, 1, TICK) == pytest.approx(14 * 0.00017171)


# --- what is no echo ---


def test_echo_of_0_is_a_stuck_pin_and_says_nothing_about_the_room():
    ranging = Ranging()
    assert ranging.range(SENSOR, 0, TICK) is None
    assert ranging.counts == {STUCK: 1}


def test_echo_that_is_not_trusted_makes_no_range_and_does_not_count_for_the_median():
    ranging = Ranging(RangingConfig(median=True))
    ranges(ranging, *[ONE_METRE_US] * 3)
    assert [ranging.range(SENSOR, 4181, TICK, is_trusted=False) for _ in range(5)] == [None] * 5
    assert ranging.counts == {DISTRUSTED: 5}
    assert ranges(ranging, ONE_METRE_US) == [pytest.approx(1.0, rel=1e-4)]


@pytest.mark.parametrize("tick, is_near", [
    pytest.param(303, False, id="first_report_after_power_up"),
    pytest.param(4_294_900, False, id="long_enough_before"),
    pytest.param(4_294_930, True, id="just_before"),
    pytest.param(4_294_968, True, id="at_the_wrap"),
    pytest.param(4_295_200, True, id="just_after"),
    pytest.param(4_295_300, False, id="long_enough_after"),
    pytest.param(2 * 4_294_967 + 1, True, id="the_second_wrap"),
    pytest.param(2 ** 32 - 8, True, id="with_the_wrap_of_the_tick"),
    pytest.param(0, True, id="and_right_after_it"),
])
def test_around_a_wrap_of_micros_no_echo_is_believed(tick, is_near):
    """Every 2**32 µs of uptime; 2**32 ms are 1000 of these."""
    ranging = Ranging()
    assert (ranging.range(SENSOR, 3357, tick) is None) == is_near
    assert ranging.counts == ({MICROS_WRAP: 1} if is_near else {})


def test_sensor_that_holds_its_pulse_for_200_ms_is_known_by_its_time_out():
    """Of 200,000 µs less 13 the report has 16 bits: 3,379, which would be a wall at 0.58 m."""
    timeouts_ms = tuple(200.0 if sensor == SENSOR else 38.0 for sensor in range(len(SONARS)))
    ranging = Ranging(RangingConfig(timeouts_ms=timeouts_ms))
    assert ranging.range(SENSOR, 3379, TICK) == INFINITE
    assert [ranging.range(SENSOR, 3379 + off, TICK) for off in (-299, 299)] == [INFINITE] * 2
    assert [ranging.range(SENSOR, 3379 + off, TICK) for off in (-400, 400)] == [
        pytest.approx(distance, abs=1e-3) for distance in (0.514, 0.651)]
    assert ranging.range(SENSOR + 1, 3379, TICK) == pytest.approx(0.5825, abs=1e-3)


def test_time_out_is_none_also_where_the_maximum_lies_beyond_it():
    ranging = Ranging(RangingConfig(max_range_m=10.0))
    assert ranges(ranging, 23_294, NONE_US) == [pytest.approx(4.0, abs=1e-3), INFINITE]


# --- the temperature ---


def test_temperature_set_while_it_runs_counts_from_then_on():
    ranging = Ranging()
    assert ranging.temperature_c == 20.0
    ranging.temperature_c = 0.0
    assert ranging.temperature_c == 0.0
    assert ranges(ranging, 10_000) == [pytest.approx(1.6565)]


@pytest.mark.parametrize("temperature_c", [math.nan, math.inf, -math.inf, -50.1, 60.1, 293.15])
def test_temperature_that_no_air_has_is_refused_and_the_one_before_stays(temperature_c):
    ranging = Ranging(RangingConfig(temperature_c=5.0))
    with pytest.raises(ConfigError, match=r"temperature is .*; accepted: -50 to 60 °C"):
        ranging.temperature_c = temperature_c
    assert ranging.temperature_c == 5.0
    assert not math.isnan(ranges(ranging, 10_000)[0])


# --- the median ---


def test_median_hides_one_or_two_wrong_echoes_in_a_row():
    ranging = Ranging(RangingConfig(median=True))
    ranges(ranging, *[ONE_METRE_US] * 5)
    steady = pytest.approx(1.0, rel=1e-4)
    wrong = (200, ONE_METRE_US, NONE_US, NONE_US, *[ONE_METRE_US] * 3, 300, 400, ONE_METRE_US)
    assert ranges(ranging, *wrong) == [steady] * 10


def test_median_shows_what_is_new_two_reports_later():
    ranging = Ranging(RangingConfig(median=True))
    ranges(ranging, *[ONE_METRE_US] * 5)
    far, near = pytest.approx(1.0, rel=1e-4), pytest.approx(0.5, rel=1e-4)
    assert ranges(ranging, *[ONE_METRE_US // 2] * 4) == [far, far, near, near]


def test_median_counts_no_echo_as_farther_than_all():
    ranging = Ranging(RangingConfig(median=True))
    ranges(ranging, *[ONE_METRE_US] * 5)
    assert ranges(ranging, NONE_US, NONE_US, NONE_US)[1:] == [pytest.approx(1.0, rel=1e-4), INFINITE]
    assert ranges(ranging, ONE_METRE_US, ONE_METRE_US, ONE_METRE_US)[1:] == [INFINITE, pytest.approx(1.0, rel=1e-4)]


def test_median_of_a_few_is_the_nearer_middle_one():
    ranging = Ranging(RangingConfig(median=True))
    assert ranges(ranging, NONE_US, 6000, 2000, 4000) == [
        INFINITE, *(pytest.approx(echo * 343.42 / 2e6) for echo in (6000, 6000, 4000))]


def test_median_of_each_sonar_is_its_own():
    ranging = Ranging(RangingConfig(median=True))
    for sensor in range(len(SONARS)):
        ranges(ranging, *[1000 * (sensor + 1)] * 5, sensor=sensor)
    for sensor in range(len(SONARS)):
        assert ranges(ranging, NONE_US, sensor=sensor) == [pytest.approx(1000 * (sensor + 1) * 343.42 / 2e6)]


def test_median_goes_by_the_newest_temperature():
    ranging = Ranging(RangingConfig(median=True))
    ranges(ranging, *[10_000] * 5)
    ranging.temperature_c = 0.0
    assert ranges(ranging, NONE_US) == [pytest.approx(1.6565)]


# --- what the parameters may be ---


@pytest.mark.parametrize("wrong, message", [
    pytest.param({"temperature_c": math.nan}, "temperature is nan; accepted: -50 to 60 °C", id="temperature_nan"),
    pytest.param({"temperature_c": 61.0}, "temperature is 61.0; accepted: -50 to 60 °C", id="too_hot"),
    pytest.param({"min_range_m": -0.01}, "min_range is -0.01; accepted: 0 m or more", id="negative_minimum"),
    pytest.param({"min_range_m": math.nan}, "min_range is nan", id="minimum_nan"),
    pytest.param({"max_range_m": 0.02}, "max_range is 0.02; accepted: more than min_range, 0.02 m",
                 id="maximum_no_more_than_minimum"),
    pytest.param({"max_range_m": math.inf}, "max_range is inf", id="infinite_maximum"),
    pytest.param({"max_range_m": math.nan}, "max_range is nan", id="maximum_nan"),
    pytest.param({"timeouts_ms": (38.0, 0.0, 38.0, 38.0, 38.0, 38.0)},
                 "no_echo_timeouts/front_middle is 0.0; accepted: more than 0, up to 1000 ms", id="no_time_out"),
    pytest.param({"timeouts_ms": (math.nan,) * 6}, "no_echo_timeouts/front_right is nan", id="time_out_nan"),
    pytest.param({"no_echo": "nan"}, "no_echo is 'nan'; accepted: inf or max_range", id="unknown_way_to_say_no_echo"),
])
def test_impossible_parameter_is_named(wrong, message):
    with pytest.raises(ConfigError, match=message):
        RangingConfig(**wrong)
