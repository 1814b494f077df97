"""The gamepad."""
