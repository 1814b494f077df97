"""Draws what the plots have in common: colours, style, axes over time, and the text of an SVG."""
from __future__ import annotations

import io
import re
from functools import lru_cache

import numpy as np
from matplotlib import font_manager
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MaxNLocator

from car_interface.common.sources import LOCKED, NEUTRAL, NO_HUMAN, PLANNER, TELEOP
from car_interface.tools.report.states import UNKNOWN_DRIVER

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
    """Return a figure with panels one above the other over the same time; ``None`` when none is wanted.

    Args:
        panels: (whether it is wanted, height in inches, function of axes and drive that draws it) of each.
    """
    panels = [(height, draw) for is_wanted, height, draw in panels if is_wanted]
    if not panels:
        return None
    heights = [height for height, _ in panels]
    figure = Figure(figsize=(WIDTH_IN, sum(heights) + 0.45 * len(heights) + 0.25), constrained_layout=True)
    all_axes = figure.subplots(len(heights), 1, sharex=True, squeeze=False,
                               gridspec_kw={"height_ratios": heights})[:, 0]
    for axes in all_axes:
        time_axis(axes, drive, labelled=axes is all_axes[-1])
        _strip(axes, drive)
    for axes, (_, draw) in zip(all_axes, panels):
        draw(axes, drive)
    return figure


def time_axis(axes, drive, labelled=True):
    """Set the range and the labels of a time axis."""
    axes.set_xlim(0, max(drive.duration_s, 1e-3))
    if drive.duration_s > 180:
        axes.xaxis.set_major_locator(MaxNLocator(9, steps=[1, 1.2, 1.5, 2, 3, 6, 10]))
        axes.xaxis.set_major_formatter(FuncFormatter(lambda time_s, _: f"{int(time_s) // 60}:{int(time_s) % 60:02}"))
    if labelled:
        axes.set_xlabel("minutes:seconds" if drive.duration_s > 180 else "seconds")


def _strip(axes, drive):
    """Draw who steered along the lower edge."""
    for start_s, width_s, source in bands(drive):
        axes.broken_barh([(start_s, width_s)], (0, 0.025), color=DRIVER_COLOURS[source], linewidth=0,
                         transform=axes.get_xaxis_transform(), zorder=1)


def bands(drive):
    """Return (start, width, source) of episodes; those with the same source, or too short to see, are one."""
    shortest_s = max(drive.duration_s * SHOWN_S, 1e-9)
    bands = []
    for episode in drive.steering.episodes:
        if bands and (bands[-1][2] == episode.source or bands[-1][0] + shortest_s > episode.end_s):
            bands[-1][1] = episode.end_s - bands[-1][0]
        else:
            bands.append([episode.start_s, episode.end_s - episode.start_s, episode.source])
    return [(start_s, max(width_s, shortest_s), source if source in DRIVER_COLOURS else UNKNOWN_DRIVER)
            for start_s, width_s, source in bands]


def curve(axes, trace, colour, label, gap_s=1.0, **style):
    """Draw a trace, unless it is empty."""
    if trace.count:
        times, values = trace.curve(gap_s)
        axes.plot(times, values, color=colour, label=label or "_", **style)


def usual_magnitude(trace):
    """Return the 95th percentile of a trace's magnitude; single larger ones are noise."""
    return float(np.nanpercentile(np.abs(trace.curve()[1]), 95)) if trace.count else 0.0


def legend(axes):
    """Draw a legend above the axes, unless nothing has a label."""
    if axes.get_legend_handles_labels()[0]:
        axes.legend(**ABOVE)


def svg_text(figure, name, description):
    """Return the text of an SVG whose ids are unique in a page."""
    FigureCanvasSVG(figure)
    file = io.StringIO()
    figure.savefig(file, format="svg", metadata={"Date": None})
    text = file.getvalue()
    text = text[text.index("<svg"):]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    text = re.sub(r'\bid="', f'id="{name}-', text)
    text = re.sub(r'(href="#|url\(#)', rf"\g<1>{name}-", text)
    return text.replace("<svg ", f'<svg role="img" aria-label="{description}" data-plot="{name}" ', 1)
