"""The ROS nodes, one file each, or a folder where a node has files that only it needs."""
