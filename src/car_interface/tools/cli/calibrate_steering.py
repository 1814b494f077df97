"""A steering calibration from recorded drives: for each turn radius the servo's duty, to both sides.

Drive for some minutes with everything recorded: slow circles to both sides at many positions of the stick, up to both
ends, each held for two seconds and, approached from a little beyond, for two more; and straight on in between. Slow
enough that no tyre slides.

Writes YAML that turn_arb loads: servo_left, servo_center, servo_right and the two tables are new, everything else is as
in --base. Its head says what the numbers are from, and how well they are known.
"""
from __future__ import annotations

import argparse
from dataclasses import dataclass, field
from functools import partial
from typing import Mapping

from car_interface.common import output
from car_interface.common.errors import CarInterfaceError, ConfigError
from car_interface.common.lookup_table import check_axis
from car_interface.common.package_files import package_file
from car_interface.common.servo_channels import CHANNELS
from car_interface.common.yaml_file import read_yaml
from car_interface.steering.calibration import SteeringCalibration
from car_interface.steering.params import load_steering
from car_interface.tools.calibration.steering.asked import AngleTable
from car_interface.tools.calibration.steering.calibrate import Calibrated, calibrate, yaml_text
from car_interface.tools.calibration.steering.recorded import RecordedDrive, load_drive
from car_interface.tools.calibration.steering.report import report
from car_interface.tools.cli.jobs import add_jobs_argument, load_all
from car_interface.tools.cli.options import add_namespace_argument, finite, length_m
from car_interface.tools.cli.topics import add_topic_arguments, topics_of
from car_interface.tools.recordings import roles
from car_interface.tools.recordings.signals import IMU, IMU_TOPIC

BASE = "config/turn_arb.yaml"
ROLES = (roles.ODOM, roles.IMU, roles.OUTPUT, roles.COMMAND, roles.ACKERMANN)
NO_IMU = "none"
MAX_BREAKPOINTS = 200


@dataclass(frozen=True)
class Config:
    """What to calibrate from, and where to write it.

    Attributes:
        recordings: paths.
        output: path of the YAML file.
        base: path of the calibration for turn_arb whose other parameters are kept.
        axis_m: turn radii of the tables; ``None`` = chosen by what was driven.
        force: write what would be refused.
        channel: of the servo board, 0..15; ``None`` = the base's.
        topics: named by the user, by role; that of the role imu may be NO_IMU.
        wheelbase_m: by which the angles that a planner asked for became duties, where no duties were recorded; ``None``
            = they are not used.
        namespace: the car's.
        jobs: recordings to read at the same time.

    Raises:
        ConfigError: naming the option.
    """

    recordings: tuple[str, ...]
    output: str
    base: str
    axis_m: tuple[float, ...] | None = None
    force: bool = False
    channel: int | None = None
    topics: Mapping[str, str] = field(default_factory=dict)
    wheelbase_m: float | None = None
    namespace: str = "/"
    jobs: int = 1

    def __post_init__(self):
        if self.channel is not None and not 0 <= self.channel < CHANNELS:
            raise ConfigError("--channel", self.channel, "a channel of the servo board, 0 to 15")
        if self.axis_m is not None:
            check_axis(self.axis_m, "--axis")
            if self.axis_m[0] <= 0 or len(self.axis_m) > MAX_BREAKPOINTS:
                raise ConfigError("--axis", self.axis_m, f"at most {MAX_BREAKPOINTS} radii above 0 m")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of calibrate_steering."""
    parser.add_argument("bags", nargs="+", metavar="BAG", help="recordings of drives with one car")
    parser.add_argument("-o", "--output", required=True, metavar="YAML", help="where to write the calibration")
    parser.add_argument("--base", metavar="YAML", help="a calibration for turn_arb whose other parameters are kept, "
                        "and with --force its duties where nothing was driven (default: the package's)")
    parser.add_argument("--axis", type=_radii_m, metavar="M,M,…", help="turn radii for the tables, continued to 300 m "
                        "where they end below 100 m (default: from the tightest that was driven to 300 m, so near to "
                        "each other that linear interpolation is exact)")
    parser.add_argument("--force", action="store_true", help="write what would be refused; where nothing was driven "
                        "the old duties stay, marked")
    parser.add_argument("--channel", type=int, metavar="N", help="of the servo board (default: the base's)")
    add_topic_arguments(parser, ROLES)
    parser.add_argument("--imu", metavar="TOPIC", help="of an IMU whose yaw rate is better than odometry's (default: "
                        f"{IMU_TOPIC} where it was recorded, else the only one; {NO_IMU} = don't)")
    parser.add_argument("--wheelbase", type=length_m, metavar="M", help="where no duties were recorded: take the "
                        "angles that a planner asked for (ackermann), which became duties by --base and this wheelbase")
    add_namespace_argument(parser)
    add_jobs_argument(parser)


def config_of(options: argparse.Namespace) -> Config:
    """The parsed options as a checked configuration.

    Raises:
        ConfigError: naming the option.
    """
    return Config(tuple(options.bags), options.output, options.base or str(package_file(BASE)), options.axis,
                  options.force, options.channel, topics_of(options, imu=options.imu), options.wheelbase,
                  options.namespace, options.jobs)


def run(options: argparse.Namespace) -> int:
    """Calibrate, print the report, and write the file."""
    config = config_of(options)
    output.check(config.output, config.recordings)
    base = load_steering(config.base)
    base_text = read_yaml(config.base)
    recorded = load_recordings(config, base)
    calibrated = calibrate(recorded, base, config.axis_m, accept_disagreement=config.force)
    lines = list(report(calibrated, recorded, config.axis_m))
    if calibrated.problems and not config.force:
        print("\n".join(lines))
        raise CarInterfaceError("no calibration is written: " + "; ".join(calibrated.problems)
                                + ". Give that recording as well, or keep the old duties there by --force")
    _write(config.output, calibrated, base_text, lines)
    return 0


def load_recordings(config: Config, base: SteeringCalibration) -> list[RecordedDrive]:
    """Read all recordings.

    Raises:
        NoRecording: one can't be read, lacks what is needed, or has the same driving as another.
    """
    angle_table = None if config.wheelbase_m is None else AngleTable(base, config.wheelbase_m)
    load = partial(load_drive, channel=base.servo_channel if config.channel is None else config.channel,
                   topics=config.topics, use_imu=config.topics.get(IMU) != NO_IMU, namespace=config.namespace,
                   angle_table=angle_table)
    return load_all(load, config.recordings, config.jobs)


def _write(path, calibrated: Calibrated, base_text, lines):
    text = yaml_text(calibrated, base_text, lines)
    try:
        load_steering(path, text)
    except CarInterfaceError as error:
        raise CarInterfaceError(f"no calibration is written, turn_arb would refuse it: {error}") from error
    backup_path = output.write(path, text, keeps_old=True)
    print("\n".join(lines))
    print(f"written: {path}" + (f"; the old one is {backup_path}" if backup_path else ""))


def _radii_m(text):
    """The radii in an option's text, with commas or blanks between them."""
    try:
        radii = tuple(map(finite, text.replace(",", " ").split()))
        check_axis(radii, "axis")
    except (ValueError, argparse.ArgumentTypeError) as error:
        like = "in m, with commas between them, like 0.7,1,2,5,20,100,300"
        raise argparse.ArgumentTypeError(f"{error} ({like})") from error
    if radii[0] <= 0 or len(radii) > MAX_BREAKPOINTS:
        raise argparse.ArgumentTypeError(f"accepted: at most {MAX_BREAKPOINTS} radii above 0 m")
    return radii
