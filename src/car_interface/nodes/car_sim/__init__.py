"""The car_sim node, and what only it needs."""
