"""The planner_interface node: anybody's planner drives by its own messages, one source at a time.

Subscribes, of these four the one that ~source names; messages of the others are counted:
    drive (ackermann_msgs/AckermannDriveStamped): source ``drive``, as F1TENTH's stacks send.
    cmd_vel (geometry_msgs/Twist or TwistStamped): source ``cmd_vel``, as move_base sends.
    ~input/control_cmd (Control): source ``autoware``, with ~input/gear_cmd (std_msgs/UInt8): GearCommand's number.
    av_speed_req (std_msgs/Float32): source ``speed``: m/s; its planner sends av_turnrad_req or av_steer_req itself.
And:
    ~input/odometry (nav_msgs/Odometry): its twist.twist.linear.x in m/s.
    throttle_arb/state (ThrottleState): who drives, and what the ESC makes of the request. Never received = the planner.
    turn_arb/state (SteeringState): whether the wheels can turn the car as asked; only quoted.
Publishes, at 50 Hz while the source is fresh:
    av_turnrad_req (std_msgs/Float32): turn radius in m, right negative, inf = straight on; not with source ``speed``.
    ~output/control_cmd (Control): the acceleration of the speed control, for generic_value_converter.
    ~state (PlannerState, latched): what is asked for, and why it isn't obeyed; on every change and 10 times a second.
    /diagnostics: the same, and who else publishes on its topics; 1 Hz.
When the source falls silent, or can't be obeyed: a radius of 0 and full braking once, then nothing; and the state, by
which throttle_arb stops. A source that sent an angle which no wheel turns to stays refused until it was sane for 2 s.
"""
from __future__ import annotations

import math

import rospy
from geometry_msgs.msg import Twist, TwistStamped
from nav_msgs.msg import Odometry
from std_msgs.msg import Float32, UInt8

from car_interface.common import causes
from car_interface.common.declared import read_all
from car_interface.common.rate_timer import RateTimer
from car_interface.common.sources import AUTOWARE, CMD_VEL, DRIVE, SPEED
from car_interface.common.staleness import TimedInput
from car_interface.common.units import NS_PER_S
from car_interface.msg import Control, PlannerState, SteeringState, ThrottleState
from car_interface.nodes.planner_interface.ackermann_messages import ackermann_drive_class
from car_interface.nodes.planner_interface.config import PlannerInterfaceConfig
from car_interface.planner.messages import (
    REVERSE,
    PlannerRequest,
    from_ackermann,
    from_control,
    from_twist,
    not_finite,
    sane_radius_m,
)
from car_interface.planner.source_arbiter import PlannerDecision, SourceArbiter
from car_interface.ros.clocks import StampedAge, odd_stamp
from car_interface.ros.command_topics import CommandTopics
from car_interface.ros.diagnostics import OK, WARN, Diagnostics, age_text
from car_interface.ros.logs import ThrottledWarnings
from car_interface.ros.runtime import run
from car_interface.ros.topics import advertise, md5_of, sender_of, subscribe
from car_interface.steering.limits import TOO_TIGHT_FOR_NS, TOO_TIGHT_REMEDY
from car_interface.throttle.speed_control import STOP, SpeedControl

RATE_HZ = 50
STEERING_TIMEOUT_S = 0.5  # turn_arb's state comes 20 times a second
TICKS_PER_STATE = 5
TOPICS = {DRIVE: "drive", CMD_VEL: "cmd_vel", AUTOWARE: "~input/control_cmd", SPEED: "av_speed_req"}
TWISTS = {message_type._md5sum: message_type for message_type in (Twist, TwistStamped)}


class PlannerInterface:
    """Convert the source's messages, control the speed, publish."""

    def __init__(self, params, inbox):
        config = read_all(params, PlannerInterfaceConfig)
        self._clocks = inbox.clocks
        now_ns = self._clocks.now_ns()
        self._config = config
        self._sources = SourceArbiter(config.source, config.source_timeout_s, sane_radius_m(config.wheelbase_m))
        # Why the wheels can't turn the car as asked, by turn_arb; empty: they can. And the newest such reason.
        self._steering = TimedInput("turn_arb's state", STEERING_TIMEOUT_S)
        self._too_tight = TimedInput("a turn that is too tight", TOO_TIGHT_FOR_NS / NS_PER_S)
        self._control = SpeedControl(config.speed)
        self._gear_number = None  # the newest of ~input/gear_cmd
        self._inbox = inbox
        self._warnings = ThrottledWarnings(inbox.clocks)
        self._odometry_age = StampedAge("odometry", inbox.clocks)
        self._timer = RateTimer(RATE_HZ, now_ns)
        self._decision, self._command = PlannerDecision("", "before the first decision"), None
        self._published = None  # what throttle_arb goes by, of the newest state
        self._radius_m = None  # the newest that was published
        self._radii = advertise("av_turnrad_req", Float32, inbox) if config.source != SPEED else None
        self._controls = advertise("~output/control_cmd", Control, inbox)
        self._states = advertise("~state", PlannerState, inbox, latch=True)
        others = tuple(topic for source, topic in TOPICS.items() if source != config.source)
        types = {TOPICS[CMD_VEL]: (Twist._type, TwistStamped._type)} if config.source == CMD_VEL else {}
        self._command_topics = CommandTopics(inbox, shared=others, types=types)
        self._diagnostics = Diagnostics(inbox, "none", {"planner": self._report, **self._command_topics.reports},
                                        now_ns)
        inbox.on_overflow(self._on_overflow)
        self._subscribe(config.source)
        self._command_topics.start(self._diagnostics.report_now)

    def _subscribe(self, obeyed):
        inbox = self._inbox
        if obeyed == AUTOWARE:
            subscribe("~input/gear_cmd", UInt8, inbox, self._on_gear)
        message_type, handler = {
            DRIVE: (None, self._on_drive), CMD_VEL: (rospy.AnyMsg, self._on_twist),
            AUTOWARE: (Control, self._on_control), SPEED: (Float32, self._on_speed)}[obeyed]
        subscribe(TOPICS[obeyed], message_type or ackermann_drive_class(), inbox, handler)
        for source, topic in TOPICS.items():
            if source != obeyed:
                subscribe(topic, rospy.AnyMsg, inbox, lambda message, now_ns, source=source:
                          self._sources.count_other(source, sender_of(message)), wakes=False)
        # The speed is controlled at the timer's ticks alone.
        subscribe("~input/odometry", Odometry, inbox, self._on_odometry, wakes=False)
        subscribe("throttle_arb/state", ThrottleState, inbox, self._on_throttle, wakes=False)
        subscribe("turn_arb/state", SteeringState, inbox, self._on_steering, wakes=False)

    def step(self, now_ns):
        """Handle what arrived; then the timer, and the moment at which the source falls silent."""
        self._inbox.dispatch()
        if self._timer.is_due(now_ns):
            self._tick(now_ns)
        elif self._decision.request is not None:
            self._decide(now_ns)  # it may have fallen silent
        self._diagnostics.step(now_ns)
        return min(self._timer.due_ns, self._sources.silent_at_ns(now_ns))

    def shut_down(self):
        """Stop: a radius of 0, and full braking."""
        if self._decision.request is not None:
            self._publish_stop()
            self._decision = PlannerDecision(causes.NO_REQUEST, "planner_interface has ended")
            self._publish_state(self._clocks.now_ns())

    # --- what arrives ---

    def _on_overflow(self, now_ns):
        self._sources.mark_stale()
        self._steering.mark_stale()
        self._control.mark_stale()
        self._decide(now_ns)

    def _on_drive(self, message, now_ns):
        self._note_odd_stamp("drive", message.header.stamp)
        drive = message.drive
        self._obey(from_ackermann(drive.steering_angle, drive.speed, drive.acceleration, drive.jerk,
                                  self._config.wheelbase_m), now_ns)

    def _on_twist(self, message, now_ns):
        message_type = TWISTS.get(md5_of(message))
        if message_type is None:  # reported with the command topics
            return
        twist = message_type().deserialize(message._buff)
        if message_type is TwistStamped:
            self._note_odd_stamp("cmd_vel", twist.header.stamp)
            twist = twist.twist
        self._obey(from_twist(twist.linear.x, twist.angular.z, self._config.cmd_vel_angular,
                              self._config.wheelbase_m), now_ns)

    def _on_gear(self, message, now_ns):
        self._gear_number = message.data

    def _on_control(self, message, now_ns):
        self._note_odd_stamp("control_cmd", message.stamp)
        longitudinal = message.longitudinal
        self._obey(from_control(message.lateral.steering_tire_angle, longitudinal.velocity, longitudinal.acceleration,
                                longitudinal.jerk, self._gear_number, self._config.wheelbase_m), now_ns)

    def _on_speed(self, message, now_ns):
        self._obey(not_finite(av_speed_req=message.data) or PlannerRequest(None, message.data), now_ns)

    def _on_odometry(self, message, now_ns):
        age_ns = self._odometry_age.at_arrival_ns(message.header.stamp, now_ns)
        self._control.speed.update(message.twist.twist.linear.x, now_ns, age_ns)

    def _on_throttle(self, message, now_ns):
        self._control.update_throttle(message.source, message.asked, message.granted, message.esc_cause, now_ns)

    def _on_steering(self, message, now_ns):
        reason = message.limit_reason if message.limit == causes.TOO_TIGHT else ""
        self._steering.update(reason, now_ns)
        if reason:
            self._too_tight.update(reason, now_ns)

    def _note_odd_stamp(self, name, stamp):
        """Count an odd stamp; the message is obeyed all the same. Many planners leave it at zero."""
        text = "" if stamp.is_zero() else odd_stamp(stamp, self._clocks.ros_now())
        if text:
            self._warnings.warn(f"{name} stamp", f"the stamp of {name} {text}; it's obeyed all the same")

    # --- what follows ---

    def _obey(self, command, now_ns):
        self._sources.update(command, now_ns)
        self._decide(now_ns)

    def _decide(self, now_ns):
        """Have the steering at once; and stop at once when there is no request any more."""
        before, self._decision = self._decision, self._sources.decide(now_ns)
        if self._decision.request is None:
            if before.request is not None:
                self._publish_stop()
        elif self._decision.radius_m != self._radius_m:
            self._publish_radius(self._decision.radius_m)
        if before.cause != self._decision.cause:
            self._control_speed(now_ns)
            self._publish_state(now_ns)

    def _tick(self, now_ns):
        self._decide(now_ns)
        self._control_speed(now_ns)
        if self._published != self._kind or self._timer.ticks % TICKS_PER_STATE == 0:
            self._publish_state(now_ns)  # the gear before what it is for
        if self._decision.request is not None:
            self._publish_radius(self._decision.radius_m)
            self._publish_control(self._command.reference_mps, self._command.acceleration_mps2)

    def _control_speed(self, now_ns):
        self._command = self._control.step(self._decision.request or STOP, now_ns)

    @property
    def _kind(self):
        """Return what throttle_arb goes by: cause, gear, and whether the car is to go on."""
        cause = self._decision.cause
        if cause == causes.PLANNER and not self._command.is_known:
            cause = causes.ODOMETRY_STALE
        request = self._decision.request
        return cause, self._command.gear, request is not None and request.speed_mps != 0.0

    def _publish_stop(self):
        self._publish_radius(0.0)
        sign = 1.0 if self._command.gear == REVERSE else -1.0
        self._publish_control(0.0, sign * self._config.speed.max_braking_mps2)

    def _publish_radius(self, radius_m):
        if self._radii is not None:
            self._radius_m = radius_m
            self._radii.publish(Float32(radius_m))

    def _publish_control(self, speed_mps, acceleration_mps2):
        message = Control()
        message.stamp = message.control_time = message.lateral.stamp = message.longitudinal.stamp = (
            self._clocks.ros_now())
        radius_m = self._radius_m or math.inf
        message.lateral.steering_tire_angle = math.atan(self._config.wheelbase_m / radius_m)
        message.longitudinal.velocity = speed_mps
        message.longitudinal.acceleration = acceleration_mps2
        message.longitudinal.is_defined_acceleration = True
        self._controls.publish(message)

    def _publish_state(self, now_ns):
        decision, command = self._decision, self._command
        before, self._published = self._published, self._kind
        cause, gear, _ = self._published
        request = decision.request
        self._states.publish(PlannerState(
            stamp=self._clocks.ros_now(), source=self._sources.source, cause=cause, reason=self._reason(), gear=gear,
            turn_radius=decision.radius_m, speed=request.speed_mps if request else 0.0,
            reference_speed=command.reference_mps if request else 0.0, measured_speed=self._control.speed.last_mps,
            acceleration=command.acceleration_mps2 if request else 0.0, source_age=self._sources.age_s(now_ns),
            odometry_age=self._control.speed.age_s(now_ns), refused=self._sources.refused,
            others=self._sources.others))
        if before is None or before[0] != cause:
            log = rospy.logwarn if _is_alarming(cause) else rospy.loginfo
            log("%s", self._reason())

    def _reason(self):
        """Return why it isn't obeyed, or what is asked for and what differs from that."""
        if self._decision.request is None:
            return self._decision.reason
        too_tight = self._steering.fresh(self._clocks.now_ns())
        return "; ".join(filter(None, (self._decision.reason, too_tight, self._command.note)))

    def _report(self, status):
        """Report on /diagnostics what is asked for, and why it isn't obeyed."""
        cause, gear, _ = self._kind
        now_ns = self._clocks.now_ns()
        reason, too_tight = self._reason(), self._too_tight.fresh(now_ns) or ""
        status.summary(WARN if too_tight or _is_alarming(cause) else OK,
                       reason if too_tight in reason else f"{reason}; {too_tight}")
        status.add("cause", cause)
        status.add("remedy", TOO_TIGHT_REMEDY if too_tight else "")
        status.add("source", self._sources.source)
        status.add("gear", gear)
        status.add("not obeyed", self._sources.others or "nobody")
        status.add("refused", self._sources.refused)
        status.add(f"age of {self._sources.source}", age_text(self._sources.age_s(now_ns)))
        status.add("age of odometry", age_text(self._control.speed.age_s(now_ns)))
        for kind, count in sorted(self._warnings.counts.items()):
            status.add(kind, count)


def _is_alarming(cause):
    """Return whether somebody has to act: an input failed, or asks for what can't be done."""
    return cause in causes.LOSSES or cause == causes.REQUEST_REFUSED


def main():
    run("planner_interface", PlannerInterface)
