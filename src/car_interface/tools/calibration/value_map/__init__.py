"""Fit of the actuator map: acceleration against speed and actuator value."""
