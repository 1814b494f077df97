"""The calibration_drive node, and what only it needs."""
