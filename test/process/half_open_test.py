#!/usr/bin/env python3
"""A node that restarts is back within 5 s, with 200 silent connections on each node that it hears, or ever new ones."""
from __future__ import annotations

import math
import os
import signal
import time
import unittest
import xmlrpc.client

import rosgraph
import rospy
import rostest
from car_interface.msg import SteeringState
from sensor_msgs.msg import Joy
from std_msgs.msg import Int32MultiArray

from car_interface.common import causes
from waiting import Repeater, Sender, Topic, eventually, retried, start
from witness import measured

PEERS = os.path.join(os.path.dirname(os.path.abspath(__file__)), "half_open_peers.py")
COUNT = 200
WITHIN_S = 5.0  # from the kill; of them 1 s is roslaunch's respawn_delay
MANUAL_BUTTON = 4  # as config/teleop_logi.yaml has it
JUST_STARTED = causes.STARTING, causes.NOT_REARMED  # while the deadman is held
LEFT = 238 * 16  # 3800 in counts
# A topic of each node that others listen to.
PUBLISHED = {"/turn_arb": "/turn_arb/state", "/throttle_arb": "/throttle_arb/state",
             "/teleop_logi": "/teleop_logi/human_in_loop"}


def ask(node, method, *arguments):
    """What a node answers; ``None`` without the node."""
    try:
        uri = rosgraph.Master("/test").lookupNode(node)
        return getattr(xmlrpc.client.ServerProxy(uri), method)("/test", *arguments)[2]
    except (rosgraph.MasterException, OSError):
        return None


def tcpros_port(node, topic):
    return (ask(node, "requestTopic", topic, [["TCPROS"]]) or [None, None, None])[2]


def joy(held):
    """The stick to the left with the manual deadman, or all let go."""
    return Joy(axes=[float(held)] + [0.0] * 7, buttons=[int(held and index == MANUAL_BUTTON) for index in range(11)])


class HalfOpenConnections(unittest.TestCase):
    def setUp(self):
        self.joy = Sender("/joy", Joy)
        self.output = Topic("/servo/output", Int32MultiArray)
        self.states = Topic("/turn_arb/state", SteeringState).connected()
        self.inputs = Repeater(0.02)
        for end in (self.joy.close, self.output.close, self.states.close, self.inputs.end):
            self.addCleanup(end)
        eventually(lambda: all(tcpros_port(*each) for each in PUBLISHED.items()), "all nodes")
        retried(self.drive)

    def drive(self):
        """Let go, hold, and see the servo at the left."""
        self.inputs.hold(self.joy, joy(False))
        self.states.wait_for(lambda state: state.cause == causes.HUMAN_ABSENT, self.states.mark(), 5.0)
        self.inputs.hold(self.joy, joy(True))
        self.wait_for_left(5.0)

    def wait_for_left(self, within_s):
        self.output.wait_for(lambda message: message.data[0] == LEFT, self.output.mark(), within_s)

    def open_half(self, mode):
        """Connections on which nothing is sent, to each node."""
        ports = [str(eventually(lambda each=each: tcpros_port(*each), each[0])) for each in PUBLISHED.items()]
        peers = start(self, PEERS, *ports, str(COUNT), mode)
        peers.stdout.wait_for(lambda line: line == "open")
        return peers

    def kill(self, node):
        """Kill it; roslaunch starts another one."""
        pid = eventually(lambda: ask(node, "getPid"), node)
        mark = self.output.mark()
        os.kill(pid, signal.SIGKILL)
        return mark, time.monotonic()

    def restart_of_the_board(self, mode):
        def attempt():
            peers = self.open_half(mode)
            mark, killed_s = self.kill("/pca9685")
            # The guard of the dead node has brought the center meanwhile.
            self.output.wait_for(lambda message: message.data[0] != LEFT, mark)
            back = self.output.wait_for(lambda message: message.data[0] == LEFT, self.output.mark())
            peers.clean_up()
            print(f"{mode}: pca9685 is back after {back.at_s - killed_s:.2f} s", flush=True)
            self.assertLess(back.at_s - killed_s, WITHIN_S)
        measured(attempt, lambda: retried(self.drive))

    def test_board_comes_back_with_silent_connections_on_the_others(self):
        self.restart_of_the_board("hold")

    def test_board_comes_back_while_they_are_opened_again_and_again(self):
        self.restart_of_the_board("reopen")

    def test_arbiter_comes_back_to_its_publishers_and_its_subscribers(self):
        def attempt():
            peers = self.open_half("reopen")
            _, killed_s = self.kill("/turn_arb")
            mark = self.states.mark()
            self.states.wait_for(lambda state: state.cause in JUST_STARTED and math.isfinite(state.human_age), mark)
            heard_s = time.monotonic()
            print(f"turn_arb hears teleop_logi after {heard_s - killed_s:.2f} s", flush=True)
            self.assertLess(heard_s - killed_s, WITHIN_S)
            retried(self.drive)  # by letting go: it has just started. pca9685 hears it
            peers.clean_up()
        measured(attempt, lambda: retried(self.drive))


if __name__ == "__main__":
    rospy.init_node("half_open_test")
    rostest.rosrun("car_interface", "half_open_test", "__main__")
