"""The throttle_arb node: decides who drives and what the ESC gets, at once on a change and within 40 ms anyhow.

Subscribes:
    /e_stop (std_msgs/Bool): true = locked: stop, whoever requests what.
    phone/e_stop (std_msgs/Bool): the same by phone; either locks.
    /teleop_logi/human_in_loop (std_msgs/Bool): true while a human holds the deadman.
    /teleop_logi/tele_throt_req (std_msgs/Float32): −1 full brake or reverse .. +1 full forward.
    /teleop_logi/mode (std_msgs/String): who steers and who drives; see ``common.causes``. Never received = a
        tele_throt_req beyond the dead band means the human.
    /teleop_logi/scale_button (std_msgs/Int8): 1 or −1 while the button for more or less speed by hand is pressed.
    ~input/value (Float64Stamped): the planner's, from generic_value_converter.
    ~input/odometry (nav_msgs/Odometry): its twist.twist.linear.x in m/s; the planner drives only while it is fresh.
    generic_value_converter/state (ConverterState): why there is no value.
    planner_interface/state (PlannerState): the planner's gear, the speed that it wants to keep, and why it has no
        request. Never received = drive.
    turn_arb/state (SteeringState): steering and throttle stop together.
    /servo/output (std_msgs/Int32MultiArray): what the servo board holds. Throttle is given only while that is what
        turn_arb commands for the steering; see ``throttle.board_watch``.
    sonar/front_right … sonar/rear_left (sensor_msgs/Range): only with ~obstacle_stop.
    teleop_logi/state (TeleopState): why human_in_loop is false; only quoted in the reason.
    battery_state (sensor_msgs/BatteryState): its voltage; see ``throttle.battery``.
Publishes:
    /servo/cmdVector (std_msgs/Int32MultiArray): 16 duties, −1 except for the ESC's channel.
    ~state (ThrottleState, latched): source, cause, request, limits, the ESC's state, duty, ages; on every change and 10
        times a second.
    servo/neutral (std_msgs/Int32MultiArray, latched, 1 Hz): the ESC's neutral, for the servo board's timeout value; −1
        elsewhere.
    /diagnostics: a summary of the same, the battery's voltage, and who else publishes on its topics; 1 Hz.
Services: see ``ros.reconfigure``; set_parameters is below ~servo.
"""
from __future__ import annotations

import math
from functools import partial

import rospy
from nav_msgs.msg import Odometry
from sensor_msgs.msg import BatteryState, Range
from std_msgs.msg import Float32, Int8, Int32MultiArray, String

from car_interface.cfg import EscNeutralConfig
from car_interface.common import causes
from car_interface.common.causes import MODES
from car_interface.common.declared import read_all
from car_interface.common.live_parameters import Tuning
from car_interface.common.measured_speed import MAX_SPEED_MPS
from car_interface.common.sources import LOCKED, source_name
from car_interface.common.units import CHANNELS
from car_interface.msg import ConverterState, Float64Stamped, PlannerState, SteeringState, TeleopState, ThrottleState
from car_interface.nodes.command_node import CommandNode
from car_interface.ros.diagnostics import ERROR, OK, WARN, age_text
from car_interface.ros.reconfigure import ReconfigureServer
from car_interface.ros.runtime import run
from car_interface.ros.topics import one_channel_duty, subscribe, subscribe_changes
from car_interface.throttle.battery import REPORT as BATTERY_REPORT
from car_interface.throttle.board_watch import Trouble
from car_interface.throttle.calibration import trimmed
from car_interface.throttle.config import ThrottleConfig
from car_interface.throttle.control import ThrottleControl
from car_interface.throttle.esc import ARMING, NO_BRAKE, PASSES

RATE_HZ = 50
LIVE_RATE = 100  # duty per second
# What the ESC's rules do that deserves a line in the log. The other causes change as often as the stick moves.
LOGGED = frozenset({causes.ESC_MOTION, causes.REVERSE_PENDING, causes.REVERSING, causes.REVERSE_REFUSED})


class ThrottleArb(CommandNode):
    """Receive the inputs, decide, publish."""

    # A planner's values change the duty as often as the timer ticks: both together would double every command.
    repeats_change = False

    def __init__(self, params, inbox):
        config = read_all(params, ThrottleConfig)
        self._control = ThrottleControl(config.calibration, config.arbiter, config.esc, config.limits,
                                        config.obstacles)
        self._arbiter, self._mark_stale = self._control.arbiter, self._control.mark_stale
        self._now_ns = inbox.clocks.now_ns()  # of the newest decision
        self._battery_cause = ""  # of the newest line in the log
        super().__init__(inbox, RATE_HZ, config.calibration.channel, self._arbiter, ThrottleState,
                         {"throttle": self._report, BATTERY_REPORT: self._report_battery})
        subscribe_changes("/teleop_logi/tele_throt_req", Float32, inbox, self._on_teleop, self._decide)
        subscribe_changes("/teleop_logi/mode", String, inbox, self._on_mode, self._decide)
        subscribe_changes("/teleop_logi/scale_button", Int8, inbox, self._on_scale_button, self._decide)
        subscribe_changes("~input/value", Float64Stamped, inbox, self._on_value, self._decide)
        subscribe_changes("turn_arb/state", SteeringState, inbox, self._on_steering, self._decide,
                          value_of=lambda state: (state.source, state.turn_radius, state.max_speed))
        # Without a change these have nothing that can't wait for the next tick.
        subscribe_changes("~input/odometry", Odometry, inbox, self._on_odometry, self._decide,
                          value_of=lambda odometry: math.isfinite(odometry.twist.twist.linear.x))
        subscribe_changes("generic_value_converter/state", ConverterState, inbox, self._on_converter, self._decide,
                          value_of=lambda state: state.cause)
        subscribe_changes("planner_interface/state", PlannerState, inbox, self._on_planner_state, self._decide,
                          value_of=lambda state: (state.cause, state.gear, state.speed != 0.0))
        subscribe("/servo/output", Int32MultiArray, inbox, self._on_output, wakes=False)
        # Only quoted: no line that quotes it is due before the next tick.
        subscribe("teleop_logi/state", TeleopState, inbox, self._on_teleop_state, wakes=False)
        subscribe("battery_state", BatteryState, inbox, self._on_battery, wakes=False)
        for sonar in config.obstacles.mounts if config.obstacles else ():
            subscribe(f"sonar/{sonar}", Range, inbox, partial(self._on_range, sonar))
        self._reconfigure = self._offer_tuning(config)
        self._command_topics.start(self._diagnostics.report_now)
        self._warn_of_calibration_drive()

    def shut_down(self):
        """Set the ESC to neutral; the servo board's timeout keeps it there."""
        self._commands.publish(self._neutral)

    def _on_teleop(self, message, now_ns):
        self._arbiter.update_teleop(message.data, now_ns)
        self._check_request("teleop", "tele_throt_req", message.data, causes.TELEOP_NOT_FINITE,
                            "the throttle is neutral while it lasts")

    def _on_mode(self, message, now_ns):
        self._arbiter.update_mode(message.data, now_ns)
        if message.data not in MODES:
            self._warnings.warn(causes.MODE_UNKNOWN, f"mode is {message.data!r}: the throttle is neutral while it "
                                                     f"lasts; accepted: {', '.join(MODES)}")

    def _on_scale_button(self, message, now_ns):
        if self._arbiter.scale.update(message.data):
            rospy.loginfo("driving by hand is scaled by %g", self._arbiter.scale.value)

    def _on_value(self, message, now_ns):
        self._control.update_planner(message.data, now_ns)
        if not math.isfinite(message.data):
            self._warnings.warn(causes.COMMAND_NOT_FINITE, f"the planner's value is {message.data}: it doesn't drive")

    def _on_odometry(self, message, now_ns):
        speed_mps = message.twist.twist.linear.x
        variance = message.twist.covariance[0]
        self._control.update_odometry(speed_mps, now_ns, self._odometry_age.at_arrival_ns(message.header.stamp, now_ns),
                                      math.sqrt(variance) if variance > 0 else 0.0)  # 0 for NaN, too
        if not abs(speed_mps) <= MAX_SPEED_MPS:  # also for NaN
            self._warnings.warn(causes.ODOMETRY_NOT_FINITE,
                                f"the velocity in the odometry is {speed_mps}: the planner doesn't drive")

    def _on_converter(self, message, now_ns):
        has_value = message.cause in (causes.CONVERTING, causes.NO_REQUEST)
        self._arbiter.update_converter(None if has_value else Trouble(message.cause, message.reason))

    def _on_planner_state(self, message, now_ns):
        no_request = None if message.cause == causes.PLANNER else Trouble(message.cause, message.reason)
        self._arbiter.update_planner_state(message.gear, no_request, now_ns, message.speed)

    def _on_steering(self, message, now_ns):
        self._arbiter.update_steering(message.source, message.reason, now_ns)
        if message.channel < CHANNELS:
            self._arbiter.update_steering_command(message.channel, message.duty, now_ns)
        else:
            self._warnings.warn("channel", f"turn_arb/state names channel {message.channel} of the servo board; "
                                           f"accepted: 0 to {CHANNELS - 1}")
        self._control.update_turn(message.turn_radius, message.max_speed)

    def _on_range(self, sonar, message, now_ns):
        self._control.update_range(sonar, message.range, now_ns)
        self._decide(now_ns)

    def _on_teleop_state(self, message, now_ns):
        self._arbiter.explain_human(message.human_in_loop, message.reason, now_ns)

    def _on_battery(self, message, now_ns):
        self._arbiter.battery.update(message.voltage, now_ns)

    def _on_output(self, message, now_ns):
        if len(message.data) == CHANNELS:
            self._control.update_output(message.data, now_ns)
        else:
            self._warnings.warn("length", f"/servo/output has {len(message.data)} values, not {CHANNELS}: ignored")

    def _decide_now(self, _):
        # Not when a message arrived: the ESC's rules go by when the board gets what they decide.
        self._now_ns = self._clocks.now_ns()
        return self._control.decide(self._now_ns)

    def _offer_tuning(self, config):
        """Have the ESC's neutral tuned while the car drives."""
        calibration, settings = config.calibration, config.tuning
        tuning = Tuning({"neutral": calibration.neutral}, settings.max_offset, LIVE_RATE,
                        lambda values: trimmed(calibration, **values))

        def apply(values):
            self._control.calibration = trimmed(calibration, **values)
            self._neutral = one_channel_duty(self._channel, values["neutral"])
            self._neutrals.publish(self._neutral)

        def parameters(values):
            return {"servo/neutral": values["neutral"],
                    "servo/duty_table": list(trimmed(calibration, **values).duty_table)}

        return ReconfigureServer(self._inbox, self._warnings, tuning, apply, parameters, EscNeutralConfig, settings,
                                 namespace="servo")

    def _log(self, before, decision):
        arbitration, esc = decision.arbitration, decision.esc
        if before is None or before.arbitration[:2] != arbitration[:2]:
            self._log_source(arbitration, self._arbiter.decide(self._now_ns), _is_alarming(decision))
        before_cause, before_state = (before.esc.cause, before.esc.state) if before else ("", None)
        if esc.cause != before_cause and esc.cause in LOGGED or esc.state == ARMING != before_state:
            log = rospy.logwarn if esc.cause in causes.LOSSES else rospy.loginfo
            log("ESC %s: %s", esc.state, esc.reason)
        elif before_state == ARMING != esc.state:
            rospy.loginfo("ESC armed, profile %s", self._control.esc_config.profile)
            self._warn_of_calibration_drive()
        elif esc.cause == causes.BRAKE_UNCERTAIN != before_cause:
            self._warnings.warn(esc.cause, f"{NO_BRAKE}: {esc.reason}")
        limited = decision.limited
        if not limited.cause or before is not None and before.limited.cause == limited.cause:
            return
        if limited.is_cut:
            self._notices.warn(limited.cause, limited.reason)
        else:
            rospy.loginfo("%s", limited.reason)

    def _warn_of_calibration_drive(self):
        if self._control.esc_config.calibration_drive:
            rospy.logwarn("%s; record it for calibrate_esc, and start without calibration_drive afterwards", PASSES)

    def _publish_state(self, decision):
        arbitration, esc = decision.arbitration, decision.esc
        ages_s = self._arbiter.ages_s(self._now_ns)
        self._states.publish(ThrottleState(
            stamp=self._clocks.ros_now(), source=arbitration.source, cause=arbitration.cause, reason=arbitration.reason,
            mode=decision.mode, human_scale=decision.scale, asked=arbitration.asked, granted=esc.fraction,
            esc=esc.state, esc_cause=esc.cause, esc_reason=esc.reason, profile=self._control.esc_config.profile,
            limit=decision.limited.cause, limit_reason=decision.limited.reason,
            max_speed=decision.limited.max_speed_mps, cuts=self._control.limiter.cuts,
            duty=decision.duty, speed=self._arbiter.speed_mps(self._now_ns), **{AGES[name]: age_s
                                                                                for name, age_s in ages_s.items()}))

    def _report(self, status):
        """Report on /diagnostics who drives, why, and what the ESC gets."""
        decision = self._decision  # there is one: the first tick is due at once, and goes before any report
        arbitration, esc = decision.arbitration, decision.esc
        is_calibration_drive = self._control.esc_config.calibration_drive
        text = f"{source_name(arbitration.source)}: {arbitration.reason}; ESC {esc.state}: {esc.reason}"
        status.summary(WARN if is_calibration_drive or _is_alarming(decision) else OK,
                       f"calibration drive; {text}" if is_calibration_drive else text)
        status.add("cause", arbitration.cause)
        status.add("cause of the ESC's state", esc.cause)
        status.add("duty", decision.duty)
        status.add("asked, granted", f"{arbitration.asked:.3f}, {esc.fraction:.3f}")
        limited = decision.limited
        status.add("limit", f"{limited.cause}: {limited.reason}" if limited.cause else "none is reached")
        status.add("requests cut by a limit", self._control.limiter.cuts)
        status.add("mode", decision.mode or "never heard")
        status.add("scale of driving by hand", f"{decision.scale:g}")
        status.add("profile of the ESC", self._control.esc_config.profile)
        for name, age_s in self._arbiter.ages_s(self._clocks.now_ns()).items():
            status.add(f"age of {name}", age_text(age_s))
        status.add("tuned live", self._reconfigure.changes)
        for kind, count in sorted(self._warnings.counts.items()):
            status.add(f"warnings of {kind}", count)

    def _report_battery(self, status):
        """Report on /diagnostics how the battery is, and log a change."""
        battery = self._arbiter.battery.status(self._clocks.now_ns())
        if battery.cause != self._battery_cause:
            log = rospy.logwarn if battery.cause else rospy.loginfo
            log("battery: %s", battery.text)
            self._battery_cause = battery.cause
        status.summary(ERROR if battery.cause == causes.BATTERY_EMPTY else WARN if battery.cause else OK, battery.text)
        status.add("cause", battery.cause)
        if battery.remedy:
            status.add("remedy", battery.remedy)


# Fields of ThrottleState for the ages by the inputs' names.
AGES = {"e_stop": "e_stop_age", "human_in_loop": "human_age", "turn_arb's state": "steering_age", "mode": "mode_age",
        "tele_throt_req": "teleop_age", "the planner's value": "planner_age", "odometry": "odometry_age",
        "/servo/output": "output_age"}


def _is_alarming(decision):
    """Return whether somebody has to act: locked, an input failed, or the car moved against the ESC's state."""
    arbitration = decision.arbitration
    return (arbitration.source == LOCKED or arbitration.cause in causes.LOSSES
            or arbitration.cause == causes.BOARD_NEVER_RECEIVED or decision.esc.cause in causes.LOSSES)


def main():
    run("throttle_arb", ThrottleArb)
