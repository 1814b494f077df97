"""A value map from recorded drives: the fit, the table that may be written, and why it should not be."""
from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Sequence

import numpy as np

from car_interface.common.errors import CarInterfaceError
from car_interface.throttle.value_map import ValueMap
from car_interface.tools.calibration.value_map import fit as fitting
from car_interface.tools.calibration.value_map import table as tables
from car_interface.tools.calibration.value_map.config import FitConfig
from car_interface.tools.calibration.value_map.recorded import RecordedDrive
from car_interface.tools.calibration.value_map.report import coverage_text

MAX_HELD_OUT_MPS2 = 0.5
MIN_DRIVEN_RATIO = 0.25  # of a map that the drives themselves state


@dataclass(frozen=True)
class MapAxes:
    """The axes of the map; ``None`` = chosen by what was driven."""

    values: tuple[float, ...] | None = None
    velocities_mps: tuple[float, ...] | None = None


class NoTable(CarInterfaceError):
    """Drives that support no table.

    Args:
        text: the message.
        coverage: what they do support, as a grid of symbols.
    """

    def __init__(self, text: str, coverage: str):
        super().__init__(text)
        self.coverage = coverage


class Calibrated(NamedTuple):
    """A map, and all that is known about it."""

    table: tables.Table
    fit: fitting.Fit
    problems: list[str]  # why it should not be written; empty = it may be


def calibrate(recorded: Sequence[RecordedDrive], axes: MapAxes, config: FitConfig,
              prior: ValueMap | None = None) -> Calibrated:
    """Fit a map to recorded drives.

    Args:
        recorded: drives of one car.
        axes: of the map.
        config: of the fit.
        prior: an old map, which stays where the drives support nothing.

    Raises:
        NoTable: the drives support too little.
        CarInterfaceError: there is nothing to fit.
    """
    names = ", ".join(one.trail.path for one in recorded)
    try:
        fit = fitting.fit([one.drive for one in recorded], _array(axes.values), _array(axes.velocities_mps), config)
    except fitting.NothingToFit as error:
        raise CarInterfaceError(f"nothing in {names} tells an acceleration: {error}") from error
    table = tables.table(fit, config.neutral, _prior_at_nodes(prior, fit))
    if table is None:
        raise NoTable(f"no map is written: {names} support no two values at the same two velocities; drive longer, "
                      "with throttle and brake of several strengths", coverage_text(fit, None))
    return Calibrated(table, fit, list(_problems(fit, table)))


def _problems(fit, table):
    """Why the map should not be written."""
    if min(table.accelerations.shape) < tables.MIN_NODES:
        yield (f"the drives support only {table.values.size} values at {table.velocities.size} velocities, "
               f"less than {tables.MIN_NODES} each")
    if table.driven_ratio() < MIN_DRIVEN_RATIO:
        yield f"the drives tell only {100 * table.driven_ratio():.0f} % of the map, the rest is the prior's"
    if fit.held_out_mps2 > MAX_HELD_OUT_MPS2:
        yield (f"it misses what was held out by {fit.held_out_mps2:.2f} m/s² RMS: something else than value and "
               "velocity moves this car")


def _prior_at_nodes(prior, fit):
    """The prior's accelerations at the fit's nodes (R, C), NaN beyond it."""
    if prior is None:
        return None
    inside = np.outer((fit.values >= prior.values[0]) & (fit.values <= prior.values[-1]),
                      (fit.velocities >= prior.velocities[0]) & (fit.velocities <= prior.velocities[-1]))
    table = [[prior.acceleration_at(value, velocity) for velocity in fit.velocities] for value in fit.values]
    return np.where(inside, np.array(table), np.nan)


def _array(numbers):
    return None if numbers is None else np.array(numbers, float)
