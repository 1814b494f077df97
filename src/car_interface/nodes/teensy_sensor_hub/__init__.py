"""The teensy_sensor_hub node, and what only it needs."""
