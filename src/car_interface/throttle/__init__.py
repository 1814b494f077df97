"""The throttle: acceleration to actuator value by the calibrated map, and the value to the ESC's channel."""
