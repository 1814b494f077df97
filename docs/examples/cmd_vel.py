#!/usr/bin/env python3
"""Drives a circle of 2 m to the left at 0.5 m/s, as move_base does, until Ctrl-C; with --back backward."""
import sys

import rospy
from geometry_msgs.msg import Twist

SPEED_MPS = -0.5 if "--back" in sys.argv else 0.5

rospy.init_node("cmd_vel")
publisher = rospy.Publisher("cmd_vel", Twist, queue_size=1)
rate = rospy.Rate(20)
while not rospy.is_shutdown():
    message = Twist()
    message.linear.x = SPEED_MPS
    message.angular.z = SPEED_MPS / 2.0  # rad/s, counterclockwise positive: the wheels are to the left both ways
    publisher.publish(message)
    try:
        rate.sleep()
    except rospy.ROSInterruptException:
        break
