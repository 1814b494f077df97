#!/usr/bin/env python3
"""Steers by −1 .. 1 and asks for a speed, as a network that was trained on a gamepad's steering does, until Ctrl-C."""
import rospy
from std_msgs.msg import Float32

rospy.init_node("end_to_end")
steering = rospy.Publisher("av_steer_req", Float32, queue_size=1)
speed = rospy.Publisher("av_speed_req", Float32, queue_size=1)
rate = rospy.Rate(20)
while not rospy.is_shutdown():
    steering.publish(-0.97)  # -1 right .. 1 left, as the gamepad's
    speed.publish(0.8)  # m/s
    try:
        rate.sleep()
    except rospy.ROSInterruptException:
        break
