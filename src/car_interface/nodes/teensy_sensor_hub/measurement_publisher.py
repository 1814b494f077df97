"""What the Teensy measures, as stamped messages in SI units: one half of teensy_sensor_hub.

The node's docstring has the topics.
"""
from __future__ import annotations

import math

from geometry_msgs.msg import Quaternion, Transform, TransformStamped, Vector3
from nav_msgs.msg import Odometry as OdometryMessage
from sensor_msgs.msg import JointState, Range, Temperature
from std_msgs.msg import Header
from tf2_msgs.msg import TFMessage

from car_interface.common.errors import ConfigError
from car_interface.common.rate_timer import RateTimer
from car_interface.common.units import NS_PER_S
from car_interface.common.vehicle_geometry import SONARS
from car_interface.msg import SteeringState, TeensyClock
from car_interface.nodes.teensy_sensor_hub.config import HubConfig
from car_interface.ros.clocks import RosClock
from car_interface.ros.diagnostics import OK, WARN
from car_interface.ros.logs import ThrottledWarnings
from car_interface.ros.topics import advertise, has_subscribers, subscribe
from car_interface.teensy.link.health import CLOCK_REPORT
from car_interface.teensy.sensing.measurements import Measurements

QUEUE_SIZE = 100
UNMEASURED = 1e6  # variance of what wheels don't measure: height, roll, pitch and sliding sideways
WHEEL_JOINTS = ("rear_left_wheel", "rear_right_wheel")
MAX_REFUSED_RATIO = 0.01  # of a second's records, from which on it's a warning


class MeasurementPublisher:
    """Publishes what ``Measurements`` makes of the Teensy's records.

    Attributes:
        ranging: has what it found out about the sonars.
        speed_mps: the newest.
    """

    def __init__(self, config: HubConfig, inbox):
        self._baud = config.baud
        self._odom_frame, self._base_frame = config.frame(config.odom_frame), config.frame(config.base_frame)
        self._joint_names = [config.frame(name) for name in WHEEL_JOINTS]
        self._sonar_frames = [config.frame(f"sonar_{name}") for name in SONARS]
        self._measurements = Measurements(config.measurement, self._on_motion)
        self.ranging = self._measurements.ranging
        self._ros_clock = RosClock(inbox.clocks)
        self._warnings = ThrottledWarnings(inbox.clocks)
        self._sync = None
        self._counted = (0, 0)
        self._pending = None  # the newest motion, while it isn't published
        self.speed_mps = 0.0
        self._motion_timer = RateTimer(config.odom_rate_hz or math.inf, 0)
        # It is reused: rospy serialises a message as it publishes it.
        self._range_msg = Range(radiation_type=Range.ULTRASOUND, field_of_view=config.field_of_view_rad,
                                min_range=config.ranging.min_range_m, max_range=config.ranging.max_range_m)
        self._odometry = advertise("odom", OdometryMessage, inbox, QUEUE_SIZE)
        self._joints = advertise("joint_states", JointState, inbox, QUEUE_SIZE)
        self._ranges = [advertise(f"sonar/{name}", Range, inbox, QUEUE_SIZE) for name in SONARS]
        self._clock = advertise("teensy_clock", TeensyClock, inbox, QUEUE_SIZE)
        self._tf = advertise("/tf", TFMessage, inbox, QUEUE_SIZE) if config.publish_tf else None
        advertise("/tf_static", TFMessage, inbox, queue_size=1, latch=True).publish(
            [_transform(inbox.clocks.ros_now(), self._base_frame, frame, *mount)
             for frame, mount in zip(self._sonar_frames, config.mounts)])
        subscribe("temperature", Temperature, inbox, self._on_temperature)
        if config.odometry.use_steering:
            inbox.on_overflow(lambda now_ns: self._measurements.steer(math.nan))
            subscribe("turn_arb/state", SteeringState, inbox, self._on_steering)

    def pong(self, record, answer, received_ns: int) -> None:
        """Take a pong, with the ping that it answers or ``None``; publish how the clocks relate."""
        sync = self._measurements.pong(record, answer, received_ns)
        if sync is None:
            return
        self._sync = sync
        self._clock.publish(TeensyClock(
            stamp=self._ros_clock.stamp("clock", received_ns), sent=answer.sent_ns, received=received_ns,
            sent_bytes=answer.sent_bytes, baud=self._baud, tick=record.timestamp2, used=sync.used,
            reason=sync.reason, converged=sync.converged, offset=sync.offset_ns / NS_PER_S, skew=sync.skew_ppm,
            uncertainty=sync.uncertainty_ns / NS_PER_S, round_trip=sync.round_trip_ns / NS_PER_S))

    def sonar(self, record, received_ns: int, is_trusted: bool, wait_ms: int) -> None:
        """Take a sonar's report, and SONAR_WAIT; publish its range, if it is one."""
        measured = self._measurements.sonar(record, received_ns, is_trusted, wait_ms)
        if measured is None or not has_subscribers(self._ranges[measured.sensor]):
            return
        message = self._range_msg
        message.range = measured.range_m
        message.header.stamp = self._ros_clock.stamp(measured.sensor, measured.stamp.time_ns)
        message.header.frame_id = self._sonar_frames[measured.sensor]
        self._ranges[measured.sensor].publish(message)

    def wheels(self, record, received_ns: int) -> None:
        """Take a report of the wheels; it may wait in the measurements' queue until a motion is due."""
        self._measurements.queue_wheels(record, received_ns)
        if received_ns >= self._motion_timer.due_ns:
            self._measurements.process_queue()

    def _on_motion(self, measured):
        """Publish a motion that is due by its own time: one read may bring reports of a second."""
        self.speed_mps = measured.motion.speed_mps
        self._pending = measured
        if self._motion_timer.is_due(measured.stamp.time_ns):
            self._publish_pending()

    @property
    def due_ns(self) -> float:
        """Return when the next step is due: reports that came too soon wait for another one, but not for long."""
        timer = self._motion_timer
        return timer.due_ns + timer.period_ns if self._pending or self._measurements.queue else math.inf

    def step(self, now_ns: int) -> None:
        """Publish the motion that came too soon, if none came after it."""
        if now_ns >= self.due_ns and self._motion_timer.is_due(now_ns):
            self._measurements.process_queue()
            self._publish_pending()

    def _publish_pending(self):
        """Publish the newest motion, if it waits: odometry, its transform, and the wheels' joints."""
        measured, self._pending = self._pending, None
        if measured is None:
            return
        motion = measured.motion
        stamp = self._ros_clock.stamp("motion", measured.stamp.time_ns)  # one for all: they are looked up by it
        if has_subscribers(self._odometry):
            self._odometry.publish(self._odometry_message(motion, stamp))
        if self._tf is not None and has_subscribers(self._tf):
            self._tf.publish([_transform(stamp, self._odom_frame, self._base_frame, motion.x_m, motion.y_m,
                                         motion.yaw_rad)])
        if has_subscribers(self._joints):
            self._joints.publish(header=Header(stamp=stamp), name=self._joint_names, position=motion.wheel_angles_rad,
                                 velocity=motion.wheel_speeds_radps)

    @property
    def reports(self) -> dict:
        """Return the reports for /diagnostics, by name."""
        return {CLOCK_REPORT: self._report_clock, "Teensy records": self._report_records}

    def _report_clock(self, status):
        sync, clock = self._sync, self._measurements.clock
        if sync is None:
            status.summary(WARN, "no ping was answered yet: times go by when reports arrive")
            return
        status.summary(OK if clock.converged else WARN, "the Teensy's clock is known" if clock.converged else
                       "too few pings were answered yet: times go by when reports arrive")
        status.add("faster than this computer's", f"{sync.skew_ppm:.1f} ppm")
        status.add("uncertainty", f"{sync.uncertainty_ns / 1e6:.2f} ms")
        status.add("round trip", f"{sync.round_trip_ns / 1e6:.1f} ms")

    def _report_records(self, status):
        """Report what the plausibility gates refused."""
        gates = self._measurements.gates
        accepted, refused = (now - before for now, before in zip((gates.accepted, gates.refused), self._counted))
        self._counted = (gates.accepted, gates.refused)
        bad = refused > MAX_REFUSED_RATIO * (accepted + refused)
        status.summary(WARN if bad else OK, f"{refused} of the last second's records made no sense" if bad else
                       "wheels, sonars and pongs make sense")
        status.add("accepted", gates.accepted)
        status.add("refused", gates.refused)
        for reason, count in sorted((gates.counts + self.ranging.counts).items()):
            status.add(reason, count)

    def _on_temperature(self, message, now_ns):
        try:
            self.ranging.set_temperature(message.temperature)
        except ConfigError as error:
            self._warnings.warn("temperature", f"{error}: the one before it counts on")

    def _on_steering(self, message, now_ns):
        self._measurements.steer(1 / message.turn_radius if message.turn_radius else math.nan)

    def _odometry_message(self, motion, stamp):
        message = OdometryMessage(header=Header(stamp=stamp, frame_id=self._odom_frame),
                                  child_frame_id=self._base_frame)
        pose, twist = message.pose.pose, message.twist
        pose.position.x, pose.position.y = motion.x_m, motion.y_m
        pose.orientation = _rotation(motion.yaw_rad)
        (xx, xy, xa), (_, yy, ya), (_, _, aa) = motion.pose_covariance
        message.pose.covariance = _covariance(xx, xy, xa, yy, ya, aa)
        twist.twist.linear.x, twist.twist.angular.z = motion.speed_mps, motion.yaw_rate_radps
        twist.covariance = _covariance(motion.speed_variance, 0, 0, UNMEASURED, 0, motion.yaw_rate_variance)
        return message


def _transform(stamp, parent, child, x_m, y_m, yaw_rad):
    return TransformStamped(Header(stamp=stamp, frame_id=parent), child,
                            Transform(Vector3(x_m, y_m, 0.0), _rotation(yaw_rad)))


def _rotation(yaw_rad):
    return Quaternion(0.0, 0.0, math.sin(yaw_rad / 2), math.cos(yaw_rad / 2))


def _covariance(xx, xy, xa, yy, ya, aa):
    """Return a covariance of x, y and the turn about the vertical as ROS wants it: 6×6."""
    return [xx, xy, 0, 0, 0, xa,
            xy, yy, 0, 0, 0, ya,
            0, 0, UNMEASURED, 0, 0, 0,
            0, 0, 0, UNMEASURED, 0, 0,
            0, 0, 0, 0, UNMEASURED, 0,
            xa, ya, 0, 0, 0, aa]
