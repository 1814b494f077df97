"""Draws the virtual car's room for rviz: its walls, boxes and posts."""
from __future__ import annotations

import math

import rospy
from geometry_msgs.msg import Point, Pose, Quaternion, Vector3
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

from car_interface.sim.world import WorldConfig

HEIGHT_M, WALL_HEIGHT_M, WALL_M = 0.25, 0.12, 0.04
THING, WALL = ColorRGBA(0.55, 0.42, 0.30, 1.0), ColorRGBA(0.45, 0.47, 0.50, 1.0)


def room_markers(world: WorldConfig, frame: str) -> MarkerArray:
    """Return the room as markers in a frame in which the car has begun at x = y = yaw = 0."""
    x_from_m, x_to_m, y_from_m, y_to_m = world.walls
    middle_x_m, middle_y_m = (x_from_m + x_to_m) / 2, (y_from_m + y_to_m) / 2
    length_m, width_m = x_to_m - x_from_m, y_to_m - y_from_m
    things = [(Marker.CUBE, x_m, y_m, 0.0, size, WALL) for x_m, y_m, size in (
        (middle_x_m, y_from_m, (length_m, WALL_M)), (middle_x_m, y_to_m, (length_m, WALL_M)),
        (x_from_m, middle_y_m, (WALL_M, width_m)), (x_to_m, middle_y_m, (WALL_M, width_m)))]
    things += [(Marker.CUBE, box.x_m, box.y_m, box.yaw_rad, (box.length_m, box.width_m), THING) for box in world.boxes]
    things += [(Marker.CYLINDER, post.x_m, post.y_m, 0.0, (2 * post.radius_m, 2 * post.radius_m), THING)
               for post in world.posts]
    markers = []
    for index, (kind, x_m, y_m, yaw_rad, size_m, color) in enumerate(things):
        rotation = Quaternion(0.0, 0.0, math.sin(yaw_rad / 2), math.cos(yaw_rad / 2))
        height_m = WALL_HEIGHT_M if color is WALL else HEIGHT_M
        markers.append(Marker(
            header=Header(stamp=rospy.Time(), frame_id=frame), ns="room", id=index, type=kind, action=Marker.ADD,
            pose=Pose(Point(x_m, y_m, height_m / 2), rotation),
            scale=Vector3(*size_m, height_m), color=color, frame_locked=True))
    return MarkerArray(markers)
