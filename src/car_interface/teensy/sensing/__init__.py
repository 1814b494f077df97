"""Measurements from the Teensy's records: plausibility, its clock, odometry, ranges."""
