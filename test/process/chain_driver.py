#!/usr/bin/env python3
"""A node that plays whoever sends something to the car: gamepad, human, planner, odometry. It can be killed.

Its standard input takes lines: ``NAME VALUE`` publishes a value now and at 50 Hz from then on, ``NAME -`` lets the
name fall silent. For each first publication it prints ``NAME VALUE`` and the monotonic time just before, in ns, a
moment later: whoever reads it must not take a core from the nodes that are measured.
"""
from __future__ import annotations

import sys
import threading
import time

import rospy
from car_interface.msg import Control
from nav_msgs.msg import Odometry
from sensor_msgs.msg import Joy
from std_msgs.msg import Bool, Float32

from car_interface.ros.tcpros_limits import limit_connections
from car_interface.ros.topics import send_directly

PERIOD_S = 0.02
REACTION_S = 0.005  # within which the chip is written


def joy(value):
    """Both sticks with the manual deadman held, as config/teleop_logi.yaml has the F710; 0 = all let go."""
    axes, buttons = [0.0] * 6, [0] * 11
    axes[0] = axes[4] = float(value)
    buttons[4] = int(axes[0] != 0)
    return Joy(axes=axes, buttons=buttons)


def control(value):
    message = Control()
    message.stamp = rospy.Time.now()
    message.longitudinal.acceleration = float(value)
    return message


def odometry(value):
    message = Odometry()
    message.header.stamp = rospy.Time.now()
    message.twist.twist.linear.x = float(value)
    return message


KINDS = {
    "human": ("/teleop_logi/human_in_loop", Bool, lambda value: Bool(float(value) == 1)),
    "e_stop": ("/e_stop", Bool, lambda value: Bool(float(value) == 1)),
    "steering": ("/teleop_logi/tele_steer_req", Float32, lambda value: Float32(float(value))),
    "joy": ("/joy", Joy, joy),
    "acceleration": ("/control/command/control_cmd", Control, control),
    "odometry": ("/localization/kinematic_state", Odometry, odometry),
}


class Driver:

    def __init__(self, names):
        self._publishers = {name: rospy.Publisher(KINDS[name][0], KINDS[name][1], queue_size=10, tcp_nodelay=True)
                            for name in names}
        self._held: dict = {}
        self._lock = threading.Lock()
        threading.Thread(target=self._repeat, daemon=True).start()

    def obey(self, line):
        name, value = line.split()
        with self._lock:
            self._held.pop(name, None)
            if value != "-":
                self._held[name] = value
                sent_ns = time.monotonic_ns()
                self._publish(name, value)
                time.sleep(REACTION_S)
                print(name, value, sent_ns, flush=True)

    def _publish(self, name, value):
        self._publishers[name].publish(KINDS[name][2](value))

    def _repeat(self):
        while True:
            time.sleep(PERIOD_S)
            with self._lock:
                for name, value in self._held.items():
                    self._publish(name, value)


if __name__ == "__main__":
    send_directly()
    limit_connections()
    rospy.init_node(sys.argv[1], disable_signals=True)
    sys.setswitchinterval(0.0005)  # as the package's nodes: it's their time that is measured
    driver = Driver(sys.argv[2].split(","))
    print("ready", flush=True)
    for each_line in sys.stdin:
        driver.obey(each_line)
