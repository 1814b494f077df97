"""The command line of calibration_drive."""
from __future__ import annotations

import argparse
from typing import Sequence

DESCRIPTION = """The car calibrates its steering by itself while you hold the autonomous deadman and watch.

Launch it with throttle:=true planner:=speed. It drives within 3 m of where it stands when you first hold the button, so
6 x 6 m have to be free. Let go, and it stops; move it with the manual deadman, hold the button again, and it goes on."""
EPILOG = """parameters, such as _radius:=4, and remappings, such as odom:=my_odom, may follow; for a car in a namespace set
ROS_NAMESPACE:
  _radius 3.0 (m)         no part of the car leaves a circle of this radius around where it began
  _speed 1.2, _tight_speed 0.9 (m/s)    in wide and in the tightest turns
  _max_time 300 (s)       of the held button; then it ends with what there is
  _braking 1.0 (m/s^2)    the deceleration that a stop is certain of
  _sonars true            false: no sonar is looked at, and only you keep it from running into something"""


def parse(arguments: Sequence[str]) -> argparse.Namespace:
    """The options, without ROS's own arguments; it exits with code 2 where they are wrong."""
    parser = argparse.ArgumentParser(prog="calibration_drive", description=DESCRIPTION, epilog=EPILOG,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", metavar="YAML", help="the file to write (default: the one that turn_arb was "
                        "launched with)")
    parser.add_argument("--base", metavar="YAML", help="whose other parameters are kept (default: the file to write, "
                        "where there is one, else turn_arb's)")
    parser.add_argument("--yes", action="store_true", help="replace the file without a question; the old one is kept "
                        "beside it")
    parser.add_argument("--stick", action="store_true", help="you drive, by the manual deadman: it says where to hold "
                        "the stick")
    return parser.parse_args(arguments)
