"""The report on a value map, as lines of text: what each of its numbers rests on."""
from __future__ import annotations

from typing import Iterator, Sequence

import numpy as np

from car_interface.tools.calibration.value_map import fit as fitting
from car_interface.tools.calibration.value_map import table as tables
from car_interface.tools.calibration.value_map.acceleration import WindowConfig
from car_interface.tools.calibration.value_map.axes import MIN_STEP_MPS2
from car_interface.tools.calibration.value_map.quality import HELD_OUT
from car_interface.tools.calibration.value_map.recorded import IMU, RecordedDrive, Source
from car_interface.tools.calibration.value_map.table import number_text

DUTY = "duty:"
SYMBOLS = {tables.DRIVEN: "#", tables.BETWEEN: "+", tables.OLD: "o", tables.MOVED: "m"}


def report(recorded: Sequence[RecordedDrive], source: Source, fit: fitting.Fit, table: tables.Table,
           problems: Sequence[str], prior_path: str | None = None) -> Iterator[str]:
    """Yield the lines.

    Args:
        recorded: the drives.
        source: where their values and accelerations are from.
        fit: the fit to them.
        table: the part of it that is written.
        problems: why it should not be written.
        prior_path: of the old map, if there was one.
    """
    yield from _source_lines(recorded, source, fit, prior_path)
    yield from _error_lines(fit)
    yield coverage_text(fit, table)
    yield ""
    yield from _map_lines(fit, table)
    yield ""
    yield "standard error in m/s²"
    yield from _grid(fit.values, fit.velocities, fit.sigma_mps2, "{:.3f}")
    yield ""
    yield "seconds of driving"
    yield from _grid(fit.values, fit.velocities, fit.seconds, "{:.1f}")
    if problems:
        yield ""
        yield from (f"not good enough: {problem}" for problem in problems)


def _source_lines(recorded, source, fit, prior_path):
    drives = [one.drive for one in recorded]
    value = source.value_topic if source.duty_channel is None else f"{DUTY}{source.duty_channel}"
    yield f"A value map from {', '.join(drive.name for drive in drives)}"
    yield f"value: {value}; accelerations by {_measured_by(source, drives)}"
    if source.throttle:
        duties, values = source.throttle.value_of_duty.axis, source.throttle.value_of_duty.values
        yield (f"a duty counts as the value of which {source.throttle.path} makes it: {duties[0]:g} is {values[0]:g}, "
               f"{duties[-1]:g} is {values[-1]:g}")
    if prior_path:
        yield f"prior: {prior_path}"
    yield from (f"{one.drive.name}: {note}" for one in recorded for note in one.notes)
    yield ""
    has_sigma = fit.delay_sigma_s >= 0
    sigma = f" ± {max(1.0, 1000 * fit.delay_sigma_s):.0f}" if has_sigma else ""
    how = "given" if fit.delay_is_given else "estimated" if has_sigma else "the drives don't tell it"
    yield f"from value to acceleration: {1000 * fit.delay_s:.0f}{sigma} ms ({how})"
    for drive, ground in zip(drives, fit.grounds):
        yield f"{drive.name}: {_ground_text(ground, drive.pitch is not None, source.measured_by == IMU)}"
    yield ""


def _error_lines(fit):
    windows = sum(fit.rejected.values())
    yield f"windows of {WindowConfig().window_s:g} s: {windows}, of which count {fit.rejected['counted']}; the others:"
    yield from (f"  {number:6d}  {text}" for text, number in fit.rejected.items() if number and text != "counted")
    yield ""
    yield f"error of single windows: {fit.residual_mps2:.3f} m/s² RMS"
    if fit.held_out_windows:
        yield (f"held out (every {HELD_OUT}th manoeuvre, from the others): {fit.held_out_mps2:.3f} m/s² RMS "
               f"over {fit.held_out_windows} windows")
    yield ""


def _map_lines(fit, table):
    count = table.accelerations.size
    yield (f"the map: {table.values.size} values, {number_text(table.values[0])} to {number_text(table.values[-1])}; "
           f"{table.velocities.size} velocities, {number_text(table.velocities[0])} to "
           f"{number_text(table.velocities[-1])} m/s")
    for origin, text in ((tables.DRIVEN, "driven"), (tables.BETWEEN, "between what was driven"),
                         (tables.OLD, "the prior's"), (tables.MOVED, "the prior's, moved so that its column rises")):
        number = int((table.origin == origin).sum())
        if number:
            yield f"  {SYMBOLS[origin]}  {number} of {count} {text}"
    yield from (f"missing: {text}" for text in _missing(fit))
    if table.velocities[0] <= 0:
        yield ("at 0 m/s the map says what holds as the car just rolls forward; from standstill an ESC holds or "
               "reverses where it says brake")
    level = _level_values(table)
    if level:
        yield (f"from value {number_text(level[0])} to {number_text(level[1])} acceleration hardly changes: the ESC's "
               "neutral band, in which the map rises only as its CSV needs it")


def _measured_by(source, drives):
    if source.measured_by == IMU:
        return "the IMU, its bias by the wheels"
    return "pulse times of the wheels" if all(drive.wheels for drive in drives) else "odometry's speed"


def _ground_text(ground, has_pitch, from_imu):
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


def coverage_text(fit: fitting.Fit, table: tables.Table | None) -> str:
    """A grid of symbols: which accelerations the drives state, and those in the table by their origin."""
    cells = np.where(fit.supported, "#" if table is None else "(#)", ".").astype(object)
    if table is not None:
        inside = np.ix_(np.searchsorted(fit.values, table.values), np.searchsorted(fit.velocities, table.velocities))
        cells[inside] = np.vectorize(SYMBOLS.get, otypes=[object])(table.origin)
    lines = ["what was driven: # enough, . not enough" + (", (#) enough, but cut off" if table is not None else "")]
    return "\n".join([*lines, *_grid(fit.values, fit.velocities, cells, "{}")])


def _grid(values, velocities, cells, form):
    """The lines of a table over values, downwards, and velocities."""
    yield f"{'value':>9} |" + "".join(f"{number_text(velocity):>7}" for velocity in velocities) + " m/s"
    for value, row in zip(values[::-1], cells[::-1]):
        yield f"{number_text(value):>9} |" + "".join(f"{form.format(cell):>7}" for cell in row)


def _missing(fit):
    """What to drive, a line for each value."""
    for value, row in zip(fit.values[::-1], fit.supported[::-1]):
        gaps = np.flatnonzero(~row)
        if gaps.size == row.size:
            yield f"value {number_text(value)}: at any speed"
        elif gaps.size:
            runs = [fit.velocities[run] for run in np.split(gaps, np.flatnonzero(np.diff(gaps) > 1) + 1)]
            yield f"value {number_text(value)}: at " + ", ".join(
                number_text(run[0]) + (f" to {number_text(run[-1])}" if run.size > 1 else "") for run in runs) + " m/s"


def _level_values(table):
    """The values around neutral between which acceleration rises no more than it must."""
    steps = np.median(np.diff(table.accelerations, axis=0), axis=1)
    level = np.flatnonzero(steps <= 2 * MIN_STEP_MPS2)
    return (table.values[level[0]], table.values[level[-1] + 1]) if level.size else None
