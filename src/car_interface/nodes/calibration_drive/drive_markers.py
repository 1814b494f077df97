"""What rviz shows of a calibration drive: its area, where it began, where the car is about to go, what is known."""
from __future__ import annotations

import math
import textwrap

from geometry_msgs.msg import Point, Pose, Quaternion, Vector3
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

CIRCLE_POINTS, CROSS_M = 72, 0.15
LINE_M, HEIGHT_M = 0.02, 0.02
ARC_M, MAX_ARC_RAD, ARC_STEPS = 1.6, 2.6, 16  # of the arcs by radius, from the car
WIDEST_M = 40.0  # wider turns can't be told from straight on
TEXT_M, TEXT_COLUMNS = 0.14, 28
BEHIND_M, ABOVE_M = 0.8, 0.7  # where no arc lies, and seen from above still over car_display's two lines
AREA, PATH = ColorRGBA(0.35, 0.35, 0.4, 1.0), ColorRGBA(0.75, 0.0, 0.75, 1.0)
TEXT = ColorRGBA(0.1, 0.1, 0.1, 1.0)
# No arc is blue as the trail, which car_display draws, or as orange as its arrow.
KNOWN, PARTLY = ColorRGBA(0.0, 0.6, 0.2, 0.9), ColorRGBA(0.95, 0.75, 0.0, 0.9)
UNKNOWN = ColorRGBA(0.85, 0.1, 0.1, 0.9)


def drive_markers(odom_frame, base_frame, start, radius_m, path, rows, text) -> MarkerArray:
    """Return the whole picture, which takes the place of the one before.

    Args:
        odom_frame, base_frame: odometry's frame, and the car's.
        start: the area's center in odometry's frame; ``None`` = it hasn't begun.
        path: where the car is about to go, (x, y) in odometry's frame.
        rows: records with side (left or right), radius_m, is_known and is_measured: an arc each, from the car.
    """
    lines = [*_area(odom_frame, start, radius_m), _line("path", 0, odom_frame, PATH, path, 2 * LINE_M),
             *_arcs(base_frame, rows)]
    label = _marker("text", 0, base_frame, Marker.TEXT_VIEW_FACING, TEXT, Vector3(0.0, 0.0, TEXT_M))
    label.pose.position = Point(-BEHIND_M, 0.0, ABOVE_M)
    label.text = textwrap.fill(text, TEXT_COLUMNS)
    # rviz reports a line of fewer points as an error.
    return MarkerArray([*no_markers(odom_frame).markers, *(line for line in lines if len(line.points) >= 2), label])


def no_markers(frame) -> MarkerArray:
    """Return a picture of nothing."""
    return MarkerArray([Marker(header=Header(frame_id=frame), action=Marker.DELETEALL)])


def _area(frame, start, radius_m):
    """Return a circle around the start, and a cross there."""
    circle, cross = [], []
    if start is not None:
        x_m, y_m = start
        angles = [2 * math.pi * index / CIRCLE_POINTS for index in range(CIRCLE_POINTS + 1)]
        circle = [(x_m + radius_m * math.cos(angle), y_m + radius_m * math.sin(angle)) for angle in angles]
        cross = [(x_m - CROSS_M, y_m), (x_m + CROSS_M, y_m), start, (x_m, y_m + CROSS_M), (x_m, y_m - CROSS_M)]
    return [_line("area", index, frame, AREA, points, LINE_M) for index, points in enumerate((circle, cross))]


def _arcs(frame, rows):
    for index, row in enumerate(rows):
        sign = 1.0 if row.side == "left" else -1.0
        color = KNOWN if row.is_known else PARTLY if row.is_measured else UNKNOWN
        points = _arc(sign / row.radius_m) if row.radius_m <= WIDEST_M else []
        yield _line("known", index, frame, color, points, LINE_M)


def _arc(curvature_per_m):
    """Return points of an arc that the middle of the rear axle would drive."""
    angle_rad = min(MAX_ARC_RAD, ARC_M * abs(curvature_per_m))
    steps = [math.copysign(angle_rad, curvature_per_m) * index / ARC_STEPS for index in range(ARC_STEPS + 1)]
    return [(math.sin(step) / curvature_per_m, (1 - math.cos(step)) / curvature_per_m) for step in steps]


def _line(ns, index, frame, color, points, width_m):
    marker = _marker(ns, index, frame, Marker.LINE_STRIP, color, Vector3(width_m, 0.0, 0.0))
    marker.points = [Point(x_m, y_m, HEIGHT_M) for x_m, y_m in points]
    return marker


def _marker(ns, index, frame, kind, color, scale):
    # A stamp of 0: where the frame is now.
    return Marker(
        header=Header(frame_id=frame), ns=ns, id=index, type=kind, action=Marker.ADD, scale=scale, color=color,
        pose=Pose(Point(0.0, 0.0, 0.0), Quaternion(0.0, 0.0, 0.0, 1.0)), frame_locked=True)
