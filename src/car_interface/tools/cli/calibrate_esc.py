"""An ESC's calibration from a recorded drive: kind, neutral, dead bands, dwell, drag brake.

Drive for two minutes with calibration_drive:=true and everything recorded, as docs/calibrate.md says second by second:
set off slowly, brake, pull twice, set off backward, wait and pull.

Writes YAML that throttle_arb loads: what the drive shows is new, everything else is as in --base. Its head says what
shows each number. What the drive does not show is refused, with what to drive for it.
"""
from __future__ import annotations

import argparse
from dataclasses import replace
from functools import partial

from car_interface.common import output
from car_interface.common.errors import CarInterfaceError
from car_interface.common.package_files import package_file
from car_interface.common.yaml_file import read_yaml
from car_interface.throttle.config import load_throttle
from car_interface.tools.calibration.esc.calibrate import PROFILE, calibrate, report, yaml_text
from car_interface.tools.calibration.esc.drive import load_esc_drive
from car_interface.tools.calibration.shared import write_table
from car_interface.tools.cli.jobs import load_all
from car_interface.tools.cli.options import add_calibration_arguments, add_recording_arguments, check_channel, topics_of
from car_interface.tools.recordings import roles

BASE = "config/throttle.yaml"
ROLES = (roles.ODOM, roles.OUTPUT)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of calibrate_esc."""
    add_calibration_arguments(parser, "YAML", "calibration")
    parser.add_argument("--base", metavar="YAML", help="the throttle.yaml with which was driven, whose other "
                        "parameters are kept (default: the package's)")
    parser.add_argument("--force", action="store_true", help="write what the drive shows, although it does not show "
                        "all; the rest stays as it was. Without the kind of ESC nothing is written")
    parser.add_argument("--channel", type=int, metavar="N", help="of the servo board (default: the base's)")
    add_recording_arguments(parser, ROLES)


def run(options: argparse.Namespace) -> int:
    """Calibrate, print the report, and write the file."""
    topics, base_path = topics_of(options), options.base or str(package_file(BASE))
    check_channel("--channel", options.channel)
    output.check(options.output, options.bags)
    base = load_throttle(base_path)
    driven = base.calibration if options.channel is None else replace(base.calibration, channel=options.channel)
    load = partial(load_esc_drive, calibration=driven, topics=topics, namespace=options.namespace)
    recorded = load_all(load, options.bags, options.jobs)
    found = calibrate(recorded, base.calibration)
    lines = list(report(found, recorded, base))
    if PROFILE not in found.values or found.missing and not options.force:
        print("\n".join(lines))
        what, remedy = (("which kind of ESC it is", "") if PROFILE not in found.values else
                        ("all of it", ", or keep the old numbers there by --force"))
        raise CarInterfaceError(f"nothing is written: the drive doesn't show {what}. Drive this, and give that "
                                f"recording as well{remedy}: {'; '.join(found.missing)}")
    written = write_table(options.output, yaml_text(found, base, read_yaml(base_path), lines), load_throttle,
                          "throttle_arb")
    print("\n".join([*lines, written]))
    return 0
