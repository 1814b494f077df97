"""The turn_arb node: decides who steers, at 100 Hz and at once on a change.

Subscribes:
    /e_stop (std_msgs/Bool): true = locked: neutral, whoever requests what.
    phone/e_stop (std_msgs/Bool): the same by phone; either locks.
    /teleop_logi/human_in_loop (std_msgs/Bool): true while a human holds the deadman.
    /teleop_logi/tele_steer_req (std_msgs/Float32): −1 right .. +1 left.
    av_turnrad_req (std_msgs/Float32): turn radius in m, right negative; 0 or NaN = no request, ±inf = straight on.
    av_steer_req (std_msgs/Float32): −1 right .. +1 left, of a planner that knows no radius; not beside av_turnrad_req.
    ~input/odometry (nav_msgs/Odometry): its twist.twist.linear.x in m/s, for the limits and the understeer. Never
        received = neither; lost = the last one stays. The steering goes on. With twist.twist.angular.z in rad/s it also
        shows whether the car turns as commanded, once that was other than 0.
    teleop_logi/state (TeleopState): why human_in_loop is false, and whether the stick overrides the planner; quoted in
        the reason. Once it was heard, no planner steers before tele_steer_req was heard, too.
Publishes:
    /servo/cmdVector (std_msgs/Int32MultiArray): 16 duties, −1 except for the steering channel.
    ~state (SteeringState, latched): source, cause, duty, limits and ages; on every change and 20 times a second.
    servo/neutral (std_msgs/Int32MultiArray, latched, 1 Hz): the center, for the servo board's timeout value; −1
        elsewhere.
    /diagnostics: a summary of the same, whether the car turns as commanded, and who else publishes on its topics; 1 Hz.
Services: see ``ros.reconfigure``.
"""
from __future__ import annotations

import math

import rospy
from nav_msgs.msg import Odometry
from std_msgs.msg import Float32

from car_interface.cfg import SteeringTrimConfig
from car_interface.common import causes
from car_interface.common.declared import read_all
from car_interface.common.live_parameters import Tuning
from car_interface.common.publishers import find_unheard_planner
from car_interface.common.sources import LOCKED, SOURCE_NAMES
from car_interface.msg import SteeringState, TeleopState
from car_interface.nodes.command_node import TICKS_PER_STATE, CommandNode
from car_interface.ros.diagnostics import OK, WARN, age_text
from car_interface.ros.reconfigure import ReconfigureServer
from car_interface.ros.runtime import run
from car_interface.ros.topics import one_channel_duty, subscribe, subscribe_changes
from car_interface.steering.arbiter import SteeringArbiter
from car_interface.steering.calibration import trimmed
from car_interface.steering.config import TurnArbConfig
from car_interface.steering.limits import TOO_TIGHT_REMEDY
from car_interface.steering.monitor import SteeringCheck

RATE_HZ = 100
LIVE_RATE = 500  # duty per second, or slew_limit where that is less


class TurnArb(CommandNode):
    """Receive the inputs, decide, publish."""

    def __init__(self, params, inbox):
        config = read_all(params, TurnArbConfig)
        self._arbiter = SteeringArbiter(config.calibration, config.arbiter)
        self._decide_now = self._arbiter.decide
        self._check = SteeringCheck()
        self._has_yaw_rate = False  # odometry of a speed alone has 0, as of a car that always goes straight on
        self._too_tight = None  # as was logged; None: no request was too tight lately
        self._master_fault = ""
        super().__init__(inbox, RATE_HZ, config.calibration.servo_channel, self._arbiter, SteeringState,
                         {"steering": self._report, "steering by the wheels": self._report_check}, find_unheard_planner)
        subscribe_changes("/teleop_logi/tele_steer_req", Float32, inbox, self._on_teleop, self._decide)
        subscribe_changes("av_turnrad_req", Float32, inbox, self._on_planner, self._decide)
        subscribe_changes("av_steer_req", Float32, inbox, self._on_planner_steering, self._decide)
        subscribe("~input/odometry", Odometry, inbox, self._on_odometry, wakes=False)
        # No line that quotes it is due before the next tick.
        subscribe("teleop_logi/state", TeleopState, inbox, self._on_teleop_state, wakes=False)
        self._reconfigure = self._offer_tuning(config)
        self._command_topics.start(self._on_publishers, self._on_master)

    def shut_down(self):
        """Nothing to do: the servo board's timeout centers the steering."""

    def _on_publishers(self):
        self._arbiter.planner_explanation = "; ".join(fault.text for fault in self._command_topics.unheard)
        self._diagnostics.report_now()

    def _on_master(self, fault, now_ns):
        self._master_fault = fault
        if fault:
            self._warnings.warn("master", fault)

    def _mark_stale(self, now_ns):
        self._arbiter.mark_stale(now_ns)
        self._check.mark_stale()

    def _on_teleop(self, message, now_ns):
        self._arbiter.update_teleop(message.data, now_ns)
        self._check_request("teleop", "tele_steer_req", message.data, causes.TELEOP_NOT_FINITE,
                            "the steering is neutral while it lasts")

    def _on_planner(self, message, now_ns):
        self._arbiter.update_planner(message.data, now_ns)
        if math.isnan(message.data):
            self._warnings.warn(causes.PLANNER_NOT_FINITE, f"av_turnrad_req is {message.data}: taken for no request")

    def _on_planner_steering(self, message, now_ns):
        self._arbiter.update_planner_steering(message.data, now_ns)
        self._check_request("planner", "av_steer_req", message.data, causes.PLANNER_NOT_FINITE, "taken for no request")

    def _on_odometry(self, message, now_ns):
        speed_mps = message.twist.twist.linear.x
        yaw_rate_radps = message.twist.twist.angular.z
        self._has_yaw_rate = self._has_yaw_rate or abs(yaw_rate_radps) > 0
        if self._has_yaw_rate:
            self._check.update_motion(speed_mps, yaw_rate_radps, now_ns)
        age_ns = self._odometry_age.at_arrival_ns(message.header.stamp, now_ns)
        self._arbiter.limiter.speed.update(speed_mps, now_ns, age_ns)
        if not math.isfinite(speed_mps):
            self._warnings.warn(causes.ODOMETRY_NOT_FINITE,
                                f"the velocity in the odometry is {speed_mps}: the limits go by the last speed")

    def _on_teleop_state(self, message, now_ns):
        self._arbiter.explain_human(message.human_in_loop, message.reason, now_ns)
        self._arbiter.overrides = message.steering_stick == causes.OVERRIDE

    def _offer_tuning(self, config):
        """Have ends and center tuned while the car drives, relative to the calibration at start."""
        calibration, settings = config.calibration, config.tuning
        start = {name: getattr(calibration, name) for name in ("servo_left", "servo_center", "servo_right")}
        rate = min(config.arbiter.slew_limit or LIVE_RATE, LIVE_RATE)
        tuning = Tuning(start, settings.max_offset, rate, lambda values: trimmed(calibration, **values))

        def apply(values):
            self._arbiter.calibrate(trimmed(calibration, **values))
            self._neutral = one_channel_duty(self._channel, values["servo_center"])
            self._neutrals.publish(self._neutral)

        def parameters(values):
            scaled = trimmed(calibration, **values)
            return {**values, "k_pwmcmd_left_table_servo": list(scaled.left_duties),
                    "k_pwmcmd_right_table_servo": list(scaled.right_duties)}

        return ReconfigureServer(self._inbox, self._warnings, tuning, apply, parameters, SteeringTrimConfig,
                                 settings)

    def _tick(self, now_ns):
        super()._tick(now_ns)
        if self._timer.ticks % TICKS_PER_STATE == 0:
            self._log_too_tight(now_ns)

    def _log(self, before, decision):
        if before is None or before.kind[:2] != decision.kind[:2]:
            self._log_source(decision, self._decide_now(self._clocks.now_ns()), _is_alarming(decision))
        if not decision.limit or before is not None and before.limit == decision.limit:
            return
        if decision.limit == causes.LIMITS_OFF:
            rospy.loginfo("%s", decision.limit_reason)
        elif decision.limit != causes.TOO_TIGHT:
            self._notices.warn(decision.limit, decision.limit_reason)

    def _log_too_tight(self, now_ns):
        """Log requests that the wheels can't do once, however often the planner's swings are too tight in between."""
        before, self._too_tight = self._too_tight, self._arbiter.limiter.too_tight.fresh(now_ns)
        if self._too_tight and not before:
            self._warnings.warn(causes.TOO_TIGHT, f"the planner {self._too_tight}")

    def _report(self, status):
        """Report source, cause and ages on /diagnostics."""
        decision = self._arbiter.decide(self._clocks.now_ns())  # for its ages
        alarming = _is_alarming(decision)
        too_tight = self._arbiter.limiter.too_tight.fresh(self._clocks.now_ns())
        status.summary(WARN if alarming or too_tight else OK, f"{SOURCE_NAMES[decision.source]}: {decision.reason}"
                       + (f"; the planner {too_tight}" if too_tight else ""))
        status.add("cause", decision.cause)
        status.add("remedy", TOO_TIGHT_REMEDY if too_tight else "")
        status.add("duty", decision.duty)
        for name, age_s in (("e_stop", decision.e_stop_age_s), ("human_in_loop", decision.human_age_s),
                            ("tele_steer_req", decision.teleop_age_s), ("av_turnrad_req", decision.planner_age_s),
                            ("odometry", self._arbiter.limiter.speed.age_s(self._clocks.now_ns()))):
            status.add(f"age of {name}", age_text(age_s))
        status.add("limit", f"{decision.limit}: {decision.limit_reason}" if decision.limit else "none is reached")
        status.add("requests cut by a limit", self._arbiter.limiter.cuts)
        status.add("locked", decision.source == LOCKED)
        status.add("ROS master", self._master_fault or "there")
        status.add("tuned live", self._reconfigure.changes)
        for kind, count in sorted(self._warnings.counts.items()):
            status.add(f"warnings of {kind}", count)

    def _report_check(self, status):
        """Report on /diagnostics whether the car turns as commanded."""
        judgement = self._check.judge(self._clocks.now_ns())
        status.summary(WARN if judgement.warning else OK,
                       judgement.warning or "the car turns as it is told to, or stands")
        status.add("commanded turn radius", f"{judgement.commanded_m:.2f} m")
        status.add("estimated_turn_radius", f"{judgement.estimated_m:.2f} m")

    def _publish_state(self, decision):
        now_ns, radius_m = self._clocks.now_ns(), self._arbiter.turn_radius_m(decision.duty)
        self._check.update_command(radius_m, now_ns)
        self._states.publish(SteeringState(
            stamp=self._clocks.ros_now(), source=decision.source, cause=decision.cause, reason=decision.reason,
            duty=decision.duty, turn_radius=radius_m, odometry_age=self._arbiter.limiter.speed.age_s(now_ns),
            speed=self._arbiter.limiter.speed.last_mps,
            limit=decision.limit, limit_reason=decision.limit_reason, asked_radius=decision.asked_radius_m,
            max_speed=decision.max_speed_mps, cuts=self._arbiter.limiter.cuts,
            e_stop_age=decision.e_stop_age_s, human_age=decision.human_age_s, teleop_age=decision.teleop_age_s,
            planner_age=decision.planner_age_s, channel=self._channel))


def _is_alarming(decision):
    """Return whether somebody has to act: the car is locked, or an input failed."""
    return decision.source == LOCKED or decision.cause in causes.LOSSES or decision.cause == causes.TWO_REQUESTS


def main():
    run("turn_arb", TurnArb)
