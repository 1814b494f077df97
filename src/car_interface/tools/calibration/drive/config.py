"""Settings of the calibration drive: by its command line, and by the parameters of turn_arb and throttle_arb."""
from __future__ import annotations

import argparse
from dataclasses import dataclass, fields, replace
from typing import Any, Sequence

from car_interface.common.declared import DECLARATION, number, read
from car_interface.common.errors import CarInterfaceError, ConfigError
from car_interface.common.params import Params
from car_interface.throttle.obstacle_stop import ObstacleConfig

DESCRIPTION = """calibration_drive: the car calibrates its steering by itself while you hold the
autonomous deadman and watch. Launch it with throttle:=true planner:=speed. It
drives within 3 m of where it stands when you first hold the button, so 6 x 6 m
have to be free. Let go, and it stops; move it with the manual deadman, hold
the button again, and it goes on."""
EPILOG = """Remappings such as odom:=my_odom may follow; for a car in a namespace set
ROS_NAMESPACE.

docs/nodes.md of the package lists its topics."""
NO_SONARS = ObstacleConfig()


@dataclass(frozen=True)
class CalibrationDriveConfig:
    """Where and how the car drives: the options that are numbers, and what throttle_arb knows."""

    radius_m: float = number("radius", 3.0, "no part of the car leaves a circle of this radius around where it began",
                             "m", low=2.5, high=100)
    speed_mps: float = number("speed", 1.2, "the speed in wide turns", "m/s", low=0.4, high=3)
    tight_speed_mps: float = number("tight_speed", 0.9, "the speed in the tightest turns", "m/s", low=0.4, high=3)
    max_time_s: float = number("max_time", 300.0, "of the held button; then it ends with what there is", "s",
                               low=30, high=3600)
    # Such as the drag's, less a slope's 0.2 m/s² for each 2 %, where the kind of ESC isn't known. Where it is seen to
    # stop with less, that counts.
    braking_mps2: float = number("braking", 0.15, "the deceleration that a stop is certain of", "m/s^2",
                                 low=0.1, high=10)
    # The car from above and its sonars, as throttle_arb takes them; without mounts none is looked at.
    obstacles: ObstacleConfig = NO_SONARS


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
    for each in fields(CalibrationDriveConfig):
        option = each.metadata.get(DECLARATION)
        if option is not None:
            parser.add_argument(f"--{option.name.replace('_', '-')}", type=float, default=each.default,
                                metavar=option.unit.upper(), help=f"{option.text} (default: {each.default:g})")
    parser.add_argument("--no-sonars", action="store_true", help="look at no sonar: only you keep the car from running "
                        "into something")
    return parser.parse_args(arguments)


def drive_config(options: argparse.Namespace, throttle_arb: dict[str, Any]) -> CalibrationDriveConfig:
    """Return where and how it drives; the car's outline and its sonars are as throttle_arb has them, whether or not it
    stops for them itself.

    Raises:
        CarInterfaceError: naming the option, or throttle_arb doesn't know the sonars.
    """
    config = read(Params(vars(options)), CalibrationDriveConfig)
    if options.no_sonars or options.stick:
        return config
    try:
        return replace(config, obstacles=read(Params({**throttle_arb, "obstacle_stop": True}), ObstacleConfig))
    except ConfigError as error:
        raise CarInterfaceError(f"of throttle_arb's parameters {error}: launch the car by its launch files, or drive "
                                "without sonars by --no-sonars") from error
