"""The plots of a drive."""
import copy
import math
import re

from car_interface.tools.report import plots as report_plots
from car_interface.tools.report.downsample import Traces
from car_interface.tools.report.plots import DRIVER_COLOURS
from tools.report.summaries import summarized
from written_recordings import odometry, output


def test_each_plot_is_one_svg_with_ids_of_its_own(drawn):
    assert list(drawn) == ["who", "steering", "path", "speed", "link"]
    ids = [name for plot in drawn.values() for name in re.findall(r'\bid="([^"]+)"', plot)]
    assert len(ids) == len(set(ids))
    for plot in drawn.values():
        assert plot.startswith('<svg role="img" aria-label="') and plot.count("</svg>") == 1
        used = set(re.findall(r'(?:href="#|url\(#)([\w.-]+)', plot))
        assert used <= set(re.findall(r'\bid="([^"]+)"', plot))


def test_each_trace_shows_in_its_plot(seen, monkeypatch):
    shown = []
    monkeypatch.setattr(report_plots, "curve", lambda axes, trace, *_, **__: shown.append(trace))
    monkeypatch.setattr(report_plots, "legend", lambda axes: None)
    for draw, names in ((report_plots._steering, "requested curvature, sent curvature, driven curvature, gamepad"),
                        (report_plots._speed, "speed, acceleration, requested acceleration, value"),
                        (report_plots._link, "frames, bad frames, round trip, skew")):
        shown.clear()
        traces = Traces(seen.duration_s)
        for name in names.split(", "):
            traces[name].add(1.0, 0.3)
        other = copy.copy(seen)
        other.traces = traces
        draw(other)
        assert {name for name, trace in traces.items() if trace.count and trace in shown} == set(names.split(", "))


def test_steering_shows_what_was_driven_where_that_is_tighter_than_what_was_sent(tmp_path):
    messages = [odometry(0.02 * step, math.sin(0.02 * step), 1 - math.cos(0.02 * step), 0.02 * step, 1.0)
                for step in range(500)]
    figure = report_plots._steering(summarized(tmp_path, messages))
    low, high = figure.axes[0].get_ylim()
    assert low < -1.0 and high > 1.0  # 1/m


def test_path_under_a_later_one_stays_visible(seen):
    axes = report_plots._path(seen).axes[0]
    lines = [line for line in axes.get_lines() if line.get_color() in DRIVER_COLOURS.values()]
    widths = {line.get_color(): line.get_linewidth() for line in lines}  # in the order in which they first drove
    assert len(widths) > 1 and list(widths.values()) == sorted(widths.values(), reverse=True)
    assert all((one.get_zorder() < other.get_zorder()) == (one.get_linewidth() > other.get_linewidth())
               for one in lines for other in lines)


def test_servos_channel_is_not_drawn_as_the_escs_though_its_channel_is_unknown(tmp_path, monkeypatch):
    drawn = []
    monkeypatch.setattr(report_plots, "curve", lambda axes, trace, colour, label, *_, **__: drawn.append(label))
    seen = summarized(tmp_path, [output(0.1 * step, 5000 + 16 * step, 4912 + 16 * step) for step in range(20)])
    with monkeypatch.context() as patch:
        patch.setattr(report_plots, "title", lambda axes, text: drawn.append(text))
        report_plots._speed(seen)
    assert drawn == ["The ESC's duty", "duty on channel 1"]
