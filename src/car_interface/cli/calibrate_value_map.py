"""A value map from recorded drives: acceleration and velocity to the value that makes it.

Drive for some minutes with everything recorded: throttle and brake of every strength at every speed, coasting, straight
on rather than in tight turns, and in all directions of the compass, so that a slope can be told from drag.

Writes the map as a CSV for generic_value_converter, and beside it NAME.report.txt: what each number rests on.
"""
from __future__ import annotations

import argparse
from functools import partial
from pathlib import Path
from typing import NamedTuple, Sequence

import numpy as np

from car_interface.calibration.value_map import fit as fitting
from car_interface.calibration.value_map import table as tables
from car_interface.calibration.value_map.acceleration import Drive, Series, WindowConfig
from car_interface.cli import output
from car_interface.cli.jobs import add_jobs_argument, for_each
from car_interface.cli.options import add_namespace_argument, finite
from car_interface.common.errors import CarInterfaceError, ConfigError
from car_interface.common.lookup_table import LookupTable, check_axis
from car_interface.common.package_files import package_file
from car_interface.common.params import Params
from car_interface.common.servo_channels import CHANNELS, MAX_DUTY
from car_interface.recordings import signals
from car_interface.recordings.recording import NoRecording
from car_interface.steering.params import load_yaml
from car_interface.throttle.value_map import ValueMap, load_value_map

VALUE_TOPIC = "generic/output/value"
ESC_CHANNEL, ESC_NEUTRAL = 1, 4915  # as config/throttle.yaml has them
DUTY = "duty:"
PULSES, ODOM, IMU = "pulses", "odom", "imu"
SHORTEST_DUTY, MAX_PULSE_DUTY = 1638, 8192  # 0.5 and 2.5 ms: an ESC takes anything beyond for no pulse
VALUE_SILENT_S, DUTY_SILENT_S = 0.5, 1.2  # a duty is repeated only now and then
COUNT = 16  # of duty: what the servo board can tell apart
THROTTLE = "config/throttle.yaml"
SETTLED_S = 0.15  # from a value to its duty on the board
CALIBRATED_PULSES = 200  # so many tell how long one is
GAP_S = 0.3  # odometry comes at least every 0.2 s
WORST_HELD_OUT_MPS2 = 0.5
MIN_RATIO = 0.25  # of a map that the drives themselves state
SYMBOLS = {tables.DRIVEN: "#", tables.BETWEEN: "+", tables.OLD: "o", tables.MOVED: "m"}


class Refused(CarInterfaceError):
    """Drives that don't support a map."""


class Loaded(NamedTuple):
    """A recording's drive, and what of it was left out."""

    drive: Drive
    notes: tuple[str, ...]
    trail: signals.Trail


class Values(NamedTuple):
    """The values that stand for an ESC's duties: generic_value_converter's table, the other way round."""

    of_duty: LookupTable
    neutral: float
    path: str

    def __call__(self, duty: np.ndarray) -> np.ndarray:
        """The value for each duty; NaN for one that no value makes. The board's rounding is none of that."""
        duties = self.of_duty.axis
        makes = (duty >= duties[0] - COUNT) & (duty <= duties[-1] + COUNT)
        return np.where(makes, np.interp(duty, duties, self.of_duty.values), np.nan)


class Calibrated(NamedTuple):
    """A map, and all that is known about it."""

    table: tables.Table
    fit: fitting.Fit
    problems: list[str]  # why it should not be written; empty = it may be
    text: str  # the report


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of calibrate_value_map."""
    parser.add_argument("bags", nargs="+", metavar="BAG", help="recordings of drives with one car")
    parser.add_argument("-o", "--output", required=True, metavar="CSV", help="where to write the map")
    parser.add_argument("--prior", metavar="CSV", help="an existing map: its numbers stay where the drives tell "
                        "nothing, and its axes are used unless others are given")
    parser.add_argument("--force", action="store_true", help="write what would be refused; nothing is made up even so")
    parser.add_argument("--value", default=VALUE_TOPIC, metavar="TOPIC|duty:CHANNEL",
                        help="what drives the car: a topic, or the duty of a channel of the servo board, which counts "
                             f"as the value that --throttle has for it (default: {VALUE_TOPIC})")
    parser.add_argument("--throttle", metavar="YAML", help="for --value duty:CHANNEL: the file with the value_axis and "
                        "the duty_table by which generic_value_converter drives the ESC (default: the package's)")
    parser.add_argument("--neutral", type=finite, metavar="VALUE", help="the value that neither drives nor brakes "
                        "(default: 0; for a duty the value of the neutral in --throttle)")
    parser.add_argument("--values", type=finite, nargs="+", metavar="VALUE",
                        help="the map's values (default: --prior's, or round numbers over what was driven)")
    parser.add_argument("--velocities", type=finite, nargs="+", metavar="M/S",
                        help="the map's velocities (as --values)")
    parser.add_argument("--acceleration", choices=(PULSES, ODOM, IMU),
                        help="measure it by the wheels' pulses, odometry's speed, or the IMU (default: pulses where "
                             "they were recorded, else odometry)")
    parser.add_argument("--odom", default="odom", metavar="TOPIC", help="of odometry (default: odom)")
    parser.add_argument("--imu", metavar="TOPIC", help="of an IMU, such as imu/data: its pitch takes gravity off")
    add_namespace_argument(parser)
    parser.add_argument("--delay", type=finite, metavar="S", help="from value to acceleration (default: estimated)")
    parser.add_argument("--esc-channel", type=int, default=ESC_CHANNEL, metavar="CHANNEL",
                        help="of the servo board: shows whether a value reached the ESC; -1 = don't look "
                             f"(default: {ESC_CHANNEL})")
    parser.add_argument("--esc-neutral", type=finite, default=ESC_NEUTRAL, metavar="DUTY",
                        help=f"its duty when nobody drives (default: {ESC_NEUTRAL})")
    parser.add_argument("--min-speed", type=finite, default=0.3, metavar="M/S", help="slower is a stop (default: 0.3)")
    parser.add_argument("--max-curvature", type=finite, default=0.6, metavar="1/M",
                        help="of the path; tighter is steering (default: 0.6)")
    parser.add_argument("--max-lateral", type=finite, default=2.5, metavar="M/S2",
                        help="acceleration sideways; more is steering (default: 2.5)")
    add_jobs_argument(parser)


def run(options: argparse.Namespace) -> int:
    """Calibrate, say how well, and write the files."""
    output.check(options.output, options.bags)
    beside = [] if output.is_stream(options.output) else [str(Path(options.output).with_suffix(".report.txt"))]
    for path in beside:
        output.check(path, options.bags)
    done = calibrate(options)
    if done.problems and not options.force:
        print(done.text)
        raise Refused("no map is written: " + "; ".join(done.problems) + ". Drive what is missing, or --force it")
    text = csv_text(done.table)
    output.check_content(options.output, text, load_value_map)
    written = {options.output: output.write(options.output, text, keeps_old=True)}
    for path in beside:
        written[path] = output.write(path, done.text + "\n", keeps_old=True)
    print(done.text)
    for path, aside in written.items():
        print(f"written: {path}" + (f"; the old one is {aside}" if aside else ""))
    return 0


def calibrate(options: argparse.Namespace) -> Calibrated:
    """The map that recordings support.

    Raises:
        CarInterfaceError: an option, a recording or the prior is no good, or there is nothing to fit.
    """
    esc = load_values(options.throttle or str(package_file(THROTTLE))) if _is_duty(options) else None
    neutral = options.neutral if options.neutral is not None else esc.neutral if esc else 0.0
    prior = load_value_map(options.prior) if options.prior else None
    values, velocities = (_axis(given, name, old) for given, name, old in (
        (options.values, "--values", prior.values if prior else None),
        (options.velocities, "--velocities", prior.velocities if prior else None)))
    if _is_duty(options):
        _channel(options)
    if not -1 <= options.esc_channel < CHANNELS:
        raise ConfigError("--esc-channel", options.esc_channel, "a channel of the servo board, 0 to 15, or -1")
    if options.acceleration == IMU and not options.imu:
        raise ConfigError("--imu", options.imu, f"the IMU's topic, as --acceleration {IMU} needs it")
    signals.check_twice(options.bags)
    loaded = list(for_each(partial(load, options=options, esc=esc), options.bags, options.jobs))
    signals.check_apart([one.trail for one in loaded])
    drives = [one.drive for one in loaded]
    config = fitting.FitConfig(
        window=WindowConfig(slowest_mps=options.min_speed, max_curvature_per_m=options.max_curvature,
                            max_lateral_mps2=options.max_lateral),
        neutral=neutral, value_silent_s=DUTY_SILENT_S if _is_duty(options) else VALUE_SILENT_S,
        delay_s=options.delay, from_imu=options.acceleration == IMU)
    try:
        fit = fitting.fit(drives, values, velocities, config)
    except fitting.NothingToFit as error:
        raise Refused(f"nothing in {', '.join(options.bags)} tells an acceleration: {error}") from error
    table = tables.table(fit, neutral, _prior_at(prior, fit))
    if table is None:
        print(_coverage(fit, None))
        raise Refused(f"no map is written: {', '.join(options.bags)} support no two values at the same two velocities; "
                      "drive longer, with throttle and brake of several strengths")
    problems = list(_warnings(fit, table))
    return Calibrated(table, fit, problems, "\n".join(_report(options, loaded, esc, fit, table, problems)))


def load(path: str, options: argparse.Namespace, esc: Values | None = None) -> Loaded:
    """What one recording tells, as the calibration takes it; with ``esc`` by the duties of the channel in --value.

    Raises:
        NoRecording: it can't be read, or lacks what is needed.
    """
    wanted, optional = [signals.ODOM, signals.OUTPUT if esc else signals.VALUE], []
    if options.acceleration == PULSES:
        wanted.append(signals.PULSES)
    elif options.acceleration is None:
        optional.append(signals.PULSES)
    if not esc and options.esc_channel >= 0:
        optional.append(signals.OUTPUT)
    found = signals.load(path, wanted, optional=optional, namespace=options.namespace, odom=options.odom,
                         imu=options.imu, value=options.value, progress=len(options.bags) == 1 or options.jobs == 1)
    speed, notes = Series(found.odom.t_s, found.odom.speed_mps), found.notes
    wheels = wheel_distances(found.pulses or (), speed)
    if options.acceleration == PULSES and not wheels:
        raise NoRecording(f"{path} has too few pulses of the wheels on {signals.WHEEL_TOPIC}: "
                          f"try --acceleration {ODOM}")
    driven = None
    if esc:
        duty = found.output.duties[:, _channel(options)]
        is_pulse = (duty >= SHORTEST_DUTY) & (duty <= MAX_PULSE_DUTY)
        value = Series(found.output.t_s, np.where(is_pulse, esc(duty), np.nan))
        notes += _beyond(value, is_pulse, esc)
    else:
        value = Series(found.value.t_s, found.value.value)
        if found.output is not None and options.esc_channel >= 0:
            driven = reached(value, Series(found.output.t_s, found.output.duties[:, options.esc_channel]),
                             options.neutral or 0.0, options.esc_neutral)
    imu = pitch = None
    if found.imu is not None:
        imu = Series(found.imu.t_s, found.imu.acceleration_mps2)
        if np.isfinite(found.imu.pitch_rad).all():
            pitch = Series(found.imu.t_s, found.imu.pitch_rad)
    drive = Drive(Path(path).name, value, speed, Series(found.odom.t_s, found.odom.yaw_rad), wheels, imu, pitch, driven)
    return Loaded(drive, notes, signals.trail(found))


def load_values(path: str) -> Values:
    """An ESC's table out of a file with the converter's parameters, the other way round.

    Raises:
        ConfigError: naming the file, and what in it is no table, or none that can be turned round.
    """
    params = Params(load_yaml(path))
    try:
        duties = params.numbers("servo/duty_table", low=0, high=MAX_DUTY)
        values = LookupTable(params.numbers("servo/value_axis"), duties, "servo/value_axis", "servo/duty_table").axis
        neutral = params.integer("servo/neutral", low=0, high=MAX_DUTY)
        steps = np.diff(duties)
        if not (np.all(steps > 0) or np.all(steps < 0)):
            raise ConfigError("servo/duty_table", duties, "duties that only rise, or only fall: each is a value's")
        if not min(duties) <= neutral <= max(duties):
            raise ConfigError("servo/neutral", neutral, "a duty within the range of servo/duty_table")
    except ConfigError as error:
        raise error.within(path) from error
    of_duty = LookupTable(*zip(*sorted(zip(duties, values))))
    return Values(of_duty, of_duty(neutral), path)


def wheel_distances(pulses: Sequence, speed: Series) -> tuple[Series, ...]:
    """The wheels' ways out of their pulses; how long a pulse is, is what odometry makes of it.

    Returns:
        Nothing, unless both wheels made enough pulses.
    """
    if len(pulses) != 2 or speed.t_s.size < 2:
        return ()
    steps_s = np.diff(speed.t_s)
    distance_m = np.concatenate(([0.0], np.cumsum(steps_s * (speed.y[1:] + speed.y[:-1]) / 2)))
    unknown_s = np.concatenate(([0.0], np.cumsum(np.where(steps_s > GAP_S, steps_s, 0.0))))
    ways = []
    for wheel in pulses:
        t_s, count = np.asarray(wheel.t_s, float), np.asarray(wheel.count, float)
        if t_s.size < 2:
            return ()
        fresh = np.concatenate(([True], np.diff(count) != 0))  # a report without a new pulse repeats the old one's time
        ways.append(Series(t_s[fresh], count[fresh]))
    if min(way.t_s.size for way in ways) < CALIBRATED_PULSES:
        return ()
    rolled_m = counted = 0.0
    for way in ways:
        # How far it rolled while nothing was recorded of its speed nobody knows; its pulses count on meanwhile.
        known = np.diff(np.interp(way.t_s, speed.t_s, unknown_s)) == 0
        rolled_m += np.abs(np.diff(np.interp(way.t_s, speed.t_s, distance_m)))[known].sum()
        counted += np.abs(np.diff(way.y))[known].sum()
    if rolled_m <= 0 or counted < CALIBRATED_PULSES:
        return ()
    pulse_m = rolled_m / counted
    return tuple(Series(way.t_s, way.y * pulse_m) for way in ways)


def reached(value: Series, duty: Series, neutral: float, neutral_duty: float) -> Series | None:
    """Whether the value was what the ESC got: not while the ESC stood at neutral and the value did not."""
    if duty.t_s.size == 0 or value.t_s.size == 0 or np.ptp(duty.y) <= COUNT:
        return None
    apart = np.abs(value.y - neutral) > 0.05 * max(np.ptp(value.y), 1e-9)
    last = np.maximum(np.searchsorted(value.t_s, duty.t_s, side="right") - 1, 0)
    earlier = np.maximum(np.searchsorted(value.t_s, duty.t_s - SETTLED_S, side="right") - 1, 0)
    idle = np.abs(duty.y - neutral_duty) <= COUNT
    return Series(duty.t_s, np.where(idle & apart[last] & apart[earlier], 0.0, 1.0))


def csv_text(table: tables.Table) -> str:
    """The map as generic_value_converter loads it."""
    lines = ["default," + ",".join(_number(velocity) for velocity in table.velocities)]
    for value, row in zip(table.values, table.accelerations):
        lines.append(_number(value) + "," + ",".join(f"{cell:.{fitting.DECIMALS}f}" for cell in row))
    return "\n".join(lines) + "\n"


# --- words ---

def _report(options, loaded, esc, fit, table, problems):
    """The report's lines."""
    drives = [one.drive for one in loaded]
    yield f"A value map from {', '.join(drive.name for drive in drives)}"
    yield f"value: {options.value}; accelerations by {_source(options, drives)}"
    if esc:
        yield (f"a duty counts as the value of which {esc.path} makes it: {esc.of_duty.axis[0]:g} is "
               f"{esc.of_duty.values[0]:g}, {esc.of_duty.axis[-1]:g} is {esc.of_duty.values[-1]:g}")
    if options.prior:
        yield f"prior: {options.prior}"
    yield from (f"{one.drive.name}: {note}" for one in loaded for note in one.notes)
    yield ""
    sure = "" if not fit.delay_sigma_s >= 0 else f" ± {max(1.0, 1000 * fit.delay_sigma_s):.0f}"
    how = "given" if options.delay is not None else "estimated" if sure else "the drives don't tell it"
    yield f"from value to acceleration: {1000 * fit.delay_s:.0f}{sure} ms ({how})"
    for drive, ground in zip(drives, fit.grounds):
        yield f"{drive.name}: {_ground(ground, drive.pitch is not None, options.acceleration == IMU)}"
    yield ""
    windows = sum(fit.rejected.values())
    yield f"windows of {WindowConfig().window_s:g} s: {windows}, of which count {fit.rejected['counted']}; the others:"
    yield from (f"  {number:6d}  {text}" for text, number in fit.rejected.items() if number and text != "counted")
    yield ""
    yield f"error of single windows: {fit.residual_mps2:.3f} m/s² RMS"
    if fit.held_out_windows:
        yield (f"held out (every {fitting.HELD_OUT}th manoeuvre, from the others): {fit.held_out_mps2:.3f} m/s² RMS "
               f"over {fit.held_out_windows} windows")
    yield ""
    yield _coverage(fit, table)
    yield ""
    count = table.accelerations.size
    yield (f"the map: {table.values.size} values, {_number(table.values[0])} to {_number(table.values[-1])}; "
           f"{table.velocities.size} velocities, {_number(table.velocities[0])} to {_number(table.velocities[-1])} m/s")
    for origin, text in ((tables.DRIVEN, "driven"), (tables.BETWEEN, "between what was driven"),
                         (tables.OLD, "the prior's"), (tables.MOVED, "the prior's, moved so that its column rises")):
        number = int((table.origin == origin).sum())
        if number:
            yield f"  {SYMBOLS[origin]}  {number} of {count} {text}"
    yield from (f"missing: {text}" for text in _missing(fit))
    if table.velocities[0] <= 0:
        yield ("at 0 m/s the map says what holds as the car just rolls forward; from standstill an ESC holds or "
               "reverses where it says brake")
    level = _level_rows(table)
    if level:
        yield (f"from value {_number(level[0])} to {_number(level[1])} acceleration hardly changes: the ESC's neutral "
               "band, in which the map rises only as its CSV needs it")
    yield ""
    yield "standard error in m/s²"
    yield from _grid(fit.values, fit.velocities, fit.sigma_mps2, "{:.3f}")
    yield ""
    yield "seconds of driving"
    yield from _grid(fit.values, fit.velocities, fit.seconds, "{:.1f}")
    if problems:
        yield ""
        yield from (f"not good enough: {problem}" for problem in problems)


def _beyond(value, is_pulse, esc):
    """A note of duties that no value makes."""
    count = int((is_pulse & np.isnan(value.y)).sum())
    low, high = esc.of_duty.axis[0], esc.of_duty.axis[-1]
    note = f"{count} of {value.y.size} duties lie beyond {low:g} to {high:g}, where {esc.path} has no value: left out"
    return (note,) if count else ()


def _source(options, drives):
    if options.acceleration == IMU:
        return "the IMU, its bias by the wheels"
    return "pulse times of the wheels" if all(drive.wheels for drive in drives) else "odometry's speed"


def _ground(ground, has_pitch, from_imu):
    if from_imu:
        slope = "gravity is in what an accelerometer feels"
    elif has_pitch:
        slope = f"gravity taken off by pitch, less {np.degrees(ground.pitch_offset_rad):.2f}° of its mounting"
    elif np.isfinite(ground.uphill[0]):
        slope = (f"ground rises by {100 * np.hypot(*ground.uphill):.2f} % towards yaw "
                 f"{np.degrees(np.arctan2(ground.uphill[1], ground.uphill[0])):.0f}°, taken off")
    else:
        slope = "headings don't spread: a slope, if there is one, is in the map"
    return (f"{slope}; drive fell by {100 * ground.sag_above:.1f} ± {100 * ground.sag_sigma[0]:.1f} %, brake by "
            f"{100 * ground.sag_below:.1f} ± {100 * ground.sag_sigma[1]:.1f} %: the map is that of the middle")


def _coverage(fit, table):
    """Which accelerations the drives state, as a picture; those in the map as it's written by symbols of their own."""
    cells = np.where(fit.supported, "#" if table is None else "(#)", ".").astype(object)
    if table is not None:
        inside = np.ix_(np.searchsorted(fit.values, table.values), np.searchsorted(fit.velocities, table.velocities))
        cells[inside] = np.vectorize(SYMBOLS.get, otypes=[object])(table.origin)
    lines = ["what was driven: # enough, . not enough" + (", (#) enough, but cut off" if table is not None else "")]
    return "\n".join([*lines, *_grid(fit.values, fit.velocities, cells, "{}")])


def _grid(values, velocities, cells, form):
    yield f"{'value':>9} |" + "".join(f"{_number(velocity):>7}" for velocity in velocities) + " m/s"
    for value, row in zip(values[::-1], cells[::-1]):
        yield f"{_number(value):>9} |" + "".join(f"{form.format(cell):>7}" for cell in row)


def _missing(fit):
    """What to drive, a line for each value."""
    for value, row in zip(fit.values[::-1], fit.supported[::-1]):
        gaps = np.flatnonzero(~row)
        if gaps.size == row.size:
            yield f"value {_number(value)}: at any speed"
        elif gaps.size:
            runs = [fit.velocities[run] for run in np.split(gaps, np.flatnonzero(np.diff(gaps) > 1) + 1)]
            yield f"value {_number(value)}: at " + ", ".join(
                _number(run[0]) + (f" to {_number(run[-1])}" if run.size > 1 else "") for run in runs) + " m/s"


def _warnings(fit, table):
    """Why the map should not be written."""
    if min(table.accelerations.shape) < tables.MIN_NODES:
        yield (f"the drives support only {table.values.size} values at {table.velocities.size} velocities, "
               f"less than {tables.MIN_NODES} each")
    if table.share() < MIN_RATIO:
        yield f"the drives tell only {100 * table.share():.0f} % of the map, the rest is the prior's"
    if fit.held_out_mps2 > WORST_HELD_OUT_MPS2:
        yield (f"it misses what was held out by {fit.held_out_mps2:.2f} m/s² RMS: something else than value and "
               "velocity moves this car")


def _level_rows(table):
    """The values around neutral between which acceleration rises no more than it must."""
    steps = np.median(np.diff(table.accelerations, axis=0), axis=1)
    level = np.flatnonzero(steps <= 2 * fitting.MIN_STEP_MPS2)
    return (table.values[level[0]], table.values[level[-1] + 1]) if level.size else None


def _prior_at(prior: ValueMap | None, fit):
    """Its accelerations at the fit's nodes, NaN beyond it."""
    if prior is None:
        return None
    inside = np.outer((fit.values >= prior.values[0]) & (fit.values <= prior.values[-1]),
                      (fit.velocities >= prior.velocities[0]) & (fit.velocities <= prior.velocities[-1]))
    table = [[prior.acceleration_at(value, velocity) for velocity in fit.velocities] for value in fit.values]
    return np.where(inside, np.array(table), np.nan)


def _axis(given, name, old):
    if given is None:
        return None if old is None else np.array(old)
    check_axis(given, name)
    return np.array(given, float)


def _is_duty(options):
    return options.value.startswith(DUTY)


def _channel(options):
    text = options.value[len(DUTY):]
    if not text.isdecimal() or int(text) >= CHANNELS:
        raise ConfigError("--value", options.value, f"a topic, or {DUTY}CHANNEL with a channel of 0 to 15")
    return int(text)


def _number(x):
    return repr(round(float(x), 9))

