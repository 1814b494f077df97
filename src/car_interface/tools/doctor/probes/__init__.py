"""Where the facts come from: the ROS graph, devices, the computer."""
