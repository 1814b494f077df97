"""Whether the car may move at all: emergency stop, deadman, re-arming."""
