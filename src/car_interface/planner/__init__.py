"""Anybody's planner: Ackermann, Twist and Autoware commands to a turn radius, a speed and a gear."""
