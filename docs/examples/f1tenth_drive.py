#!/usr/bin/env python3
"""Drives a circle of 2 m to the left at 1 m/s, as an F1TENTH stack does, until Ctrl-C."""
import math

import rospy

from car_interface.nodes.planner_interface.ackermann_messages import ackermann_drive_class

# With the package installed: from ackermann_msgs.msg import AckermannDriveStamped
AckermannDriveStamped = ackermann_drive_class()

WHEELBASE_M = 0.324

rospy.init_node("f1tenth_drive")
publisher = rospy.Publisher("drive", AckermannDriveStamped, queue_size=1)
rate = rospy.Rate(40)
while not rospy.is_shutdown():
    message = AckermannDriveStamped()
    message.header.stamp = rospy.Time.now()
    message.drive.steering_angle = math.atan(WHEELBASE_M / 2.0)  # rad, left positive
    message.drive.speed = 1.0  # m/s
    publisher.publish(message)
    try:
        rate.sleep()
    except rospy.ROSInterruptException:
        break
