"""The car_display node, and what only it needs."""
