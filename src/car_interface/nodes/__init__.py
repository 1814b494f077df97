"""The ROS nodes, a file each, and what they share. The only place that imports rospy and generated messages."""
