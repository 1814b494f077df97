"""The car_display node: the car, its trail and its steering for rviz.

Subscribes:
    odom (nav_msgs/Odometry): the trail.
    turn_arb/state (SteeringState): the commanded turn radius, and who steers.
Publishes:
    ~markers (visualization_msgs/MarkerArray, latched, 10 Hz): in base_link the car, its front wheels turned as the
        steering is commanded, an arrow along the way that its nose will take, with who steers and the turn radius; in
        odom the trail, a point every 5 cm, the newest 2,000. Without a command the wheels look ahead and there is no
        arrow.
Parameters:
    ~wheelbase 0.324, ~track 0.296, ~wheel_diameter 0.095 (m): the car's size.
    ~odom_frame odom, ~base_frame base_link, ~frame_prefix "" (before both).
"""
from __future__ import annotations

import math
import time
from collections import deque
from dataclasses import dataclass

import rospy
from geometry_msgs.msg import Point, Pose, Quaternion, Vector3
from nav_msgs.msg import Odometry
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

from car_interface.common.rate_timer import RateTimer
from car_interface.common.staleness import TimedInput
from car_interface.msg import SteeringState
from car_interface.ros.runtime import run
from car_interface.ros.topics import subscribe
from car_interface.steering.arbiter import source_name

RATE_HZ = 10
TICKS_PER_TRAIL = 10  # a trail that didn't grow is sent once a second, for an rviz that comes late
COMMAND_TIMEOUT_S = 0.5
SPACING_M = 0.05
TRAIL_POINTS = 2000
# Odometry that begins anew, somewhere else, is another trail. No car gets this far from one report to the next.
JUMP_M = 5.0
ARROW_M, ARROW_STEPS = 1.0, 20
ARROW_HEAD_M = 0.16
# Beyond the axles, and the least that a body is above the ground.
OVERHANG_M, CLEARANCE_M = 0.10, 0.035
TIRE_WIDTH_M = 0.05
LINE_M = 0.02

BODY, CABIN = ColorRGBA(0.10, 0.35, 0.75, 1.0), ColorRGBA(0.06, 0.10, 0.18, 1.0)
TIRE = ColorRGBA(0.08, 0.08, 0.08, 1.0)
ARROW, TRAIL, WORDS = ColorRGBA(1.0, 0.45, 0.0, 1.0), ColorRGBA(0.0, 0.6, 0.35, 1.0), ColorRGBA(0.1, 0.1, 0.1, 1.0)
NO_TURN = Quaternion(0.0, 0.0, 0.0, 1.0)


@dataclass(frozen=True)
class CarDisplayConfig:
    """What the node's parameters say: the car's size, and the frames with their prefix."""

    wheelbase_m: float
    track_m: float
    wheel_diameter_m: float
    odom_frame: str
    base_frame: str


def read_config(params) -> CarDisplayConfig:
    """The node's configuration from its parameters.

    Raises:
        ConfigError: naming the parameter.
    """
    prefix = params.text("frame_prefix", "", may_be_empty=True)
    config = CarDisplayConfig(
        wheelbase_m=params.number("wheelbase", 0.324, above=0.0, high=10),
        track_m=params.number("track", 0.296, above=0.0, high=10),
        wheel_diameter_m=params.number("wheel_diameter", 0.095, above=0.0, high=10),
        odom_frame=prefix + params.text("odom_frame", "odom"),
        base_frame=prefix + params.text("base_frame", "base_link"))
    params.finish()
    return config


class Trail:
    """Where the car went, in steps."""

    def __init__(self):
        self.points: deque = deque(maxlen=TRAIL_POINTS)
        self.grew = False  # whoever has shown it sets this back

    def add(self, x_m: float, y_m: float) -> None:
        """Take where the car is; what isn't finite is no place."""
        if not math.isfinite(x_m + y_m):
            return
        if self.points:
            step_m = math.hypot(x_m - self.points[-1].x, y_m - self.points[-1].y)
            if step_m < SPACING_M:
                return
            if step_m > JUMP_M:
                self.points.clear()
        self.points.append(Point(x_m, y_m, LINE_M))
        self.grew = True


class CarDisplay:
    """Hears where the car is and what it's told; draws both."""

    def __init__(self, params, inbox):
        config = read_config(params)
        self._wheelbase_m, self._track_m = config.wheelbase_m, config.track_m
        self._wheel_m = config.wheel_diameter_m
        self._odom_frame, self._base_frame = config.odom_frame, config.base_frame
        self._inbox = inbox
        self._state = TimedInput("turn_arb/state", COMMAND_TIMEOUT_S)
        self._trail = Trail()
        self._ticks = 0
        self._timer = RateTimer(RATE_HZ, time.monotonic_ns())
        self._markers = rospy.Publisher("~markers", MarkerArray, queue_size=1, latch=True)
        subscribe("turn_arb/state", SteeringState, inbox, self._on_state)
        subscribe("odom", Odometry, inbox, self._on_odometry, queue_size=100)

    def step(self, now_ns):
        """Take what arrived; draw when it's time."""
        self._inbox.dispatch()
        if self._timer.is_due(now_ns):
            self._draw(now_ns)
        return self._timer.due_ns

    def shut_down(self):
        """Nothing to undo."""

    def _on_state(self, message, now_ns):
        self._state.update(message, now_ns)

    def _on_odometry(self, message, now_ns):
        position = message.pose.pose.position
        self._trail.add(position.x, position.y)

    def _draw(self, now_ns):
        state = None if self._state.is_stale(now_ns) else self._state.value
        known = state is not None and abs(state.turn_radius) > 0  # nor is it NaN
        curvature_per_m = 1 / state.turn_radius if known else 0.0
        markers = [*self._body(), *self._wheels(curvature_per_m)]
        markers += self._arrow(curvature_per_m, state) if known else self._no_arrow()
        if self._trail.grew or self._ticks % TICKS_PER_TRAIL == 0:
            markers.append(self._trail_marker())
            self._trail.grew = False
        self._ticks += 1
        self._markers.publish(MarkerArray(markers))

    def _body(self):
        """A box over the axles, a smaller one on top of it: it shows where ahead is."""
        length_m = self._wheelbase_m + 2 * OVERHANG_M
        middle_m, height_m = self._wheelbase_m / 2, 0.8 * self._wheel_m
        low = Vector3(length_m, self._track_m - TIRE_WIDTH_M, height_m)
        high = Vector3(0.45 * length_m, 0.75 * low.y, 0.7 * height_m)
        return [self._marker("body", 0, Marker.CUBE, BODY, low, _at(middle_m, 0.0, CLEARANCE_M + height_m / 2)),
                self._marker("body", 1, Marker.CUBE, CABIN, high,
                             _at(middle_m - 0.1 * length_m, 0.0, CLEARANCE_M + height_m + high.z / 2))]

    def _wheels(self, curvature_per_m):
        """Four cylinders on their sides; each front one at a right angle to the line to the middle of the turn."""
        size = Vector3(self._wheel_m, self._wheel_m, TIRE_WIDTH_M)
        places = [(x_m, y_m) for x_m in (0.0, self._wheelbase_m) for y_m in (self._track_m / 2, -self._track_m / 2)]
        return [self._marker("wheels", index, Marker.CYLINDER, TIRE, size, _at(
                    x_m, y_m, self._wheel_m / 2, _lying(math.atan2(curvature_per_m * x_m, 1 - curvature_per_m * y_m))))
                for index, (x_m, y_m) in enumerate(places)]

    def _arrow(self, curvature_per_m, state):
        nose_m = self._wheelbase_m + OVERHANG_M
        way = [_nose(index / ARROW_STEPS * ARROW_M, curvature_per_m, nose_m) for index in range(ARROW_STEPS + 1)]
        line = self._marker("steering", 0, Marker.LINE_STRIP, ARROW, Vector3(2 * LINE_M, 0.0, 0.0))
        line.points = [Point(x_m, y_m, LINE_M) for x_m, y_m, _ in way]
        head = self._marker("steering", 1, Marker.ARROW, ARROW, Vector3(0.001, 0.12, ARROW_HEAD_M))
        x_m, y_m, heading_rad = way[-1]
        head.points = [line.points[-1], Point(x_m + ARROW_HEAD_M * math.cos(heading_rad),
                                              y_m + ARROW_HEAD_M * math.sin(heading_rad), LINE_M)]
        words = self._marker("steering", 2, Marker.TEXT_VIEW_FACING, WORDS, Vector3(0.0, 0.0, 0.12),
                             _at(self._wheelbase_m / 2, 0.0, 0.5))
        words.text = f"{source_name(state.source)}: {_turn(state.turn_radius)}"
        return [line, head, words]

    def _no_arrow(self):
        return [Marker(header=self._header(self._base_frame), ns="steering", id=index, action=Marker.DELETE)
                for index in range(3)]

    def _trail_marker(self):
        points = list(self._trail.points)
        marker = self._marker("trail", 0, Marker.LINE_STRIP, TRAIL, Vector3(1.5 * LINE_M, 0.0, 0.0),
                              frame=self._odom_frame)
        marker.points = points
        if len(points) < 2:  # rviz takes that for a fault
            marker.action = Marker.DELETE
        return marker

    def _marker(self, ns, index, kind, color, scale, pose=None, frame=None):
        return Marker(header=self._header(frame or self._base_frame), ns=ns, id=index, type=kind, action=Marker.ADD,
                      pose=pose or _at(0.0, 0.0, 0.0), scale=scale, color=color, frame_locked=True)

    @staticmethod
    def _header(frame):
        return Header(stamp=rospy.Time(), frame_id=frame)  # 0: where the frame is now


def _at(x_m, y_m, z_m, orientation=NO_TURN):
    return Pose(Point(x_m, y_m, z_m), orientation)


def _lying(heading_rad):
    """A cylinder's orientation: on its side, and rolling in this direction."""
    half_rad, lie = heading_rad / 2, math.sqrt(0.5)
    return Quaternion(lie * math.cos(half_rad), lie * math.sin(half_rad), lie * math.sin(half_rad),
                      lie * math.cos(half_rad))


def _nose(distance_m, curvature_per_m, nose_m):
    """Where the nose is, and looks, when the middle of the rear axle has gone so far along its arc: x, y, heading."""
    turned_rad = curvature_per_m * distance_m
    if abs(turned_rad) < 1e-6:
        return distance_m + nose_m, 0.0, 0.0
    x_m = math.sin(turned_rad) / curvature_per_m + nose_m * math.cos(turned_rad)
    y_m = (1 - math.cos(turned_rad)) / curvature_per_m + nose_m * math.sin(turned_rad)
    return x_m, y_m, turned_rad


def _turn(radius_m):
    return "straight on" if math.isinf(radius_m) else f"{'left' if radius_m > 0 else 'right'} {abs(radius_m):.1f} m"


def main():
    """Run the node."""
    run("car_display", CarDisplay)
