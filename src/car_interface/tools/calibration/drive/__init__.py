"""The drive that calibrates the steering: what to steer next, how fast, within which area, and when it is enough."""
