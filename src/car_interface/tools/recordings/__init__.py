"""Recordings of drives: read without ROS, through rosbags, as signals or as the records that a Teensy sent."""
