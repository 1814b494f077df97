"""What the Teensy's records measure: plausibility, its clock, odometry, ranges."""
