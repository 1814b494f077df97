"""The generic_value_converter node: converts accelerations to an actuator's value, and optionally drives the ESC.

Subscribes:
    ~input/control_cmd (Control): its longitudinal.acceleration in m/s².
    ~input/odometry (nav_msgs/Odometry): its twist.twist.linear.x in m/s.
    With servo/channel set also /e_stop, /teleop_logi/human_in_loop (std_msgs/Bool) and turn_arb/state (SteeringState).
Publishes:
    ~output/value (Float64Stamped): one for each command that can be converted.
    With servo/channel set /servo/cmdVector (std_msgs/Int32MultiArray) at 50 Hz: the ESC's duty, all others −1; and
        servo/neutral (the same, latched): its neutral, for the servo board's timeout value.
    /diagnostics: whether commands are converted, and why not, and who else publishes on its topics; 1 Hz.
Parameters:
    ~csv_path_value_map: the absolute path of the map; required unless it isn't used.  ~allow_plateaus false.
    ~max_value 3.0, ~min_value −5.0: limits of the output.
    ~convert_value_cmd true, ~use_value_ff true: one of them false passes accelerations through.
    ~odometry_timeout 0.5 (s, 0 = never).
    ~servo/channel −1 (none), ~servo/value_axis, ~servo/duty_table, ~servo/neutral: the ESC.
    ~command_timeout 0.5, ~human_timeout 0.5, ~steering_timeout 0.25 (s, 0 = never): for the ESC.
    ~e_stop_timeout 1.0 (s, 0 = never), ~e_stop_required false, ~grant_at_start true: as turn_arb's, for the ESC.
    ~live_range 100 (duty): the largest change of servo/neutral while it runs.  ~save_to: the file to save it to.
Services, with servo/channel set: see ``ros.reconfigure``; set_parameters is below ~servo.
"""
from __future__ import annotations

import math
import time
from collections import Counter
from dataclasses import dataclass

import rospy
from nav_msgs.msg import Odometry
from std_msgs.msg import Int32MultiArray

from car_interface.cfg import EscNeutralConfig
from car_interface.common import causes
from car_interface.common.errors import ConfigError
from car_interface.common.live_parameters import Tuning, TuningSettings, read_tuning
from car_interface.common.rate_timer import RateTimer
from car_interface.common.servo_channels import CHANNELS, MAX_DUTY, one_channel
from car_interface.interlock.motion_interlock import read_interlock
from car_interface.msg import Control, Float64Stamped, SteeringState
from car_interface.ros.command_topics import CommandTopics
from car_interface.ros.diagnostics import OK, WARN, Diagnostics, age_text
from car_interface.ros.interlock_topics import subscribe_interlock
from car_interface.ros.reconfigure import ReconfigureServer
from car_interface.ros.runtime import run
from car_interface.ros.servo_messages import duty_vector
from car_interface.ros.throttled_warnings import ThrottledWarnings
from car_interface.ros.topics import advertise, subscribe
from car_interface.throttle.converter import ConversionConfig, Converter
from car_interface.throttle.esc_channel import Throttle, ThrottleConfig, duty_of_value, trimmed
from car_interface.throttle.value_map import ValueMap, load_value_map

RATE_HZ = 50
NO_CHANNEL = -1
LIVE_RANGE = 100  # duty, by default: 6 % of an ESC's range to each side
LIVE_RATE = 100  # duty per second
ODD_STAMP_S = 10.0  # a stamp this far from now is reported


@dataclass(frozen=True)
class ConverterConfig:
    """The node's configuration.

    Attributes:
        conversion: limits and timeout.
        map_path: the map's file; empty = accelerations pass through.
        value_map: the map; ``None`` = accelerations pass through.
        throttle: the ESC's channel and rules; ``None`` = no ESC.
        tuning: how far the ESC's neutral may be tuned while the car drives, and where it is saved.
    """

    conversion: ConversionConfig
    map_path: str
    value_map: ValueMap | None
    throttle: ThrottleConfig | None
    tuning: TuningSettings


def read_config(params) -> ConverterConfig:
    """Read the node's configuration, including the map, without other side effects.

    Raises:
        ConfigError: naming the parameter, or the place in the map's file.
    """
    tuning = read_tuning(params, LIVE_RANGE)
    conversion, map_path, value_map = _read_conversion(params)
    throttle = _read_throttle(params)
    params.finish()
    return ConverterConfig(conversion, map_path, value_map, throttle, tuning)


def _read_conversion(params):
    """Limits and timeout, the map's path, and the map; without one an empty path and ``None``."""
    converts = params.flag("convert_value_cmd", True)
    uses_map = params.flag("use_value_ff", True)
    path = params.path("csv_path_value_map", None)
    allow_plateaus = params.flag("allow_plateaus", False)
    conversion = ConversionConfig(min_value=params.number("min_value", -5.0), max_value=params.number("max_value", 3.0),
                                  odometry_timeout_s=params.timeout("odometry_timeout", 0.5))
    if not (converts and uses_map):
        return conversion, "", None
    if path is None:
        path = params.path("csv_path_value_map")
    value_map = load_value_map(path, allow_plateaus)
    try:
        Converter(conversion, value_map)  # checks the map against the limits
    except ConfigError as error:
        raise error.within(path) from error
    return conversion, path, value_map


def _read_throttle(params):
    """The ESC's channel and rules, or ``None``."""
    channel = params.integer("servo/channel", NO_CHANNEL, low=NO_CHANNEL, high=CHANNELS - 1)
    missing = {"default": []} if channel == NO_CHANNEL else {}
    settings = {
        "value_axis": params.numbers("servo/value_axis", **missing),
        "duty_table": params.numbers("servo/duty_table", low=0, high=MAX_DUTY, **missing),
        "neutral": params.integer("servo/neutral", low=0, high=MAX_DUTY, **({"default": 0} if missing else {})),
        "interlock": read_interlock(params),
        "steering_timeout_s": params.timeout("steering_timeout", 0.25),
        "command_timeout_s": params.timeout("command_timeout", 0.5),
    }
    if channel == NO_CHANNEL:
        return None
    config = ThrottleConfig(channel=channel, **settings)
    duty_of_value(config)  # checks the table
    return config


class GenericValueConverter:
    """Converts each command, and commands the ESC's channel."""

    def __init__(self, params, inbox):
        config = read_config(params)
        self._converter = Converter(config.conversion, config.value_map)
        self._throttle = None if config.throttle is None else Throttle(config.throttle, self._converter)
        _warn_of_clamped_values(config)
        self._inbox = inbox
        self._warnings = ThrottledWarnings()
        self._decision = None
        self._conversion = None
        self._counts: Counter = Counter()
        now_ns = time.monotonic_ns()
        self._timer = RateTimer(RATE_HZ, now_ns)
        self._ticks = 0
        self._command_topics = CommandTopics(inbox)
        self._diagnostics = Diagnostics(inbox, "none", {"converter": self._report, **self._command_topics.reports},
                                        now_ns)
        self._values = advertise("~output/value", Float64Stamped, inbox)
        if self._throttle is not None:
            self._commands = advertise("/servo/cmdVector", Int32MultiArray, inbox)
            subscribe_interlock(inbox, self._throttle)
            subscribe("turn_arb/state", SteeringState, inbox, self._on_steering)
            self._neutrals = advertise("servo/neutral", Int32MultiArray, inbox, latch=True)
            self._reconfigure = self._offer_tuning(config.tuning)
        inbox.on_overflow(self._on_overflow)
        rospy.loginfo("waiting for odometry on %s and commands on %s",
                      *(rospy.resolve_name(inbox.resolve_name(name))
                        for name in ("~input/odometry", "~input/control_cmd")))
        subscribe("~input/odometry", Odometry, inbox, self._on_odometry)
        subscribe("~input/control_cmd", Control, inbox, self._on_command)
        self._command_topics.start(self._diagnostics.report_now)

    def _offer_tuning(self, settings):
        """Have the ESC's neutral tuned while the car drives."""
        config = self._throttle.config
        tuning = Tuning({"neutral": config.neutral}, settings.max_offset, LIVE_RATE,
                        lambda values: trimmed(config, **values))

        def apply(values):
            self._throttle.calibrate(trimmed(config, **values))
            self._neutral = duty_vector(one_channel(config.channel, values["neutral"]))
            self._neutrals.publish(self._neutral)

        def parameters(values):
            return {"servo/neutral": values["neutral"],
                    "servo/duty_table": list(trimmed(config, **values).duty_table)}

        return ReconfigureServer(self._inbox, self._warnings, tuning, apply, parameters, EscNeutralConfig,
                                 settings.save_to, namespace="servo")

    def step(self, now_ns):
        """Handle each message and its effect on the ESC; then the timers."""
        for handler, message, arrival_ns in self._inbox.drain():
            handler(message, arrival_ns)
            self._stop_if_blocked(arrival_ns)
        self._diagnostics.step(now_ns)
        if self._throttle is None:
            return self._diagnostics.due_ns
        if self._timer.is_due(now_ns):
            self._reconfigure.step(now_ns)
            self._publish_throttle(self._throttle.decide(now_ns))
            self._ticks += 1
            if self._ticks % RATE_HZ == 0:  # a topic latches one message in a process, also for two nodes in it
                self._neutrals.publish(self._neutral)
        return min(self._timer.due_ns, self._diagnostics.due_ns)

    def shut_down(self):
        """Set the ESC to neutral; the servo board's timeout keeps it there."""
        if self._throttle is not None:
            self._throttle.update_human(False, time.monotonic_ns())
            self._publish_throttle(self._throttle.decide(time.monotonic_ns()))
            time.sleep(0.02)  # rospy sends in a thread of its own

    def _on_overflow(self, now_ns):
        self._converter.mark_stale()
        if self._throttle is not None:
            self._throttle.mark_stale(now_ns)

    def _on_odometry(self, message, now_ns):
        self._note_odd_stamp("odometry", message.header.stamp)
        velocity = message.twist.twist.linear.x
        self._converter.update_odometry(velocity, now_ns)
        if not math.isfinite(velocity):
            self._warnings.warn(causes.ODOMETRY_NOT_FINITE, f"the velocity in the odometry is {velocity}: no output")

    def _on_command(self, message, now_ns):
        self._note_odd_stamp("control_cmd", message.stamp)
        conversion = self._conversion = self._converter.convert(message.longitudinal.acceleration, now_ns)
        self._counts["commands"] += 1
        if self._throttle is not None:
            self._throttle.update_conversion(conversion, now_ns)
        if conversion.value is None:
            self._warnings.warn(conversion.cause, f"no output: {conversion.reason}")
            return
        self._counts["values"] += 1
        self._values.publish(Float64Stamped(stamp=rospy.Time.now(), data=conversion.value))

    def _on_steering(self, message, now_ns):
        self._throttle.update_steering(message.source, now_ns)

    def _note_odd_stamp(self, name, stamp):
        """Count an odd stamp. The message is used all the same: freshness is measured by arrival."""
        offset_s = (stamp - rospy.Time.now()).to_sec()
        if abs(offset_s) > ODD_STAMP_S:
            tense = "future" if offset_s > 0 else "past"
            text = "is zero" if stamp.is_zero() else f"is {abs(offset_s):.0f} s in the {tense}"
            self._warnings.warn(f"{name} stamp", f"the stamp of {name} {text}; it's obeyed all the same")

    def _stop_if_blocked(self, now_ns):
        """Publish neutral at once when an input demands it, before the next timer tick."""
        if self._throttle is not None and self._decision is not None and self._decision.driving:
            decision = self._throttle.decide(now_ns)
            if not decision.driving:
                self._publish_throttle(decision)

    def _report(self, status):
        """Whether commands are converted, and why not, for /diagnostics."""
        conversion = self._conversion
        if conversion is not None and conversion.value is None:
            status.summary(WARN, f"no output: {conversion.reason}")
        elif self._decision is not None:
            level = WARN if self._decision.cause in causes.STALE and conversion is not None else OK
            status.summary(level, f"ESC {'driven' if self._decision.driving else 'neutral'}: {self._decision.reason}")
        else:
            status.summary(OK, "waiting for the first command" if conversion is None else "converting")
        now_ns = time.monotonic_ns()
        status.add("age of odometry", age_text(self._converter.odometry_age_s(now_ns)))
        status.add("cause", self._cause())
        status.add("commands", self._counts["commands"])
        status.add("values sent", self._counts["values"])
        if self._decision is not None:
            status.add("duty of the ESC", self._decision.duty)
            status.add("tuned live", self._reconfigure.changes)
            for name, age_s in self._throttle.ages_s(now_ns).items():
                status.add(f"age of {name}", age_text(age_s))
        for kind, count in sorted(self._warnings.counts.items()):
            status.add(kind, count)
        return status

    def _cause(self):
        """Why there is no value, or the ESC's state; empty: neither is known yet."""
        if self._conversion is not None and self._conversion.value is None:
            return self._conversion.cause
        return "" if self._decision is None else self._decision.cause

    def _publish_throttle(self, decision):
        self._commands.publish(duty_vector(one_channel(self._throttle.config.channel, decision.duty)))
        before, self._decision = self._decision, decision
        if before is None or before.cause != decision.cause:
            rospy.loginfo("throttle %s: %s", "driving" if decision.driving else "neutral", decision.reason)


def _warn_of_clamped_values(config):
    """Warn of a map with values beyond the limits of the output."""
    limits, value_map = config.conversion, config.value_map
    if value_map is not None and (value_map.values[0] < limits.min_value or value_map.values[-1] > limits.max_value):
        rospy.logwarn("%s has values from %g to %g; min_value and max_value clamp them to %g to %g", config.map_path,
                      value_map.values[0], value_map.values[-1], limits.min_value, limits.max_value)


def main():
    """Run the node."""
    run("generic_value_converter", GenericValueConverter)
