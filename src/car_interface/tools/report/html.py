"""Parts of a page in HTML, and texts for numbers and times."""
from __future__ import annotations

import time
from html import escape
from typing import Iterable, Sequence

from car_interface.common.units import NS_PER_S

SAME_RATIO = 0.015  # from 1: it counts as the same
MANY_TIMES = 10  # more than that is no percentage any more
MIN_DATE_NS = 1_000_000_000 * NS_PER_S  # September 2001: before ROS; the clock of a simulation begins at 0
OPEN_ROWS, MAX_ROWS = 25, 500  # of a table: shown at once, and altogether
STYLE = """
:root { color-scheme: light; --ink: #16202b; --faint: #5c6773; --line: #dfe4e9; --bad: #c0392b; --warn: #b9671a;
        --good: #1b7f5c; }
* { box-sizing: border-box; }
body { margin: 0; background: #f4f6f8; color: var(--ink);
       font: 16px/1.5 system-ui, -apple-system, "Segoe UI", Roboto, "DejaVu Sans", sans-serif; }
main { max-width: 1060px; margin: 0 auto; padding: 32px 20px 64px; }
h1 { font-size: 26px; line-height: 1.25; margin: 0 0 4px; overflow-wrap: anywhere; }
h2 { font-size: 19px; margin: 0 0 4px; }
section, header { background: white; border: 1px solid var(--line); border-radius: 10px; padding: 22px 26px;
                  margin-bottom: 18px; }
p { margin: 0 0 12px; max-width: 78ch; }
.faint { color: var(--faint); }
.verdict { font-size: 17px; margin: 12px 0 18px; }
.figures { display: grid; grid-template-columns: repeat(auto-fit, minmax(150px, 1fr)); gap: 10px; margin-bottom: 18px; }
.figures div { border: 1px solid var(--line); border-radius: 8px; padding: 10px 14px; }
.figures b { display: block; font-size: 23px; font-weight: 650; font-variant-numeric: tabular-nums; }
.figures span { color: var(--faint); font-size: 13.5px; }
table { border-collapse: collapse; width: 100%; font-size: 14.5px; }
th, td { text-align: left; vertical-align: top; padding: 5px 14px 5px 0; border-bottom: 1px solid var(--line);
         overflow-wrap: anywhere; }
th { font-weight: 600; color: var(--faint); }
tr:last-child td, tr:last-child th { border-bottom: 0; }
td.number, th.number { text-align: right; width: 1%; font-variant-numeric: tabular-nums; white-space: nowrap; }
.summary th { width: 230px; font-weight: 500; }
.bad { color: var(--bad); font-weight: 600; } .warn { color: var(--warn); font-weight: 600; }
.good { color: var(--good); font-weight: 600; }
.level { white-space: nowrap; }
.dot { display: inline-block; width: 11px; height: 11px; border-radius: 3px; margin-right: 7px; }
svg { display: block; width: 100%; height: auto; margin: 8px 0 2px; }
details summary { cursor: pointer; color: var(--faint); }
.scroll { overflow-x: auto; }
.verdict a, .figures a { color: inherit; }
@media (max-width: 700px) { main { padding: 12px 8px 32px; } section, header { padding: 16px 14px; }
  .scroll > svg { min-width: 640px; } .summary th { width: 120px; } }
@media print { body { background: white; } section, header { break-inside: avoid; border: 0; padding: 8px 0; } }
"""
# A browser must not load anything, nor run scripts, which texts of a recording could contain.
POLICY = "default-src 'none'; style-src 'unsafe-inline'"


def document(title: str, body: str) -> str:
    """A whole page; the title is plain text, the body HTML."""
    return (f'<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
            f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">\n'
            f'<meta name="viewport" content="width=device-width, initial-scale=1">\n'
            f"<title>{escape(title)}</title>\n<style>{STYLE}</style>\n</head>\n<body>\n<main>\n"
            + body + "</main>\n</body>\n</html>\n")


def section(name: str, title: str, text: str, *parts: str) -> str:
    """A section of the page; name and title are plain text, the rest is HTML."""
    shown = (f'<div class="scroll">{part}</div>\n' if part.startswith("<svg") else part for part in parts)
    return (f'<section id="{name}">\n<h2>{escape(title)}</h2>\n<p class="faint">{text}</p>\n' + "".join(shown)
            + "</section>\n")


def table(names: Sequence[str], rows: Sequence[Sequence], numbers: int, numbers_from: int | None = None,
          open_rows: int = OPEN_ROWS) -> str:
    """A table, folded if it has more than ``open_rows``; cells are HTML.

    The first ``numbers`` columns, or those from ``numbers_from`` on, are numbers.
    """
    def kind(index):
        is_number = index < numbers if numbers_from is None else index >= numbers_from
        return ' class="number"' if is_number else ""
    head = "".join(f"<th{kind(index)}>{escape(name)}</th>" for index, name in enumerate(names))
    body = "\n".join("<tr>" + "".join(f"<td{kind(index)}>{cell}</td>" for index, cell in enumerate(row)) + "</tr>"
                     for row in rows[:MAX_ROWS])
    more = f'<p class="faint">And {len(rows) - MAX_ROWS} more.</p>\n' if len(rows) > MAX_ROWS else ""
    text = f'<div class="scroll"><table>\n<tr>{head}</tr>\n{body}\n</table></div>\n{more}'
    return f"<details><summary>{len(rows)} lines</summary>\n{text}</details>\n" if len(rows) > open_rows else text


def counted(texts: Iterable[str]) -> str:
    """Texts with their numbers, the most frequent first."""
    counts: dict = {}
    for text in texts:
        counts[text] = counts.get(text, 0) + 1
    ordered = sorted(counts.items(), key=lambda item: -item[1])
    return "; ".join(text + (f" ({count}×)" if count > 1 else "") for text, count in ordered[:6])


def range_text(minimum: float, maximum: float, unit: str) -> str:
    """A range with its unit."""
    return f"{round(minimum, 2) + 0.0:.2f} to {round(maximum, 2) + 0.0:.2f} {unit}"  # + 0.0: no "-0.00"


def date_text(time_ns: int) -> str:
    """ROS time as a date, UTC; in words where the clock had none."""
    if time_ns < MIN_DATE_NS:
        return f"no date: its clock began at 0, {span_text(time_ns / NS_PER_S)} before"
    return time.strftime("%Y-%m-%d %H:%M:%S UTC", time.gmtime(time_ns / NS_PER_S))


def times_text(count: int) -> str:
    """How often: never, once, twice, 3 times."""
    return ("never", "once", "twice")[count] if count < 3 else f"{count} times"


def ratio_text(ratio: float, wanted: str, more: str, less: str) -> str:
    """A ratio in words: as ``wanted``, or by how many percent more or less than that."""
    if abs(ratio - 1) < SAME_RATIO:
        return f"as {wanted}"
    if ratio > MANY_TIMES:
        return f"more than {MANY_TIMES} times {more} than {wanted}"
    return f"{abs(ratio - 1):.0%} {more if ratio > 1 else less} than {wanted}"


def moment_text(time_s: float, duration_s: float) -> str:
    """A time of a drive: 7.25 s, or in a long one 3:07.2."""
    if duration_s < 100:
        return f"{time_s:.2f} s"
    minutes, tenths = divmod(round(time_s * 10), 600)
    return f"{minutes}:{tenths // 10:02}.{tenths % 10}"


def span_text(time_s: float) -> str:
    """A duration: 0.05 s, 12.5 s, 3 min 7 s, 1 h 2 min."""
    if time_s < 100:
        return f"{time_s:.2g} s" if time_s < 0.1 else f"{time_s:.1f} s"
    minutes, seconds = divmod(round(time_s), 60)
    return f"{minutes // 60} h {minutes % 60} min" if minutes >= 60 else f"{minutes} min {seconds} s"
