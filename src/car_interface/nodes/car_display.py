"""The car_display node: publishes the car, its sonars, its trail and its steering as markers for rviz.

Subscribes:
    odom (nav_msgs/Odometry): the trail.
    turn_arb/state (SteeringState): the commanded turn radius, and who steers.
    throttle_arb/state (ThrottleState): speed and throttle, and who drives.
    sonar/front_right … (sensor_msgs/Range): a fan for each; a pale one without an echo. rviz's own cones stay behind.
Publishes:
    ~markers (visualization_msgs/MarkerArray, latched, 10 Hz): in base_link the car, its front wheels turned as the
        steering is commanded, an arrow along the path of its nose, and who steers and drives; in the sonars' frames
        their fans; in odom the trail, a point every 5 cm, the newest 2,000. Without a command the wheels point ahead
        and there is no arrow.
"""
from __future__ import annotations

import math
from collections import deque

from geometry_msgs.msg import Point, Pose, Quaternion, Vector3
from nav_msgs.msg import Odometry
from sensor_msgs.msg import Range
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

from car_interface.common.declared import read_all
from car_interface.common.rate_timer import RateTimer
from car_interface.common.sources import source_name
from car_interface.common.vehicle_geometry import SONARS
from car_interface.msg import SteeringState, ThrottleState
from car_interface.nodes.teensy_sensor_hub.config import CarDisplayConfig
from car_interface.ros.runtime import run
from car_interface.ros.topics import advertise, listen, subscribe

RATE_HZ = 10
TICKS_PER_TRAIL = 10  # an unchanged trail is sent once a second, for an rviz that starts late
STATE_TIMEOUT_S = 0.5
RANGE_TIMEOUT_S = 1.5  # each of six comes three times a second
SPACING_M = 0.05
TRAIL_POINTS = 2000
# A jump of odometry starts another trail; no car drives this far between two messages.
JUMP_M = 5.0
ARROW_M, ARROW_STEPS = 1.0, 20
ARROW_HEAD_M = 0.16
BEHIND_M, ABOVE_M = 0.8, 0.2  # of the text: the arrow lies before the car
# Beyond the axles, and of the body above the ground.
OVERHANG_M, CLEARANCE_M = 0.10, 0.035
TIRE_WIDTH_M = 0.05
LINE_M = 0.02
FAN_STEPS = 8

BODY, CABIN = ColorRGBA(0.10, 0.35, 0.75, 1.0), ColorRGBA(0.06, 0.10, 0.18, 1.0)
TIRE = ColorRGBA(0.08, 0.08, 0.08, 1.0)
ARROW, TRAIL, TEXT = ColorRGBA(1.0, 0.45, 0.0, 1.0), ColorRGBA(0.3, 0.5, 0.9, 1.0), ColorRGBA(0.1, 0.1, 0.1, 1.0)
ECHO, NO_ECHO = ColorRGBA(0.95, 0.45, 0.1, 0.45), ColorRGBA(0.3, 0.5, 0.9, 0.12)
NO_ROTATION = Quaternion(0.0, 0.0, 0.0, 1.0)


class CarDisplay:
    """Draw the car, its steering command, its sonars and its trail."""

    def __init__(self, params, inbox):
        config = read_all(params, CarDisplayConfig)
        self._wheelbase_m, self._track_m, self._wheel_m = config.wheelbase_m, config.track_m, config.wheel_m
        self._odom_frame = config.frame_prefix + config.odom_frame
        self._base_frame = config.frame_prefix + config.base_frame
        self._inbox = inbox
        self._steering = listen("turn_arb/state", SteeringState, inbox, STATE_TIMEOUT_S)
        self._throttle = listen("throttle_arb/state", ThrottleState, inbox, STATE_TIMEOUT_S)
        self._ranges = [listen(f"sonar/{name}", Range, inbox, RANGE_TIMEOUT_S) for name in SONARS]
        self._trail: deque[Point] = deque(maxlen=TRAIL_POINTS)  # where it was, at least 5 cm apart
        self._trail_has_grown = False  # since it was last sent
        self._timer = RateTimer(RATE_HZ, inbox.clocks.now_ns())
        self._markers = advertise("~markers", MarkerArray, inbox, queue_size=1, latch=True)
        subscribe("odom", Odometry, inbox, self._on_odometry, queue_size=100)

    def step(self, now_ns):
        """Handle what arrived; then the timer."""
        self._inbox.dispatch()
        if self._timer.is_due(now_ns):
            self._draw(now_ns)
        return self._timer.due_ns

    def shut_down(self):
        """Nothing to do."""

    def _on_odometry(self, message, now_ns):
        """Add where the car is to the trail, unless that isn't finite or is near to the newest point."""
        x_m, y_m = message.pose.pose.position.x, message.pose.pose.position.y
        step_m = math.hypot(x_m - self._trail[-1].x, y_m - self._trail[-1].y) if self._trail else SPACING_M
        if not math.isfinite(x_m + y_m) or step_m < SPACING_M:
            return
        if step_m > JUMP_M:
            self._trail.clear()
        self._trail.append(Point(x_m, y_m, LINE_M))
        self._trail_has_grown = True

    def _draw(self, now_ns):
        steering, throttle = self._steering.fresh(now_ns), self._throttle.fresh(now_ns)
        known = steering is not None and abs(steering.turn_radius) > 0  # nor is it NaN
        curvature_per_m = 1 / steering.turn_radius if known else 0.0
        arrow = self._arrow(curvature_per_m) if known else [self._nothing("steering", index) for index in range(2)]
        markers = [*self._body(), *self._wheels(curvature_per_m), self._words(steering, throttle), *arrow,
                   *(self._fan(index, measured.fresh(now_ns)) for index, measured in enumerate(self._ranges))]
        if self._trail_has_grown or self._timer.ticks % TICKS_PER_TRAIL == 1:
            markers.append(self._trail_marker())
            self._trail_has_grown = False
        self._markers.publish(MarkerArray(markers))

    def _body(self):
        """Draw a box over the axles, and a smaller one on top, towards the rear."""
        length_m = self._wheelbase_m + 2 * OVERHANG_M
        middle_m, height_m = self._wheelbase_m / 2, 0.8 * self._wheel_m
        low = Vector3(length_m, self._track_m - TIRE_WIDTH_M, height_m)
        high = Vector3(0.45 * length_m, 0.75 * low.y, 0.7 * height_m)
        return [marker("body", 0, self._base_frame, Marker.CUBE, BODY, low,
                       _at(middle_m, 0.0, CLEARANCE_M + height_m / 2)),
                marker("body", 1, self._base_frame, Marker.CUBE, CABIN, high,
                       _at(middle_m - 0.1 * length_m, 0.0, CLEARANCE_M + height_m + high.z / 2))]

    def _wheels(self, curvature_per_m):
        """Draw four cylinders on their sides, the front ones perpendicular to the line to the turning center."""
        size = Vector3(self._wheel_m, self._wheel_m, TIRE_WIDTH_M)
        places = [(x_m, y_m) for x_m in (0.0, self._wheelbase_m) for y_m in (self._track_m / 2, -self._track_m / 2)]
        return [marker("wheels", index, self._base_frame, Marker.CYLINDER, TIRE, size, _at(
                    x_m, y_m, self._wheel_m / 2, _lying(math.atan2(curvature_per_m * x_m, 1 - curvature_per_m * y_m))))
                for index, (x_m, y_m) in enumerate(places)]

    def _arrow(self, curvature_per_m):
        nose_m = self._wheelbase_m + OVERHANG_M
        path = [_nose(index / ARROW_STEPS * ARROW_M, curvature_per_m, nose_m) for index in range(ARROW_STEPS + 1)]
        points, (x_m, y_m, heading_rad) = [Point(x_m, y_m, LINE_M) for x_m, y_m, _ in path], path[-1]
        tip = Point(x_m + ARROW_HEAD_M * math.cos(heading_rad), y_m + ARROW_HEAD_M * math.sin(heading_rad), LINE_M)
        width, head = Vector3(2 * LINE_M, 0.0, 0.0), Vector3(0.001, 0.12, ARROW_HEAD_M)
        return [marker("steering", 0, self._base_frame, Marker.LINE_STRIP, ARROW, width, points=points),
                marker("steering", 1, self._base_frame, Marker.ARROW, ARROW, head, points=[points[-1], tip])]

    def _words(self, steering, throttle):
        """Write who steers and who drives behind the car."""
        lines = []
        if steering is not None:
            lines.append(f"steers: {source_name(steering.source)}, {_turn_text(steering.turn_radius)}")
        if throttle is not None:
            speed = "" if math.isnan(throttle.speed) else f"{throttle.speed:.1f} m/s, "
            lines.append(f"drives: {source_name(throttle.source)}, {speed}throttle {throttle.granted:.2f}")
        if not lines:
            return self._nothing("words", 0)
        return marker("words", 0, self._base_frame, Marker.TEXT_VIEW_FACING, TEXT, Vector3(0.0, 0.0, 0.12),
                      _at(-BEHIND_M, 0.0, ABOVE_M), text="\n".join(lines))

    def _fan(self, index, measured):
        """Draw what a sonar looked at: up to its echo or, without one, up to its range."""
        radius_m = 0.0 if measured is None else min(measured.range, measured.max_range)
        if not 0 < radius_m < math.inf or not math.isfinite(measured.field_of_view):  # nor is it NaN
            return self._nothing("sonars", index)
        angles = [measured.field_of_view * (step / FAN_STEPS - 0.5) for step in range(FAN_STEPS + 1)]
        edge = [Point(radius_m * math.cos(angle), radius_m * math.sin(angle), 0.0) for angle in angles]
        return marker("sonars", index, measured.header.frame_id or self._base_frame, Marker.TRIANGLE_LIST,
                      ECHO if measured.range < measured.max_range else NO_ECHO, Vector3(1.0, 1.0, 1.0),
                      points=[corner for sides in zip(edge, edge[1:]) for corner in (Point(), *sides)])

    def _nothing(self, ns, index):
        return Marker(header=Header(frame_id=self._base_frame), ns=ns, id=index, action=Marker.DELETE)

    def _trail_marker(self):
        action = Marker.DELETE if len(self._trail) < 2 else Marker.ADD  # rviz reports such a line as an error
        return marker("trail", 0, self._odom_frame, Marker.LINE_STRIP, TRAIL, Vector3(1.5 * LINE_M, 0.0, 0.0),
                      action=action, points=list(self._trail))


def marker(ns, index, frame, kind, color, scale, pose=None, action=Marker.ADD, **content) -> Marker:
    """Return a marker without a time: it is where its frame is now."""
    return Marker(header=Header(frame_id=frame), ns=ns, id=index, type=kind, action=action, scale=scale, color=color,
                  pose=pose or _at(0.0, 0.0, 0.0), frame_locked=True, **content)


def _at(x_m, y_m, z_m, orientation=NO_ROTATION):
    return Pose(Point(x_m, y_m, z_m), orientation)


def _lying(heading_rad):
    """Return the orientation of a cylinder on its side that rolls in this direction."""
    half_rad, factor = heading_rad / 2, math.sqrt(0.5)
    return Quaternion(factor * math.cos(half_rad), factor * math.sin(half_rad), factor * math.sin(half_rad),
                      factor * math.cos(half_rad))


def _nose(distance_m, curvature_per_m, nose_m):
    """Return x, y and heading of the nose when the middle of the rear axle has driven a distance along its arc."""
    half_rad = curvature_per_m * distance_m / 2
    chord_m = distance_m * (math.sin(half_rad) / half_rad if half_rad else 1.0)
    return (chord_m * math.cos(half_rad) + nose_m * math.cos(2 * half_rad),
            chord_m * math.sin(half_rad) + nose_m * math.sin(2 * half_rad), 2 * half_rad)


def _turn_text(radius_m):
    if not abs(radius_m) > 0:
        return "its turn is unknown"
    return "straight on" if math.isinf(radius_m) else f"{'left' if radius_m > 0 else 'right'} {abs(radius_m):.1f} m"


def main():
    """Run the node."""
    run("car_display", CarDisplay)
