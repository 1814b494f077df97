"""The planner_interface node, and what only it needs."""
