"""How exact the clock, the odometry, the calibrations are, on the virtual car: longer runs than the unit tests take."""
