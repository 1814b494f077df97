"""A steering calibration from recorded drives: for each turn radius the servo's duty, to both sides.

Drive for some minutes with everything recorded: slow circles to both sides at many positions of the stick, up to both
ends, each held for two seconds and, come back to from a little beyond, for two more; and straight on in between. Slow
enough that no tyre slides.

Writes YAML that turn_arb loads: servo_left, servo_center, servo_right and the two tables are new, everything else is as
in --base. Its head says from what the numbers are, and how well they are known.
"""
from __future__ import annotations

import argparse
import math
import re
from functools import partial
from pathlib import Path
from typing import Iterator, NamedTuple, Sequence

import numpy as np

from car_interface.calibration.steering import fit as fitting
from car_interface.calibration.steering.fit import Curve
from car_interface.calibration.steering.segments import Drive, FitConfig, NothingToFit
from car_interface.calibration.steering.table import (
    DRIVEN,
    LEFT,
    OLD,
    RIGHT,
    UNKNOWN,
    Breakpoint,
    axis,
    breakpoints,
    completed,
    widened,
)
from car_interface.cli import output
from car_interface.cli.jobs import add_jobs_argument, for_each
from car_interface.cli.options import add_namespace_argument
from car_interface.common.errors import CarInterfaceError, ConfigError
from car_interface.common.lookup_table import LookupTable, check_axis
from car_interface.common.package_files import package_file
from car_interface.recordings import signals
from car_interface.steering.calibration import WIDE_M, SteeringCalibration
from car_interface.steering.params import load_steering

BASE = "config/turn_arb.yaml"
AXIS, LEFT_TABLE, RIGHT_TABLE = "m_turnrad_axis_servo", "k_pwmcmd_left_table_servo", "k_pwmcmd_right_table_servo"
MIN_PULSE, MAX_PULSE = 1638, 8192  # duties that a servo takes for a command: 0.5 and 2.5 ms of 20
BIN_S, MIN_BIN_M, MAX_BIN_GAP_S = 1.0, 0.4, 0.3
IMU_GAP_S = 0.1
MIN_IMU_RATIO = 0.95  # of a drive that an IMU must have covered to be used
STRAIGHT_PER_M = 0.02
AGREES = 0.03  # so much odometry and IMU may turn apart without a word
MAX_BREAKPOINTS = 200
KEY = re.compile(r"^([A-Za-z_]\w*)\s*:")


class Refused(CarInterfaceError):
    """Drives that don't support a table."""


class Loaded(NamedTuple):
    """One recording."""

    drive: Drive
    notes: tuple[str, ...]
    duration_s: float
    uses_imu: bool
    trail: signals.Trail


class Calibrated(NamedTuple):
    """What is to be written."""

    curve: Curve
    center: float
    ends: dict  # duty, by side
    points: dict  # Breakpoints, by side
    problems: list[str]  # what is missing; empty = the drives support the table
    report: list[str]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of calibrate_steering."""
    parser.add_argument("bags", nargs="+", metavar="BAG", help="recordings of drives with one car")
    parser.add_argument("-o", "--output", required=True, metavar="YAML", help="where to write the calibration")
    parser.add_argument("--base", metavar="YAML", help="a calibration for turn_arb whose other parameters are kept, "
                        "and with --force its duties where nothing was driven (default: the package's)")
    parser.add_argument("--axis", type=_radii, metavar="M,M,…", help="turn radii for the tables, continued to 300 m "
                        "where they end below 100 m (default: from the tightest that was driven to 300 m, so near to "
                        "each other that lines between them are exact)")
    parser.add_argument("--force", action="store_true", help="write what would be refused; where nothing was driven "
                        "the old duties stay, marked")
    parser.add_argument("--channel", type=int, metavar="N", help="of the servo board (default: the base's)")
    parser.add_argument("--odom", default="odom", metavar="TOPIC", help="of odometry, any nav_msgs/Odometry "
                        "(default: odom)")
    parser.add_argument("--imu", metavar="TOPIC", help="of an IMU whose yaw rate is better than odometry's (default: "
                        f"{signals.IMU_TOPIC} where it was recorded; none = don't)")
    add_namespace_argument(parser)
    add_jobs_argument(parser)


def run(options: argparse.Namespace) -> int:
    """Calibrate, say how well, and write the file."""
    base_path = options.base or str(package_file(BASE))
    output.check(options.output, options.bags)
    base = load_steering(base_path)
    base_text = Path(base_path).read_text(encoding="utf-8-sig")
    done = calibrate(options, base)
    if done.problems and not options.force:
        print("\n".join(done.report))
        raise Refused("no calibration is written: " + "; ".join(done.problems)
                      + ". Give that recording as well, or keep the old duties there by --force")
    text = yaml_text(done, base_text)
    try:
        output.check_content(options.output, text, load_steering)
    except CarInterfaceError as error:
        raise Refused(f"no calibration is written, turn_arb would refuse it: {error}") from error
    aside = output.write(options.output, text, keeps_old=True)
    print("\n".join(done.report))
    print(f"written: {options.output}" + (f"; the old one is {aside}" if aside else ""))
    return 0


def calibrate(options: argparse.Namespace, base: SteeringCalibration) -> Calibrated:
    """The calibration that recordings support.

    Raises:
        CarInterfaceError: a recording is no good, or there is nothing to fit.
    """
    signals.check_twice(options.bags)
    loaded = list(for_each(partial(load, options=options, channel=_channel(options, base)), options.bags, options.jobs))
    signals.check_apart([one.trail for one in loaded])
    config = FitConfig(limits=(base.servo_left, base.servo_right))
    disagreement = _disagreement(options, loaded, config)
    if disagreement and not options.force:
        raise Refused(f"no calibration is written: {disagreement}? Give those that belong together")
    try:
        curve = fitting.fit([one.drive for one in loaded], config)
    except NothingToFit as error:
        raise Refused(f"{', '.join(options.bags)}: no steering can be told from this: {error}") from error
    _check_axis_was_driven(options.axis, curve)
    radii = widened(options.axis, WIDE_M) if options.axis else axis(curve)
    points = {side: breakpoints(curve, radii, side, config) for side in (LEFT, RIGHT)}
    problems = list(_warnings(curve, points))
    center = base.servo_center if math.isnan(curve.center) else curve.center
    ends = {LEFT: curve.left.duty, RIGHT: curve.right.duty}
    old_tables = {LEFT: base.left_duties, RIGHT: base.right_duties}
    old_ends = {LEFT: base.servo_left, RIGHT: base.servo_right}
    for side in (LEFT, RIGHT):
        old = LookupTable(base.radius_axis_m, old_tables[side])
        points[side] = completed(points[side], center, [old(radius) for radius in radii])
        if points[side][0].source == OLD:
            ends[side] = _outer(points[side][0].duty, old_ends[side], center)
    added = [radius for radius in radii if options.axis and radius > options.axis[-1]]
    report = list(_report(options, loaded, curve, points, problems, added))
    if disagreement:
        report.append(f"  {disagreement}?")
    return Calibrated(curve, center, ends, points, problems, report)


def load(path: str, options: argparse.Namespace, channel: int) -> Loaded:
    """What one recording tells.

    Raises:
        NoRecording: it can't be read, or lacks what is needed.
    """
    imu = None if options.imu == "none" else options.imu
    optional = () if options.imu == "none" else (signals.IMU,)
    found = signals.load(path, (signals.ODOM, signals.OUTPUT), optional=optional, namespace=options.namespace,
                         odom=options.odom, imu=imu, progress=True)
    odom, notes = found.odom, list(found.notes)
    yaw_rad, uses_imu = odom.yaw_rad, False
    if found.imu is not None:
        turned = _imu_heading(found)
        if turned is None:
            notes.append(f"{options.imu or signals.IMU_TOPIC} covers too little of the drive, or doesn't follow the "
                         "car's turning: not used")
        else:
            yaw_rad, uses_imu = turned.yaw_rad, True
            if abs(turned.ratio - 1) > AGREES:
                more = "more" if turned.ratio > 1 else "less"
                notes.append(f"odometry turns {abs(turned.ratio - 1):.0%} {more} than the IMU: measure track and "
                             "wheel_diameter")
    duty = found.output.duties[:, channel].astype(float)
    is_pulse = (duty >= MIN_PULSE) & (duty <= MAX_PULSE)
    if not is_pulse.any():
        raise Refused(f"{path}: channel {channel} of the servo board never had a servo's pulse")
    return Loaded(Drive(odom.t_s, distance_m(odom), yaw_rad, found.output.t_s, np.where(is_pulse, duty, np.nan)),
                  tuple(notes), found.duration_s, uses_imu, signals.trail(found))


def distance_m(odom: signals.Odom) -> np.ndarray:
    """The signed way at each row of odometry: its speed's, made as long altogether as that between its places.

    A speed tells small steps better, and which way they go; places tell long ones better.
    """
    dx, dy = np.diff(odom.x_m), np.diff(odom.y_m)
    if np.any(odom.speed_mps):
        steps_m = np.diff(odom.t_s) * (odom.speed_mps[1:] + odom.speed_mps[:-1]) / 2
    else:
        steps_m = np.hypot(dx, dy) * np.sign(dx * np.cos(odom.yaw_rad[:-1]) + dy * np.sin(odom.yaw_rad[:-1]))
    way = np.concatenate([[0.0], np.cumsum(steps_m)])
    return way * _stretch(odom, way)


def _stretch(odom, way):
    """How much longer the way between places is, over every second in which the car drove."""
    at_s = np.arange(odom.t_s[0], odom.t_s[-1], BIN_S)
    x_m, y_m, yaw_rad, by_speed = (np.diff(np.interp(at_s, odom.t_s, column))
                                   for column in (odom.x_m, odom.y_m, odom.yaw_rad, way))
    half_rad = np.clip(np.abs(yaw_rad) / 2, 1e-6, 1.5)
    by_places = np.hypot(x_m, y_m) * half_rad / np.sin(half_rad)  # an arc, not its chord
    drove = (np.abs(by_speed) > MIN_BIN_M) & (np.abs(yaw_rad) < 2.0) & ~_has_gap(odom.t_s, at_s)
    if drove.sum() < 5:
        return 1.0
    ratio = by_places[drove] / np.abs(by_speed[drove])
    usual = np.median(ratio)
    fine = np.abs(ratio - usual) < 0.1 * usual
    stretch = float(by_places[drove][fine].sum() / np.abs(by_speed[drove][fine]).sum()) if fine.any() else 1.0
    return stretch if 0.5 < stretch < 2.0 else 1.0


def _has_gap(t_s, at_s):
    """Which of the stretches from each moment to the next have a gap in odometry: nobody knows the way in there."""
    before = np.flatnonzero(np.diff(t_s) > MAX_BIN_GAP_S)
    begun = np.searchsorted(t_s[before], at_s[1:])  # gaps that began before a stretch's end
    ended = np.searchsorted(t_s[before + 1], at_s[:-1], side="right")  # and those that were over at its begin
    return begun > ended


class _ImuHeading(NamedTuple):
    yaw_rad: np.ndarray
    ratio: float  # of odometry's turning to the IMU's


def _imu_heading(found):
    """The IMU's yaw rate, less its offset, as a heading at odometry's times; ``None``: it's no use."""
    odom, imu = found.odom, found.imu
    inside = (odom.t_s >= imu.t_s[0]) & (odom.t_s <= imu.t_s[-1])
    gaps = np.diff(imu.t_s) > IMU_GAP_S
    covered = np.mean(inside) - np.sum(np.diff(imu.t_s)[gaps]) / max(odom.t_s[-1] - odom.t_s[0], 1e-9)
    if len(imu.t_s) < 100 or covered < MIN_IMU_RATIO:
        return None
    steps = np.diff(imu.t_s) * (imu.yaw_rate_radps[1:] + imu.yaw_rate_radps[:-1]) / 2
    turned = np.interp(odom.t_s, imu.t_s, np.concatenate([[0.0], np.cumsum(steps)]))
    # Heading after each second by both: ratio and offset by a straight line, twice, without what lies off it.
    at_s = np.arange(odom.t_s[0], odom.t_s[-1], 1.0)
    by_odom, by_imu = (np.diff(np.interp(at_s, odom.t_s, yaw)) for yaw in (odom.yaw_rad, turned))
    used = np.ones(len(by_odom), bool)
    for _ in range(3):
        if used.sum() < 10 or np.ptp(by_imu[used]) < 0.2:
            return None
        ratio, offset = np.polyfit(by_imu[used], by_odom[used], 1)
        off = np.abs(by_odom - ratio * by_imu - offset)
        used = off <= 4 * 1.4826 * np.median(off) + 1e-9
    if not 0.7 < ratio < 1.4:
        return None
    return _ImuHeading(turned + offset / ratio * (odom.t_s - odom.t_s[0]), float(ratio))


def _channel(options, base):
    channel = base.servo_channel if options.channel is None else options.channel
    if not 0 <= channel < 16:
        raise ConfigError("--channel", channel, "a channel of the servo board, 0 to 15")
    return channel


def _radii(text):
    try:
        radii = [float(part) for part in text.replace(",", " ").split()]
        check_axis(radii, "axis")
    except ValueError as error:
        like = "in m, with commas between them, like 0.7,1,2,5,20,100,300"
        raise argparse.ArgumentTypeError(f"{error} ({like})") from error
    if radii[0] <= 0 or len(radii) > MAX_BREAKPOINTS:
        raise argparse.ArgumentTypeError(f"accepted: at most {MAX_BREAKPOINTS} radii above 0 m")
    return radii


def _check_axis_was_driven(radii, curve):
    tightest_per_m = max(curve.left.curvature_per_m, curve.right.curvature_per_m)
    if radii and 1 / radii[-1] >= tightest_per_m:
        raise Refused(f"--axis {radii[0]:g} to {radii[-1]:g} m lies outside of what was driven: the tightest circle "
                      f"was one of {_radius(tightest_per_m)}")


def _outer(duty, other, center):
    """The one that is farther from the center."""
    return max(duty, other, key=lambda one: abs(one - center))


# --- in words ---


def _warnings(curve: Curve, points) -> Iterator[str]:
    if math.isnan(curve.center):
        yield "the car never went straight, nor to both sides: drive straight on for some seconds, three times"
    elif fitting.BAND * float(np.interp(curve.center, curve.duties, curve.sigmas)) > FitConfig().known_per_m:
        yield (f"where the car goes straight is known to ±{fitting.BAND * curve.center_sigma:.0f} duty only: drive "
               "straight on for some seconds, three times")
    for side in (LEFT, RIGHT):
        table = points[side]
        unknown = [point.source == UNKNOWN for point in table]
        index = 0
        while index < len(table):
            if not unknown[index]:
                index += 1
                continue
            last = index
            while last + 1 < len(table) and unknown[last + 1]:
                last += 1
            yield _gap(curve, side, table, index, last)
            index = last + 1


def _disagreement(options, loaded, config):
    """What the first two recordings say that can't be of the same steering; empty if there are none."""
    told = []
    for bag, one in zip(options.bags, loaded) if len(loaded) > 1 else ():
        try:
            told.append((bag, fitting.fit([one.drive], config)))
        except NothingToFit:
            continue  # it may still tell something beside the others
    for index, (bag, curve) in enumerate(told):
        for before, other in told[:index]:
            found = fitting.disagreement(other, curve)
            if found is not None:
                k = found.curvature_per_m
                place = (f"{LEFT if k > 0 else RIGHT} turns of {1 / abs(k):.2g} m" if abs(k) > STRAIGHT_PER_M else
                         "straight on")
                return (f"{before} and {bag} disagree by {found.duty:.0f} duty about {place}: was the linkage changed "
                        "between them")
    return ""


def _gap(curve, side, table, first, last):
    end = curve.left if side == LEFT else curve.right
    if first == 0 and last == len(table) - 1:
        return f"no data for {side} turns: drive slow {side} circles at ten positions of the stick, up to its end"
    if first == 0:
        tightest = max(table[last + 1].radius_m if last + 1 < len(table) else 0.0, table[last].radius_m)
        if end.curvature_per_m * table[0].radius_m < 1:
            tightest = 1 / end.curvature_per_m
        beyond = "beyond" if not end.is_stop else "around"
        about = float(f"{tightest:.2g}")
        return (f"no data for {side} turns tighter than {about:g} m: drive three slow {side} circles with duties "
                f"{beyond} {end.farthest_duty:.0f}, up to the end of the stick")
    wide = (" and wider" if last == len(table) - 1 else "" if first == last else f" to {table[last].radius_m:.3g} m")
    duties = sorted((table[first - 1].duty, table[min(last + 1, len(table) - 1)].duty))
    return (f"too little data for {side} turns of {table[first].radius_m:.3g} m{wide}: drive three slow ones with "
            f"duties from {duties[0]:.0f} to {duties[1]:.0f}, come to from both sides")


def _report(options, loaded: Sequence[Loaded], curve: Curve, points, problems,
            added: Sequence[float]) -> Iterator[str]:
    kept = curve.kept
    way = curve.pieces.distance_m[kept].sum()
    band = fitting.BAND
    yield (f"steering by {', '.join(Path(bag).name for bag in options.bags)}: "
           f"{sum(one.duration_s for one in loaded):.0f} s, {kept.sum()} pieces of steady steering, {way:.0f} m in them"
           + (", heading by the IMU" if all(one.uses_imu for one in loaded) else ""))
    for bag, one in zip(options.bags, loaded):
        for note in one.notes:
            yield f"  {bag}: {note}"
    left_out = ", ".join(f"{count} {reason}" for reason, count in curve.counts.items() if count)
    yield f"  left out (stretches): {left_out or 'none'}"
    yield (f"  the servo follows after {curve.delay.delay_s:.2f} s, with a lag of {curve.delay.lag_s:.2f} s; play in "
           f"the steering: {curve.backlash_duty:.0f} ± {band * curve.backlash_sigma:.0f} duty")
    off = np.abs(curve.pieces.curvature_per_m - curve.pieces.weights @ _at_knots(curve))[kept]
    yield f"  pieces lie off the curve by {np.median(off):.4f} 1/m (median), {np.percentile(off, 95):.4f} (95 %)"
    if not math.isnan(curve.center):
        yield f"  straight on: duty {curve.center:.0f} ± {band * curve.center_sigma:.0f}"
    for side, end in ((LEFT, curve.left), (RIGHT, curve.right)):
        why = ("the radius shrinks no more" if end.is_stop else "the end that was allowed" if end.is_end else
               "the farthest that was driven; the end was not reached")
        yield f"  {side}: duty {end.duty:.0f}, radius {_radius(end.curvature_per_m)}: {why}"
    if added:
        yield (f"  --axis ends at {options.axis[-1]:g} m: {added[0]:g} to {added[-1]:g} m are added, or turn_arb would "
               "turn as tight as there when asked for straight on")
    yield "  radius         left  ±duty   ±radius  pieces     m        right  ±duty   ±radius  pieces     m"
    for left, right in zip(points[LEFT], points[RIGHT]):
        yield f"  {left.radius_m:6g} m  {_cells(left)}   {_cells(right)}"
    yield "  (±: two standard errors; pieces: driven about as tight; e: the end, no tighter turn can be had;"
    yield "  *: nothing was driven)"
    for problem in problems:
        yield f"  missing: {problem}"


def _at_knots(curve):
    """The curve at all knots of the pieces' weights; those beyond what was driven have none."""
    made = np.zeros(curve.pieces.weights.shape[1])
    made[curve.first_knot:curve.first_knot + len(curve.curvatures)] = curve.curvatures
    return made


def _radius(curvature_per_m):
    return f"{1 / curvature_per_m:.2f} m" if curvature_per_m > 1e-6 else "none"


def _cells(point: Breakpoint):
    if point.source == OLD:
        return f"{point.duty:8.0f} *{'old':>26}{'':8}"
    mark = " " if point.source == DRIVEN else "e"
    share = min(9.99, fitting.BAND * point.radius_sigma_m / point.radius_m)
    return (f"{point.duty:8.0f}{mark} {min(9999, fitting.BAND * point.duty_sigma):5.0f} {share:8.1%} {point.pieces:7d} "
            f"{point.distance_m:6.0f}")


# --- the file ---


def yaml_text(done: Calibrated, base_text: str) -> str:
    """The base with the calibration's values; its own head gives way to one that tells of this one."""
    import yaml  # for tools: a node gets its parameters from ROS
    radii = [_plain(point.radius_m) for point in done.points[LEFT]]
    tables = {side: [round(point.duty) for point in done.points[side]] for side in (LEFT, RIGHT)}
    center = round(done.center)
    values = {
        "servo_left": round(done.ends[LEFT]), "servo_center": center, "servo_right": round(done.ends[RIGHT]),
        AXIS: radii, LEFT_TABLE: tables[LEFT], RIGHT_TABLE: tables[RIGHT],
    }
    head = ["# Written by calibrate_steering; turn_arb loads it. Duties are 0..65535 of the PWM period.", "#"]
    head += [f"# {line}".rstrip() for line in done.report]
    text = "\n".join(head) + "\n\n" + "\n".join(_with(values, base_text)) + "\n"
    wanted = {**yaml.safe_load(base_text), **values}
    if yaml.safe_load(text) != wanted:
        # A base that isn't laid out a parameter a line: its values count, not its looks.
        text = "\n".join(head) + "\n\n" + yaml.safe_dump(wanted, sort_keys=False)
    return text


def _with(values, base_text):
    """The base's lines, those of some keys replaced."""
    left = dict(values)
    is_replaced, has_begun = False, False
    for line in base_text.splitlines():
        key = KEY.match(line)
        if key:
            has_begun = True
            is_replaced = key.group(1) in values
            if key.group(1) in left:
                yield _line(key.group(1), left.pop(key.group(1)))
        elif not line.strip() or line.startswith("#"):
            is_replaced = False
        if has_begun and not is_replaced:
            yield line
    for key, value in left.items():
        yield _line(key, value)


def _line(key, value):
    return f"{key}: [{', '.join(map(str, value))}]" if isinstance(value, list) else f"{key}: {value}"


def _plain(number):
    return int(number) if number == int(number) else number
