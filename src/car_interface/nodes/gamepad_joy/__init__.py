"""The gamepad_joy node, and what only it needs."""
