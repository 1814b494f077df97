#!/usr/bin/env python3
"""calibration_drive whose last fit waits for ten odometries and two duties more, and counts the samples around that."""
from __future__ import annotations

import rospy
from nav_msgs.msg import Odometry
from std_msgs.msg import Int32MultiArray

from car_interface.calibration.drive.conclusion import Conclusion
from car_interface.nodes import calibration_drive


def conclude(samples, base, base_text, name):
    begun = _counts(samples)
    for topic, message_type, count in (("odom", Odometry, 10), ("servo/output", Int32MultiArray, 2)):
        for _ in range(count):
            rospy.wait_for_message(topic, message_type)
    return Conclusion("", (f"at its end: {begun}", f"later: {_counts(samples)}"), "it only counted", 0, (0, 0))


def _counts(samples):
    drive = samples.drive()
    return f"{len(drive.t_s)} odometries, {len(drive.duty)} duties"


calibration_drive.conclude = conclude
calibration_drive.main()
