"""Says on a keyboard's terminal how the car drives, who drives it and why, what is near, and what to do next. Pure."""
from __future__ import annotations

import math
import textwrap
from typing import Any, Mapping

from car_interface.common import causes
from car_interface.common.sources import source_name

NEAR_M = 1.0
BACK_OUT = "you hit a wall. To back out: hold S; then M alone for a second; then S again"
UNLOCK = "the e-stop is on. To end it: rostopic pub -r 10 /e_stop std_msgs/Bool false"
REVERSE = "it stands. To reverse: hold M alone for a second, then S again"
ADVICE = {**dict.fromkeys(causes.LOCKS, UNLOCK), causes.HUMAN_ABSENT: "hold M to drive, P to let the planner drive",
          causes.NOT_REARMED: "let go of all keys, then hold M or P again"}
NO_REVERSE = frozenset({causes.AT_STANDSTILL, causes.HOLDING})


def screen_lines(steering: Any, throttle: Any, ranges_m: Mapping[str, float], is_blocked: bool,
                 columns: int) -> list[str]:
    """Return the lines.

    Args:
        steering, throttle: the arbiters' newest states; ``None`` = silent.
        ranges_m: the newest of each sonar, by its name.
        is_blocked: the virtual car stands at what it ran into.
        columns: of the terminal.
    """
    lines = []
    if throttle is not None:
        speed = "unknown" if math.isnan(throttle.speed) else f"{throttle.speed:.2f} m/s"
        cut = f", cut: {throttle.limit_reason}" if throttle.limit in causes.THROTTLE_CUTS else ""
        lines.append(f"speed {speed}   throttle {throttle.granted:.2f} of {throttle.asked:.2f} asked{cut}   "
                     f"scale {throttle.human_scale:.1f}   mode {throttle.mode or 'none'}")
        lines.append(f"drives: {source_name(throttle.source)}, {throttle.reason}")
        if throttle.esc_reason:
            lines.append(f"ESC:    {throttle.esc}, {throttle.esc_reason}")
    if steering is not None:
        lines.append(f"steers: {source_name(steering.source)}, {steering.reason}")
    near = sorted((range_m, name) for name, range_m in ranges_m.items() if range_m < NEAR_M)
    lines.append("near:   " + (", ".join(f"{name.replace('_', ' ')} {max(0.0, range_m):.2f} m"
                                         for range_m, name in near) or f"nothing within {NEAR_M:g} m"))
    lines.append(f"--> {_advice(steering, throttle, is_blocked)}")
    return [part for line in lines for part in textwrap.wrap(line, max(20, columns - 1), subsequent_indent="        ")]


def _advice(steering, throttle, is_blocked):
    for state in (steering, throttle):
        if state is not None and state.cause in ADVICE:
            return ADVICE[state.cause]
    if steering is None or throttle is None:
        return "the car is silent: does it run?"
    if is_blocked:
        return BACK_OUT
    if throttle.mode == causes.AUTONOMOUS:
        return "let go of P to stop"
    if throttle.asked < 0 and throttle.esc_cause in NO_REVERSE:
        return REVERSE
    return "let go of M to stop"
