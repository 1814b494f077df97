"""A drive as one page of HTML that needs nothing besides itself: words, tables, plots."""
from __future__ import annotations

import math
import time
from html import escape
from typing import Iterable

from car_interface.report.plots import DRIVER_COLOURS, DRIVER_NAMES, Plot
from car_interface.report.summary import ERROR, NS_PER_S, SONARS, UNKNOWN_DRIVER, WARN, Drive
from car_interface.steering.arbiter import LOCKED, NEUTRAL, NO_HUMAN, PLANNER, TELEOP

OPEN_ROWS, MAX_ROWS = 25, 500  # of a table: shown at once, and at all
FEWEST_RATIOS = 30  # samples, before a ratio is told
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
.dot { display: inline-block; width: 11px; height: 11px; border-radius: 3px; margin-right: 7px; }
svg { display: block; width: 100%; height: auto; margin: 8px 0 2px; }
details summary { cursor: pointer; color: var(--faint); }
.scroll { overflow-x: auto; }
.verdict a { color: inherit; }
@media print { body { background: white; } section, header { break-inside: avoid; border: 0; padding: 8px 0; } }
"""
# What no browser may do with this page: fetch anything, or run what a recording's texts might smuggle in.
POLICY = "default-src 'none'; style-src 'unsafe-inline'"


def page(drive: Drive, plots: dict[str, Plot]) -> str:
    """The page.

    Args:
        drive: what it is about.
        plots: the ones that could be made.
    """
    name = drive.path.rstrip("/").rsplit("/", 1)[-1]
    sections = (_who(drive, plots), _faults(drive), _steering(drive, plots), _path(drive, plots), _speed(drive, plots),
                _link(drive, plots), _contents(drive))
    return (f'<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
            f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">\n'
            f'<meta name="viewport" content="width=device-width, initial-scale=1">\n'
            f"<title>Drive: {escape(name)}</title>\n<style>{STYLE}</style>\n</head>\n<body>\n<main>\n"
            + _head(drive, name) + "".join(sections) + "</main>\n</body>\n</html>\n")


# --- the summary ---


def _head(drive, name):
    began = time.strftime("%Y-%m-%d %H:%M:%S UTC", time.gmtime(drive.start_ns / NS_PER_S))
    place = f" · car {escape(drive.namespace)}" if drive.namespace.strip("/") else ""
    cards = [(_span(drive.duration_s), "recorded")]
    if "odom" in drive.present:
        cards += [(f"{drive.distance_m:.1f} m", "driven"), (f"{_top(drive):.2f} m/s", "top speed")]
    if drive.episodes:
        cards.append((_span(_driven(drive)), "somebody drove"))
    cards.append((str(sum(fault.times for fault in drive.faults) + drive.pending), "faults and timeouts"))
    figures = "".join(f"<div><b>{escape(value)}</b><span>{escape(what)}</span></div>" for value, what in cards)
    rows = "".join(f"<tr><th>{escape(what)}</th><td>{value}</td></tr>\n" for what, value in _summary(drive))
    return (f'<header id="summary">\n<h1>{escape(name)}</h1>\n<div class="faint">{began}{place}</div>\n'
            f'<p class="verdict">{_verdict(drive)}</p>\n<div class="figures">{figures}</div>\n'
            f'<table class="summary">\n{rows}</table>\n</header>\n')


def _verdict(drive):
    """The drive in a sentence or two."""
    parts = []
    if drive.episodes:
        drove = [f"the {DRIVER_NAMES[source]} for {_span(drive.source_s[source])}"
                 for source in (TELEOP, PLANNER) if drive.source_s[source]]
        text = " and ".join(drove).replace("for", "drove for", 1) if drove else "nobody drove"
        parts.append(text[0].upper() + text[1:] + ".")
        lost = [fault for fault in drive.faults if fault.where == "turn_arb"]
        if lost:
            parts.append(f'<span class="warn">The car was stopped {_times(len(lost))} because something was lost or '
                         "locked.</span>")
    bad = sum(fault.level == ERROR for fault in drive.faults)
    if bad:
        parts.append(f'<span class="bad">{bad} {"fault needs" if bad == 1 else "faults need"} somebody to look: '
                     'see <a href="#faults">below</a>.</span>')
    elif drive.faults:
        parts.append('Nothing was broken; what is worth a look stands <a href="#faults">below</a>.')
    else:
        parts.append('<span class="good">Nothing went wrong that this recording shows.</span>')
    return " ".join(parts)


def _summary(drive):
    """What is in the table on top: name, and HTML."""
    traces = drive.traces
    if drive.episodes:
        total = sum(drive.source_s.values()) or 1
        yield "Who drove", ", ".join(f"{DRIVER_NAMES.get(source, source)} {seconds / total:.0%}"
                                     for source, seconds in drive.source_s.most_common())
        stops = [episode for before, episode in zip(drive.episodes, drive.episodes[1:])
                 if before.source in (TELEOP, PLANNER) and episode.source in (LOCKED, NO_HUMAN, NEUTRAL)]
        yield "Went neutral", _times(len(stops)) + (": " + escape(_counted(_cause(stop) for stop in stops)) if stops
                                                    else "")
    if traces["speed"].count:
        mean = drive.distance_m / drive.moving_s if drive.moving_s else 0.0
        yield "Moving", f"{_span(drive.moving_s)}, on average at {mean:.2f} m/s; {_range(traces['speed'], 'm/s')}"
    if traces["acceleration"].count:
        yield "Acceleration", _range(traces["acceleration"], "m/s²")
    if any(count >= FEWEST_RATIOS for _, count in drive.turned):
        yield "Turned against the tables", "; ".join(
            f"{side} {_wider(ratio)}" for side, (ratio, count) in zip(("left", "right"), drive.turned)
            if count >= FEWEST_RATIOS)
    if math.isfinite(drive.nearest_m):
        yield "Nearest thing seen", (f"{drive.nearest_m:.2f} m, {escape(drive.nearest_sonar.replace('_', ' '))}, "
                                     f"at {_moment(drive, drive.nearest_s)}")
    link = drive.link
    if link is not None:
        frames, bad = link.frames - drive.first_link.frames, link.bad_frames - drive.first_link.bad_frames
        share = f" ({bad / (frames + bad):.2%})" if bad else ""
        reopened = f"; the port was opened again {_times(link.reconnects)}" if link.reconnects else ""
        reboots = f"; the Teensy started anew {_times(link.reboots)}" if link.reboots else ""
        yield "Teensy's link", (f"{frames} frames, {bad} corrupt{share}; {link.pongs} of {link.pings} pings answered"
                                f"{reopened}{reboots}")
    if traces["round trip"].count:
        yield "Round trip", _range(traces["round trip"], "ms")
    if traces["skew"].count:
        yield "Teensy's clock", (f"{traces['skew'].curve()[1][-1]:+.1f} ppm at the end, known to "
                                 f"{traces['uncertainty'].curve()[1][-1]:.2f} ms")


# --- the sections ---


def _section(name, title, words, *parts):
    return (f'<section id="{name}">\n<h2>{escape(title)}</h2>\n<p class="faint">{words}</p>\n' + "".join(parts)
            + "</section>\n")


def _plot(plots, name):
    return plots[name].svg if name in plots else ""


def _missing(drive, *topics):
    """A line for those of a section's topics that weren't recorded."""
    absent = [topic for topic in topics if topic not in drive.present]
    return f'<p class="faint">Not recorded: {escape(", ".join(absent))}.</p>\n' if absent else ""


def _who(drive, plots):
    words = "turn_arb's own account. The strip of the same colours stands under every plot."
    rows = [(_moment(drive, episode.start_s), _span(episode.end_s - episode.start_s), _driver(episode.source),
             escape(episode.reason)) for episode in drive.episodes]
    table = _table(("from", "for", "who", "why"), rows, numbers=2) if rows else ""
    return _section("who", "Who drove, and why not", words, _plot(plots, "who"), table,
                    _missing(drive, "turn_arb/state"))


def _faults(drive):
    words = ("Everything that was lost, refused, reset or complained of, at its moment: from turn_arb, the Teensy's "
             "link, /diagnostics and the nodes' logs.")
    rows = []
    for fault in drive.faults:
        lasted = _span(fault.end_s - fault.start_s) if math.isfinite(fault.end_s) else ""
        kind = {WARN: '<span class="warn">warning</span>', ERROR: '<span class="bad">error</span>'}[fault.level]
        often = f' <span class="faint">({_times(fault.times)})</span>' if fault.times > 1 else ""
        rows.append((_moment(drive, fault.start_s), lasted, kind, escape(fault.where), escape(fault.what) + often))
    body = _table(("at", "for", "", "who says so", "what"), rows, numbers=2) if rows else "<p>None.</p>\n"
    more = f'<p class="faint">{drive.pending} more are not kept.</p>\n' if drive.pending else ""
    return _section("faults", "Timeouts and faults", words, body, more,
                    _missing(drive, "/diagnostics", "turn_arb/state", "teensy_sensor_hub/link"))


def _steering(drive, plots):
    words = ("What the planner asked for, what turn_arb sent to the servo, and what the wheels say that the car did. "
             "Sent and turned lie on each other when the steering is calibrated.")
    told = []
    for side, (ratio, count) in zip(("left", "right"), drive.turned):
        if count >= FEWEST_RATIOS and abs(ratio - 1) > 0.05:
            told.append(f"To the {side} the car turns {_wider(ratio)}.")
    advice = f'<p class="warn">{" ".join(told)} calibrate_steering makes tables from a drive.</p>\n' if told else ""
    return _section("steering", "Steering: asked, sent, turned", words, _plot(plots, "steering"), advice,
                    _missing(drive, "turn_arb/state", "/servo/output", "odom", "av_turnrad_req",
                             "/teleop_logi/tele_steer_req"))


def _path(drive, plots):
    words = (f"From above, by odometry, in the colours of who drove; dots are what the sonars saw ({drive.hits.count} "
             "echoes), drawn straight ahead of the sonar: each hears in a cone of some 30°.")
    lacking = ""
    if drive.sonars_without_place:
        lacking = ('<p class="faint">Where these sit was not recorded (/tf_static), so their echoes are not drawn: '
                   f'{escape(", ".join(sorted(drive.sonars_without_place)))}.</p>\n')
    absent = _missing(drive, "odom", *([] if set(SONARS) & drive.present else ["sonar/*"]))
    return _section("path", "The path, and what the sonars saw", words, _plot(plots, "path"), lacking, absent)


def _speed(drive, plots):
    words = "What was asked of the drive, and what came of it."
    return _section("speed", "Speed and acceleration", words, _plot(plots, "speed"),
                    _missing(drive, "odom", "control/command/control_cmd", "generic/output/value"))


def _link(drive, plots):
    words = "How the serial line and the clocks did."
    parts = [_plot(plots, "link")]
    if drive.pongs:
        parts.append(f"<p>{drive.pongs} pongs; {drive.pongs_unused} of them were not used for the clock.</p>\n")
    rows = [(escape(name), first, last, f"{last - first:+d}" if last != first else "")
            for name, (first, last) in sorted(drive.counters.items())]
    if rows:
        parts.append(_table(("the Teensy's counter", "first", "last", "change"), rows, numbers=0, numbers_from=1))
    else:
        parts.append('<p class="faint">No counters of the Teensy were recorded: it sends those that are not 0 when '
                     "the hub's ~get_counters asks.</p>\n")
    return _section("link", "The Teensy: link, clock, counters", words, *parts,
                    _missing(drive, "teensy_sensor_hub/link", "teensy_clock"))


def _contents(drive):
    rows = [(escape(name), escape(topic.type.replace("/msg/", "/")), topic.count,
             f"{topic.count / drive.duration_s:.1f}" if drive.duration_s else "")
            for name, topic in drive.topics.items()]
    table = _table(("topic", "type", "messages", "a second"), rows, numbers=0, numbers_from=2)
    return _section("contents", "What the recording has", escape(drive.path),
                    table)


# --- what they are made of ---


def _table(names, rows, numbers, numbers_from=None):
    """A table; the first ``numbers`` columns, or those from one on, are numbers. Cells are HTML."""
    def kind(index):
        is_number = index < numbers if numbers_from is None else index >= numbers_from
        return ' class="number"' if is_number else ""
    head = "".join(f"<th{kind(index)}>{escape(name)}</th>" for index, name in enumerate(names))
    body = "\n".join("<tr>" + "".join(f"<td{kind(index)}>{cell}</td>" for index, cell in enumerate(row)) + "</tr>"
                     for row in rows[:MAX_ROWS])
    more = f'<p class="faint">And {len(rows) - MAX_ROWS} more.</p>\n' if len(rows) > MAX_ROWS else ""
    table = f'<div class="scroll"><table>\n<tr>{head}</tr>\n{body}\n</table></div>\n{more}'
    return f"<details><summary>{len(rows)} lines</summary>\n{table}</details>\n" if len(rows) > OPEN_ROWS else table


def _driver(source):
    source = source if source in DRIVER_COLOURS else UNKNOWN_DRIVER
    return f'<span class="dot" style="background:{DRIVER_COLOURS[source]}"></span>{DRIVER_NAMES[source]}'


def _driven(drive):
    return drive.source_s[TELEOP] + drive.source_s[PLANNER]


def _top(drive):
    trace = drive.traces["speed"]
    return max(abs(trace.least), abs(trace.greatest)) if trace.count else 0.0


def _cause(episode):
    """The reason for a stop, without what counts on."""
    return episode.reason.split(" for ")[0]


def _counted(texts: Iterable[str]):
    """Texts with how often each came, the most frequent first."""
    counts: dict = {}
    for text in texts:
        counts[text] = counts.get(text, 0) + 1
    ordered = sorted(counts.items(), key=lambda item: -item[1])
    return "; ".join(text + (f" ({count}×)" if count > 1 else "") for text, count in ordered[:6])


def _range(trace, unit):
    return f"{trace.least:.2f} to {trace.greatest:.2f} {unit}"


def _wider(ratio):
    if abs(ratio - 1) < 0.015:
        return "as the tables say"
    radius = 1 / ratio  # ratio is one of curvatures
    return f"{abs(radius - 1):.0%} {'tighter' if radius < 1 else 'wider'} than the tables say"


def _times(count):
    return ("never", "once", "twice")[count] if count < 3 else f"{count} times"


def _moment(drive, time_s):
    """A time in the drive: 7.25 s, or in a long one 3:07.2."""
    if drive.duration_s < 100:
        return f"{time_s:.2f} s"
    minutes, tenths = divmod(round(time_s * 10), 600)
    return f"{minutes}:{tenths // 10:02}.{tenths % 10}"


def _span(time_s):
    if time_s < 100:
        return f"{time_s:.2g} s" if time_s < 0.1 else f"{time_s:.1f} s"
    minutes, seconds = divmod(round(time_s), 60)
    return f"{minutes // 60} h {minutes % 60} min" if minutes >= 60 else f"{minutes} min {seconds} s"
