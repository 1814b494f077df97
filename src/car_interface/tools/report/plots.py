"""Draws the plots of a drive, each as the text of an SVG that can be part of a page, and tables, as files.

At the end stands what all plots have in common: axes over time, panels, curves, and the text of an SVG.
"""
from __future__ import annotations

import io
import re
from functools import lru_cache
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING

import matplotlib
import numpy as np
from matplotlib import cm, font_manager
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter, MaxNLocator

from car_interface.common.sources import LOCKED, NEUTRAL, NO_HUMAN, PLANNER, TELEOP
from car_interface.steering.calibration import SteeringCalibration
from car_interface.throttle.value_map import ValueMap
from car_interface.tools.report.faults import ERROR
from car_interface.tools.report.states import UNKNOWN_DRIVER

if TYPE_CHECKING:  # a table is drawn without the libraries that read recordings
    from car_interface.tools.report.summary import Summary

# Distinguishable for colour-blind people, too.
DRIVER_COLOURS = {LOCKED: "#c0392b", NO_HUMAN: "#b8bfc7", NEUTRAL: "#e8c468", TELEOP: "#2f6fb3", PLANNER: "#1b9e77",
                  UNKNOWN_DRIVER: "#7d8590"}
DRIVER_NAMES = {LOCKED: "locked", NO_HUMAN: "no human", NEUTRAL: "neutral", TELEOP: "gamepad", PLANNER: "planner",
                UNKNOWN_DRIVER: "driver not known"}
REQUESTED, SENT, DRIVEN, BAD, INK, FAINT = "#d9822b", "#2f6fb3", "#16202b", "#c0392b", "#16202b", "#5c6773"
WIDTH_IN = 9.6
SHOWN_S = 0.0007  # of the drive's length: shorter episodes are drawn this long to be visible
STYLE = {
    "font.family": "sans-serif", "font.sans-serif": ["DejaVu Sans"], "font.size": 9, "svg.fonttype": "path",
    "svg.hashsalt": "car_interface", "axes.spines.top": False, "axes.spines.right": False, "axes.edgecolor": "#9aa4af",
    "axes.labelcolor": FAINT, "axes.titlesize": 9.5, "axes.titleweight": "bold",
    "xtick.color": FAINT, "ytick.color": FAINT, "axes.grid": True, "grid.color": "#e6eaee",
    "grid.linewidth": 0.8, "axes.axisbelow": True, "lines.linewidth": 1.2, "legend.frameon": False,
    "legend.fontsize": 8.5, "path.simplify": True,
}
ABOVE = {"loc": "lower right", "ncol": 3, "bbox_to_anchor": (1.0, 0.98), "borderaxespad": 0.2}  # a legend's place
MAX_LABEL = 60  # characters: a longer one leaves no room for the plot beside it
# The board publishes its output when it changes, and otherwise now and then.
HELD = {"gap_s": 3.0, "drawstyle": "steps-post"}
DASHED = (0, (4, 2))
ASKED, DONE = {"linestyle": DASHED}, {"linewidth": 0.9}
DOTTED = {"gap_s": 5, "marker": ".", "markersize": 4}
PATH_WIDTH, WIDER = 1.6, 1.6  # of the path of who was the last to begin, and by how much those before are wider
DPI = 120  # of a picture of a table
CURVES = 9  # of a map's velocities
MAX_LABELS = 12  # below an axis of radii
ESC_COLOURS = {"ARMING": "#b8bfc7", "BRAKING": "#d9822b", "HOLD": "#e8c468", "REVERSE": "#8e5ea2"}


def plots(drive: Summary) -> dict[str, str]:
    """Return the SVGs for which there are data, by name, in the order of the page."""
    with matplotlib.rc_context(STYLE):
        return {name: svg_text(figure, name, description) for name, draw, description in (
            ("calibration", _calibration, "the curvature of each duty: driven, by the new table, by the old one"),
            ("who", _who, "who drove when, as bands of colour over time"),
            ("steering", _steering, "curvature requested, sent and driven, and the servo's duty, over time"),
            ("throttle", _throttle, "throttle asked and granted, and the ESC's state, over time"),
            ("path", _path, "the car's path from above, with the places that the sonars saw"),
            ("speed", _speed, "speed, acceleration and the ESC over time"),
            ("battery", _battery, "the battery's voltage over time"),
            ("link", _link, "frames, round trip and clock skew of the Teensy's link over time"),
        ) if (figure := draw(drive)) is not None}


def _calibration(drive):
    result = drive.calibration
    if result is None or not result.curve or not result.old_curve:
        return None
    figure = Figure(figsize=(WIDTH_IN, 3.4), constrained_layout=True)
    axes = figure.add_subplot()
    duty, curvature, error = (np.array(column) for column in zip(*result.curve))
    axes.fill_between(duty, curvature - error, curvature + error, color=SENT, alpha=0.2, linewidth=0,
                      label="± two standard errors")
    axes.plot(duty, curvature, color=SENT, linewidth=1.6, label="new table")
    axes.plot(*zip(*result.old_curve), color=REQUESTED, linestyle=DASHED, label="old table")
    if result.driven:
        axes.plot(*zip(*result.driven), color=DRIVEN, marker="o", markersize=3, linestyle="none",
                  label="asked and driven")
    largest = 1.2 * max(np.abs(curvature).max(), 0.1)
    axes.set(ylim=(-largest, largest), xlabel="the servo's duty")
    title(axes, "How tight: 1/radius in 1/m, left up")
    axes.legend(**{**ABOVE, "ncol": 4})
    return figure


def _who(drive):
    if not drive.steering.episodes:
        return None
    figure = Figure(figsize=(WIDTH_IN, 1.3))
    axes = figure.add_subplot()
    for start_s, width_s, source in bands(drive):
        axes.broken_barh([(start_s, width_s)], (0, 1), color=DRIVER_COLOURS[source], linewidth=0)
    for fault in drive.faults.entries:
        axes.plot(fault.start_s, 1.22, marker="v", markersize=5, clip_on=False,
                  color=BAD if fault.level == ERROR else REQUESTED, linestyle="none")
    handles = [Patch(color=DRIVER_COLOURS[source], label=DRIVER_NAMES[source])
               for source in DRIVER_NAMES if source in drive.steering.source_s]
    if drive.faults.entries:
        handles.append(Line2D([], [], marker="v", linestyle="none", color=REQUESTED, label="fault"))
    axes.legend(handles=handles, ncol=len(handles), loc="lower left", bbox_to_anchor=(-0.01, 1.12))
    axes.set(ylim=(0, 1), yticks=[])
    axes.spines["left"].set_visible(False)
    time_axis(axes, drive)
    figure.subplots_adjust(left=0.015, right=0.985, top=0.66, bottom=0.33)
    return figure


def _steering(drive):
    traces, which = drive.traces, "the table before" if drive.calibration else "the tables"
    sent = [trace for trace in (traces["requested curvature"], traces["sent curvature"]) if trace.count]
    largest = 1.45 * max([abs(bound) for trace in sent for bound in (trace.minimum, trace.maximum)]
                         + [0.2, usual_magnitude(traces["driven curvature"])])
    channel, gamepad = drive.steering.steering_channel, traces["gamepad"]
    duty = drive.steering.duties[channel]
    margin = max(0.08 * (duty.maximum - duty.minimum), 40)
    return stack(drive, [
        _panel(2.6, "How tight: 1/radius in 1/m, left up",
               (traces["requested curvature"], REQUESTED, "requested (planner)", ASKED),
               (traces["sent curvature"], SENT, f"sent (by {which})", {"linewidth": 1.6}),
               (traces["driven curvature"], DRIVEN, "driven (by odometry)", DONE), limits=(-largest, largest)),
        drive.asked.wheelbase_m is None and _panel(
            1.4, "The steering angle that was asked for, in degrees, left up",
            (traces["requested angle"], REQUESTED, "", {})),
        _panel(1.7, "The servo's duty" if duty.count else "The gamepad's request, left up",
               (duty, SENT, f"duty on channel {channel}", HELD),
               right=[(gamepad, REQUESTED, "the gamepad's request" if duty.count else "", ASKED)],
               limits=(duty.minimum - margin, duty.maximum + margin), right_limits=(-1.25, 1.25)),
        _panel(1.4, "The position of the VESC's servo, 0 to 1", (traces["servo position"], SENT, "", HELD))])


def _throttle(drive):
    asked, granted = drive.traces["throttle asked"], drive.traces["throttle granted"]
    return stack(drive, [granted.count and (0.4, lambda axes: _esc_states(axes, drive)), _panel(
        1.7, "Throttle: brake or reverse down", (asked, REQUESTED, "asked", ASKED), (granted, SENT, "granted", {}),
        limits=(-1.1, 1.1))])


def _esc_states(axes, drive):
    found = dict.fromkeys(episode.esc for episode in drive.throttle.episodes if episode.esc)
    for episode in drive.throttle.episodes:
        if episode.esc:
            axes.broken_barh([(episode.start_s, episode.end_s - episode.start_s)], (0, 1), linewidth=0,
                             color=ESC_COLOURS.get(episode.esc, INK))
    title(axes, "The ESC, where it isn't in NEUTRAL or FORWARD")
    axes.set(ylim=(0, 1), yticks=[])
    if found:
        axes.legend(handles=[Patch(color=ESC_COLOURS.get(esc, INK), label=label_text(esc)) for esc in found], **ABOVE)


def _path(drive):
    path, echoes = np.array(drive.motion.path.places, complex), drive.sonars.echoes.places()
    if len(path) < 2 and not len(echoes):
        return None
    every = np.concatenate([path, echoes])
    width_m, height_m = (np.nanmax(part) - np.nanmin(part) + 0.5 for part in (every.real, every.imag))
    figure = Figure(figsize=(WIDTH_IN, min(max(0.75 * WIDTH_IN * height_m / width_m + 0.7, 2.8), 6.8)))
    axes = figure.add_subplot()
    if len(echoes):
        axes.plot(echoes.real, echoes.imag, linestyle="none", marker="o", markersize=2.6, markeredgewidth=0,
                  color=REQUESTED, alpha=0.55, label="seen by a sonar")
    # In the order in which they first drove: a path under a later one stays visible.
    sources = list(dict.fromkeys(drive.motion.path.kinds))
    end, unseen = 0, set(sources)
    for source, points in groupby(drive.motion.path.kinds):
        begin, end = max(end - 1, 0), end + len(list(points))
        width = PATH_WIDTH + WIDER * (len(sources) - 1 - sources.index(source))
        axes.plot(path[begin:end].real, path[begin:end].imag, linewidth=width, color=DRIVER_COLOURS[source],
                  label=DRIVER_NAMES[source] if source in unseen else None, solid_capstyle="round",
                  zorder=3 - width / 10)
        unseen.discard(source)
    if len(path):
        axes.plot(path[0].real, path[0].imag, marker="o", markersize=8, color="white", markeredgecolor=INK,
                  markeredgewidth=1.5, linestyle="none", label="start")
        axes.plot(path[-1].real, path[-1].imag, marker="s", markersize=7, color=INK, linestyle="none", label="end")
    axes.set_aspect("equal", adjustable="datalim")
    axes.margins(0.06)
    axes.set(xlabel="x of odometry in m", ylabel="y of odometry in m")
    axes.legend(loc="center left", bbox_to_anchor=(1.01, 0.5))
    height_in = figure.get_figheight()
    figure.subplots_adjust(left=0.07, right=0.82, top=1 - 0.12 / height_in, bottom=0.55 / height_in)
    return figure


def _speed(drive):
    traces = drive.traces
    is_asked = traces["requested speed"].count or traces["planner's speed"].count
    duties = [(duty, SENT, f"duty on channel {channel}", HELD)
              for channel, duty in sorted(drive.steering.duties.items())
              if channel != drive.steering.steering_channel and duty.maximum > duty.minimum]
    value = traces["value"]
    fastest = max([0.1, *(1.3 * usual_magnitude(traces[name]) for name in ("imu turn rate", "turn rate"))])
    return stack(drive, [
        traces["speed"].count and _panel(
            2.0, "Speed in m/s, backward down", (traces["requested speed"], REQUESTED, "requested", ASKED),
            (traces["planner's speed"], REQUESTED, "requested by the planner", {"linestyle": (0, (1, 1))}),
            (traces["reference speed"], SENT, "within its limits", DONE),
            (traces["speed"], DRIVEN, "by odometry" if is_asked else "", {})),
        _panel(2.0, "Acceleration in m/s²", (traces["requested acceleration"], REQUESTED, "requested", ASKED),
               (traces["acceleration"], DRIVEN, "by odometry, over 0.3 s", DONE)),
        _panel(1.6, "The ESC's duty" if not value.count else "Value, and the ESC's duty" if duties else "Value",
               (value, REQUESTED, "value", {}), right=duties),
        _panel(1.6, "The VESC's motor speed in ERPM", (traces["motor speed asked"], REQUESTED, "requested", ASKED),
               (traces["motor speed"], DRIVEN, "measured", DONE)),
        traces["imu turn rate"].count and _panel(
            1.6, "How fast it turned, in rad/s, left up", (traces["imu turn rate"], REQUESTED, "by the IMU", DONE),
            (traces["turn rate"], DRIVEN, "by odometry", DONE), limits=(-fastest, fastest))])


def _battery(drive):
    return stack(drive, [_panel(1.5, "The battery's voltage", (
        drive.traces["battery voltage"], SENT, "", {"gap_s": 15}))])  # some publish it once in 10 s


def _link(drive):
    frames, skew = drive.traces["frames"], drive.traces["skew"]
    return stack(drive, [
        _panel(1.5, "Frames from the Teensy in a second", (frames, SENT, "good", {"gap_s": 5}),
               (drive.traces["bad frames"], BAD, "corrupt", {"gap_s": 5}),
               limits=(-0.03 * max(frames.maximum, 1), None)),
        _panel(1.5, "Round trip of a ping in ms", (drive.traces["round trip"], SENT, "", DOTTED), limits=(0, None)),
        _panel(1.5, "How much faster the Teensy's clock runs, in ppm", (skew, SENT, "", DOTTED), limits=_most(skew))])


def _most(skew):
    """Return limits that leave out the first few values, which are far off."""
    if not skew.count:
        return None
    low, high = np.nanpercentile(skew.curve()[1], (10, 90))
    margin = max(high - low, 10, 1e-3 * max(abs(low), abs(high)))  # garbage is drawn, too
    return low - margin, high + margin


# --- tables ---


def draw(table: SteeringCalibration | ValueMap, kind: str, name: str) -> bytes:
    """Return a picture of a table, as the bytes of a file of that kind: svg, png or pdf."""
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH_IN, 4.2), constrained_layout=True)
        figure.suptitle(label_text(Path(name).name), x=0.01, ha="left", fontsize=11, fontweight="bold")
        (_draw_calibration if isinstance(table, SteeringCalibration) else _draw_map)(figure, table)
        file = io.BytesIO()
        figure.savefig(file, format=kind, dpi=DPI, metadata={"Date": None} if kind == "svg" else None)
        return file.getvalue()


def _draw_calibration(figure, config):
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


def _draw_map(figure, table):
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

# --- what plots have in common ---


def label_text(text: str) -> str:
    """Return a text from outside, such as a file's name or a recorded cause, as a label that is drawn as it reads.

    matplotlib takes what is between two $ for a formula, and leaves out of a legend what begins with _. A character
    that its font lacks is drawn as ?.
    """
    shown = "".join(letter if ord(letter) in _glyphs() else " " if letter.isspace() else "?" for letter in text)
    if len(shown) > MAX_LABEL:
        shown = shown[:MAX_LABEL - 1] + "…"
    return (" " if shown.startswith("_") else "") + shown.replace("$", r"\$")


@lru_cache(maxsize=None)
def _glyphs():
    """Return the characters that the font has, plain and bold."""
    fonts = [font_manager.FontProperties(family="DejaVu Sans", weight=weight) for weight in ("normal", "bold")]
    return frozenset.intersection(*(frozenset(font_manager.get_font(font_manager.findfont(font)).get_charmap())
                                    for font in fonts))


def title(axes, text: str) -> None:
    """Put a title over a plot's left end."""
    axes.set_title(text, loc="left", color=INK)


def stack(drive, panels):
    """Return a figure with panels one above the other over the same time; ``None`` when there is none.

    Args:
        panels: (height in inches, function of axes that draws it) of each; ``None`` = it has nothing to show.
    """
    panels = list(filter(None, panels))
    if not panels:
        return None
    heights, draws = zip(*panels)
    figure = Figure(figsize=(WIDTH_IN, sum(heights) + 0.45 * len(heights) + 0.25), constrained_layout=True)
    all_axes = figure.subplots(len(heights), 1, sharex=True, squeeze=False,
                               gridspec_kw={"height_ratios": heights})[:, 0]
    time_axis(all_axes[-1], drive)
    for axes, draw in zip(all_axes, draws):
        for start_s, width_s, source in bands(drive):  # who steered, along the lower edge
            axes.broken_barh([(start_s, width_s)], (0, 0.025), color=DRIVER_COLOURS[source], linewidth=0,
                             transform=axes.get_xaxis_transform(), zorder=1)
        draw(axes)
    return figure


def _panel(height_in, text, *curves, right=(), limits=None, right_limits=None):
    """Return a panel for ``stack``; ``None`` where all traces are empty.

    Args:
        curves: (trace, colour, label, style) of each.
        right: the same of those with a scale of their own, at the right, where there are both.
        limits: (bottom, top) of the vertical axis; ``None`` = by the curves.
    """
    left, right = ([one for one in some if one[0].count] for some in (curves, right))
    if not left and not right:
        return None

    def draw(axes):
        title(axes, text)
        beside, more = (axes.twinx(), " (right scale)") if left and right else (axes, "")
        for place, shown, ends, says in ((axes, left, limits, ""), (beside, right, right_limits, more)):
            for trace, colour, label, style in shown:
                curve(place, trace, colour, label + says, **style)
            if shown and ends:
                place.set_ylim(ends)
        if left and right:
            beside.grid(False)
            axes.legend(handles=axes.get_lines() + beside.get_lines(), **ABOVE)
        else:
            legend(axes)
    return height_in, draw


def time_axis(axes, drive):
    """Set the range and the labels of a time axis, and of those that share it."""
    axes.set_xlim(0, max(drive.duration_s, 1e-3))
    if drive.duration_s > 180:
        axes.xaxis.set_major_locator(MaxNLocator(9, steps=[1, 1.2, 1.5, 2, 3, 6, 10]))
        axes.xaxis.set_major_formatter(FuncFormatter(lambda time_s, _: f"{int(time_s) // 60}:{int(time_s) % 60:02}"))
    axes.set_xlabel("minutes:seconds" if drive.duration_s > 180 else "seconds")


def bands(drive):
    """Return (start, width, source) of episodes; those with the same source, or too short to see, are one."""
    shortest_s = max(drive.duration_s * SHOWN_S, 1e-9)
    bands = []
    for episode in drive.steering.episodes:
        if bands and (bands[-1][2] == episode.source or bands[-1][0] + shortest_s > episode.end_s):
            bands[-1][1] = episode.end_s - bands[-1][0]
        else:
            bands.append([episode.start_s, episode.end_s - episode.start_s, episode.source])
    return [(start_s, max(width_s, shortest_s), source) for start_s, width_s, source in bands]


def curve(axes, trace, colour, label, gap_s=1.0, **style):
    """Draw a trace that has samples."""
    axes.plot(*trace.curve(gap_s), color=colour, label=label or "_", **style)


def usual_magnitude(trace):
    """Return the 95th percentile of a trace's magnitude; single larger ones are noise."""
    return float(np.nanpercentile(np.abs(trace.curve()[1]), 95)) if trace.count else 0.0


def legend(axes):
    """Draw a legend above the axes, unless nothing has a label."""
    if axes.get_legend_handles_labels()[0]:
        axes.legend(**ABOVE)


def svg_text(figure, name, description):
    """Return the text of an SVG whose ids are unique in a page."""
    file = io.StringIO()
    figure.savefig(file, format="svg", metadata={"Date": None})
    text = file.getvalue()
    text = text[text.index("<svg"):]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    text = re.sub(r'\bid="', f'id="{name}-', text)
    text = re.sub(r'(href="#|url\(#)', rf"\g<1>{name}-", text)
    return text.replace("<svg ", f'<svg role="img" aria-label="{description}" data-plot="{name}" ', 1)
