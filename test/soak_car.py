"""What the soak run publishes to the virtual car, and what it observes of it."""
from __future__ import annotations

import math
import threading
import time

import rospy
from car_interface.msg import Control, LinkStatus, SteeringState
from nav_msgs.msg import Odometry
from sensor_msgs.msg import Joy
from std_msgs.msg import Bool, Float32, Int32MultiArray

STEERING, ESC = 0, 1  # channels
NEUTRAL = {STEERING: 5104, ESC: 4912}  # on the chip: 319 and 307 counts
LEFT = 3824  # for the radius below
RADIUS_M, SPEED_MPS = 1.6, 1.0
PERIOD_S = 0.02
STOPPED_WITHIN_S = 1.0  # 0.25 s joy, 0.5 s human, and time for a busy machine
AUTONOMOUS_BUTTON = 5


class Inputs:
    """Gamepad, planner and emergency stop: publishes its attributes at 50 Hz; None = nothing is published."""

    def __init__(self):
        self.deadman: bool | None = True
        self.radius_m: float | None = RADIUS_M
        self.acceleration: float | None = 0.0  # added to that of the speed control
        self.e_stop: bool | None = False
        self.joy_axis = 0.0
        self.speed_mps = 0.0
        self.may_move_until_s = math.inf  # when the human's evidence ended
        self._joy = rospy.Publisher("joy", Joy, queue_size=10)
        self._radius = rospy.Publisher("av_turnrad_req", Float32, queue_size=10)
        self._command = rospy.Publisher("control/command/control_cmd", Control, queue_size=10)
        self._e_stop = rospy.Publisher("e_stop", Bool, queue_size=10)
        threading.Thread(target=self._run, daemon=True).start()

    def _run(self):
        try:
            self._publish_until_shutdown()
        except rospy.ROSException:
            pass  # shutdown

    def _publish_until_shutdown(self):
        while not rospy.is_shutdown():
            permits = bool(self.deadman) and self.e_stop is False and math.isfinite(self.joy_axis)
            self.may_move_until_s = math.inf if permits else min(self.may_move_until_s, time.monotonic())
            if self.deadman is not None:
                buttons = [0] * 11
                buttons[AUTONOMOUS_BUTTON] = int(self.deadman)
                self._joy.publish(Joy(axes=[self.joy_axis] * 8, buttons=buttons))
            if self.radius_m is not None:
                self._radius.publish(self.radius_m)
            if self.acceleration is not None:
                command = Control()
                command.stamp = rospy.Time.now()
                control = 1.5 * (SPEED_MPS - self.speed_mps)
                command.longitudinal.acceleration = self.acceleration + max(-2.0, min(2.0, control))
                self._command.publish(command)
            if self.e_stop is not None:
                self._e_stop.publish(self.e_stop)
            time.sleep(PERIOD_S)


class Observer:
    """The car's newest state, and each moment at which an output was off neutral that must not be."""

    def __init__(self, inputs):
        self._inputs = inputs
        self.output = self.state = self.link = None
        self.unsafe: list = []
        self.board_unreachable = False
        self.pose = None
        self.distance_m = 0.0
        rospy.Subscriber("/servo/output", Int32MultiArray, lambda message: setattr(self, "output", message.data))
        rospy.Subscriber("turn_arb/state", SteeringState, lambda message: setattr(self, "state", message))
        rospy.Subscriber("teensy_sensor_hub/link", LinkStatus, lambda message: setattr(self, "link", message))
        rospy.Subscriber("car_sim/truth", Odometry, self._on_truth)

    def _on_truth(self, message):
        position = message.pose.pose.position
        if self.pose is not None:
            self.distance_m += math.hypot(position.x - self.pose[0], position.y - self.pose[1])
        self.pose = (position.x, position.y)
        self._inputs.speed_mps = message.twist.twist.linear.x
        passed_s = time.monotonic() - self._inputs.may_move_until_s
        is_judged = self.output is not None and not self.board_unreachable and passed_s >= STOPPED_WITHIN_S
        if is_judged and not self.is_neutral():
            self.unsafe.append((passed_s, self.output[STEERING], self.output[ESC]))

    def is_neutral(self, *channels):
        """Whether these are at neutral; without an argument, whether nothing moves: each at neutral or off."""
        if channels:
            return all(self.output[channel] == NEUTRAL[channel] for channel in channels)
        return all(self.output[channel] in (neutral, 0, -1) for channel, neutral in NEUTRAL.items())

    def drives(self):
        return (self.state is not None and self.state.source == SteeringState.PLANNER
                and self.output[STEERING] == LEFT and abs(self._inputs.speed_mps) > 0.3)
