"""The report on a drive as one page of HTML without external resources: summary, tables, plots."""
from __future__ import annotations

import math
from html import escape

from car_interface.steering.arbiter import PLANNER, TELEOP
from car_interface.tools.report.faults import ERROR, WARN
from car_interface.tools.report.figures import DRIVER_COLOURS, DRIVER_NAMES
from car_interface.tools.report.html import (
    counted,
    date_text,
    document,
    moment_text,
    range_text,
    ratio_text,
    section,
    span_text,
    table,
    times_text,
)
from car_interface.tools.report.plots import Plot
from car_interface.tools.report.steering_state import UNKNOWN_DRIVER
from car_interface.tools.report.summary import SONARS, Summary

MIN_RATIOS = 30  # samples, for a ratio to be shown
WRONG_RATIO = 0.05  # of the driven to the sent curvature, from 1: the tables need calibration
LEVELS = {WARN: '<span class="warn level">warning</span>', ERROR: '<span class="bad level">error</span>'}


def page(drive: Summary, plots: dict[str, Plot]) -> str:
    """The page.

    Args:
        drive: the summary.
        plots: by name; those that are missing are left out.
    """
    name = drive.path.rstrip("/").rsplit("/", 1)[-1]
    sections = (_who(drive, plots), _faults(drive), _steering(drive, plots), _throttle(drive, plots),
                _limits(drive), _path(drive, plots), _speed(drive, plots), _link(drive, plots), _contents(drive))
    return document(f"Drive: {name}", _head(drive, name) + "".join(sections))


# --- the head ---


def _head(drive, name):
    place = f" · car {escape(drive.namespace)}" if drive.namespace.strip("/") else ""
    figures = "".join(f"<div><b>{escape(value)}</b><span>{escape(what)}</span></div>"
                      for value, what in _figures(drive))
    lines = [*_steering_lines(drive.steering), *_motion_lines(drive), *_asked_lines(drive), *_teensy_lines(drive)]
    if drive.notes:
        lines.append(("Topics", "<br>".join(map(escape, drive.notes))))
    rows = "".join(f"<tr><th>{escape(what)}</th><td>{value}</td></tr>\n" for what, value in lines)
    began = date_text(drive.start_ns)
    return (f'<header id="summary">\n<h1>{escape(name)}</h1>\n<div class="faint">{began}{place}</div>\n'
            f'<p class="verdict">{_verdict(drive)}</p>\n<div class="figures">{figures}</div>\n'
            f'<table class="summary">\n{rows}</table>\n</header>\n')


def _figures(drive):
    """Yield the most important numbers: text, and what it is."""
    yield span_text(drive.duration_s), "recorded"
    if "odom" in drive.present:
        yield f"{drive.motion.distance_m:.1f} m", "driven"
        yield f"{_top_speed(drive.traces['speed']):.2f} m/s", "top speed"
    if drive.steering.episodes:
        driven_s = drive.steering.source_s[TELEOP] + drive.steering.source_s[PLANNER]
        yield span_text(driven_s), "somebody drove"
    faults = drive.faults
    times = sum(fault.times for fault in faults.entries) + faults.dropped
    yield str(times) if times or not drive.coverage.is_blind else "unknown", "faults and timeouts"


def _verdict(drive):
    """The drive in a sentence or two, as HTML."""
    parts, faults, source_s = [], drive.faults.entries, drive.steering.source_s
    gaps = drive.coverage.gaps()
    if drive.steering.episodes:
        drove = [f"the {DRIVER_NAMES[source]} for {span_text(source_s[source])}"
                 for source in (TELEOP, PLANNER) if source_s[source]]
        text = " and ".join(drove).replace("for", "drove for", 1) if drove else "nobody drove"
        parts.append(text[0].upper() + text[1:] + ".")
        stops = drive.steering.losses()
        if stops:
            what = escape(counted(stop.cause or stop.reason for stop in stops))
            parts.append(f'<span class="warn">The car was stopped {times_text(len(stops))} because something was lost '
                         f"or locked: {what}.</span>")
    errors = sum(fault.level == ERROR for fault in faults)
    if errors:
        parts.append(f'<span class="bad">{errors} {"fault needs" if errors == 1 else "faults need"} somebody to look: '
                     'see <a href="#faults">below</a>.</span>')
    elif faults:
        parts.append('There were no errors; the warnings are listed <a href="#faults">below</a>.')
    elif not gaps:
        parts.append('<span class="good">Nothing went wrong that this recording shows.</span>')
    elif not drive.coverage.is_blind:
        parts.append("What was recorded shows no fault.")
    if gaps:
        parts.append(f'<span class="warn">{_gaps_text(drive)}</span>')
    return " ".join(parts)


def _gaps_text(drive):
    """The questions that the recording can't answer, and what it lacks for them."""
    duration_s, lacking = drive.duration_s, []
    for gap in drive.coverage.gaps():
        when = "" if math.isnan(gap.start_s) else (f" from {moment_text(gap.start_s, duration_s)} to "
                                                   f"{moment_text(gap.end_s, duration_s)}")
        lacking.append(f"no {gap.lacks}{when} ({gap.asks})")
    return escape(f"What this recording can't tell: {'; '.join(lacking)}.", quote=False)


def _steering_lines(steering):
    """Yield lines of the table at the top: name, and HTML."""
    episodes = steering.episodes
    if not episodes:
        return
    total = sum(steering.source_s.values()) or 1
    yield "Who drove", ", ".join(f"{DRIVER_NAMES.get(source, source)} {seconds / total:.0%}"
                                 for source, seconds in steering.source_s.most_common())
    stops = steering.stops()
    why = escape(counted(stop.cause or stop.reason for stop in stops))
    yield "Went neutral", times_text(len(stops)) + (f": {why}" if stops else "")


def _motion_lines(drive):
    motion, sonars, traces = drive.motion, drive.sonars, drive.traces
    if traces["speed"].count:
        mean_mps = motion.distance_m / motion.moving_s if motion.moving_s else 0.0
        yield "Moving", (f"{span_text(motion.moving_s)}, on average at {mean_mps:.2f} m/s; "
                         f"{_range_of(traces['speed'], 'm/s')}")
    if traces["acceleration"].count:
        yield "Acceleration", _range_of(traces["acceleration"], "m/s²")
    ratios = [f"{side} {_ratio_text(ratio)}" for side, ratio in _known_ratios(motion.by_tables)]
    if ratios:
        yield "Slow turns against the tables", "; ".join(ratios)
    by_imu = drive.imu.odometry_ratio()
    if by_imu.samples >= MIN_RATIOS:
        yield "Turned by odometry", ratio_text(by_imu.median, "the IMU says", "more", "less")
    if math.isfinite(sonars.nearest_m):
        yield "Nearest thing seen", (f"{sonars.nearest_m:.2f} m, {escape(sonars.nearest_sonar.replace('_', ' '))}, "
                                     f"at {moment_text(sonars.nearest_s, drive.duration_s)}")


def _teensy_lines(drive):
    first, link, traces = drive.teensy.first_link, drive.teensy.link, drive.traces
    if link is not None:
        frames, corrupt = link.frames - first.frames, link.bad_frames - first.bad_frames
        ratio = f" ({corrupt / (frames + corrupt):.2%})" if corrupt else ""
        reopened = f"; the port was opened again {times_text(link.reconnects)}" if link.reconnects else ""
        reboots = f"; the Teensy started anew {times_text(link.reboots)}" if link.reboots else ""
        yield "Teensy's link", (f"{frames} frames, {corrupt} corrupt{ratio}; {link.pongs} of {link.pings} pings "
                                f"answered{reopened}{reboots}")
    if traces["round trip"].count:
        yield "Round trip", _range_of(traces["round trip"], "ms")
    if traces["skew"].count:
        yield "Teensy's clock", (f"{traces['skew'].curve()[1][-1]:+.1f} ppm at the end, known to "
                                 f"{traces['uncertainty'].curve()[1][-1]:.2f} ms")


def _asked_lines(drive):
    """Yield lines on what a planner asked for by AckermannDrive."""
    if not drive.traces["requested speed"].count:
        return
    ratio = drive.asked.speed_ratio()
    if ratio.samples >= MIN_RATIOS:
        yield "Speed against what was asked", ratio_text(ratio.median, "asked", "faster", "slower")
    if drive.asked.wheelbase_m is None:
        yield "Turned against what was asked", "can't tell: which curve an angle asks for needs --wheelbase"
    else:
        ratios = [f"{side} {_ratio_text(ratio, 'asked')}" for side, ratio in _known_ratios(drive.motion.by_planner)]
        if ratios:
            yield "Turned against what was asked", "; ".join(ratios)


def _known_ratios(following):
    """(side, median ratio of the driven to the sent curvature) for sides with enough samples."""
    return [(side, found.median) for side, found in zip(("left", "right"), following.ratios())
            if found.samples >= MIN_RATIOS]


def _top_speed(trace):
    return max(abs(trace.minimum), abs(trace.maximum)) if trace.count else 0.0


def _range_of(trace, unit):
    return range_text(trace.minimum, trace.maximum, unit)


def _ratio_text(ratio, wanted="the tables say"):
    """A ratio of curvatures in words, for the radius."""
    return ratio_text(1 / ratio, wanted, "wider", "tighter")


# --- the sections ---


def _plot(plots, name):
    return plots[name].svg if name in plots else ""


def _missing(drive, *topics):
    """A line for those of a section's topics that weren't recorded."""
    absent = [topic for topic in topics if topic not in drive.present]
    return f'<p class="faint">Not recorded: {escape(", ".join(absent))}.</p>\n' if absent else ""


def _who(drive, plots):
    text = "As turn_arb reports. The strip of the same colours stands under every plot."
    rows = [(moment_text(episode.start_s, drive.duration_s), span_text(episode.end_s - episode.start_s),
             _driver(episode.source), escape(episode.reason)) for episode in drive.steering.episodes]
    return section("who", "Who drove, and why not", text, _plot(plots, "who"),
                   table(("from", "for", "who", "why"), rows, numbers=2) if rows else "",
                   _missing(drive, "turn_arb/state"))


def _driver(source):
    source = source if source in DRIVER_COLOURS else UNKNOWN_DRIVER
    return f'<span class="dot" style="background:{DRIVER_COLOURS[source]}"></span>{DRIVER_NAMES[source]}'


def _faults(drive):
    text = ("Losses, refusals, resets and warnings with their times: from the arbiters, teleop_logi, the Teensy's "
            "link, /diagnostics and the nodes' logs.")
    rows = []
    for fault in drive.faults.entries:
        lasted = span_text(fault.end_s - fault.start_s) if math.isfinite(fault.end_s) else ""
        often = f' <span class="faint">({times_text(fault.times)})</span>' if fault.times > 1 else ""
        level = LEVELS.get(fault.level, LEVELS[ERROR])  # of a damaged or foreign recording
        rows.append((moment_text(fault.start_s, drive.duration_s), lasted, level, escape(fault.where),
                     escape(fault.what) + often))
    gaps = f'<p class="warn">{_gaps_text(drive)}</p>\n' if drive.coverage.gaps() else ""
    none = "None was recorded." if gaps else "None."
    body = table(("at", "for", "", "who says so", "what"), rows, numbers=2) if rows else f"<p>{none}</p>\n"
    dropped = drive.faults.dropped
    return section("faults", "Timeouts and faults", text, body,
                   f'<p class="faint">{dropped} more are not kept.</p>\n' if dropped else "", gaps)


def _steering(drive, plots):
    text = ("What the planner requested, what turn_arb sent to the servo, and what the car did by its wheels. "
            "Sent and driven curvature are the same when the steering is calibrated, as long as no tyre slides.")
    advice = " ".join(f"To the {side} the car turns {_ratio_text(ratio)}."
                      for side, ratio in _known_ratios(drive.motion.by_tables) if abs(ratio - 1) > WRONG_RATIO)
    if advice:
        advice = f'<p class="warn">{advice} calibrate_steering makes tables from a drive.</p>\n'
    if drive.traces["requested angle"].count:
        text += " A planner's angles are those of the front wheels."
    return section("steering", "Steering: requested, sent, driven", text, _plot(plots, "steering"), advice,
                   _missing(drive, "turn_arb/state", "/servo/output", "odom", "av_turnrad_req",
                            "/teleop_logi/tele_steer_req"))


def _throttle(drive, plots):
    profile = f" Kind of the ESC: {escape(drive.throttle.profile)}." if drive.throttle.profile else ""
    text = ("As throttle_arb reports: what was asked, by stick or planner, and what the ESC was given; 1 is full "
            f"forward, −1 full brake or reverse.{profile}{_planner(drive.planner)}")
    rows = [(moment_text(episode.start_s, drive.duration_s), span_text(episode.end_s - episode.start_s),
             _driver(episode.source), escape(episode.esc), escape(episode.reason))
            for episode in drive.throttle.episodes]
    return section("throttle", "Throttle: asked, granted", text, _plot(plots, "throttle"),
                   table(("from", "for", "who", "ESC", "why"), rows, numbers=2) if rows else "",
                   _missing(drive, "throttle_arb/state"))


def _planner(planner):
    """Which planner was obeyed, by planner_interface."""
    if not planner.source:
        return ""
    others = f"; not obeyed: {escape(planner.others)}" if planner.others else ""
    return f" The planner that was obeyed: {escape(planner.source)}{others}."


def _limits(drive):
    text = ("Where turn_arb or throttle_arb granted something else than was asked for, since the car was too fast for "
            "it, or something was in its way.")
    rows = [(moment_text(episode.start_s, drive.duration_s), span_text(episode.end_s - episode.start_s),
             escape(episode.node), escape(episode.cause), escape(episode.reason)) for episode in drive.limits.episodes]
    counts = ", ".join(f"{node} {times_text(count)}" for node, count in sorted(drive.limits.counts.items()) if count)
    return section("limits", "Limits", text, f"<p>Requests cut: {counts}.</p>\n" if counts else "",
                   table(("from", "for", "by", "limit", "why"), rows, numbers=2) if rows else
                   "<p>None was cut.</p>\n" if drive.steering.episodes or drive.throttle.episodes else "",
                   _missing(drive, "turn_arb/state", "throttle_arb/state"))


def _path(drive, plots):
    text = ("From above, by odometry, in the colours of who drove; dots are what the sonars saw "
            f"({drive.sonars.echoes.count} echoes), drawn straight ahead of the sonar, whose cone is some 30° wide.")
    lacking, frames = "", drive.sonars.frames_without_mount
    if frames:
        lacking = ('<p class="faint">Where these sit was not recorded (/tf_static), so their echoes are not drawn: '
                   f'{escape(", ".join(sorted(frames)))}.</p>\n')
    absent = _missing(drive, "odom", *([] if set(SONARS) & drive.present else ["sonar/*"]))
    return section("path", "The path, and what the sonars saw", text, _plot(plots, "path"), lacking, absent)


def _speed(drive, plots):
    text = "What was requested of the drive, and what the car did."
    return section("speed", "Speed and acceleration", text, _plot(plots, "speed"),
                   _missing(drive, "odom", "control/command/control_cmd", "generic/output/value"))


def _link(drive, plots):
    teensy, parts = drive.teensy, [_plot(plots, "link")]
    if teensy.pongs:
        parts.append(f"<p>{teensy.pongs} pongs; {teensy.pongs_unused} of them were not used for the clock.</p>\n")
    rows = [(escape(name), first, last, f"{last - first:+d}" if last != first else "")
            for name, (first, last) in sorted(teensy.counters.items())]
    if rows:
        parts.append(table(("the Teensy's counter", "first", "last", "change"), rows, numbers=0, numbers_from=1))
    else:
        parts.append('<p class="faint">No counters of the Teensy were recorded: it sends those that are not 0 when '
                     "the hub's ~get_counters asks.</p>\n")
    return section("link", "The Teensy: link, clock, counters", "The serial line and the clocks.", *parts,
                   _missing(drive, "teensy_sensor_hub/link", "teensy_clock"))


def _contents(drive):
    rows = [(escape(name), escape(topic.type.replace("/msg/", "/")), topic.count,
             f"{topic.count / drive.duration_s:.1f}" if drive.duration_s else "")
            for name, topic in drive.topics.items()]
    return section("contents", "What the recording has", escape(drive.path),
                   table(("topic", "type", "messages", "a second"), rows, numbers=0, numbers_from=2))
