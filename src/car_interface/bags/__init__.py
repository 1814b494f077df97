"""Recordings of drives: read without ROS, through rosbags, and put through the same core as a live car's records."""
