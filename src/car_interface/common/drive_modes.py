"""Who steers and who drives the throttle while a deadman is held: the values of /teleop_logi/mode."""
from __future__ import annotations

MANUAL = "manual"  # the human steers and drives
AUTONOMOUS = "autonomous"  # the planner steers and drives, a human watches
HUMAN_THROTTLE = "human_throttle"  # the planner steers, the human drives
HUMAN_STEERING = "human_steering"  # the human steers, the planner drives
MODES = (MANUAL, AUTONOMOUS, HUMAN_THROTTLE, HUMAN_STEERING)

HUMAN_DRIVES = frozenset({MANUAL, HUMAN_THROTTLE})
HUMAN_STEERS = frozenset({MANUAL, HUMAN_STEERING})
# A stick that overrides the planner is centered for so long before the planner gets the actuator back: longer than a
# hand needs from one side of the center to the other.
OVERRIDE_HOLD_S = 0.5
