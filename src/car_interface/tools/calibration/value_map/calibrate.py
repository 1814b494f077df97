"""Fits a value map to recorded drives: the part that may be written, as nothing is invented, its CSV, why it should not
be written, and the report.
"""
from __future__ import annotations

from pathlib import Path
from typing import NamedTuple, Sequence

import numpy as np

from car_interface.common.errors import CarInterfaceError
from car_interface.throttle.value_map import ValueMap
from car_interface.tools.calibration.shared import NothingToFit, RecordedDrive, names_of, runs
from car_interface.tools.calibration.value_map import fit as fitting
from car_interface.tools.calibration.value_map.recorded import BY_IMU, MapConfig
from car_interface.tools.calibration.value_map.surface import (
    DECIMALS,
    MIN_STEP_MPS2,
    RESOLUTION_MPS2,
    rising_column,
    rounded,
)
from car_interface.tools.calibration.value_map.windows import WINDOW_S

MAX_HELD_OUT_MPS2 = 0.5
MIN_DRIVEN_RATIO = 0.25  # of a map that the drives themselves state
MIN_NODES = 3  # values, and velocities, of a map that is fit to drive with
BRACKET = 2  # nodes: this near on both sides must be supported ones
# The source of an acceleration: the drives; drives next to it on both sides, and as sure; an old map; an old map, moved
# because its column would not have risen.
DRIVEN, BETWEEN, OLD, MOVED = range(4)
SYMBOLS = {DRIVEN: "#", BETWEEN: "+", OLD: "o", MOVED: "m"}


class Table(NamedTuple):
    """A map of R values and C velocities, as it is written."""

    values: np.ndarray  # those of the fit, or part of it, (R,); so are the next two
    velocities: np.ndarray  # (C,)
    accelerations: np.ndarray  # (R, C)
    origin: np.ndarray  # of each acceleration: DRIVEN, BETWEEN, OLD or MOVED, (R, C)


class MapResult(NamedTuple):
    """A map, and all that is known about it."""

    table: Table | None  # ``None`` = the drives support none
    fit: fitting.Fit
    problems: list[str]  # why it should not be written; empty = it may be


def calibrate(recorded: Sequence[RecordedDrive], values: Sequence[float] | None, velocities_mps: Sequence[float] | None,
              config: MapConfig, prior: ValueMap | None = None) -> MapResult:
    """Fit a map to recorded drives.

    Args:
        values, velocities_mps: the map's axes; ``None`` = chosen by what was driven.
        prior: an old map, which stays where the drives support nothing.

    Raises:
        CarInterfaceError: there is nothing to fit.
    """
    try:
        fit = fitting.fit([one.drive for one in recorded], values, velocities_mps, config)
    except NothingToFit as error:
        raise CarInterfaceError(f"nothing in {names_of(recorded)} tells an acceleration: {error}") from error
    table = supported_table(fit, config.neutral, _prior_at_nodes(prior, fit))
    return MapResult(table, fit, [] if table is None else list(_problems(fit, table)))


def _problems(fit, table):
    """Yield why the map should not be written."""
    if min(table.accelerations.shape) < MIN_NODES:
        yield (f"the drives support only {table.values.size} values at {table.velocities.size} velocities, "
               f"less than {MIN_NODES} each")
    driven_ratio = float(np.mean(table.origin <= BETWEEN))
    if driven_ratio < MIN_DRIVEN_RATIO:
        yield f"the drives tell only {100 * driven_ratio:.0f} % of the map, the rest is the prior's"
    if fit.held_out_mps2 > MAX_HELD_OUT_MPS2:
        yield (f"it misses what was held out by {fit.held_out_mps2:.2f} m/s² RMS: something else than value and "
               "velocity moves this car")


def _prior_at_nodes(prior, fit):
    """Return the prior's accelerations at the fit's nodes (R, C), NaN beyond it."""
    if prior is None:
        return None
    inside = np.outer((fit.values >= prior.values[0]) & (fit.values <= prior.values[-1]),
                      (fit.velocities >= prior.velocities[0]) & (fit.velocities <= prior.velocities[-1]))
    table = [[prior.acceleration_at(value, velocity) for velocity in fit.velocities] for value in fit.values]
    return np.where(inside, np.array(table), np.nan)


# --- the table ---


def supported_table(fit: fitting.Fit, neutral: float, prior: np.ndarray | None = None) -> Table | None:
    """Return the part of a fit that may be written.

    Where the drives support nothing the prior's accelerations stay; one that contradicts the measured ones of its
    column is moved so that the column rises. Without a prior the axes are limited to the largest part in which every
    node is supported.

    Args:
        neutral: the value at which the car coasts: the map should have values on both sides of it.
        prior: an old map's accelerations at the fit's nodes, (R, C), NaN where it has none.

    Returns:
        The table, with at least two values and velocities, or ``None``.
    """
    origin = np.where(fit.supported, DRIVEN, np.where(_between(fit), BETWEEN, OLD))
    has_prior = False if prior is None else np.isfinite(prior)
    part = _largest_part((origin != OLD) | has_prior, fit.values, fit.velocities, neutral)
    if part is None:
        return None
    origin = origin[part]
    old = origin == OLD
    wanted = fit.accelerations[part]
    if old.any():
        wanted = np.where(old, prior[part], wanted)
        weight = np.where(old, 1.0, 1e9)  # measured ones don't move
        risen = np.array(list(map(rising_column, wanted.T, weight.T))).T
        origin[old & (np.abs(risen - wanted) > RESOLUTION_MPS2)] = MOVED
        wanted = risen
    return Table(fit.values[part[0].ravel()], fit.velocities[part[1].ravel()], rounded(wanted), origin)


def _between(fit):
    """Return which nodes have supported ones on both sides, and are known as well (R, C)."""
    def on_both_sides(known):
        padded = np.pad(known, [(BRACKET, BRACKET), (0, 0)])
        shifted = [padded[begin:begin + len(known)] for begin in range(2 * BRACKET + 1)]
        return np.any(shifted[:BRACKET], axis=0) & np.any(shifted[BRACKET + 1:], axis=0)
    return (on_both_sides(fit.supported) | on_both_sides(fit.supported.T).T) & ~fit.supported & fit.sure


def _largest_part(stated, values, velocities, neutral):
    """Rows and columns of the largest part of a map in which every node is stated: at least two each, or ``None``.

    Its velocities are consecutive. Up to BRACKET consecutive values may be left out: the map is linear over them. Its
    size is the product of its ranges; a part that both drives and brakes is preferred, and one with less than MIN_NODES
    of either is the last choice.
    """
    best, largest = None, 0.0
    for first in range(velocities.size - 1):
        for last in range(first + 1, velocities.size):
            whole = np.flatnonzero(stated[:, first:last + 1].all(axis=1))
            for rows in np.split(whole, np.flatnonzero(np.diff(whole) > BRACKET + 1) + 1):
                if rows.size < 2:
                    continue
                low, high = values[rows[0]], values[rows[-1]]
                sides = 4.0 if low < neutral < high else 2.0 if low <= neutral <= high else 1.0
                few = 0.01 if min(rows.size, last - first + 1) < MIN_NODES else 1.0
                size = few * sides * (high - low) * (velocities[last] - velocities[first])
                if size > largest:
                    best, largest = np.ix_(rows, np.arange(first, last + 1)), size
    return best


def csv_text(written: Table) -> str:
    """Return the map's CSV, as generic_value_converter loads it."""
    rows = [["default", *map(number_text, written.velocities)],
            *([number_text(value), *(f"{cell:.{DECIMALS}f}" for cell in row)]
              for value, row in zip(written.values, written.accelerations))]
    return "".join(",".join(row) + "\n" for row in rows)


def number_text(x: float) -> str:
    """Return a number on an axis, without the errors of binary fractions."""
    return repr(round(float(x), 9))


# --- the report ---


def report(recorded: Sequence[RecordedDrive], config: MapConfig, found: MapResult,
           prior_path: str | None = None) -> str:
    """Return the report's text."""
    table, fit, problems = found
    sections = (
        _source_lines(recorded, config, prior_path), _delay_and_ground_lines(recorded, config, fit),
        _window_lines(fit), [coverage_text(fit, table)], _map_lines(fit, table),
        ["standard error in m/s²", *_grid(fit.values, fit.velocities, fit.sigma_mps2, "{:.3f}")],
        ["seconds of driving", *_grid(fit.values, fit.velocities, fit.seconds, "{:.1f}")],
        [f"not good enough: {problem}" for problem in problems])
    return "\n\n".join(filter(None, map("\n".join, sections)))


def _source_lines(recorded, config, prior_path):
    names = [Path(one.path).name for one in recorded]
    yield f"A value map from {', '.join(names)}"
    measured_by = ("the IMU, its bias by the wheels" if config.measured_by == BY_IMU else "pulse times of the wheels"
                   if all(one.drive.wheels for one in recorded) else "odometry's speed")
    yield f"value: {config.value_name}; accelerations by {measured_by}"
    if config.throttle:
        duties, values = config.throttle.duties, config.throttle.values
        yield (f"a duty counts as the value of which {config.throttle.path} makes it: {duties[0]:g} is {values[0]:g}, "
               f"{duties[-1]:g} is {values[-1]:g}")
    if prior_path:
        yield f"prior: {prior_path}"
    yield from (f"{name}: {note}" for name, one in zip(names, recorded) for note in one.notes)


def _delay_and_ground_lines(recorded, config, fit):
    has_sigma = fit.delay_sigma_s >= 0
    sigma = f" ± {max(1.0, 1000 * fit.delay_sigma_s):.0f}" if has_sigma else ""
    how = "given" if config.delay_s is not None else "estimated" if has_sigma else "the drives don't tell it"
    yield f"from value to acceleration: {1000 * fit.delay_s:.0f}{sigma} ms ({how})"
    for one, ground in zip(recorded, fit.grounds):
        if config.measured_by == BY_IMU:
            slope = "gravity is in what an accelerometer feels"
        elif one.drive.pitch is not None:
            slope = f"gravity taken off by pitch, less {np.degrees(ground.pitch_offset_rad):.2f}° of its mounting"
        elif np.isfinite(ground.uphill[0]):
            slope = (f"ground rises by {100 * np.hypot(*ground.uphill):.2f} % towards yaw "
                     f"{np.degrees(np.arctan2(ground.uphill[1], ground.uphill[0])):.0f}°, taken off")
        else:
            slope = "headings don't spread: a slope, if there is one, is in the map"
        yield (f"{Path(one.path).name}: {slope}; drive fell by {100 * ground.sag_above:.1f} ± "
               f"{100 * ground.sag_sigma[0]:.1f} %, brake by {100 * ground.sag_below:.1f} ± "
               f"{100 * ground.sag_sigma[1]:.1f} %: the map is that of the middle")


def _window_lines(fit):
    windows = sum(fit.rejected.values())
    yield f"windows of {WINDOW_S:g} s: {windows}, of which count {fit.rejected['counted']}; the others:"
    yield from (f"  {number:6d}  {text}" for text, number in fit.rejected.items() if number and text != "counted")
    yield f"\nerror of single windows: {fit.residual_mps2:.3f} m/s² RMS"
    if fit.held_out_windows:
        yield (f"held out (every {fitting.HELD_OUT}th manoeuvre, from the others): {fit.held_out_mps2:.3f} m/s² RMS "
               f"over {fit.held_out_windows} windows")


def _map_lines(fit, table):
    count = table.accelerations.size
    yield (f"the map: {table.values.size} values, {_range_text(table.values)}; {table.velocities.size} velocities, "
           f"{_range_text(table.velocities)} m/s")
    for origin, text in ((DRIVEN, "driven"), (BETWEEN, "between what was driven"),
                         (OLD, "the prior's"), (MOVED, "the prior's, moved so that its column rises")):
        number = int((table.origin == origin).sum())
        if number:
            yield f"  {SYMBOLS[origin]}  {number} of {count} {text}"
    for value, row in zip(fit.values[::-1], fit.supported[::-1]):
        gaps = [fit.velocities[begin:end] for begin, end in runs(~row)]
        texts = [_range_text(gap) if gap.size > 1 else number_text(gap[0]) for gap in gaps]
        if texts:
            where = f"{', '.join(texts)} m/s" if row.any() else "any speed"
            yield f"missing: value {number_text(value)}: at {where}"
    if table.velocities[0] <= 0:
        yield ("at 0 m/s the map says what holds as the car just rolls forward; from standstill an ESC holds or "
               "reverses where it says brake")
    steps = np.median(np.diff(table.accelerations, axis=0), axis=1)
    level = np.flatnonzero(steps <= 2 * MIN_STEP_MPS2)
    if level.size:
        yield (f"from value {_range_text(table.values[level[0]:level[-1] + 2])} acceleration hardly changes: the ESC's "
               "neutral band, in which the map rises only as its CSV needs it")


def narrower_text(table: Table, old: ValueMap, old_path: str) -> str | None:
    """Return a line that says by how much a map is narrower than the one that it replaces; ``None`` = it isn't."""
    narrowed = [f"{name} {_range_text(new)} in place of {_range_text(before)}"
                for name, new, before in (("values", table.values, old.values),
                                          ("velocities", table.velocities, old.velocities))
                if new[0] > before[0] or new[-1] < before[-1]]
    if not narrowed:
        return None
    return (f"narrower than the old map: {', '.join(narrowed)}: drive what is missing, or fill it from the old one by "
            f"--prior {old_path}")


def _range_text(axis):
    return f"{number_text(axis[0])} to {number_text(axis[-1])}"


def coverage_text(fit: fitting.Fit, table: Table | None) -> str:
    """Return a grid of symbols: which accelerations the drives state, and those in the table by their origin."""
    cells = np.where(fit.supported, "#" if table is None else "(#)", ".").astype(object)
    if table is not None:
        inside = np.ix_(np.searchsorted(fit.values, table.values), np.searchsorted(fit.velocities, table.velocities))
        cells[inside] = np.vectorize(SYMBOLS.get, otypes=[object])(table.origin)
    lines = ["what was driven: # enough, . not enough" + (", (#) enough, but cut off" if table is not None else "")]
    return "\n".join([*lines, *_grid(fit.values, fit.velocities, cells, "{}")])


def _grid(values, velocities, cells, form):
    """Yield the lines of a table over values, downwards, and velocities."""
    yield f"{'value':>9} |" + "".join(f"{number_text(velocity):>7}" for velocity in velocities) + " m/s"
    for value, row in zip(values[::-1], cells[::-1]):
        yield f"{number_text(value):>9} |" + "".join(f"{form.format(cell):>7}" for cell in row)
