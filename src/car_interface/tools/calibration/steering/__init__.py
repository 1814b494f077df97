"""Fit of the steering table: turn radius against servo duty."""
