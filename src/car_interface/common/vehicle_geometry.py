"""The size of the car that all defaults are of, a Traxxas Slash 4x4 with a Teensy's sensor hub, and its sonars' names.

Lengths are in metres, from its data sheet: 568 mm long, 296 mm wide over the tyres, which is the track there, too.
"""
from __future__ import annotations

WHEELBASE_M = 0.324
TRACK_M = WIDTH_M = 0.296
FRONT_M, REAR_M = 0.426, 0.142  # its ends, before and behind the middle of the rear axle
WHEEL_DIAMETER_M = 0.095
PULSES_PER_REVOLUTION = 20  # of a rear wheel's encoder
SONARS = ("front_right", "front_middle", "front_left", "rear_right", "rear_middle", "rear_left")  # by sensor id
