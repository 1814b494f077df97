"""Permission to move: emergency stop, deadman, re-arming."""
