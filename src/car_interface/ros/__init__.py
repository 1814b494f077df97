"""What every node does alike: runtime, topics, logs, diagnostics. With ``nodes`` the only place that imports rospy."""
