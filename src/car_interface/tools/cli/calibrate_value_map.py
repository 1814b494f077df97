"""A value map from recorded drives: acceleration and velocity to the value that makes it.

Drive for some minutes with everything recorded: throttle and brake of every strength at every speed, coasting, straight
on rather than in tight turns, and in all directions of the compass, so that a slope can be told from drag.

Writes the map as a CSV for generic_value_converter, and beside it NAME.report.txt: what each number rests on.
"""
from __future__ import annotations

import argparse
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

from car_interface.common import output
from car_interface.common.errors import CarInterfaceError, ConfigError
from car_interface.common.lookup_table import check_axis
from car_interface.common.package_files import package_file
from car_interface.common.servo_channels import CHANNELS
from car_interface.throttle.value_map import load_value_map
from car_interface.tools.calibration.value_map.acceleration import WindowConfig
from car_interface.tools.calibration.value_map.calibrate import Calibrated, MapAxes, NoTable, calibrate
from car_interface.tools.calibration.value_map.config import FitConfig
from car_interface.tools.calibration.value_map.recorded import (
    IMU,
    ODOM,
    PULSES,
    RecordedDrive,
    Source,
    is_by_hand,
    load_drive,
)
from car_interface.tools.calibration.value_map.report import DUTY, report
from car_interface.tools.calibration.value_map.table import csv_text
from car_interface.tools.calibration.value_map.throttle import load_throttle
from car_interface.tools.cli.jobs import add_jobs_argument, load_all
from car_interface.tools.cli.options import add_namespace_argument, finite
from car_interface.tools.cli.topics import add_topic_arguments, topics_of
from car_interface.tools.recordings import roles
from car_interface.tools.recordings.signals import VALUE_TOPIC

ESC_CHANNEL, ESC_NEUTRAL_DUTY = 1, 4915  # as config/throttle.yaml has them
NO_CHANNEL = -1
ROLES = (roles.ODOM, roles.IMU, roles.VALUE, roles.OUTPUT, roles.COMMAND)
THROTTLE = "config/throttle.yaml"
VALUE_TIMEOUT_S, DUTY_TIMEOUT_S = 0.5, 1.2  # a duty that doesn't change is repeated only now and then
LIMITS = WindowConfig()


@dataclass(frozen=True)
class Config:
    """What to calibrate from, and where to write it.

    Attributes:
        recordings: paths.
        output: path of the CSV.
        source: where value and accelerations are from.
        axes: of the map.
        fit: how it is fitted.
        prior: path of an existing map; ``None`` = none.
        force: write what would be refused.
        jobs: recordings to read at the same time.

    Raises:
        ConfigError: naming the option.
    """

    recordings: tuple[str, ...]
    output: str
    source: Source = field(default_factory=Source)
    axes: MapAxes = field(default_factory=MapAxes)
    fit: FitConfig = field(default_factory=FitConfig)
    prior: str | None = None
    force: bool = False
    jobs: int = 1

    def __post_init__(self):
        for name, axis in (("--values", self.axes.values), ("--velocities", self.axes.velocities_mps)):
            if axis is not None:
                check_axis(axis, name)
        esc_channel = self.source.esc_channel
        if esc_channel is not None and not 0 <= esc_channel < CHANNELS:
            raise ConfigError("--esc-channel", esc_channel, "a channel of the servo board, 0 to 15, or -1")
        if self.source.measured_by == IMU and IMU not in self.source.topics:
            raise ConfigError("--imu", None, f"the IMU's topic, as --acceleration {IMU} needs it")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of calibrate_value_map."""
    parser.add_argument("bags", nargs="+", metavar="BAG", help="recordings of drives with one car")
    parser.add_argument("-o", "--output", required=True, metavar="CSV", help="where to write the map")
    parser.add_argument("--prior", metavar="CSV", help="an existing map: its numbers stay where the drives tell "
                        "nothing, and its axes are used unless others are given")
    parser.add_argument("--force", action="store_true", help="write what would be refused; nothing is made up even so")
    parser.add_argument("--value", metavar="TOPIC|duty:CHANNEL",
                        help="what drives the car: a topic, or the duty of a channel of the servo board, which counts "
                             f"as the value that --throttle has for it (default: {VALUE_TOPIC}; for a drive by hand "
                             "the duty of the channel in --throttle)")
    parser.add_argument("--throttle", metavar="YAML", help="for duties: the throttle.yaml with which was driven, its "
                        "value_axis, duty_table and channel (default: the package's)")
    parser.add_argument("--neutral", type=finite, metavar="VALUE", help="the value that neither drives nor brakes "
                        "(default: 0; for a duty the value of the neutral in --throttle)")
    parser.add_argument("--values", type=finite, nargs="+", metavar="VALUE",
                        help="the map's values (default: --prior's, or round numbers over what was driven)")
    parser.add_argument("--velocities", type=finite, nargs="+", metavar="M/S",
                        help="the map's velocities (as --values)")
    parser.add_argument("--acceleration", choices=(PULSES, ODOM, IMU),
                        help="measure it by the wheels' pulses, odometry's speed, or the IMU (default: pulses where "
                             "they were recorded, else odometry)")
    add_topic_arguments(parser, ROLES)
    parser.add_argument("--imu", metavar="TOPIC", help="of an IMU, such as imu/data: its pitch takes gravity off")
    add_namespace_argument(parser)
    parser.add_argument("--delay", type=finite, metavar="S", help="from value to acceleration (default: estimated)")
    parser.add_argument("--esc-channel", type=int, default=ESC_CHANNEL, metavar="CHANNEL",
                        help="of the servo board: shows whether a value reached the ESC; -1 = don't look "
                             f"(default: {ESC_CHANNEL})")
    parser.add_argument("--esc-neutral", type=finite, default=ESC_NEUTRAL_DUTY, metavar="DUTY",
                        help=f"its duty when nobody drives (default: {ESC_NEUTRAL_DUTY})")
    parser.add_argument("--min-speed", type=finite, default=LIMITS.min_speed_mps, metavar="M/S",
                        help=f"slower is a stop (default: {LIMITS.min_speed_mps})")
    parser.add_argument("--max-curvature", type=finite, default=LIMITS.max_curvature_per_m, metavar="1/M",
                        help=f"of the path; tighter is steering (default: {LIMITS.max_curvature_per_m})")
    parser.add_argument("--max-lateral", type=finite, default=LIMITS.max_lateral_mps2, metavar="M/S2",
                        help=f"acceleration sideways; more is steering (default: {LIMITS.max_lateral_mps2})")
    add_jobs_argument(parser)


def config_of(options: argparse.Namespace) -> Config:
    """The parsed options as a checked configuration.

    Reads the axes of --prior, the table of --throttle, and without --value whether the recordings are of drives by
    hand.

    Raises:
        ConfigError: naming the option or the file.
    """
    value = options.value or topics_of(options).get(roles.VALUE.name) or _recorded_value(options)
    channel = _duty_channel(value)
    by_duty = channel is not None
    throttle = _throttle(options) if by_duty else None
    neutral = options.neutral if options.neutral is not None else throttle.neutral if throttle else 0.0
    source = Source(
        topics=topics_of(options, value=None if by_duty else value, imu=options.imu), duty_channel=channel,
        throttle=throttle, neutral=neutral, measured_by=options.acceleration, namespace=options.namespace,
        esc_channel=None if options.esc_channel == NO_CHANNEL else options.esc_channel,
        esc_neutral_duty=options.esc_neutral)
    fit = FitConfig(
        window=WindowConfig(min_speed_mps=options.min_speed, max_curvature_per_m=options.max_curvature,
                            max_lateral_mps2=options.max_lateral),
        neutral=neutral, value_timeout_s=DUTY_TIMEOUT_S if by_duty else VALUE_TIMEOUT_S, delay_s=options.delay,
        from_imu=options.acceleration == IMU)
    return Config(tuple(options.bags), options.output, source, _axes(options), fit, options.prior, options.force,
                  options.jobs)


def run(options: argparse.Namespace) -> int:
    """Calibrate, print the report, and write the files."""
    output.check(options.output, options.bags)
    config = config_of(options)
    beside = [] if output.is_stream(config.output) else [str(Path(config.output).with_suffix(".report.txt"))]
    for path in beside:
        output.check(path, config.recordings)
    try:
        recorded, calibrated = calibrate_by(config)
    except NoTable as error:
        print(error.coverage)
        raise
    text = "\n".join(report(recorded, config.source, calibrated.fit, calibrated.table, calibrated.problems,
                            config.prior))
    if calibrated.problems and not config.force:
        print(text)
        raise CarInterfaceError("no map is written: " + "; ".join(calibrated.problems)
                                + ". Drive what is missing, or --force it")
    csv = csv_text(calibrated.table)
    load_value_map(config.output, text=csv)
    backup_paths = {config.output: output.write(config.output, csv, keeps_old=True)}
    for path in beside:
        backup_paths[path] = output.write(path, text + "\n", keeps_old=True)
    print(text)
    for path, backup_path in backup_paths.items():
        print(f"written: {path}" + (f"; the old one is {backup_path}" if backup_path else ""))
    return 0


def calibrate_by(config: Config) -> tuple[list[RecordedDrive], Calibrated]:
    """Read all recordings and fit a map to them.

    Raises:
        CarInterfaceError: a recording or the prior is no good, or there is nothing to fit.
    """
    prior = load_value_map(config.prior) if config.prior else None
    load = partial(load_drive, source=config.source, progress=len(config.recordings) == 1 or config.jobs == 1)
    recorded = load_all(load, config.recordings, config.jobs)
    return recorded, calibrate(recorded, config.axes, config.fit, prior)


def _throttle(options):
    return load_throttle(options.throttle or str(package_file(THROTTLE)))


def _recorded_value(options):
    """--value by what the recordings hold."""
    if any(is_by_hand(path, VALUE_TOPIC, options.namespace) for path in options.bags):
        return f"{DUTY}{_throttle(options).channel}"
    return VALUE_TOPIC


def _duty_channel(value):
    """The channel in --value duty:CHANNEL; ``None`` for a topic."""
    if value is None or not value.startswith(DUTY):
        return None
    text = value[len(DUTY):]
    if not text.isdecimal() or int(text) >= CHANNELS:
        raise ConfigError("--value", value, f"a topic, or {DUTY}CHANNEL with a channel of 0 to 15")
    return int(text)


def _axes(options):
    """The map's axes: those given, or else the prior's."""
    values, velocities = options.values, options.velocities
    if options.prior and (values is None or velocities is None):
        prior = load_value_map(options.prior)
        values, velocities = values or prior.values, velocities or prior.velocities
    return MapAxes(None if values is None else tuple(values), None if velocities is None else tuple(velocities))
