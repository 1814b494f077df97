"""A value map from recorded drives: acceleration and velocity to the value that makes it.

Drive for some minutes with everything recorded: throttle and brake of every strength at every speed, coasting, straight
on rather than in tight turns, and in all directions of the compass, so that a slope can be told from drag.

Writes the map as a CSV for generic_value_converter, and beside it NAME.report.txt: what each number rests on.
"""
from __future__ import annotations

import argparse
from functools import partial
from pathlib import Path

from car_interface.common import output
from car_interface.common.errors import CarInterfaceError, ConfigError
from car_interface.common.lookup_table import check_axis
from car_interface.common.package_files import package_file
from car_interface.common.units import CHANNELS
from car_interface.throttle.value_map import load_value_map
from car_interface.tools.calibration.shared import RecordedDrive, names_of
from car_interface.tools.calibration.value_map import calibrate
from car_interface.tools.calibration.value_map.recorded import (
    BY_IMU,
    BY_ODOM,
    BY_PULSES,
    DEFAULTS,
    DUTY,
    ESC_CHANNEL,
    MapConfig,
    is_by_hand,
    load_map_drive,
    load_throttle_table,
)
from car_interface.tools.cli.jobs import load_all
from car_interface.tools.cli.options import (
    add_calibration_arguments,
    add_recording_arguments,
    check_channel,
    finite,
    topics_of,
)
from car_interface.tools.recordings import roles

ESC_NEUTRAL_DUTY = 4915  # as config/throttle.yaml has it
NO_CHANNEL = -1
ROLES = (roles.ODOM, roles.IMU, roles.VALUE, roles.OUTPUT, roles.COMMAND)
THROTTLE = "config/throttle.yaml"
DUTY_TIMEOUT_S = 1.2  # a duty that doesn't change is repeated only now and then


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of calibrate_value_map."""
    add_calibration_arguments(parser, "CSV", "map")
    parser.add_argument("--prior", metavar="CSV", help="an existing map: its numbers stay where the drives tell "
                        "nothing, and its axes are used unless others are given")
    parser.add_argument("--force", action="store_true", help="write what would be refused; nothing is made up even so")
    parser.add_argument("--value", metavar="TOPIC|duty:CHANNEL",
                        help="what drives the car: a topic, or the duty of a channel of the servo board, which counts "
                             f"as the value that --throttle has for it (default: {roles.VALUE.topics[0]}; for a drive "
                             "by hand the duty of the channel in --throttle)")
    parser.add_argument("--throttle", metavar="YAML", help="for duties: the throttle.yaml with which was driven, its "
                        "value_axis, duty_table and channel (default: the package's)")
    parser.add_argument("--neutral", type=finite, metavar="VALUE", help="the value that neither drives nor brakes "
                        "(default: 0; for a duty the value of the neutral in --throttle)")
    parser.add_argument("--values", type=finite, nargs="+", metavar="VALUE",
                        help="the map's values (default: --prior's, or round numbers over what was driven)")
    parser.add_argument("--velocities", type=finite, nargs="+", metavar="M/S",
                        help="the map's velocities (as --values)")
    parser.add_argument("--acceleration", choices=(BY_PULSES, BY_ODOM, BY_IMU),
                        help="measure it by the wheels' pulses, odometry's speed, or the IMU (default: pulses where "
                             "they were recorded, else odometry)")
    parser.add_argument("--imu", metavar="TOPIC", help="of an IMU, such as imu/data: its pitch takes gravity off")
    parser.add_argument("--delay", type=finite, metavar="S", help="from value to acceleration (default: estimated)")
    parser.add_argument("--esc-channel", type=int, default=ESC_CHANNEL, metavar="CHANNEL",
                        help="of the servo board: shows whether a value reached the ESC; -1 = don't look "
                             f"(default: {ESC_CHANNEL})")
    parser.add_argument("--esc-neutral", type=finite, default=ESC_NEUTRAL_DUTY, metavar="DUTY",
                        help=f"its duty when nobody drives (default: {ESC_NEUTRAL_DUTY})")
    parser.add_argument("--min-speed", type=finite, default=DEFAULTS.min_speed_mps, metavar="M/S",
                        help=f"slower is a stop (default: {DEFAULTS.min_speed_mps})")
    parser.add_argument("--max-curvature", type=finite, default=DEFAULTS.max_curvature_per_m, metavar="1/M",
                        help=f"of the path; tighter is steering (default: {DEFAULTS.max_curvature_per_m})")
    parser.add_argument("--max-lateral", type=finite, default=DEFAULTS.max_lateral_mps2, metavar="M/S2",
                        help=f"acceleration sideways; more is steering (default: {DEFAULTS.max_lateral_mps2})")
    add_recording_arguments(parser, ROLES)


def config_of(options: argparse.Namespace) -> MapConfig:
    """Return where value and accelerations are from, and what counts.

    Reads the table of --throttle, and without --value whether the recordings are of drives by hand.

    Raises:
        ConfigError: naming the option or the file.
    """
    value = options.value or topics_of(options).get(roles.VALUE.name) or (
        f"{DUTY}{_throttle(options).channel}" if any(is_by_hand(path, options.namespace) for path in options.bags) else
        roles.VALUE.topics[0])
    is_duty = value.startswith(DUTY)
    throttle = _throttle(options)._replace(channel=_duty_channel(value)) if is_duty else None
    topics = topics_of(options, value=None if is_duty else value, imu=options.imu or None)
    esc_channel = None if options.esc_channel == NO_CHANNEL else options.esc_channel
    check_channel("--esc-channel", esc_channel, "a channel of the servo board, 0 to 15, or -1")
    if options.acceleration == BY_IMU and roles.IMU.name not in topics:
        raise ConfigError("--imu", None, f"the IMU's topic, as --acceleration {BY_IMU} needs it")
    neutral = options.neutral if options.neutral is not None else throttle.neutral if throttle else DEFAULTS.neutral
    return MapConfig(
        topics, throttle, options.acceleration, options.namespace, esc_channel, options.esc_neutral, options.min_speed,
        options.max_curvature, options.max_lateral, neutral, DUTY_TIMEOUT_S if is_duty else DEFAULTS.value_timeout_s,
        options.delay)


def run(options: argparse.Namespace) -> int:
    """Calibrate, print the report, and write the files."""
    beside = [] if output.is_stream(options.output) else [str(Path(options.output).with_suffix(".report.txt"))]
    for path in (options.output, *beside):
        output.check(path, options.bags)
    config = config_of(options)
    recorded, found = calibrate_by(options, config)
    if found.table is None:
        print(calibrate.coverage_text(found.fit, None))
        raise CarInterfaceError(f"no map is written: {names_of(recorded)} support no two values at the same two "
                                "velocities; drive longer, with throttle and brake of several strengths")
    text = calibrate.report(recorded, config, found, options.prior)
    if found.problems and not options.force:
        print(text)
        raise CarInterfaceError("no map is written: " + "; ".join(found.problems)
                                + ". Drive what is missing, or --force it")
    csv = calibrate.csv_text(found.table)
    load_value_map(options.output, text=csv)
    old = _old_map(options.output)
    kept = {path: output.write(path, content, keeps_old=True)
            for path, content in zip((options.output, *beside), (csv, text + "\n"))}
    narrower = None if old is None else calibrate.narrower_text(found.table, old, kept[options.output])
    print("\n".join([text, *(output.written_text(*pair) for pair in kept.items()), *filter(None, [narrower])]))
    return 0


def calibrate_by(options: argparse.Namespace, config: MapConfig) -> tuple[list[RecordedDrive], calibrate.MapResult]:
    """Read all recordings and fit a map to them, on the axes that are given, or else on those of --prior.

    Raises:
        CarInterfaceError: an axis, a recording or the prior is no good, or there is nothing to fit.
    """
    prior = load_value_map(options.prior) if options.prior else None
    names = "values", "velocities"
    axes = [getattr(options, name) or prior and getattr(prior, name) for name in names]
    for name, axis in zip(names, axes):
        if axis is not None:
            check_axis(axis, f"--{name}")
    recorded = load_all(partial(load_map_drive, config=config), options.bags, options.jobs)
    return recorded, calibrate.calibrate(recorded, *axes, config, prior)


def _old_map(path):
    """Return the map that is about to be replaced; ``None`` = there is none that can be read."""
    try:
        return None if output.is_stream(path) else load_value_map(path, allow_plateaus=True)
    except CarInterfaceError:
        return None


def _throttle(options):
    return load_throttle_table(options.throttle or str(package_file(THROTTLE)))


def _duty_channel(value):
    """Return the channel in --value duty:CHANNEL."""
    text = value[len(DUTY):]
    if not text.isdecimal() or int(text) >= CHANNELS:
        raise ConfigError("--value", value, f"a topic, or {DUTY}CHANNEL with a channel of 0 to 15")
    return int(text)
