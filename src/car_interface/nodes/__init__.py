"""The ROS nodes, one file each: entry points only."""
