"""The command line of calibration_drive."""
from __future__ import annotations

import argparse
from typing import Sequence

from car_interface.tools.calibration.drive.config import DriveConfig

DESCRIPTION = """calibration_drive: the car calibrates its steering by itself while you hold the
autonomous deadman and watch. Launch it with throttle:=true planner:=speed. It
drives within 3 m of where it stands when you first hold the button, so 6 x 6 m
have to be free. Let go, and it stops; move it with the manual deadman, hold
the button again, and it goes on."""
EPILOG = """Remappings such as odom:=my_odom may follow; for a car in a namespace set
ROS_NAMESPACE.

docs/nodes.md of the package lists its topics."""


def parse(arguments: Sequence[str]) -> argparse.Namespace:
    """The options, without ROS's own arguments; it exits with code 2 where they are wrong."""
    default = DriveConfig()
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
    for name, value, text in (
            ("radius", default.radius_m, "M: no part of the car leaves a circle of this radius around where it began"),
            ("speed", default.speed_mps, "M/S: the speed in wide turns"),
            ("tight-speed", default.tight_speed_mps, "M/S: the speed in the tightest turns"),
            ("max-time", default.max_time_s, "S: of the held button; then it ends with what there is"),
            ("braking", default.braking_mps2, "M/S^2: the deceleration that a stop is certain of")):
        metavar, _, words = text.partition(": ")
        parser.add_argument(f"--{name}", type=float, default=value, metavar=metavar,
                            help=f"{words} (default: {value:g})")
    parser.add_argument("--no-sonars", action="store_true", help="look at no sonar: only you keep the car from running "
                        "into something")
    return parser.parse_args(arguments)


def drive_config(options: argparse.Namespace) -> DriveConfig:
    """Where and how it drives, without the car's sonars and outline.

    Raises:
        ConfigError: naming the option.
    """
    return DriveConfig(radius_m=options.radius, speed_mps=options.speed, tight_speed_mps=options.tight_speed,
                       max_time_s=options.max_time, braking_mps2=options.braking)
