#!/usr/bin/env python3
"""A rospy node with one publisher at 50 Hz, that imports nothing else: what any rospy node needs."""
import rospy
from std_msgs.msg import Bool

rospy.init_node("bare")
publisher = rospy.Publisher("~timer", Bool, queue_size=10)
rate = rospy.Rate(50)
try:
    while not rospy.is_shutdown():
        publisher.publish(True)
        rate.sleep()
except rospy.ROSInterruptException:
    pass  # shutdown
