"""What a launch file gives to a process itself, and which parameters are refused because of it."""
import pytest

from car_interface.common.errors import ConfigError
from car_interface.common.fixed_parameters import fixed_parameters
from car_interface.common.params import Params

BOARD = ["--device", "virtual", "--address", "0x40", "--virtual-chip", "auto"]
ROS = ["__name:=pca9685", "/servo/output:=servo/output", "__log:=/tmp/my log"]


def test_arguments_fix_the_parameters_of_their_node():
    assert fixed_parameters("pca9685", BOARD + ROS) == {"device": "virtual", "address": "0x40", "virtual_chip": None}
    assert fixed_parameters("car_sim", ["--port", "/tmp/a", "--virtual-chip", "/tmp/chip", *ROS]) == {
        "port": "/tmp/a", "virtual_chip": "/tmp/chip"}


def test_auto_is_no_device_and_a_node_that_is_started_by_hand_or_has_no_device_fixes_nothing():
    assert fixed_parameters("pca9685", ["--device", "auto"]) == {"device": "auto"}  # a real car may share the default
    assert fixed_parameters("pca9685", ["_device:=virtual", *ROS]) == {}
    assert fixed_parameters("calibration_drive", ["--output", "/tmp/table.yaml", "x"]) == {}


def test_in_a_process_of_several_each_has_its_own():
    arguments = [*BOARD, "--port", "/tmp/a", "--throttle", "true", "--planner", "False", *ROS]
    of = {node: fixed_parameters(node, arguments, "car_nodes") for node in ("pca9685", "teensy_sensor_hub", "turn_arb")}
    assert of == {"pca9685": {"device": "virtual", "address": "0x40", "virtual_chip": None},
                  "teensy_sensor_hub": {"port": "/tmp/a"}, "turn_arb": {}}
    assert fixed_parameters("car_nodes", arguments) == {"throttle": "true", "planner": "False"}


@pytest.mark.parametrize("arguments, message", [
    (["--devise", "virtual"],
     "argument --devise is unknown; accepted: --device VALUE, --address VALUE, --virtual-chip VALUE$"),
    (["--device", "my", "car"], "argument car is unknown"),
    (["--device"], "argument --device has no value; accepted: a value after it"),
])
def test_arguments_that_fix_nothing_are_refused(arguments, message):
    with pytest.raises(ConfigError, match=message):
        fixed_parameters("pca9685", arguments)


@pytest.mark.parametrize("reader, fixed, value", [
    ("text", "virtual", "virtual"),
    ("integer", "0x40", "0x40"),
    ("integer", "0x40", 64),
    ("flag", "True", True),
    ("flag", "false", False),
    ("text_or_integer", "1", 1),
    ("path", "/tmp/chip", "/tmp/chip"),
])
def test_parameter_that_is_as_the_launch_file_has_it_is_taken(reader, fixed, value):
    arguments = ("default",) if reader == "text_or_integer" else ()
    params = Params({"x": value}, fixed={"x": fixed})
    assert getattr(params, reader)("x", *arguments) == getattr(Params({"x": value}), reader)("x", *arguments)
    params.finish()


@pytest.mark.parametrize("reader, default, fixed, value, message", [
    ("text_or_integer", "/dev/i2c-1", "virtual", None,
     "^x is missing; accepted: virtual, by the launch file that started this process$"),
    ("text_or_integer", "/dev/i2c-1", "virtual", "/dev/i2c-1",
     "^x is '/dev/i2c-1'; accepted: virtual, by the launch file that started this process$"),
    ("integer", 64, "0x40", "0x41", "^x is '0x41'; accepted: 0x40, by"),
    ("flag", False, "true", None, "^x is missing; accepted: true, by"),
    ("flag", False, "true", False, "^x is False; accepted: true, by"),
    ("flag", False, "maybe", False, "^x is False; accepted: maybe, by"),
    ("path", None, None, "/tmp/other",
     "^x is '/tmp/other'; accepted: none, by the launch file that started this process; its argument x sets it$"),
])
def test_parameter_that_is_missing_or_differs_is_refused(reader, default, fixed, value, message):
    params = Params({} if value is None else {"x": value}, fixed={"x": fixed})
    with pytest.raises(ConfigError, match=message) as error:
        getattr(params, reader)("x", default)
    assert error.value.name == "x"


def test_value_that_cannot_be_is_refused_as_without_a_launch_file_and_none_around_a_node_stands_in_for_it():
    with pytest.raises(ConfigError, match=r"^address is 'foo'; accepted: an integer from 64 to 127$"):
        Params({"address": "foo"}, fixed={"address": "foo"}).integer("address", 64, 64, 127)
    with pytest.raises(ConfigError, match="x is missing"):
        Params({}, lambda name: "7", fixed={"x": "7"}).integer("x", search_parents=True)
    assert Params({}, fixed={"x": None}).path("x", None) is None
