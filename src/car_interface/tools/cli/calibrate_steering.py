"""A steering calibration from recorded drives: for each turn radius the servo's duty, to both sides.

Drive for some minutes with everything recorded: slow circles to both sides at many positions of the stick, up to both
ends, each held for two seconds and, approached from a little beyond, for two more; and straight on in between. Slow
enough that no tyre slides.

Writes YAML that turn_arb loads: servo_left, servo_center, servo_right and the two tables are new, everything else is as
in --base. Its head says what the numbers are from, and how well they are known.
"""
from __future__ import annotations

import argparse
from functools import partial

from car_interface.common import output
from car_interface.common.errors import CarInterfaceError
from car_interface.common.lookup_table import check_axis
from car_interface.common.package_files import package_file
from car_interface.common.yaml_file import read_yaml
from car_interface.steering.config import load_steering
from car_interface.tools.calibration.shared import write_table
from car_interface.tools.calibration.steering.calibrate import calibrate, report, yaml_text
from car_interface.tools.calibration.steering.recorded import load_steering_drive
from car_interface.tools.cli.jobs import load_all
from car_interface.tools.cli.options import (
    add_calibration_arguments,
    add_recording_arguments,
    check_channel,
    finite,
    length_m,
    topics_of,
)
from car_interface.tools.recordings import roles

BASE = "config/turn_arb.yaml"
ROLES = (roles.ODOM, roles.IMU, roles.OUTPUT, roles.COMMAND, roles.SERVO, roles.ACKERMANN)
NO_IMU = "none"
MAX_BREAKPOINTS = 200


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of calibrate_steering."""
    add_calibration_arguments(parser, "YAML", "calibration")
    parser.add_argument("--base", metavar="YAML", help="a calibration for turn_arb whose other parameters are kept, "
                        "and with --force its duties where nothing was driven (default: the package's)")
    parser.add_argument("--axis", type=_radii_m, metavar="M,M,…", help="turn radii for the tables, continued to 300 m "
                        "where they end below 100 m (default: from the tightest that was driven to 300 m, so near to "
                        "each other that linear interpolation is exact)")
    parser.add_argument("--force", action="store_true", help="write what would be refused; where nothing was driven "
                        "the old duties stay, marked")
    parser.add_argument("--channel", type=int, metavar="N", help="of the servo board (default: the base's)")
    parser.add_argument("--imu", metavar="TOPIC", help="of an IMU whose yaw rate is better than odometry's (default: "
                        f"{roles.IMU.topics[0]} where it was recorded, else the only one; {NO_IMU} = don't)")
    parser.add_argument("--wheelbase", type=length_m, metavar="M", help="where no duties were recorded: take the "
                        "angles that a planner asked for (ackermann), which became duties by --base and this wheelbase")
    add_recording_arguments(parser, ROLES)


def run(options: argparse.Namespace) -> int:
    """Calibrate, print the report, and write the file."""
    topics, base_path = topics_of(options, imu=options.imu), options.base or str(package_file(BASE))
    check_channel("--channel", options.channel)
    output.check(options.output, options.bags)
    base = load_steering(base_path)
    load = partial(load_steering_drive, channel=base.servo_channel if options.channel is None else options.channel,
                   topics=topics, use_imu=topics.get(roles.IMU.name) != NO_IMU, namespace=options.namespace,
                   base=base, wheelbase_m=options.wheelbase)
    recorded = load_all(load, options.bags, options.jobs)
    calibrated = calibrate(recorded, base, options.axis, accept_disagreement=options.force)
    lines = report(calibrated, recorded, options.axis)
    if calibrated.problems and not options.force:
        print("\n".join(lines))
        raise CarInterfaceError("no calibration is written: " + "; ".join(calibrated.problems)
                                + ". Give that recording as well, or keep the old duties there by --force")
    written = write_table(options.output, yaml_text(calibrated, read_yaml(base_path), lines), load_steering, "turn_arb")
    print("\n".join([*lines, written]))
    return 0


def _radii_m(text):
    """Return the radii in an option's text, with commas or blanks between them."""
    try:
        radii = tuple(map(finite, text.replace(",", " ").split()))
        check_axis(radii, "axis")
    except (ValueError, argparse.ArgumentTypeError) as error:
        like = "in m, with commas between them, like 0.7,1,2,5,20,100,300"
        raise argparse.ArgumentTypeError(f"{error} ({like})") from error
    if radii[0] <= 0 or len(radii) > MAX_BREAKPOINTS:
        raise argparse.ArgumentTypeError(f"accepted: at most {MAX_BREAKPOINTS} radii above 0 m")
    return radii
