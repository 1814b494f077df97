"""Draws tables: a steering calibration, and a value map."""
from __future__ import annotations

import io
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib import cm
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from car_interface.steering.calibration import SteeringCalibration
from car_interface.throttle.value_map import ValueMap
from car_interface.tools.report.plots import FAINT, REQUESTED, SENT, STYLE, label_text, title

DPI = 120
CURVES = 9  # of a map's velocities
MAX_LABELS = 12  # below an axis of radii


def draw(table: SteeringCalibration | ValueMap, kind: str, name: str) -> bytes:
    """Return a picture of a table, as the bytes of a file of that kind: svg, png or pdf."""
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(9.6, 4.2), constrained_layout=True)
        FigureCanvasAgg(figure)
        figure.suptitle(label_text(Path(name).name), x=0.01, ha="left", fontsize=11, fontweight="bold")
        (_steering if isinstance(table, SteeringCalibration) else _map)(figure, table)
        file = io.BytesIO()
        figure.savefig(file, format=kind, dpi=DPI, metadata={"Date": None} if kind == "svg" else None)
        return file.getvalue()


def _steering(figure, config):
    by_radius, by_duty = figure.subplots(1, 2)
    axis = list(config.radius_axis_m)
    title(by_radius, "Duty for a turn radius")
    by_radius.axhline(config.servo_center, color=FAINT, linewidth=0.9)
    for duties, colour, side in ((config.left_duties, SENT, "left"), (config.right_duties, REQUESTED, "right")):
        by_radius.plot(axis, duties, color=colour, marker="o", markersize=3.5, label=side)
    by_radius.set(xscale="log", xlabel="turn radius in m")
    shown = _labelled(axis)
    by_radius.set_xticks(shown)
    by_radius.set_xticklabels([f"{radius:g}" for radius in shown])
    by_radius.minorticks_off()
    by_radius.legend()
    low, high = sorted((config.servo_left, config.servo_right))
    duties = np.linspace(low, high, 600)
    title(by_duty, "What a duty is taken to turn: 1/radius in 1/m, left up")
    by_duty.plot(duties, [1 / config.turn_radius_m(duty) for duty in duties], color=SENT)
    by_duty.axhline(0, color=FAINT, linewidth=0.9)
    by_duty.axvline(config.servo_center, color=FAINT, linewidth=0.9)
    by_duty.set_xlabel("duty")


def _labelled(axis):
    """Return radii that are far enough apart for a label each, on a logarithmic axis."""
    min_ratio = (axis[-1] / axis[0]) ** (1 / MAX_LABELS)
    shown = [axis[-1]]
    for radius in reversed(axis):
        if radius * min_ratio <= shown[-1]:
            shown.append(radius)
    return shown[::-1]


def _map(figure, table):
    surface, curves = figure.subplots(1, 2)
    values, velocities = np.linspace(table.values[0], table.values[-1], 161), np.linspace(
        table.velocities[0], table.velocities[-1], 121)
    cells = np.array([[table.acceleration_at(value, velocity) for velocity in velocities] for value in values])
    largest = np.abs(cells).max() or 1.0
    image = surface.pcolormesh(velocities, values, cells, cmap="RdBu", vmin=-largest, vmax=largest, shading="gouraud",
                               rasterized=True)
    figure.colorbar(image, ax=surface, label="m/s²")
    if cells.min() < 0 < cells.max():
        surface.contour(velocities, values, cells, levels=[0], colors=[FAINT], linewidths=1)
    title(surface, "Acceleration; the line is 0 m/s²")
    surface.set(xlabel="velocity in m/s", ylabel="value")
    surface.grid(False)
    title(curves, "Acceleration in m/s² by value, at some velocities")
    shown = table.velocities if len(table.velocities) <= CURVES else [
        table.velocities[int(index)] for index in np.linspace(0, len(table.velocities) - 1, CURVES)]
    for index, velocity in enumerate(shown):
        curves.plot(table.values, [table.acceleration_at(value, velocity) for value in table.values],
                    color=cm.viridis(0.9 * index / max(len(shown) - 1, 1)), marker="o", markersize=2.5,
                    label=f"{velocity:g} m/s")
    curves.axhline(0, color=FAINT, linewidth=0.9)
    curves.set_xlabel("value")
    curves.legend(fontsize=7.5)
