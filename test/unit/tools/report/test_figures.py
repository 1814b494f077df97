"""What the plots have in common: episodes as bands, axes over time, curves, and the text of an SVG."""
import math
from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.figure import Figure

from car_interface.common.sources import LOCKED, NEUTRAL, PLANNER, TELEOP
from car_interface.tools.report.downsample import Trace
from car_interface.tools.report.plots import bands, curve, label_text, stack, usual_magnitude
from car_interface.tools.report.states import Episode


def drive(duration_s, *episodes):
    """A drive with episodes of (start in s, end in s, source)."""
    return SimpleNamespace(duration_s=duration_s, steering=SimpleNamespace(
        episodes=[Episode(start_s, end_s, "turn_arb", "", "", source) for start_s, end_s, source in episodes]))


def trace(*samples):
    made = Trace(100.0)
    for time_s, value in samples:
        made.add(time_s, value)
    return made


@pytest.fixture
def axes():
    return Figure().subplots()


# --- bands ---

@pytest.mark.parametrize("episodes, expected", [
    pytest.param([], [], id="none"),
    pytest.param([(0, 10, TELEOP), (10, 30, PLANNER)], [(0, 10, TELEOP), (10, 20, PLANNER)], id="each_source"),
    pytest.param([(0, 10, TELEOP), (10, 30, TELEOP)], [(0, 30, TELEOP)], id="same_source_is_one"),
    # Of 1000 s, 0.7 s can just be seen.
    pytest.param([(0, 0.1, NEUTRAL), (50, 60, TELEOP)], [(0, 0.7, NEUTRAL), (50, 10, TELEOP)], id="short_is_drawn"),
    pytest.param([(0, 0.1, NEUTRAL), (0.1, 0.2, LOCKED), (0.2, 50, TELEOP)], [(0, 0.7, NEUTRAL), (0.2, 49.8, TELEOP)],
                 id="short_ones_at_the_same_place_are_one"),
])
def test_bands_are_start_width_and_source(episodes, expected):
    found = bands(drive(1000, *episodes))
    assert [source for _, _, source in found] == [source for _, _, source in expected]
    assert [band[:2] for band in found] == [pytest.approx(band[:2]) for band in expected]


# --- axes ---

def test_stack_draws_the_wanted_panels_and_labels_the_last_one():
    drawn = []
    figure = stack(drive(60, (0, 30, TELEOP), (30, 60, PLANNER)), [
        (2.0, drawn.append), None, (1.0, drawn.append)])
    panels = figure.axes
    assert len(panels) == 2 and drawn == panels
    assert [panel.get_xlabel() for panel in panels] == ["", "seconds"]
    assert figure.get_size_inches()[1] == pytest.approx(2.0 + 1.0 + 2 * 0.45 + 0.25)
    assert [len(panel.collections) for panel in panels] == [2, 2]  # who steered
    assert stack(drive(60), [None]) is None


# --- curves ---

def test_curve_has_the_samples_of_its_trace_and_a_gap_where_they_are_missing(axes):
    curve(axes, trace((0, 1.0), (0.5, 2.0), (10, 3.0)), "red", "speed", gap_s=1.0)
    (line,) = axes.lines
    assert line.get_label() == "speed" and line.get_color() == "red"
    times, values = line.get_data()
    finite = np.isfinite(values)
    assert sorted(set(zip(times[finite], values[finite]))) == [(0, 1.0), (0.5, 2.0), (10, 3.0)]
    assert np.isnan(values[(times > 0.5) & ~finite]).any()


def test_usual_magnitude_ignores_a_single_outlier():
    samples = [(0.5 * index, -2.0 if index % 2 else 2.0) for index in range(100)]
    assert usual_magnitude(trace(*samples, (60, 1000.0))) == 2.0
    assert usual_magnitude(trace()) == 0.0
    assert math.isfinite(usual_magnitude(trace((0, 1.0), (90, 1.0))))  # with a gap


# --- SVG ---

@pytest.mark.parametrize("text, shown", [
    ("planner silent", "planner silent"), ("电池 low", "?? low"), ("низкий", "низкий"), ("a\tb\nc", "a b c"),
    ("_x", " _x"), ("$\\frac{x$", "\\$\\frac{x\\$"), ("x" * 100, "x" * 59 + "…"), ("\x07", "?"),
], ids=["plain", "chinese", "cyrillic", "white_space", "underscore", "formula", "long", "bell"])
def test_label_of_a_text_from_outside_is_drawn_as_it_reads(text, shown):
    assert label_text(text) == shown
