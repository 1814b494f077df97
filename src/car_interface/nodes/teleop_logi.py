"""The teleop_logi node: a gamepad as steering and throttle requests, and as evidence of a human.

Subscribes:
    joy (sensor_msgs/Joy).
Publishes, at 50 Hz and at once when the deadman changes:
    /teleop_logi/human_in_loop (std_msgs/Bool): true while a deadman button is held and the gamepad is heard; a button
        that is held at the start counts from when all were let go.
    /teleop_logi/tele_steer_req (std_msgs/Float32): −1 right .. +1 left; neutral under the autonomous deadman, and never
        quite so under the manual one, or with the stick at rest the planner would steer.
    /teleop_logi/tele_throt_req (std_msgs/Float32): −1 .. +1; 0 under the autonomous deadman.
Parameters:
    ~steer_axis, ~throttle_axis, ~manual_button, ~autonomous_button: indices into the Joy message; required.
    ~steer_scale 1.0, ~throttle_scale 1.0: −1 turns an axis round.
    ~steer_neutral 0.0, ~steer_deadband 0.001: the request that means "not steering", and how near to it another one
        means the same: turn_arb's tele_steer_neutral and tele_steer_deadband.
    ~joy_timeout 0.25 (s): silence longer than this releases the deadman.
"""
from __future__ import annotations

import time

import rospy
from sensor_msgs.msg import Joy
from std_msgs.msg import Bool, Float32

from car_interface.common.rate_timer import RateTimer
from car_interface.ros.runtime import run
from car_interface.ros.topics import subscribe
from car_interface.teleop.gamepad import Gamepad, GamepadConfig

RATE_HZ = 50
MAX_AXES = 64


def read_config(params) -> GamepadConfig:
    """The node's configuration from its parameters."""
    config = GamepadConfig(
        steer_axis=params.integer("steer_axis", low=0, high=MAX_AXES - 1),
        throttle_axis=params.integer("throttle_axis", low=0, high=MAX_AXES - 1),
        manual_button=params.integer("manual_button", low=0, high=MAX_AXES - 1),
        autonomous_button=params.integer("autonomous_button", low=0, high=MAX_AXES - 1),
        steer_scale=params.number("steer_scale", 1.0, low=-1, high=1),
        throttle_scale=params.number("throttle_scale", 1.0, low=-1, high=1),
        steer_neutral=params.number("steer_neutral", 0.0, low=-1, high=1),
        steer_deadband=params.number("steer_deadband", 0.001, low=0.0, high=0.4),
        joy_timeout_s=params.timeout("joy_timeout", 0.25),
    )
    params.finish()
    return config


class TeleopLogi:
    """Reads the gamepad, publishes requests."""

    def __init__(self, params, inbox):
        self._gamepad = Gamepad(read_config(params))
        self._inbox = inbox
        self._published = None
        self._timer = RateTimer(RATE_HZ, time.monotonic_ns())
        self._human = rospy.Publisher("/teleop_logi/human_in_loop", Bool, queue_size=10)
        self._steering = rospy.Publisher("/teleop_logi/tele_steer_req", Float32, queue_size=10)
        self._throttle = rospy.Publisher("/teleop_logi/tele_throt_req", Float32, queue_size=10)
        inbox.on_overflow(lambda now_ns: self._gamepad.mark_stale())
        subscribe("joy", Joy, inbox, self._on_joy)

    def step(self, now_ns):
        """Take each message with its consequence; then publish if it is time."""
        for handler, message, arrival_ns in self._inbox.drain():
            handler(message, arrival_ns)
            self._publish_if_deadman_changed(arrival_ns)
        if self._timer.is_due(now_ns):
            self._publish(self._gamepad.requests(now_ns))
        return self._timer.due_ns

    def shut_down(self):
        """Let go."""
        self._human.publish(False)
        time.sleep(0.02)  # it leaves by a thread of rospy's

    def _on_joy(self, message, now_ns):
        self._gamepad.update(message.axes, message.buttons, now_ns)

    def _publish_if_deadman_changed(self, now_ns):
        requests = self._gamepad.requests(now_ns)
        if self._published is None or requests.human_in_loop != self._published.human_in_loop:
            self._publish(requests)

    def _publish(self, requests):
        before, self._published = self._published, requests
        # Letting go comes first; what the human wants comes before his evidence, or the planner would steer in between.
        if not requests.human_in_loop:
            self._human.publish(False)
        self._steering.publish(requests.steering)
        self._throttle.publish(requests.throttle)
        if requests.human_in_loop:
            self._human.publish(True)
        if before is None or (before.human_in_loop, before.must_let_go) != (requests.human_in_loop,
                                                                            requests.must_let_go):
            log = rospy.logwarn if requests.must_let_go else rospy.loginfo
            log("human in loop: %s (%s)", requests.human_in_loop, requests.reason)


def main():
    """Run the node."""
    run("teleop_logi", TeleopLogi)
