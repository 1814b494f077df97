"""Gamepad and planner of a car that drives circles, and everything that a recording of it would subscribe to."""
from __future__ import annotations

import time

import rospy
from car_interface.msg import Control, SteeringState
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from sensor_msgs.msg import Joy
from std_msgs.msg import Bool, Float32

from .inputs import control, joy, publisher, twist

RADIUS_M = 3.0  # the turn is not limited below 3.4 m/s, by 4 m/s² sideways
TURN_S = 10  # for which the gamepad, then the planner steers
SONARS = ("front_right", "front_middle", "front_left", "rear_right", "rear_middle", "rear_left")
RECORDED = ("car_sim/truth", "turn_arb/state", "servo/output", "servo/cmdVector", "teensy_wheel", "teensy_distance",
            "teensy_pong", "teensy_clock", "teensy_error", "teensy_sensor_hub/link", "throttle_arb/state",
            "planner_interface/state", "teleop_logi/human_in_loop", "teleop_logi/tele_steer_req",
            "teleop_logi/tele_throt_req", "generic/output/value", *(f"sonar/{name}" for name in SONARS))


class Driver:
    """Holds the autonomous deadman and commands a circle at a speed; for the options see roles.py."""

    def __init__(self, speed_mps: float, alternates: bool = False, by_twist: bool = False):
        self._target_mps = speed_mps
        self._e_stop = publisher("e_stop", Bool) if alternates else None
        self._steers_s = 0.0  # when turn_arb last steered by gamepad or planner
        if alternates:
            rospy.Subscriber("turn_arb/state", SteeringState, self._on_steering)
        self._speed_mps = 0.0
        self._begun_s = time.monotonic()
        self._drives = False
        rospy.Subscriber("odom", Odometry, self._on_odometry)
        for topic in RECORDED:
            rospy.Subscriber(topic, rospy.AnyMsg, lambda message: None)
        self._joy = publisher("joy", Joy)
        self._twists = publisher("cmd_vel", Twist) if by_twist else None
        if not by_twist:
            self._radii = publisher("av_turnrad_req", Float32)
            self._commands = publisher("control/command/control_cmd", Control)

    def _on_odometry(self, message):
        self._speed_mps = message.twist.twist.linear.x

    def _on_steering(self, state):
        if state.source in (SteeringState.TELEOP, SteeringState.PLANNER):
            self._steers_s = time.monotonic()

    def publish(self) -> None:
        """Publish all inputs. Until the car drives the deadman is released and held every three seconds: topics connect
        in any order.
        """
        passed_s = time.monotonic() - self._begun_s
        must_rearm = not self._drives or self._e_stop and time.monotonic() - self._steers_s > 3
        held = int(not must_rearm or passed_s % 3 > 0.3)
        manual = held if self._e_stop and passed_s % (2 * TURN_S) > TURN_S else 0
        self._joy.publish(joy(held - manual, manual))
        if self._e_stop:
            self._e_stop.publish(False)
        if self._twists:
            self._twists.publish(twist(self._target_mps, RADIUS_M))
        else:
            self._radii.publish(RADIUS_M)
            self._commands.publish(control(max(-2.0, min(2.0, 1.5 * (self._target_mps - self._speed_mps)))))
        if not self._drives and self._speed_mps > 0.9 * self._target_mps:
            self._drives = True
            print("drives", flush=True)
