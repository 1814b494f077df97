"""Shared by the parts: errors, parameters, stale inputs, lookup tables, files. No ROS, no device."""
