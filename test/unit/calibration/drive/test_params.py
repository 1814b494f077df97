"""The drive's settings from parameters, and the car's from those of its nodes."""
from __future__ import annotations

import pytest

from car_interface.calibration.drive.config import DriveConfig
from car_interface.calibration.drive.params import read_base, read_config, read_obstacles
from car_interface.common.errors import CarInterfaceError, ConfigError
from car_interface.common.package_files import package_file
from car_interface.common.params import Params
from car_interface.steering.params import load_steering, load_yaml
from car_interface.throttle.obstacle_stop import NAMES

THROTTLE = {**load_yaml(str(package_file("config/throttle.yaml"))),
            "sonar_hub": load_yaml(str(package_file("config/sonars.yaml")))}


def test_defaults_are_those_of_the_drive():
    assert read_config(Params({})).drive == DriveConfig()
    assert read_config(Params({})).sonars is True


def test_given_parameters_are_taken():
    made = read_config(Params({"radius": 4, "speed": 1.0, "tight_speed": 0.8, "max_time": 60, "braking": 0.5,
                               "sonars": False}))
    assert made.drive == DriveConfig(4.0, 1.0, 0.8, 60.0, 0.5)
    assert made.sonars is False


@pytest.mark.parametrize(("given", "begin"), [
    ({"radius": 1.0}, "radius is 1.0; accepted: a number from 2.5 to 100"),
    ({"max_time": 5}, "max_time is 5.0; accepted: a number from 30 to 3600"),
    ({"speed": "fast"}, "speed is 'fast'; accepted: a number"),
    ({"raduis": 3.0}, "unknown parameter raduis is 3.0; accepted: only "),
])
def test_bad_parameter_is_named(given, begin):
    with pytest.raises(ConfigError) as raised:
        read_config(Params(given))
    assert str(raised.value).startswith(begin)


def test_sonars_are_those_of_throttle_arb_though_it_does_not_stop_for_them():
    assert THROTTLE["obstacle_stop"] is False
    made = read_obstacles({**THROTTLE, "obstacle": {"sonars": {"rear_left": "absent"}, "front": 0.5}})
    assert set(made.mounts) == set(NAMES) - {"rear_left"}
    assert made.outline.front_m == 0.5


def test_throttle_arb_that_does_not_know_the_sonars_is_refused_in_words():
    with pytest.raises(CarInterfaceError, match=r"of throttle_arb's parameters sonar_hub/sonars/front_right is "
                                                r"missing.*launch the car by its launch files, or .* _sonars:=false"):
        read_obstacles({"servo": THROTTLE["servo"]})


def test_calibration_is_the_one_that_turn_arb_runs_with():
    path = str(package_file("config/turn_arb.yaml"))
    assert read_base(load_yaml(path)) == load_steering(path)
    with pytest.raises(CarInterfaceError, match=r"turn_arb's calibration isn't known: its parameter servo_left is "
                                                r"missing.*Is the car launched, and in this namespace"):
        read_base({})
