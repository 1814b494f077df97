#!/usr/bin/env python3
"""Drives where there is more room, and stops for a thing within 0.8 m: docs/planners.md's, by Ackermann's messages."""
import rospy
from sensor_msgs.msg import Range

from car_interface.nodes.planner_interface.ackermann_messages import ackermann_drive_class

AckermannDriveStamped = ackermann_drive_class()  # else: from ackermann_msgs.msg import AckermannDriveStamped
free = {"front_left": 0.0, "front_middle": 0.0, "front_right": 0.0}  # m

def on_range(message, sonar):
    free[sonar] = min(message.range, message.max_range)

def plan():
    left, right = free["front_left"], free["front_right"]
    command = AckermannDriveStamped()
    if min(free.values()) > 0.8:
        command.drive.speed = 0.5  # m/s
        command.drive.steering_angle = 0.2 * (left - right) / (left + right)  # rad, left positive
    return command

rospy.init_node("first_planner")
publisher = rospy.Publisher("drive", AckermannDriveStamped, queue_size=1)
for sonar in free:
    rospy.Subscriber(f"sonar/{sonar}", Range, on_range, sonar)
rate = rospy.Rate(20)
while not rospy.is_shutdown():
    publisher.publish(plan())
    rate.sleep()
