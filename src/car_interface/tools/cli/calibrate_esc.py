"""An ESC's calibration from a recorded drive: kind, neutral, dead bands, dwell, drag brake.

Drive for two minutes with calibration_drive:=true and everything recorded, as docs/calibrate.md says second by second:
set off slowly, brake, pull twice, set off backward, wait and pull.

Writes YAML that throttle_arb loads: what the drive shows is new, everything else is as in --base. Its head says what
shows each number. What the drive does not show is refused, with what to drive for it.
"""
from __future__ import annotations

import argparse
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Mapping

from car_interface.common import output
from car_interface.common.errors import CarInterfaceError, ConfigError
from car_interface.common.package_files import package_file
from car_interface.common.servo_channels import CHANNELS
from car_interface.common.yaml_file import read_yaml
from car_interface.throttle.params import load_throttle
from car_interface.tools.calibration.esc.calibrate import calibrate, yaml_text
from car_interface.tools.calibration.esc.recorded import load_drive
from car_interface.tools.calibration.esc.report import report
from car_interface.tools.cli.jobs import add_jobs_argument, load_all
from car_interface.tools.cli.options import add_namespace_argument
from car_interface.tools.cli.topics import add_topic_arguments, topics_of
from car_interface.tools.recordings import roles

BASE = "config/throttle.yaml"
ROLES = (roles.ODOM, roles.OUTPUT)


@dataclass(frozen=True)
class Config:
    """What to calibrate from, and where to write it.

    Attributes:
        recordings: paths.
        output: path of the YAML file.
        base: path of the file for throttle_arb with which was driven; its other parameters are kept.
        force: write what the drive shows, although it does not show all.
        channel: of the servo board, 0..15; ``None`` = the base's.
        topics: named by the user, by role.
        namespace: the car's.
        jobs: recordings to read at the same time.

    Raises:
        ConfigError: naming the option.
    """

    recordings: tuple[str, ...]
    output: str
    base: str
    force: bool = False
    channel: int | None = None
    topics: Mapping[str, str] = field(default_factory=dict)
    namespace: str = "/"
    jobs: int = 1

    def __post_init__(self):
        if self.channel is not None and not 0 <= self.channel < CHANNELS:
            raise ConfigError("--channel", self.channel, "a channel of the servo board, 0 to 15")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of calibrate_esc."""
    parser.add_argument("bags", nargs="+", metavar="BAG", help="recordings of drives with one car")
    parser.add_argument("-o", "--output", required=True, metavar="YAML", help="where to write the calibration")
    parser.add_argument("--base", metavar="YAML", help="the throttle.yaml with which was driven, whose other "
                        "parameters are kept (default: the package's)")
    parser.add_argument("--force", action="store_true", help="write what the drive shows, although it does not show "
                        "all; the rest stays as it was. Without the kind of ESC nothing is written")
    parser.add_argument("--channel", type=int, metavar="N", help="of the servo board (default: the base's)")
    add_topic_arguments(parser, ROLES)
    add_namespace_argument(parser)
    add_jobs_argument(parser)


def config_of(options: argparse.Namespace) -> Config:
    """The parsed options as a checked configuration.

    Raises:
        ConfigError: naming the option.
    """
    return Config(tuple(options.bags), options.output, options.base or str(package_file(BASE)), options.force,
                  options.channel, topics_of(options), options.namespace, options.jobs)


def run(options: argparse.Namespace) -> int:
    """Calibrate, print the report, and write the file."""
    config = config_of(options)
    output.check(config.output, config.recordings)
    base = load_throttle(config.base)
    base_text = read_yaml(config.base)
    driven = base.calibration if config.channel is None else replace(base.calibration, channel=config.channel)
    load = partial(load_drive, calibration=driven, topics=config.topics, namespace=config.namespace)
    recorded = load_all(load, config.recordings, config.jobs)
    calibrated = calibrate(recorded, base.calibration)
    lines = list(report(calibrated, recorded, base))
    if calibrated.fit.profile is None or calibrated.problems and not config.force:
        print("\n".join(lines))
        what = "which kind of ESC it is" if calibrated.fit.profile is None else "all of it"
        remedy = ("" if calibrated.fit.profile is None else ", or keep the old numbers there by --force")
        raise CarInterfaceError(f"nothing is written: the drive doesn't show {what}. Drive this, and give that "
                                f"recording as well{remedy}: {'; '.join(calibrated.problems)}")
    _write(config.output, yaml_text(calibrated, base, base_text, lines), lines)
    return 0


def _write(path, text, lines):
    try:
        load_throttle(path, text)
    except CarInterfaceError as error:
        raise CarInterfaceError(f"nothing is written, throttle_arb would refuse it: {error}") from error
    backup_path = output.write(path, text, keeps_old=True)
    print("\n".join(lines))
    print(f"written: {path}" + (f"; the old one is {backup_path}" if backup_path else ""))
