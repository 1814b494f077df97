"""Echoes in microseconds to ranges in metres: there and back, nothing, too near, too far, and the median."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from car_interface.common.declared import read
from car_interface.common.errors import ConfigError
from car_interface.common.params import Params
from car_interface.common.vehicle_geometry import SONARS
from car_interface.teensy.sensing import ranging as reasons
from car_interface.teensy.sensing.ranging import INF, MAX_RANGE, Ranging, RangingConfig

INFINITE = math.inf
SENSOR = 1
TICK = 60_000
NONE_US = 38_001  # of an HC-SR04 that hears nothing; as seen in test/data/firmware
# At 20 °C sound travels 343.42 m/s: 1 m and back takes 5823.8 µs, 2 cm 116.5 µs, 2 m 11647.5 µs.
ONE_METRE_US = 5824


def ranges(ranging, *echoes_us, sensor=SENSOR):
    """Of pulses that last so long: the firmware reports 13 µs less, and without an echo its sensor's 38 ms."""
    return [ranging.range(sensor, echo - 13, TICK) for echo in echoes_us]


@pytest.mark.parametrize("echo, temperature_c, range_m", [
    (10_000, -50.0, 1.505), (10_000, 0.0, 1.6565), (10_000, 60.0, 1.8383),
    (117, 20.0, 0.02009), (ONE_METRE_US, 20.0, 1.0), (11_647, 20.0, 1.99991),
])
def test_echo_is_half_its_time_at_the_speed_of_sound(echo, temperature_c, range_m):
    ranging = Ranging(RangingConfig(temperature_c=temperature_c))
    assert ranges(ranging, echo) == [pytest.approx(range_m, rel=1e-4)]


@pytest.mark.parametrize("config, echo, range_m", [
    ({}, NONE_US, INFINITE), ({}, 11_648, INFINITE), ({}, 116, -INFINITE), ({}, 14, -INFINITE),
    ({"no_echo": MAX_RANGE}, NONE_US, 2.0), ({"no_echo": MAX_RANGE}, 14, 0.02),
    ({"min_range_m": 0.0}, 14, 14 * 0.00017171),
    ({"max_range_m": 10.0}, 23_294, 4.0), ({"max_range_m": 10.0}, NONE_US, INFINITE),  # its time-out is nearer
])
def test_no_echo_or_one_from_beyond_or_from_too_near_is_said_as_asked_for(config, echo, range_m):
    assert ranges(Ranging(RangingConfig(**config)), echo) == [pytest.approx(range_m, rel=2.5e-4)]


@pytest.mark.once
@given(st.lists(st.tuples(st.sampled_from(range(len(SONARS))), st.integers(1, 2 ** 16 - 1)), max_size=20),
       st.sampled_from((INF, MAX_RANGE)), st.booleans(), st.floats(-50, 60))
def test_range_of_any_echoes_is_within_the_limits_or_infinite_and_never_nan(echoes, no_echo, median, temperature_c):
    ranging = Ranging(RangingConfig(temperature_c=temperature_c, no_echo=no_echo, median=median))
    for sensor, echo in echoes:
        range_m = ranging.range(sensor, echo, TICK)
        if echo > 64_987:
            assert range_m is None or math.isinf(range_m) or range_m == 2.0
            continue
        assert 0.02 <= range_m <= 2.0 or no_echo == INF and math.isinf(range_m)


def test_echo_of_a_stuck_pin_of_unknown_length_or_that_is_not_trusted_makes_no_range_nor_counts_for_the_median():
    ranging = Ranging(RangingConfig(median=True))
    ranges(ranging, *[ONE_METRE_US] * 3)
    assert [ranging.range(SENSOR, 4181, TICK, is_trusted=False) for _ in range(5)] == [None] * 5
    assert [ranging.range(SENSOR, 0, TICK) for _ in range(5)] == [None] * 5
    assert [ranging.range(SENSOR, None, TICK) for _ in range(5)] == [None] * 5
    assert ranging.counts == {reasons.DISTRUSTED: 5, reasons.STUCK: 5, reasons.UNKNOWN: 5}
    assert ranges(ranging, ONE_METRE_US) == [pytest.approx(1.0, rel=1e-4)]


@pytest.mark.parametrize("tick, is_near", [
    (303, False), (4_294_917, False), (4_294_918, True), (4_295_167, True), (4_295_300, False),
    (2 * 4_294_967 + 1, True), (2 ** 32 - 8, True), (0, True), (2 ** 29 + 250, True), (2 ** 29 + 251, False),
])
def test_around_a_wrap_of_micros_no_echo_is_believed(tick, is_near):
    """Every 2**32 µs of uptime; 2**32 ms are 1000 of these, 2**29 ms exactly 125."""
    ranging = Ranging()
    assert (ranging.range(SENSOR, 3357, tick) is None) == is_near
    assert ranging.counts == ({reasons.MICROS_WRAP: 1} if is_near else {})


def test_sensor_that_holds_its_pulse_for_200_ms_is_known_by_its_time_out():
    timeouts_ms = tuple(200.0 if sensor == SENSOR else 38.0 for sensor in range(len(SONARS)))
    ranging = Ranging(RangingConfig(timeouts_ms=timeouts_ms))
    assert ranges(ranging, 200_000, 190_000, 210_000, 3392) == [INFINITE] * 3 + [pytest.approx(0.5825, abs=1e-3)]
    assert ranges(ranging, 131_000, 1_500_000) == [None] * 2
    assert ranging.counts == {reasons.HELD: 2} and ranging.clones == {}


@pytest.mark.parametrize("other_sensor_us", [NONE_US, 65_000])
def test_three_long_pulses_of_one_length_are_a_clone_s_that_is_found_by_itself(other_sensor_us):
    ranging = Ranging()
    assert ranges(ranging, 200_000, ONE_METRE_US, 200_100, 200_000, 199_900, 2000, 200_000) == [
        None, pytest.approx(1.0, rel=1e-3), None, None, INFINITE, pytest.approx(0.343, abs=1e-3), INFINITE]
    assert ranging.counts == {reasons.HELD: 3} and ranging.clones == {SENSOR: pytest.approx(200, abs=0.2)}
    assert ranges(ranging, 200_000, sensor=SENSOR + 1) == [None], "the others are what they were"
    assert ranges(ranging, other_sensor_us, 200_000) == [INFINITE, None] and ranging.clones == {}, "it was replaced"


@pytest.mark.parametrize("timeout_us", [110_000, 1_000_000])
def test_clone_is_found_whose_pulses_last_for_110_ms_to_a_second(timeout_us):
    ranging = Ranging()
    assert ranges(ranging, *[timeout_us] * 3) == [None, None, INFINITE] and not ranging.blinks


@pytest.mark.parametrize("echoes_us, blinks", [
    ((150_000, 200_000, 150_000, 200_000), set()), ((1_000_001,) * 5, {SENSOR}), ((103_500,) * 5, set())],
    ids=["lengths_that_differ", "longer_than_a_second", "after_lost_reports"])
def test_long_pulse_of_a_loose_wire_or_after_a_lost_report_is_no_clone_s_and_makes_no_range(echoes_us, blinks):
    ranging = Ranging()
    assert ranges(ranging, *echoes_us) == [None] * len(echoes_us)
    assert ranging.clones == {} and ranging.blinks == blinks


def test_median_shows_what_is_new_two_reports_later_and_counts_no_echo_as_farther_than_all():
    ranging = Ranging(RangingConfig(median=True))
    ranges(ranging, *[ONE_METRE_US] * 5)
    far, near = pytest.approx(1.0, rel=1e-4), pytest.approx(0.5, rel=1e-4)
    assert ranges(ranging, *[ONE_METRE_US // 2] * 5) == [far, far, near, near, near]
    assert ranges(ranging, *[NONE_US] * 5) == [near, near, INFINITE, INFINITE, INFINITE]
    assert ranges(ranging, *[ONE_METRE_US] * 3) == [INFINITE, INFINITE, far]


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


@pytest.mark.parametrize("wrong", [
    {"temperature": math.nan}, {"temperature": -50.1}, {"temperature": 60.1}, {"min_range": -0.01},
    {"min_range": math.nan}, {"max_range": math.inf}, {"max_range": math.nan}, {"no_echo_timeouts/front_middle": 0.0},
    {"no_echo_timeouts/front_right": 1000.1}, {"no_echo_timeouts/front_right": math.nan}, {"no_echo": "nan"},
])
def test_impossible_parameter_is_named(wrong):
    (name, value), = wrong.items()
    with pytest.raises(ConfigError, match=f"^{name} is {value!r}; accepted: "):
        read(Params(wrong), RangingConfig)
    read(Params({"temperature": 60.0, "min_range": 0.0, "no_echo_timeouts/front_right": 1000.0}), RangingConfig)


def test_largest_range_is_above_the_smallest():
    with pytest.raises(ConfigError, match=r"max_range is 0\.02; accepted: more than min_range, 0.02 m"):
        RangingConfig(max_range_m=0.02)
