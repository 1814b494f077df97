"""Writes the report on a drive as one page of HTML without external resources: summary, tables, plots."""
from __future__ import annotations

import math

from car_interface.common.sources import PLANNER, TELEOP
from car_interface.tools.report.downsample import Trace
from car_interface.tools.report.faults import ERROR, WARN
from car_interface.tools.report.html import counted, moment_text, ratio_text, render, span_text, times_text
from car_interface.tools.report.plots import DRIVER_COLOURS, DRIVER_NAMES
from car_interface.tools.report.summary import RANGES, Summary

# What the page shows, as far as it was recorded; the sonars' topics are one here.
TOPICS = ("turn_arb/state", "throttle_arb/state", "/servo/output", "odom", "av_turnrad_req",
          "/teleop_logi/tele_steer_req", "control/command/control_cmd", "generic/output/value",
          "teensy_sensor_hub/link", "teensy_clock")
WRONG_RATIO = 0.05  # of the driven to the sent curvature, from 1: the tables need calibration


def page(drive: Summary, plots: dict[str, str]) -> str:
    """Return the page; ``plots`` are SVGs by name, of which those that are missing are left out."""
    name = drive.path.rstrip("/").rsplit("/", 1)[-1]
    lines = (*_steering_lines(drive.steering), *_motion_lines(drive), *_asked_lines(drive), *_teensy_lines(drive))
    has_sonars = not drive.present.isdisjoint(RANGES)
    return render(
        "drive.html", title=f"Drive: {name}", name=name, drive=drive, plots=plots, figures=_figures(drive),
        lines=[line for line in lines if line[1]], who_drove=_who_drove(drive.steering.source_s),
        wrong_sides=_turns(drive.motion.by_tables, least=WRONG_RATIO), gaps=drive.coverage.gaps(),
        errors=sum(fault.level == ERROR for fault in drive.faults.entries), warn=WARN,
        absent=[topic for topic in TOPICS if topic not in drive.present] + ["sonar/*"] * (not has_sonars),
        has_sonars=has_sonars, left_out=_left_out(drive, plots),
        driver_names=DRIVER_NAMES, driver_colours=DRIVER_COLOURS,
        moment=lambda time_s: moment_text(time_s, drive.duration_s))


def _left_out(drive, plots):
    """Return the sections that would be empty: what they are about, by their ids."""
    has_drivers = bool(drive.steering.episodes)
    has_throttle = bool(drive.throttle.episodes)
    sections = (
        ("who", "who drove", has_drivers), ("faults", "faults", drive.faults.entries or not drive.coverage.is_blind),
        ("steering", "steering", "steering" in plots), ("throttle", "throttle", has_throttle or drive.planner.source),
        ("limits", "limits", has_drivers or has_throttle),
        ("path", "the path", "path" in plots or drive.sonars.frames_without_mount),
        ("speed", "speed", "speed" in plots),
        ("link", "the Teensy", "link" in plots or drive.teensy.pongs or drive.teensy.counters))
    return {name: what for name, what, has_content in sections if not has_content}


def _figures(drive):
    """Yield the most important numbers: text, and what it is."""
    yield span_text(drive.duration_s), "recorded"
    if "odom" in drive.present:
        yield f"{drive.motion.distance_m:.1f} m", "driven"
        speed = drive.traces["speed"]
        yield f"{max(abs(speed.minimum), abs(speed.maximum)) if speed.count else 0.0:.2f} m/s", "top speed"
    if drive.steering.episodes:
        driven_s = drive.steering.source_s[TELEOP] + drive.steering.source_s[PLANNER]
        yield span_text(driven_s), "somebody drove"
    faults = drive.faults
    times = sum(fault.times for fault in faults.entries) + faults.dropped
    yield str(times) if times or not drive.coverage.is_blind else "unknown", "faults and timeouts"


def _who_drove(source_s):
    """Return who drove for how long, as a sentence without its full stop."""
    drove = [f"the {DRIVER_NAMES[source]} for {span_text(source_s[source])}"
             for source in (TELEOP, PLANNER) if source_s[source]]
    text = " and ".join(drove).replace("for", "drove for", 1) if drove else "nobody drove"
    return text[0].upper() + text[1:]


def _steering_lines(steering):
    """Yield lines of the table at the top: name, and text; an empty one is left out, as from all of these functions."""
    episodes = steering.episodes
    if not episodes:
        return
    total = sum(steering.source_s.values()) or 1
    yield "Who drove", ", ".join(f"{DRIVER_NAMES[source]} {seconds / total:.0%}"
                                 for source, seconds in steering.source_s.most_common())
    stops = steering.stops()
    yield "Went neutral", times_text(len(stops)) + (f": {counted(stop.why for stop in stops)}" if stops else "")


def _motion_lines(drive):
    motion, sonars, traces = drive.motion, drive.sonars, drive.traces
    if traces["speed"].count:
        mean_mps = motion.distance_m / motion.moving_s if motion.moving_s else 0.0
        yield "Moving", (f"{span_text(motion.moving_s)}, on average at {mean_mps:.2f} m/s; "
                         f"{range_text(traces['speed'], 'm/s')}")
    yield "Acceleration", range_text(traces["acceleration"], "m/s²")
    yield "Battery", range_text(traces["battery voltage"], "V")
    yield "Slow turns against the tables", "; ".join(map(" ".join, _turns(motion.by_tables)))
    # Mounted on its side an IMU measures no turn.
    by_imu = None if drive.imu.gravity.note("") else drive.imu.ratios.median()
    if by_imu is not None:
        yield "Turned by odometry", ratio_text(by_imu, "the IMU says", "more", "less")
    if math.isfinite(sonars.nearest_m):
        yield "Nearest thing seen", (f"{sonars.nearest_m:.2f} m, {sonars.nearest_sonar.replace('_', ' ')}, "
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
    yield "Round trip", range_text(traces["round trip"], "ms")
    if traces["skew"].count:
        yield "Teensy's clock", (f"{traces['skew'].curve()[1][-1]:+.1f} ppm at the end, known to "
                                 f"{traces['uncertainty'].curve()[1][-1]:.2f} ms")


def _asked_lines(drive):
    """Yield lines on what a planner asked for by AckermannDrive."""
    if not drive.traces["requested speed"].count:
        return
    ratio = drive.asked.speed_ratios.median()
    if ratio is not None:
        yield "Speed against what was asked", ratio_text(ratio, "asked", "faster", "slower")
    turns = "; ".join(map(" ".join, _turns(drive.motion.by_planner, "asked")))
    yield "Turned against what was asked", turns if drive.asked.wheelbase_m is not None else (
        "can't tell: which curve an angle asks for needs --wheelbase")


def _turns(following, wanted="the tables say", least=0.0):
    """Return sides with enough samples, and their radius against the wanted one in words, if it differs so much."""
    ratios = ("left", following.left.median()), ("right", following.right.median())
    return [(side, ratio_text(1 / ratio, wanted, "wider", "tighter")) for side, ratio in ratios
            if ratio is not None and abs(ratio - 1) >= least]


def range_text(trace: Trace, unit: str) -> str:
    """Return the range of a trace's samples with its unit; of none an empty text."""
    low, high = (round(bound, 2) + 0.0 for bound in (trace.minimum, trace.maximum))  # + 0.0: no "-0.00"
    return f"{low:.2f} to {high:.2f} {unit}" if trace.count else ""
