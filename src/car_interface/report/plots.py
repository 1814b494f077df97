"""A drive's plots, each as the text of an SVG that can stand in a page."""
from __future__ import annotations

import io
import re
from typing import NamedTuple

import matplotlib
import numpy as np
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter, MaxNLocator

from car_interface.report.summary import ERROR, UNKNOWN_DRIVER, Drive
from car_interface.steering.arbiter import LOCKED, NEUTRAL, NO_HUMAN, PLANNER, TELEOP

# Told apart by people who see no red and green, too.
DRIVER_COLOURS = {LOCKED: "#c0392b", NO_HUMAN: "#b8bfc7", NEUTRAL: "#e8c468", TELEOP: "#2f6fb3", PLANNER: "#1b9e77",
                  UNKNOWN_DRIVER: "#7d8590"}
DRIVER_NAMES = {LOCKED: "locked", NO_HUMAN: "no human", NEUTRAL: "neutral", TELEOP: "gamepad", PLANNER: "planner",
                UNKNOWN_DRIVER: "driver not known"}
ASKED, SENT, DONE, BAD, INK, FAINT = "#d9822b", "#2f6fb3", "#16202b", "#c0392b", "#16202b", "#5c6773"
WIDTH_IN = 9.6
SHOWN_S = 0.0007  # of the drive's length: what is shorter is drawn as long as this, or nobody would see it
STYLE = {
    "font.family": "sans-serif", "font.sans-serif": ["DejaVu Sans"], "font.size": 9, "svg.fonttype": "path",
    "svg.hashsalt": "car_interface", "axes.spines.top": False, "axes.spines.right": False, "axes.edgecolor": "#9aa4af",
    "axes.labelcolor": FAINT, "axes.titlesize": 9.5, "axes.titleweight": "bold",
    "xtick.color": FAINT, "ytick.color": FAINT, "axes.grid": True, "grid.color": "#e6eaee",
    "grid.linewidth": 0.8, "axes.axisbelow": True, "lines.linewidth": 1.2, "legend.frameon": False,
    "legend.fontsize": 8.5, "path.simplify": True,
}


# The board tells its outputs when one changes, and else now and then.
HELD = {"gap_s": 3.0, "drawstyle": "steps-post"}


class Plot(NamedTuple):
    """One plot."""

    name: str  # unique in a page
    svg: str
    words: str  # what it shows, for who can't see it


def plots(drive: Drive) -> dict[str, Plot]:
    """The plots for which something was recorded, by name: who, steering, path, speed, link."""
    made = {}
    with matplotlib.rc_context(STYLE):
        for name, draw, words in (
                ("who", _who, "who drove when, as bands of colour over time"),
                ("steering", _steering, "curvature asked for, sent and driven, and the servo's duty, over time"),
                ("path", _path, "the car's path from above, with the places that the sonars saw"),
                ("speed", _speed, "speed, acceleration and the ESC over time"),
                ("link", _link, "frames, round trip and clock skew of the Teensy's link over time")):
            figure = draw(drive)
            if figure is not None:
                made[name] = Plot(name, _svg(figure, name, words), words)
    return made


def _who(drive):
    if not drive.episodes:
        return None
    figure = Figure(figsize=(WIDTH_IN, 1.3))
    axes = figure.add_subplot()
    for start_s, width_s, source in _bands(drive):
        axes.broken_barh([(start_s, width_s)], (0, 1), color=DRIVER_COLOURS[source], linewidth=0)
    for fault in drive.faults:
        axes.plot(fault.start_s, 1.22, marker="v", markersize=5, clip_on=False,
                  color=BAD if fault.level == ERROR else ASKED, linestyle="none")
    handles = [Patch(color=DRIVER_COLOURS[source], label=DRIVER_NAMES[source])
               for source in DRIVER_NAMES if source in drive.source_s]
    if drive.faults:
        handles.append(Line2D([], [], marker="v", linestyle="none", color=ASKED, label="fault"))
    axes.legend(handles=handles, ncol=len(handles), loc="lower left", bbox_to_anchor=(-0.01, 1.12))
    axes.set(ylim=(0, 1), yticks=[])
    axes.spines["left"].set_visible(False)
    _time_axis(axes, drive)
    figure.subplots_adjust(left=0.015, right=0.985, top=0.66, bottom=0.33)
    return figure


def _steering(drive):
    traces = drive.traces
    duty = drive.duties.get(drive.steering_channel)
    panels = [any(traces[name].count for name in ("asked curvature", "sent curvature", "turned curvature")),
              duty is not None or traces["gamepad"].count > 0]
    if not any(panels):
        return None
    figure, all_axes = _stack(drive, panels, [2.6, 1.7])
    if panels[0]:
        axes = all_axes[0]
        _curve(axes, traces["asked curvature"], ASKED, "asked (planner)", linestyle=(0, (4, 2)))
        _curve(axes, traces["sent curvature"], SENT, "sent (by the tables)", linewidth=1.6)
        _curve(axes, traces["turned curvature"], DONE, "turned (by the wheels)", linewidth=0.9)
        turned = traces["turned curvature"]
        largest = max([abs(bound) for name in ("asked curvature", "sent curvature") if traces[name].count
                       for bound in (traces[name].least, traces[name].greatest)] + [0.2, _usual(turned)])
        axes.set_ylim(-1.45 * largest, 1.45 * largest)
        title(axes, "How tight: 1/radius in 1/m, left up")
        _legend(axes)
    if panels[1]:
        axes = all_axes[-1]
        title(axes, "The servo's duty" if duty else "The gamepad's request, left up")
        if duty is not None:
            _curve(axes, duty, SENT, f"duty on channel {drive.steering_channel}", **HELD)
            margin = max(0.08 * (duty.greatest - duty.least), 40)
            axes.set_ylim(duty.least - margin, duty.greatest + margin)
        if traces["gamepad"].count:
            beside = axes.twinx() if duty is not None else axes
            _curve(beside, traces["gamepad"], ASKED, "the gamepad's request (right scale)" if duty else "the gamepad",
                   linestyle=(0, (4, 2)))
            beside.set_ylim(-1.25, 1.25)
            if duty is not None:
                beside.grid(False)
                axes.legend(handles=axes.get_lines() + beside.get_lines(), **_above())
        if not traces["gamepad"].count:
            _legend(axes)
    return figure


def _path(drive):
    way, (hit_x, hit_y) = drive.way, drive.hits.places()
    if len(way.x_m) < 2 and not len(hit_x):
        return None
    width_m, height_m = (np.nanmax(both) - np.nanmin(both) + 0.5 for both in (
        np.concatenate([way.x_m, hit_x]), np.concatenate([way.y_m, hit_y])))
    figure = Figure(figsize=(WIDTH_IN, min(max(0.75 * WIDTH_IN * height_m / width_m + 0.7, 2.8), 6.8)))
    axes = figure.add_subplot()
    if len(hit_x):
        axes.plot(hit_x, hit_y, linestyle="none", marker="o", markersize=2.6, markeredgewidth=0, color=ASKED,
                  alpha=0.55, label="seen by a sonar")
    begin, seen = 0, set()
    for index in range(1, len(way.kinds) + 1):
        if index < len(way.kinds) and way.kinds[index] == way.kinds[begin]:
            continue
        source = way.kinds[begin]
        axes.plot(way.x_m[max(begin - 1, 0):index], way.y_m[max(begin - 1, 0):index], linewidth=1.8,
                  color=DRIVER_COLOURS[source], label=None if source in seen else DRIVER_NAMES[source],
                  solid_capstyle="round")
        seen.add(source)
        begin = index
    if len(way.x_m):
        axes.plot(way.x_m[0], way.y_m[0], marker="o", markersize=8, color="white", markeredgecolor=INK,
                  markeredgewidth=1.5, linestyle="none", label="start")
        axes.plot(way.x_m[-1], way.y_m[-1], marker="s", markersize=7, color=INK, linestyle="none", label="end")
    axes.set_aspect("equal", adjustable="datalim")
    axes.margins(0.06)
    axes.set(xlabel="x of odometry in m", ylabel="y of odometry in m")
    axes.legend(loc="center left", bbox_to_anchor=(1.01, 0.5))
    height_in = figure.get_figheight()
    figure.subplots_adjust(left=0.07, right=0.82, top=1 - 0.12 / height_in, bottom=0.55 / height_in)
    return figure


def _speed(drive):
    traces = drive.traces
    driven = {channel: duty for channel, duty in drive.duties.items()
              if channel != drive.steering_channel and duty.greatest > duty.least}
    panels = [traces["speed"].count > 0,
              traces["acceleration"].count + traces["asked acceleration"].count > 0,
              traces["value"].count > 0 or bool(driven)]
    if not any(panels):
        return None
    figure, all_axes = _stack(drive, panels, [2.0, 2.0, 1.6])
    left = iter(all_axes)
    if panels[0]:
        axes = next(left)
        title(axes, "Speed in m/s, backwards down")
        _curve(axes, traces["speed"], DONE, "by the wheels")
    if panels[1]:
        axes = next(left)
        title(axes, "Acceleration in m/s²")
        _curve(axes, traces["asked acceleration"], ASKED, "asked", linestyle=(0, (4, 2)))
        _curve(axes, traces["acceleration"], DONE, "made (by the wheels, over 0.3 s)", linewidth=0.9)
        _legend(axes)
    if panels[2]:
        axes = next(left)
        has_value = traces["value"].count > 0
        title(axes, "Value, and the ESC's duty" if has_value and driven else "Value" if has_value else "The ESC's duty")
        if has_value:
            _curve(axes, traces["value"], ASKED, "value")
        beside = axes.twinx() if has_value and driven else axes
        for channel, duty in sorted(driven.items()):
            _curve(beside, duty, SENT, f"duty on channel {channel}"
                   + (" (right scale)" if beside is not axes else ""), **HELD)
        if beside is not axes:
            beside.grid(False)
            axes.legend(handles=axes.get_lines() + beside.get_lines(), **_above())
        else:
            _legend(axes)
    return figure


def _link(drive):
    traces = drive.traces
    panels = [traces["frames"].count > 0, traces["round trip"].count > 0, traces["skew"].count > 0]
    if not any(panels):
        return None
    figure, all_axes = _stack(drive, panels, [1.5, 1.5, 1.5])
    left = iter(all_axes)
    if panels[0]:
        axes = next(left)
        title(axes, "Frames from the Teensy in a second")
        _curve(axes, traces["frames"], SENT, "good", gap_s=5)
        _curve(axes, traces["bad frames"], BAD, "corrupt", gap_s=5)
        axes.set_ylim(bottom=-0.03 * max(traces["frames"].greatest, 1))
        _legend(axes)
    if panels[1]:
        axes = next(left)
        title(axes, "Round trip of a ping in ms")
        _curve(axes, traces["round trip"], SENT, "", gap_s=5, marker=".", markersize=4)
        axes.set_ylim(bottom=0)
    if panels[2]:
        axes = next(left)
        title(axes, "How much faster the Teensy's clock runs, in ppm")
        _curve(axes, traces["skew"], SENT, "", gap_s=5, marker=".", markersize=4)
        low, high = np.nanpercentile(traces["skew"].curve()[1], (10, 90))  # the first few are far off
        axes.set_ylim(low - max(high - low, 10), high + max(high - low, 10))
    return figure


# --- what they are made of ---


def title(axes, text: str) -> None:
    """Put a title over a plot's left end."""
    axes.set_title(text, loc="left", color=INK)


def _stack(drive, panels, heights):
    """A figure with one above the other, those that are wanted, over the same time."""
    heights = [height for height, wanted in zip(heights, panels) if wanted]
    figure = Figure(figsize=(WIDTH_IN, sum(heights) + 0.45 * len(heights) + 0.25), constrained_layout=True)
    all_axes = figure.subplots(len(heights), 1, sharex=True, squeeze=False,
                               gridspec_kw={"height_ratios": heights})[:, 0]
    for axes in all_axes:
        _time_axis(axes, drive, labelled=axes is all_axes[-1])
        _strip(axes, drive)
    return figure, list(all_axes)


def _time_axis(axes, drive, labelled=True):
    axes.set_xlim(0, max(drive.duration_s, 1e-3))
    if drive.duration_s > 180:
        axes.xaxis.set_major_locator(MaxNLocator(9, steps=[1, 1.2, 1.5, 2, 3, 6, 10]))
        axes.xaxis.set_major_formatter(FuncFormatter(lambda time_s, _: f"{int(time_s) // 60}:{int(time_s) % 60:02}"))
    if labelled:
        axes.set_xlabel("minutes:seconds" if drive.duration_s > 180 else "seconds")


def _strip(axes, drive):
    """Who drove, along the lower edge."""
    for start_s, width_s, source in _bands(drive):
        axes.broken_barh([(start_s, width_s)], (0, 0.025), color=DRIVER_COLOURS[source], linewidth=0,
                         transform=axes.get_xaxis_transform(), zorder=1)


def _bands(drive):
    """Start, width, source: neighbours with the same source are one; of those too short to be seen the first is."""
    shortest_s = max(drive.duration_s * SHOWN_S, 1e-9)
    bands = []
    for episode in drive.episodes:
        if bands and (bands[-1][2] == episode.source or bands[-1][0] + shortest_s > episode.end_s):
            bands[-1][1] = episode.end_s - bands[-1][0]
        else:
            bands.append([episode.start_s, episode.end_s - episode.start_s, episode.source])
    return [(start_s, max(width_s, shortest_s), source if source in DRIVER_COLOURS else UNKNOWN_DRIVER)
            for start_s, width_s, source in bands]


def _curve(axes, trace, colour, label, gap_s=1.0, **style):
    if trace.count:
        times, values = trace.curve(gap_s)
        axes.plot(times, values, color=colour, label=label or "_", **style)


def _usual(trace):
    """A magnitude that all but a twentieth of a trace's extremes stay below; single ones are noise."""
    return float(np.nanpercentile(np.abs(trace.curve()[1]), 95)) if trace.count else 0.0


def _legend(axes):
    if axes.get_legend_handles_labels()[0]:
        axes.legend(**_above())


def _above():
    return {"loc": "lower right", "ncol": 3, "bbox_to_anchor": (1.0, 0.98), "borderaxespad": 0.2}


def _svg(figure, name, words):
    """The SVG's text, its ids made unique in a page, with its words."""
    FigureCanvasSVG(figure)
    file = io.StringIO()
    figure.savefig(file, format="svg", metadata={"Date": None})
    text = file.getvalue()
    text = text[text.index("<svg"):]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    text = re.sub(r'\bid="', f'id="{name}-', text)
    text = re.sub(r'(href="#|url\(#)', rf"\g<1>{name}-", text)
    return text.replace("<svg ", f'<svg role="img" aria-label="{words}" data-plot="{name}" ', 1)
