"""Draws the plots of a drive, each as the text of an SVG that can be part of a page."""
from __future__ import annotations

from itertools import groupby

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from car_interface.tools.report.faults import ERROR
from car_interface.tools.report.figures import (
    ABOVE,
    BAD,
    DRIVEN,
    DRIVER_COLOURS,
    DRIVER_NAMES,
    HELD,
    INK,
    REQUESTED,
    SENT,
    STYLE,
    WIDTH_IN,
    bands,
    curve,
    label_text,
    legend,
    stack,
    svg_text,
    time_axis,
    title,
    usual_magnitude,
)
from car_interface.tools.report.states import UNKNOWN_DRIVER
from car_interface.tools.report.summary import Summary

DASHED = (0, (4, 2))
ASKED, DONE = {"linestyle": DASHED}, {"linewidth": 0.9}
DOTTED = {"gap_s": 5, "marker": ".", "markersize": 4}
PATH_WIDTH, WIDER = 1.6, 1.6  # of the path of who was the last to begin, and by how much those before are wider
ESC_COLOURS = {"ARMING": "#b8bfc7", "BRAKING": "#d9822b", "HOLD": "#e8c468", "REVERSE": "#8e5ea2"}


def plots(drive: Summary) -> dict[str, str]:
    """Return the SVGs for which there are data, by name, in the order of the page."""
    made = {}
    with matplotlib.rc_context(STYLE):
        for name, draw, description in (
                ("calibration", _calibration, "the curvature of each duty: driven, by the new table, by the old one"),
                ("who", _who, "who drove when, as bands of colour over time"),
                ("steering", _steering, "curvature requested, sent and driven, and the servo's duty, over time"),
                ("throttle", _throttle, "throttle asked and granted, and the ESC's state, over time"),
                ("path", _path, "the car's path from above, with the places that the sonars saw"),
                ("speed", _speed, "speed, acceleration and the ESC over time"),
                ("battery", _battery, "the battery's voltage over time"),
                ("link", _link, "frames, round trip and clock skew of the Teensy's link over time")):
            figure = draw(drive)
            if figure is not None:
                made[name] = svg_text(figure, name, description)
    return made


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


def _panel(traces, height_in, text, *curves, **limits):
    """Return a panel for ``stack``, wanted if one of its traces has samples.

    Args:
        curves: the trace's name, colour, label and style of each.
        limits: of the vertical axis, as for set_ylim; none = by the curves.
    """
    def draw(axes, drive):
        title(axes, text)
        for name, colour, label, style in curves:
            curve(axes, traces[name], colour, label, **style)
        if limits:
            axes.set_ylim(**limits)
        legend(axes)
    return any(traces[name].count for name, *_ in curves), height_in, draw


def _symmetric(largest):
    return {"bottom": -largest, "top": largest}


def _steering(drive):
    traces, which = drive.traces, "the table before" if drive.calibration else "the tables"
    sent = [trace for trace in (traces["requested curvature"], traces["sent curvature"]) if trace.count]
    largest = max([abs(bound) for trace in sent for bound in (trace.minimum, trace.maximum)]
                  + [0.2, usual_magnitude(traces["driven curvature"])])
    angle = _panel(traces, 1.4, "The steering angle that was asked for, in degrees, left up",
                   ("requested angle", REQUESTED, "", {}))
    return stack(drive, [
        _panel(traces, 2.6, "How tight: 1/radius in 1/m, left up",
               ("requested curvature", REQUESTED, "requested (planner)", ASKED),
               ("sent curvature", SENT, f"sent (by {which})", {"linewidth": 1.6}),
               ("driven curvature", DRIVEN, "driven (by odometry)", DONE), **_symmetric(1.45 * largest)),
        *([angle] if drive.asked.wheelbase_m is None else []),
        (drive.steering.steering_channel in drive.steering.duties or traces["gamepad"].count > 0, 1.7, _steering_duty),
        _panel(traces, 1.4, "The position of the VESC's servo, 0 to 1", ("servo position", SENT, "", HELD))])


def _steering_duty(axes, drive):
    duty, gamepad = drive.steering.duties.get(drive.steering.steering_channel), drive.traces["gamepad"]
    title(axes, "The servo's duty" if duty else "The gamepad's request, left up")
    beside = _two_scales(
        axes, [(duty, SENT, f"duty on channel {drive.steering.steering_channel}", HELD)] if duty else [],
        [(gamepad, REQUESTED, "the gamepad's request" if duty else "", ASKED)] if gamepad.count else [])
    if duty:
        margin = max(0.08 * (duty.maximum - duty.minimum), 40)
        axes.set_ylim(duty.minimum - margin, duty.maximum + margin)
    if gamepad.count:
        beside.set_ylim(-1.25, 1.25)


def _two_scales(axes, left, right):
    """Draw curves, each a trace with its colour, label and style; where there are both, those at the right have a scale
    of their own. Return its axes.
    """
    has_both = bool(left and right)
    beside = axes.twinx() if has_both else axes
    for trace, colour, label, style in left:
        curve(axes, trace, colour, label, **style)
    for trace, colour, label, style in right:
        curve(beside, trace, colour, label + (" (right scale)" if has_both else ""), **style)
    if has_both:
        beside.grid(False)
        axes.legend(handles=axes.get_lines() + beside.get_lines(), **ABOVE)
    else:
        legend(axes)
    return beside


def _throttle(drive):
    return stack(drive, [(drive.traces["throttle granted"].count > 0, 0.4, _esc_states), _panel(
        drive.traces, 1.7, "Throttle: brake or reverse down", ("throttle asked", REQUESTED, "asked", ASKED),
        ("throttle granted", SENT, "granted", {}), bottom=-1.1, top=1.1)])


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
    path, (echo_x, echo_y) = drive.motion.path, drive.sonars.echoes.places()
    if len(path.x_m) < 2 and not len(echo_x):
        return None
    width_m, height_m = (np.nanmax(both) - np.nanmin(both) + 0.5 for both in (
        np.concatenate([path.x_m, echo_x]), np.concatenate([path.y_m, echo_y])))
    figure = Figure(figsize=(WIDTH_IN, min(max(0.75 * WIDTH_IN * height_m / width_m + 0.7, 2.8), 6.8)))
    axes = figure.add_subplot()
    if len(echo_x):
        axes.plot(echo_x, echo_y, linestyle="none", marker="o", markersize=2.6, markeredgewidth=0, color=REQUESTED,
                  alpha=0.55, label="seen by a sonar")
    # By the order in which they first drove: a path under another one stays visible.
    sources = list(dict.fromkeys(kind if kind in DRIVER_COLOURS else UNKNOWN_DRIVER for kind in path.kinds))
    end, seen = 0, set()
    for kind, points in groupby(path.kinds):
        begin, end = max(end - 1, 0), end + len(list(points))
        source = kind if kind in DRIVER_COLOURS else UNKNOWN_DRIVER
        width = PATH_WIDTH + WIDER * (len(sources) - 1 - sources.index(source))
        axes.plot(path.x_m[begin:end], path.y_m[begin:end], linewidth=width, color=DRIVER_COLOURS[source],
                  label=None if source in seen else DRIVER_NAMES[source], solid_capstyle="round",
                  zorder=3 - width / 10)
        seen.add(source)
    if len(path.x_m):
        axes.plot(path.x_m[0], path.y_m[0], marker="o", markersize=8, color="white", markeredgecolor=INK,
                  markeredgewidth=1.5, linestyle="none", label="start")
        axes.plot(path.x_m[-1], path.y_m[-1], marker="s", markersize=7, color=INK, linestyle="none", label="end")
    axes.set_aspect("equal", adjustable="datalim")
    axes.margins(0.06)
    axes.set(xlabel="x of odometry in m", ylabel="y of odometry in m")
    axes.legend(loc="center left", bbox_to_anchor=(1.01, 0.5))
    height_in = figure.get_figheight()
    figure.subplots_adjust(left=0.07, right=0.82, top=1 - 0.12 / height_in, bottom=0.55 / height_in)
    return figure


def _speed(drive):
    traces = drive.traces
    fastest = max([0.1, *(1.3 * usual_magnitude(traces[name]) for name in ("imu turn rate", "turn rate"))])
    turn_rates = _panel(traces, 1.6, "How fast it turned, in rad/s, left up",
                        ("imu turn rate", REQUESTED, "by the IMU", DONE), ("turn rate", DRIVEN, "by odometry", DONE),
                        **_symmetric(fastest))
    return stack(drive, [
        (traces["speed"].count > 0, 2.0, _speeds),
        _panel(traces, 2.0, "Acceleration in m/s²", ("requested acceleration", REQUESTED, "requested", ASKED),
               ("acceleration", DRIVEN, "by odometry, over 0.3 s", DONE)),
        (traces["value"].count > 0 or bool(_driven_duties(drive)), 1.6, _value),
        _panel(traces, 1.6, "The VESC's motor speed in ERPM", ("motor speed asked", REQUESTED, "requested", ASKED),
               ("motor speed", DRIVEN, "measured", DONE)),
        *([turn_rates] if traces["imu turn rate"].count else [])])


def _driven_duties(drive):
    """Return the duties that changed, by channel, without the servo's."""
    return {channel: duty for channel, duty in sorted(drive.steering.duties.items())
            if channel != drive.steering.steering_channel and duty.maximum > duty.minimum}


def _speeds(axes, drive):
    traces = drive.traces
    title(axes, "Speed in m/s, backward down")
    curve(axes, traces["requested speed"], REQUESTED, "requested", linestyle=DASHED)
    curve(axes, traces["planner's speed"], REQUESTED, "requested by the planner", linestyle=(0, (1, 1)))
    curve(axes, traces["reference speed"], SENT, "within its limits", linewidth=0.9)
    curve(axes, traces["speed"], DRIVEN, "by odometry")
    if traces["requested speed"].count or traces["planner's speed"].count:
        legend(axes)


def _value(axes, drive):
    duties, value = _driven_duties(drive), drive.traces["value"]
    title(axes, "The ESC's duty" if not value.count else "Value, and the ESC's duty" if duties else "Value")
    _two_scales(axes, [(value, REQUESTED, "value", {})] if value.count else [],
                [(duty, SENT, f"duty on channel {channel}", HELD) for channel, duty in duties.items()])


def _battery(drive):
    return stack(drive, [_panel(drive.traces, 1.5, "The battery's voltage",
                                ("battery voltage", SENT, "", {"gap_s": 15}))])  # some publish it once in 10 s


def _link(drive):
    traces = drive.traces
    return stack(drive, [
        _panel(traces, 1.5, "Frames from the Teensy in a second", ("frames", SENT, "good", {"gap_s": 5}),
               ("bad frames", BAD, "corrupt", {"gap_s": 5}), bottom=-0.03 * max(traces["frames"].maximum, 1)),
        _panel(traces, 1.5, "Round trip of a ping in ms", ("round trip", SENT, "", DOTTED), bottom=0),
        _panel(traces, 1.5, "How much faster the Teensy's clock runs, in ppm", ("skew", SENT, "", DOTTED),
               **_most(traces["skew"]))])


def _most(skew):
    """Return limits that leave out the first few values, which are far off."""
    if not skew.count:
        return {}
    low, high = np.nanpercentile(skew.curve()[1], (10, 90))
    margin = max(high - low, 10, 1e-3 * max(abs(low), abs(high)))  # garbage is drawn, too
    return {"bottom": low - margin, "top": high + margin}
