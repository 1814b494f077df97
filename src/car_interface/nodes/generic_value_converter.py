"""The generic_value_converter node: converts accelerations to an actuator's value.

Subscribes:
    ~input/control_cmd (Control): its longitudinal.acceleration in m/s².
    ~input/odometry (nav_msgs/Odometry): its twist.twist.linear.x in m/s.
Publishes:
    ~output/value (Float64Stamped): one for each command that can be converted.
    ~state (ConverterState, latched): the newest value, or why there is none; when the cause changes and at 1 Hz.
    /diagnostics: whether commands are converted, and why not, and who else publishes on its topics; 1 Hz.
"""
from __future__ import annotations

import math
from collections import Counter

import rospy
from nav_msgs.msg import Odometry

from car_interface.common import causes
from car_interface.common.declared import read_all
from car_interface.common.rate_timer import RateTimer
from car_interface.msg import Control, ConverterState, Float64Stamped
from car_interface.ros.clocks import RosClock, StampedAge, odd_stamp
from car_interface.ros.command_topics import CommandTopics
from car_interface.ros.diagnostics import OK, WARN, Diagnostics, age_text
from car_interface.ros.logs import ThrottledWarnings
from car_interface.ros.runtime import run
from car_interface.ros.topics import advertise, subscribe
from car_interface.throttle.converter import Conversion, Converter, ConverterConfig

STATE_RATE_HZ = 1
NO_COMMAND = Conversion(None, causes.NO_REQUEST, "waiting for the first command")


class GenericValueConverter:
    """Convert each command."""

    def __init__(self, params, inbox):
        config = read_all(params, ConverterConfig)
        self._converter = Converter(config)
        _warn_of_clamped_values(config)
        self._inbox = inbox
        self._warnings = ThrottledWarnings(inbox.clocks)
        self._conversion = NO_COMMAND  # the newest command's
        self._counts: Counter = Counter()
        self._clocks = inbox.clocks
        now_ns = self._clocks.now_ns()
        self._timer = RateTimer(STATE_RATE_HZ, now_ns)
        self._command_topics = CommandTopics(inbox)
        self._diagnostics = Diagnostics(inbox, "none", {"converter": self._report, **self._command_topics.reports},
                                        now_ns)
        self._ros_clock = RosClock(inbox.clocks)
        self._odometry_age = StampedAge("odometry", inbox.clocks)
        self._values = advertise("~output/value", Float64Stamped, inbox)
        self._states = advertise("~state", ConverterState, inbox, latch=True)
        inbox.on_overflow(lambda now_ns: self._converter.odometry.mark_stale())
        rospy.loginfo("waiting for odometry on %s and commands on %s",
                      *(inbox.resolve_name(name) for name in ("~input/odometry", "~input/control_cmd")))
        subscribe("~input/odometry", Odometry, inbox, self._on_odometry, wakes=False)  # only a command asks for it
        subscribe("~input/control_cmd", Control, inbox, self._on_command)
        self._command_topics.start(self._diagnostics.report_now)

    def step(self, now_ns):
        """Handle each message; then the timers."""
        self._inbox.dispatch()
        self._diagnostics.step(now_ns)
        if self._timer.is_due(now_ns):
            self._publish_state()
        return min(self._timer.due_ns, self._diagnostics.due_ns)

    def shut_down(self):
        """Nothing to do: without values throttle_arb stops the car."""

    def _on_odometry(self, message, now_ns):
        velocity = message.twist.twist.linear.x
        age_ns = self._odometry_age.at_arrival_ns(message.header.stamp, now_ns)
        self._converter.odometry.update(velocity, now_ns, age_ns)
        if not math.isfinite(velocity):
            self._warnings.warn(causes.ODOMETRY_NOT_FINITE, f"the velocity in the odometry is {velocity}: no output")

    def _on_command(self, message, now_ns):
        odd = odd_stamp(message.stamp, self._clocks.ros_now())
        if odd:  # the message is used all the same: freshness is measured by arrival
            self._warnings.warn("control_cmd stamp", f"the stamp of control_cmd {odd}; it's obeyed all the same")
        before, conversion = self._conversion, self._converter.convert(message.longitudinal.acceleration, now_ns)
        self._conversion = conversion
        self._counts["commands"] += 1
        if conversion.value is not None:
            self._counts["values"] += 1
            self._values.publish(Float64Stamped(stamp=self._ros_clock.stamp("value", self._clocks.now_ns()),
                                                data=conversion.value))
        if conversion.cause != before.cause:
            self._publish_state()
        if conversion.value is None:
            self._warnings.warn(conversion.cause, f"no output: {conversion.reason}")

    def _publish_state(self):
        value, cause, reason = self._conversion
        self._states.publish(ConverterState(stamp=self._clocks.ros_now(), value=math.nan if value is None else value,
                                            cause=cause, reason=reason))

    def _report(self, status):
        """Report on /diagnostics whether commands are converted, and why not."""
        conversion = self._conversion
        if conversion is NO_COMMAND:
            status.summary(OK, conversion.reason)
        elif conversion.value is None:
            status.summary(WARN, f"no output: {conversion.reason}")
        else:
            status.summary(OK, "converting")
        status.add("age of odometry", age_text(self._converter.odometry.age_s(self._clocks.now_ns())))
        status.add("cause", conversion.cause)
        status.add("commands", self._counts["commands"])
        status.add("values sent", self._counts["values"])
        for kind, count in sorted(self._warnings.counts.items()):
            status.add(kind, count)


def _warn_of_clamped_values(config):
    """Warn of a map with values beyond the limits of the output."""
    value_map = config.value_map
    if value_map is not None and (value_map.values[0] < config.min_value or value_map.values[-1] > config.max_value):
        rospy.logwarn("%s has values from %g to %g; min_value and max_value clamp them to %g to %g", config.map_path,
                      value_map.values[0], value_map.values[-1], config.min_value, config.max_value)


def main():
    run("generic_value_converter", GenericValueConverter)
