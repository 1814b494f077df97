"""Calibration of steering and throttle: recorded drives in, tables with the confidence of their numbers out."""
