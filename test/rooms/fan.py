"""What the cones of one end look at, as one fan, and how fast a car may be on an arc that leaves it.

From the outermost edge of one outer cone to that of the other, as far as the range reaches. Free is the arc up to where
the middle of the bumper leaves that.
"""
from __future__ import annotations

import math

from .scene import ALL_IN_TURN, FIELD_OF_VIEW_RAD, MOSTLY_AHEAD, MOUNTS, OUTLINE, SONARS, Scene

STEP_M = 0.005
ACTUATION_S, MARGIN_M = 0.1, 0.1  # docs/limits.md
CALM_S = 0.5  # of a cycle: the age of a range, on the mean


def is_in_fan(ahead_m: float, left_m: float, max_range_m: float) -> bool:
    """Whether a place, seen from the car, lies in the fan of the front cones."""
    middle, outer = MOUNTS["front_middle"], MOUNTS["front_left"]
    edge_rad = outer.yaw_rad + FIELD_OF_VIEW_RAD / 2
    beyond_m = (abs(left_m) - outer.y_m) * math.cos(edge_rad) - (ahead_m - outer.x_m) * math.sin(edge_rad)
    return beyond_m <= 0 and math.hypot(ahead_m - middle.x_m, left_m) <= max_range_m


def free(curvature_per_m: float, max_range_m: float) -> tuple[float, float, float]:
    """How far the car may drive, in m, until its bumper's middle leaves the fan, and where that is: ahead, left."""
    driven_m = 0.0
    while True:
        ahead_m, left_m = _bumper(curvature_per_m, driven_m + STEP_M)
        if not is_in_fan(ahead_m, left_m, max_range_m):
            return driven_m, ahead_m, left_m
        driven_m += STEP_M


def _bumper(curvature_per_m, driven_m):
    """Where the middle of the bumper is after so far on an arc, seen from where the car was."""
    angle = driven_m * curvature_per_m
    if abs(angle) < 1e-9:
        return driven_m + OUTLINE.front_m, 0.0
    ahead_m = math.sin(angle) / curvature_per_m + OUTLINE.front_m * math.cos(angle)
    return ahead_m, (1 - math.cos(angle)) / curvature_per_m + OUTLINE.front_m * math.sin(angle)


def bound_mps(scene: Scene) -> float:
    """The speed that the fan allows on the scene's arc, with nothing in sight."""
    driven_m, ahead_m, left_m = free(scene.driver.curvature_per_m, scene.max_range_m)
    cycle_s = _longest_gap(scene, "front_middle" if _is_in_middle(ahead_m, left_m) else "front_left") * scene.firing_s
    delay_s = CALM_S * cycle_s + cycle_s + ACTUATION_S
    esc, slows_mps2 = scene.esc, scene.esc.drag_deceleration_mps2  # what a stop is certain of, whatever the ESC
    if scene.kind == "measured":
        slows_mps2 = esc.stop_brake * esc.brake_deceleration_mps2
    distance_m = max(0.0, driven_m - MARGIN_M)
    return slows_mps2 * (math.sqrt(delay_s ** 2 + 2 * distance_m / slows_mps2) - delay_s)


def _is_in_middle(ahead_m, left_m):
    return math.atan2(abs(left_m), ahead_m - MOUNTS["front_middle"].x_m) <= FIELD_OF_VIEW_RAD / 2


def _longest_gap(scene, sonar):
    """How many firings pass at most from one of a sonar's to its next."""
    sequence = MOSTLY_AHEAD if scene.is_mostly_ahead else ALL_IN_TURN
    places = [number for number, index in enumerate(sequence) if SONARS[index] == sonar]
    return max(there - here for here, there in zip(places, [*places[1:], places[0] + len(sequence)]))
