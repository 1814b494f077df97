"""Renders pages by the templates beside this module, and puts numbers and times into words."""
from __future__ import annotations

import math
import re
import time
from collections import Counter
from pathlib import Path
from typing import Any, Iterable

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup, escape

from car_interface.common.units import NS_PER_S

SAME_RATIO = 0.015  # from 1: taken for the same
MANY_TIMES = 10  # more than that is no percentage any more
NAME_PART = re.compile(r"(?<=[^\W_])([/_]+)(?=\w)")
MIN_DATE_NS = 1_000_000_000 * NS_PER_S  # September 2001: before ROS; the clock of a simulation begins at 0


def render(template: str, **values: Any) -> str:
    """Return a page as HTML by a template such as drive.html; texts are escaped: recordings come from other people."""
    pages = Environment(loader=FileSystemLoader(str(Path(__file__).with_name("templates"))), autoescape=True,
                        undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True)
    pages.filters.update(breakable=breakable, counted=counted, date=date_text, span=span_text, times=times_text,
                         radius=radius_text, zip=zip)
    pages.tests["finite"] = math.isfinite
    return pages.get_template(template).render(values)


def breakable(text: str) -> Markup:
    """Return a text as HTML whose long names, of topics and files, break behind / and _ and not in mid-word."""
    return Markup(NAME_PART.sub(r"\1<wbr>", str(escape(text))))


def counted(texts: Iterable[str]) -> str:
    """Return texts with how often each comes, the most frequent first."""
    return "; ".join(text + (f" ({count}×)" if count > 1 else "") for text, count in Counter(texts).most_common(6))


def date_text(time_ns: int) -> str:
    """Return ROS time as a date, UTC; in words where the clock had none."""
    if time_ns < MIN_DATE_NS:
        return f"no date: its clock began at 0, {span_text(time_ns / NS_PER_S)} before"
    return time.strftime("%Y-%m-%d %H:%M:%S UTC", time.gmtime(time_ns / NS_PER_S))


def radius_text(curvature_per_m: float) -> str:
    """Return the radius of a turn to a side; a negative curvature is one to the other side."""
    return "straight on" if abs(curvature_per_m) < 0.001 else f"{1 / curvature_per_m:.2f} m"


def times_text(count: int) -> str:
    """Return how often: never, once, twice, 3 times."""
    return ("never", "once", "twice")[count] if count < 3 else f"{count} times"


def ratio_text(ratio: float, wanted: str, more: str, less: str) -> str:
    """Return a ratio in words: as ``wanted``, or by how many percent more or less than that."""
    if abs(ratio - 1) < SAME_RATIO:
        return f"as {wanted}"
    if ratio > MANY_TIMES:
        return f"more than {MANY_TIMES} times {more} than {wanted}"
    return f"{abs(ratio - 1):.0%} {more if ratio > 1 else less} than {wanted}"


def moment_text(time_s: float, duration_s: float) -> str:
    """Return a time of a drive: 7.25 s, or in a long one 3:07.2."""
    if duration_s < 100:
        return f"{time_s:.2f} s"
    minutes, tenths = divmod(round(time_s * 10), 600)
    return f"{minutes}:{tenths // 10:02}.{tenths % 10}"


def span_text(time_s: float) -> str:
    """Return a duration: 0 s, <0.01 s, 0.05 s, 12.5 s, 3 min 7 s, 1 h 2 min; in words where it can't be known."""
    if time_s < 0:
        return "unknown"  # the clock was set back
    if 0 < time_s < 0.01:
        return "<0.01 s"  # as of a state that the node's next message changed
    if time_s < 99.95:
        return "0 s" if not time_s else f"{time_s:.2f} s" if time_s < 0.095 else f"{time_s:.1f} s"
    minutes, seconds = divmod(round(time_s), 60)
    return f"{minutes // 60} h {minutes % 60} min" if minutes >= 60 else f"{minutes} min {seconds} s"
