#!/usr/bin/env python3
"""A rospy node with one publisher, 50 Hz, that imports nothing else: what any node of rospy takes."""
import rospy
from std_msgs.msg import Bool

rospy.init_node("bare")
beats = rospy.Publisher("~beat", Bool, queue_size=10)
rate = rospy.Rate(50)
try:
    while not rospy.is_shutdown():
        beats.publish(True)
        rate.sleep()
except rospy.ROSInterruptException:
    pass  # it ends
