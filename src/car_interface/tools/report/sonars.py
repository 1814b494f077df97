"""Where the sonars saw something, in odometry's frame."""
from __future__ import annotations

import math
from typing import Any

from car_interface.common.units import NS_PER_S, stamp_ns, yaw_rad
from car_interface.tools.report.downsample import Spots
from car_interface.tools.report.motion import MotionWatch


class SonarWatch:
    """Follows the sonars' ranges and /tf_static.

    Args:
        motion: where the car is.
        start_ns: ROS time of the recording's first message.

    Attributes:
        echoes: places in odometry's frame.
        nearest_m, nearest_s, nearest_sonar: the shortest range, inf = none.
        frames_without_mount: frames of sonars whose place on the car wasn't recorded.
    """

    def __init__(self, motion: MotionWatch, start_ns: int):
        self._motion, self._start_ns = motion, start_ns
        self.echoes = Spots()
        self.nearest_m, self.nearest_s, self.nearest_sonar = math.inf, math.nan, ""
        self.frames_without_mount: set = set()
        self._mounts: dict = {}  # (x, y, yaw) on the car by frame

    def on_static_tf(self, time_s: float, message: Any) -> None:
        """tf2_msgs/TFMessage."""
        for transform in message.transforms:
            place, rotation = transform.transform.translation, transform.transform.rotation
            self._mounts[transform.child_frame_id] = (place.x, place.y, yaw_rad(rotation))

    def on_range(self, time_s: float, message: Any, topic: str) -> None:
        """sensor_msgs/Range."""
        range_m = message.range
        if not message.min_range < range_m < message.max_range:
            return
        if range_m < self.nearest_m:
            self.nearest_m, self.nearest_s, self.nearest_sonar = range_m, time_s, topic.rsplit("/", 1)[-1]
        mount = self._mounts.get(message.header.frame_id)
        if mount is None:
            self.frames_without_mount.add(message.header.frame_id)
            return
        pose = self._motion.pose_at((stamp_ns(message.header.stamp) - self._start_ns) / NS_PER_S)
        if pose is None:
            return
        x, y, yaw = pose
        ahead_m = mount[0] + range_m * math.cos(mount[2])
        left_m = mount[1] + range_m * math.sin(mount[2])
        self.echoes.add(x + ahead_m * math.cos(yaw) - left_m * math.sin(yaw),
                        y + ahead_m * math.sin(yaw) + left_m * math.cos(yaw))
