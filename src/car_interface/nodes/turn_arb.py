"""The turn_arb node: who steers, at 100 Hz and at once whenever that changes.

Subscribes:
    /e_stop (std_msgs/Bool): true = locked: neutral, whoever asks for what.
    /teleop_logi/human_in_loop (std_msgs/Bool): true while a human holds the deadman.
    /teleop_logi/tele_steer_req (std_msgs/Float32): −1 right .. +1 left.
    av_turnrad_req (std_msgs/Float32): turn radius in m, right negative; 0 = no request.
Publishes:
    /servo/cmdVector (std_msgs/Int32MultiArray): 16 duties, −1 but for the steering channel.
    ~state (SteeringState, latched): who steers, why, with what duty; on every change and 10 times a second.
    /diagnostics: the same in short; 1 Hz.
Parameters (those of the original are also looked up in the namespaces around the node's):
    servo_left, servo_center, servo_right (duty 0..65535), servo_channel (0..15), m_turnrad_axis_servo (m),
    k_pwmcmd_left_table_servo, k_pwmcmd_right_table_servo (duties): all required.
    ~tele_steer_neutral 0.0, ~tele_steer_deadband 0.001.
    ~slew_limit 0 (duty per second, 0 = none): how fast gamepad and planner may move the servo.
    ~e_stop_timeout 1.0 (s, 0 = never): a lock that was heard once and is silent for longer is on.
    ~e_stop_required false: true = also one that was never heard.
    ~input_timeout 0.5 (s, 0 = never), and ~human_timeout, ~teleop_timeout, ~planner_timeout, which it sets.
"""
from __future__ import annotations

import math
import time

import rospy
from std_msgs.msg import Float32, Int32MultiArray

from car_interface.msg import SteeringState
from car_interface.nodes.diagnostics import OK, WARN, Diagnostics, age_text
from car_interface.nodes.master import MasterWatch
from car_interface.nodes.messages import duty_vector
from car_interface.nodes.node import Complaints, Heartbeat, run, subscribe_changes
from car_interface.nodes.permission import read_permission, subscribe_permission
from car_interface.servo import CHANNELS, MAX_DUTY, one_channel
from car_interface.steering import LOCKED, SOURCE_NAMES, SteeringArbiter, SteeringConfig

RATE_HZ = 100
FASTEST_SLEW = 1e9  # duty per second: from end to end within a heartbeat, many times over
BEATS_PER_STATE = 10
# What an owner wants to be warned of: something was there and failed.
ALARMING = ("human silent", "not re-armed", "teleop silent", "teleop not finite", "planner silent",
            "planner not finite")
# rospy sends by a thread of its own, which needs the interpreter: state and log wait until the command has left.
TELL_AFTER_NS = 500_000


def read_config(params) -> SteeringConfig:
    """The node's configuration from its parameters."""
    timeout_s = params.timeout("input_timeout", 0.5)
    config = SteeringConfig(
        servo_left=params.integer("servo_left", low=0, high=MAX_DUTY, outward=True),
        servo_center=params.integer("servo_center", low=0, high=MAX_DUTY, outward=True),
        servo_right=params.integer("servo_right", low=0, high=MAX_DUTY, outward=True),
        servo_channel=params.integer("servo_channel", low=0, high=CHANNELS - 1, outward=True),
        radius_axis_m=params.numbers("m_turnrad_axis_servo", outward=True),
        left_duties=params.numbers("k_pwmcmd_left_table_servo", low=0, high=MAX_DUTY, outward=True),
        right_duties=params.numbers("k_pwmcmd_right_table_servo", low=0, high=MAX_DUTY, outward=True),
        tele_steer_neutral=params.number("tele_steer_neutral", 0.0, low=-1, high=1),
        tele_steer_deadband=params.number("tele_steer_deadband", 0.001, low=0, high=1),
        slew_limit=params.number("slew_limit", 0.0, low=0, high=FASTEST_SLEW),
        permission=read_permission(params, timeout_s),
        teleop_timeout_s=params.timeout("teleop_timeout", timeout_s),
        planner_timeout_s=params.timeout("planner_timeout", timeout_s),
    )
    params.finish()
    return config


class TurnArb:
    """Hears the three inputs, decides, publishes."""

    def __init__(self, params, inbox):
        config = read_config(params)
        now_ns = time.monotonic_ns()
        self._arbiter = SteeringArbiter(config)
        self._channel = config.servo_channel
        self._inbox = inbox
        self._complaints = Complaints()
        self._heartbeat = Heartbeat(RATE_HZ, now_ns)
        self._beats = 0
        self._decision = None
        self._command = self._commanded_duty = None  # the message that goes out, and the duty in it
        self._untold = []  # decisions whose command is out, and whose state and log line are not
        self._tell_ns = 0
        self._commands = rospy.Publisher("/servo/cmdVector", Int32MultiArray, queue_size=10)
        self._states = rospy.Publisher("~state", SteeringState, queue_size=10, latch=True)
        self._diagnostics = Diagnostics("none", {"steering": self._report}, now_ns)
        self._master_trouble = ""
        MasterWatch(lambda trouble: inbox.put(self._on_master, trouble))
        subscribe_permission(inbox, self._arbiter)
        subscribe_changes("/teleop_logi/tele_steer_req", Float32, inbox, self._on_teleop)
        subscribe_changes("av_turnrad_req", Float32, inbox, self._on_planner)

    def step(self, now_ns):
        """Take what arrived, each with its consequence; then beat if it is time."""
        for handler, message, arrival_ns in self._inbox.take():
            handler(message, arrival_ns)
            self._decide(arrival_ns)
        if self._heartbeat.is_due(now_ns):
            self._beat(now_ns)
        elif self._untold and now_ns >= self._tell_ns:
            self._tell()
        self._diagnostics.step(now_ns)
        return min(self._heartbeat.due_ns, self._tell_ns) if self._untold else self._heartbeat.due_ns

    def shut_down(self):
        """Nothing to undo: the servo board's own timeout takes over from here."""

    def _on_master(self, trouble, now_ns):
        self._master_trouble = trouble
        if trouble:
            self._complaints.warn("master", trouble)

    def _on_teleop(self, message, now_ns):
        self._arbiter.hear_teleop(message.data, now_ns)
        if not math.isfinite(message.data):
            self._complaints.warn("teleop not finite",
                                  f"tele_steer_req is {message.data}: the steering is neutral while it lasts")
        elif abs(message.data) > 1:
            self._complaints.warn("teleop clamped", f"tele_steer_req is {message.data:.3f}: clamped to -1..1")

    def _on_planner(self, message, now_ns):
        self._arbiter.hear_planner(message.data, now_ns)
        if not math.isfinite(message.data):
            self._complaints.warn("planner not finite", f"av_turnrad_req is {message.data}: taken for no request")

    def _decide(self, now_ns):
        """Publish at once when the decision is another; whether it was."""
        decision = self._arbiter.decide(now_ns)
        if not decision.differs_from(self._decision):
            return False
        self._untold.append((self._decision, decision))
        self._tell_ns = now_ns + TELL_AFTER_NS
        self._decision = decision
        self._publish_command(decision)
        return True

    def _beat(self, now_ns):
        self._beats += 1
        if not self._decide(now_ns):
            self._publish_command(self._decision)
        if self._beats % BEATS_PER_STATE == 0:
            self._tell()
            self._publish_state(self._arbiter.decide(now_ns))

    def _tell(self):
        """Publish and log what was decided, now that the commands are on their way."""
        for before, decision in self._untold:
            self._publish_state(decision)
            if before is None or (before.source, before.cause) != (decision.source, decision.cause):
                log = rospy.logwarn if decision.cause in ALARMING or decision.source == LOCKED else rospy.loginfo
                log("%s: %s", SOURCE_NAMES[decision.source], decision.reason)
        self._untold.clear()

    def _report(self, status):
        """Who drives and why, on /diagnostics."""
        decision = self._arbiter.decide(time.monotonic_ns())  # for its ages
        alarming = decision.source == LOCKED or decision.cause in ALARMING
        status.summary(WARN if alarming else OK, f"{SOURCE_NAMES[decision.source]}: {decision.reason}")
        status.add("duty", decision.duty)
        for name, age_s in (("e_stop", decision.e_stop_age_s), ("human_in_loop", decision.human_age_s),
                            ("tele_steer_req", decision.teleop_age_s), ("av_turnrad_req", decision.planner_age_s)):
            status.add(f"age of {name}", age_text(age_s))
        status.add("locked", decision.source == LOCKED)
        status.add("ROS master", self._master_trouble or "there")
        for kind, count in sorted(self._complaints.counts.items()):
            status.add(f"warnings of {kind}", count)
        return status

    def _publish_command(self, decision):
        if decision.duty != self._commanded_duty:
            self._commanded_duty = decision.duty
            self._command = duty_vector(one_channel(self._channel, decision.duty))
        self._commands.publish(self._command)

    def _publish_state(self, decision):
        self._states.publish(SteeringState(
            stamp=rospy.Time.now(), source=decision.source, reason=decision.reason, duty=decision.duty,
            turn_radius=self._arbiter.turn_radius_m(decision.duty),
            e_stop_age=decision.e_stop_age_s, human_age=decision.human_age_s, teleop_age=decision.teleop_age_s,
            planner_age=decision.planner_age_s))


def main():
    """Run the node."""
    run("turn_arb", TurnArb)
