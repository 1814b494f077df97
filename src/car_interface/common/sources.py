"""Whose requests the car obeys: the sources of steering and throttle, and the planners that may be one of them."""
from __future__ import annotations

# Values of SteeringState.source and ThrottleState.source, in order of priority.
LOCKED, NO_HUMAN, NEUTRAL, TELEOP, PLANNER = range(5)
SOURCE_NAMES = ("LOCKED", "NO_HUMAN", "NEUTRAL", "TELEOP", "PLANNER")

# Values of planner_interface's parameter ``source``: which messages a planner sends.
DRIVE, CMD_VEL, AUTOWARE, SPEED = PLANNERS = ("drive", "cmd_vel", "autoware", "speed")


def source_name(source: int) -> str:
    """Return the name of a value of SteeringState.source, or its number when it has none."""
    return SOURCE_NAMES[source] if 0 <= source < len(SOURCE_NAMES) else str(source)
