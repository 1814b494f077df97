#!/usr/bin/env python3
"""Drives a circle of 2 m to the right at 1 m/s, as Autoware's control does, until Ctrl-C; with --back backward."""
import math
import sys

import rospy
from car_interface.msg import Control
from std_msgs.msg import UInt8

WHEELBASE_M = 0.324
BACK = "--back" in sys.argv
DRIVE, REVERSE = 2, 20  # of autoware_vehicle_msgs/GearCommand

rospy.init_node("autoware_control")
controls = rospy.Publisher("control/command/control_cmd", Control, queue_size=1)
gears = rospy.Publisher("control/command/gear_cmd", UInt8, queue_size=1, latch=True)
gears.publish(REVERSE if BACK else DRIVE)
rate = rospy.Rate(30)
while not rospy.is_shutdown():
    message = Control()
    message.stamp = rospy.Time.now()
    message.lateral.steering_tire_angle = -math.atan(WHEELBASE_M / 2.0)  # rad, left positive
    message.longitudinal.velocity = -1.0 if BACK else 1.0  # m/s
    message.longitudinal.acceleration = 0.5  # m/s², in the gear's direction
    controls.publish(message)
    try:
        rate.sleep()
    except rospy.ROSInterruptException:
        break
