"""Settings of the calibration drive: by its command line, and by the parameters of turn_arb and throttle_arb."""
from __future__ import annotations

import argparse
from dataclasses import dataclass, field
from typing import Any, Sequence

from car_interface.common.declared import read
from car_interface.common.errors import CarInterfaceError, ConfigError
from car_interface.common.params import Params
from car_interface.throttle.obstacle_stop import ObstacleConfig, Outline

DESCRIPTION = """calibration_drive: the car calibrates its steering by itself while you hold the
autonomous deadman and watch. Launch it with throttle:=true planner:=speed. It
drives within 3 m of where it stands when you first hold the button, so 6 x 6 m
have to be free. Let go, and it stops; move it with the manual deadman, hold
the button again, and it goes on."""
EPILOG = """Remappings such as odom:=my_odom may follow; for a car in a namespace set
ROS_NAMESPACE.

docs/nodes.md of the package lists its topics."""


# Field, lowest and highest value, and the option's placeholder and help.
NUMBERS = (
    ("radius_m", 2.5, 100.0, "M", "no part of the car leaves a circle of this radius around where it began"),
    ("speed_mps", 0.4, 3.0, "M/S", "the speed in wide turns"),
    ("tight_speed_mps", 0.4, 3.0, "M/S", "the speed in the tightest turns"),
    ("max_time_s", 30.0, 3600.0, "S", "of the held button; then it ends with what there is"),
    ("braking_mps2", 0.1, 10.0, "M/S^2", "the deceleration that a stop is certain of"))


@dataclass(frozen=True)
class CalibrationDriveConfig:
    """Where and how the car drives; the names are those of the ROS parameters.

    Raises:
        ConfigError: naming the parameter.
    """

    # no part of the car leaves a circle of this radius around the start: 3 m is an area of 6 × 6 m
    radius_m: float = 3.0
    speed_mps: float = 1.2  # in wide turns; tight ones are slower
    tight_speed_mps: float = 0.9  # in the tightest turns
    max_time_s: float = 300.0  # of driving, that is of the held button; then it ends with what there is
    # the deceleration that a stop is certain of, such as the drag's, less a slope's 0.2 m/s² for each 2 %, where the
    # kind of ESC isn't known. Where it is seen to stop with less, that counts, and with more once two stops or more
    # without a brake have shown it.
    braking_mps2: float = 0.15
    outline: Outline = field(default_factory=Outline)  # of the car from above
    obstacles: ObstacleConfig | None = None  # the sonars, as throttle_arb takes them; ``None`` = none is looked at

    def __post_init__(self):
        for field_name, low, high, _, _ in NUMBERS:
            value = getattr(self, field_name)
            if not low <= value <= high:
                raise ConfigError(_option(field_name), value, f"a number from {low:g} to {high:g}")


DEFAULTS = CalibrationDriveConfig()


def read_obstacles(throttle_arb: dict[str, Any]) -> ObstacleConfig:
    """Return the car's outline and sonars as throttle_arb has them, whether or not it stops for them itself.

    Raises:
        CarInterfaceError: it doesn't know the sonars.
    """
    try:
        return read(Params({**throttle_arb, "obstacle_stop": True}), ObstacleConfig)
    except ConfigError as error:
        raise CarInterfaceError(f"of throttle_arb's parameters {error}: launch the car by its launch files, or drive "
                                "without sonars by --no-sonars") from error


def parse(arguments: Sequence[str]) -> argparse.Namespace:
    """Parse the options, without ROS's own arguments; it exits with code 2 where they are wrong."""
    parser = argparse.ArgumentParser(prog="rosrun car_interface calibration_drive", description=DESCRIPTION,
                                     epilog=EPILOG, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", metavar="YAML", help="the file to write (default: the one that turn_arb was "
                        "launched with)")
    parser.add_argument("--base", metavar="YAML", help="whose other parameters are kept (default: the file to write, "
                        "where there is one, else turn_arb's)")
    parser.add_argument("--yes", action="store_true", help="replace the file without a question; the old one is kept "
                        "beside it")
    parser.add_argument("--stick", action="store_true", help="you drive, by the manual deadman: it says where to hold "
                        "the stick")
    for field_name, _, _, metavar, words in NUMBERS:
        value = getattr(DEFAULTS, field_name)
        parser.add_argument(f"--{_option(field_name).replace('_', '-')}", type=float, default=value, metavar=metavar,
                            help=f"{words} (default: {value:g})")
    parser.add_argument("--no-sonars", action="store_true", help="look at no sonar: only you keep the car from running "
                        "into something")
    return parser.parse_args(arguments)


def drive_config(options: argparse.Namespace) -> CalibrationDriveConfig:
    """Return where and how it drives, without the car's sonars and outline.

    Raises:
        ConfigError: naming the option.
    """
    return CalibrationDriveConfig(**{name: getattr(options, _option(name)) for name, *_ in NUMBERS})


def _option(field_name):
    return field_name.rsplit("_", 1)[0]  # without its unit
