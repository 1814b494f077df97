"""Accelerations to values: the rules around the map. Time is passed in."""

import math

import pytest

from car_interface.common.declared import read
from car_interface.common.errors import ConfigError
from car_interface.common.params import Params
from car_interface.throttle.converter import Converter, ConverterConfig
from car_interface.throttle.value_map import ValueMap

S = 1_000_000_000
NOW = 1000 * S
# At 0 m/s a value makes twice as much acceleration, at 10 m/s one less than that.
MAP = ValueMap([-10.0, 10.0], [0.0, 10.0], [[-20.0, -21.0], [20.0, 19.0]])


def convert(acceleration, velocity=0.0, age_s=0.1, value_map=MAP, **config):
    """The conversion at NOW with odometry of an age; velocity None = never heard."""
    converter = Converter(ConverterConfig(**config, value_map=value_map))
    if velocity is not None:
        converter.odometry.update(velocity, NOW - round(age_s * S))
    return converter.convert(acceleration, NOW)


@pytest.mark.parametrize("acceleration, velocity, value", [
    (2.0, 0.0, 1.0), (2.0, 10.0, 1.5), (2.0, 5.0, 1.25), (-4.0, 0.0, -2.0), (100.0, 0.0, 3.0), (-100.0, 0.0, -5.0),
    (8.0, 0.0, 3.0), (2.0, -3.0, 1.0)])
def test_command_is_looked_up_and_clamped(acceleration, velocity, value):
    assert convert(acceleration, velocity) == (pytest.approx(value), "converting", f"the value is {value:.3f}")


@pytest.mark.parametrize("acceleration, value", [(1.5, 1.5), (3.1, 3.0), (-5.1, -5.0)])
@pytest.mark.parametrize("velocity", [None, math.nan])
def test_command_passed_through_needs_neither_map_nor_odometry(acceleration, value, velocity):
    assert convert(acceleration, velocity, value_map=None) == (value, "converting", f"the value is {value:.3f}")


@pytest.mark.parametrize("value_map", [MAP, None])
def test_limits_are_those_of_the_config(value_map):
    assert convert(100.0, value_map=value_map, min_value=-1.0, max_value=0.5).value == 0.5
    assert convert(-100.0, value_map=value_map, min_value=-1.0, max_value=0.5).value == -1.0
    assert convert(1.0, value_map=value_map, min_value=2.0, max_value=2.0).value == 2.0
    with pytest.raises(ConfigError, match=r"min_value is 4\.0; accepted: at most max_value 3\.0"):
        ConverterConfig(min_value=4.0)


@pytest.mark.parametrize("values", [(3665.0, 6165.0), (-6.0, -5.0), (3.0, 4.0)])
def test_map_all_of_whose_values_are_beyond_the_limits_is_refused(values):
    """A map of duties: each of its values would be clamped to the same one, full throttle for braking too."""
    with pytest.raises(ConfigError, match=fr"value map has values from {values[0]} to {values[1]}; accepted: values "
                                          r"within min_value -5\.0 to max_value 3\.0"):
        ConverterConfig(value_map=ValueMap(values, [0.0, 10.0], [[-1.0, -1.0], [1.0, 1.0]]))
    reaching = ValueMap([-9.0, -6.0, 2.0], [0.0, 10.0], [[-2.0, -2.0], [-1.0, -1.0], [1.0, 1.0]])
    assert convert(1.0, value_map=reaching).value == 2.0


@pytest.mark.parametrize("acceleration", [math.nan, -math.inf])
@pytest.mark.parametrize("value_map", [MAP, None])
def test_command_that_is_not_finite_gets_no_value(acceleration, value_map):
    assert convert(acceleration, value_map=value_map) == (
        None, "command not finite", f"the commanded acceleration is {acceleration}")


@pytest.mark.parametrize("odometry, trouble", [
    ({"velocity": math.nan}, ("odometry not finite", "the velocity in the odometry is nan")),
    ({"velocity": -math.inf}, ("odometry not finite", "the velocity in the odometry is -inf")),
    ({"velocity": None}, ("odometry silent", "odometry was never heard")),
    ({"velocity": None, "odometry_timeout_s": 0.0}, ("odometry silent", "odometry was never heard")),
    ({"age_s": 0.51}, ("odometry silent", "odometry silent for 0.51 s")),
    ({"age_s": 0.5}, None),
    ({"age_s": 1e6, "odometry_timeout_s": 0.0}, None),
])
def test_without_finite_and_fresh_odometry_there_is_no_value(odometry, trouble):
    assert convert(1.0, **odometry) == ((None, *trouble) if trouble else (0.5, "converting", "the value is 0.500"))


def test_newest_odometry_counts_unless_messages_were_dropped():
    converter = Converter(ConverterConfig(value_map=MAP))
    converter.odometry.update(math.nan, NOW)
    converter.odometry.update(10.0, NOW)
    assert converter.convert(2.0, NOW).value == pytest.approx(1.5)
    assert converter.odometry.age_s(NOW + S) == 1.0
    converter.odometry.mark_stale()
    assert converter.convert(2.0, NOW).reason == "odometry was not heard since messages were dropped"


@pytest.fixture
def path(tmp_path):
    file = tmp_path / "map.csv"
    file.write_text("default,0.0,10.0\n-10.0,-20.0,-21.0\n10.0,20.0,19.0\n", encoding="utf-8")
    return str(file)


def configured(**parameters):
    return read(Params(parameters), ConverterConfig)


def test_the_map_is_read_where_it_is_used(path):
    assert configured(csv_path_value_map=path).value_map.velocities == (0.0, 10.0)
    with pytest.raises(ConfigError, match="csv_path_value_map"):
        configured()


@pytest.mark.parametrize("name", ["convert_value_cmd", "use_value_ff"])
def test_where_commands_pass_through_no_map_is_read(name):
    assert configured(csv_path_value_map="/nowhere", **{name: False}).value_map is None


def test_a_map_beyond_the_limits_is_refused_with_its_path(path):
    with pytest.raises(ConfigError, match=rf"{path}.*value map has values from -10\.0 to 10\.0"):
        configured(csv_path_value_map=path, min_value=11.0, max_value=12.0)
