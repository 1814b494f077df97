#!/usr/bin/env python3
"""A node that stood still: nothing that was sent meanwhile is obeyed, and its inputs have to be granted anew."""
from __future__ import annotations

import os
import shutil
import signal
import tempfile
import time
import unittest

import rospy
import rostest
from car_interface.msg import Control, SteeringState
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from nav_msgs.msg import Odometry
from std_msgs.msg import Bool, Float32, Int32MultiArray

from car_interface.common.causes import INHIBITS
from waiting import (
    NodeProcess,
    Repeater,
    Sender,
    Topic,
    config,
    eventually,
    executable,
    one_process_params,
    retried,
    set_params,
)

CENTER, ESC_NEUTRAL = 5100, 4915
FROZEN_S = 3.0
LATE_S = 0.25  # as a busy computer makes a step late
# Sent while the node is frozen: the deadman is released and held again, and released in the end.
MEANWHILE = (False, False, False, True, True, True, False)
STOOD_STILL = (r"WARN.*node stood still for \d\.\d\d s: what was sent meanwhile is dropped; what is sent from now on "
               "counts")
NOT_REARMED = "messages were dropped; let go once: publish false, then true"


class StandstillTest(unittest.TestCase):
    def setUp(self):
        self.folder = tempfile.mkdtemp()
        self.addCleanup(shutil.rmtree, self.folder, ignore_errors=True)
        self.repeater = Repeater(0.02)
        self.addCleanup(self.repeater.end)
        self.commands = self.topic("/servo/cmdVector", Int32MultiArray)
        self.states = self.topic("/turn_arb/state", SteeringState)
        self.senders = {}

    def topic(self, name, message_type):
        topic = Topic(name, message_type)
        self.addCleanup(topic.close)
        return topic

    def start(self, node, *arguments):
        process = NodeProcess(executable(node), *arguments)
        self.addCleanup(process.clean_up)
        return process

    def hold(self, topic, message):
        """Publish over and over."""
        if topic not in self.senders:
            self.senders[topic] = Sender(topic, type(message))
            self.addCleanup(self.senders[topic].close)
            self.addCleanup(self.repeater.drop, self.senders[topic])
        self.repeater.hold(self.senders[topic], message)

    def human(self, *held):
        """Send each of these once, and stop sending."""
        sender = self.senders["/teleop_logi/human_in_loop"]
        self.repeater.drop(sender)
        for each in held:
            sender.publish(Bool(each))

    def duties(self, channel, since):
        return {duty for duty in (command.data[channel] for command in self.commands.since(since)) if duty != -1}

    def arm(self, channels=(0,)):
        """Let go and hold again, until the car drives."""
        def attempt():
            self.hold("/teleop_logi/human_in_loop", Bool(False))
            self.states.wait_for(lambda state: "human_in_loop is false" in state.reason, self.states.mark())
            mark = self.commands.mark()
            self.hold("/teleop_logi/human_in_loop", Bool(True))
            for channel, rest in ((0, CENTER), (1, ESC_NEUTRAL)):
                if channel in channels:
                    eventually(lambda channel=channel, rest=rest: self.duties(channel, mark) - {rest}, "it drives", 3.0)
        retried(attempt)

    def start_turn_arb(self, **changes):
        set_params(self, "/turn_arb", {**config("turn_arb.yaml"), **changes})
        process = self.start("turn_arb")
        self.hold("/av_turnrad_req", Float32(2.0))
        return process

    def freeze(self, process, seconds=FROZEN_S, meanwhile=MEANWHILE):
        """Freeze a process; in the middle of it the human does something. Where the commands stood when it went on."""
        process.send(signal.SIGSTOP)
        frozen_s = time.monotonic()
        eventually(lambda: time.monotonic() - frozen_s > seconds / 2, "half of it")
        if meanwhile:
            self.human(*meanwhile)
        eventually(lambda: time.monotonic() - frozen_s > seconds, "all of it")
        mark = self.commands.mark()
        process.send(signal.SIGCONT)
        return mark

    def check_nothing_old_is_obeyed(self, mark, state_mark, channels=(0,)):
        began_s = time.monotonic()
        eventually(lambda: time.monotonic() - began_s > 1.0, "a second")
        since = self.states.since(state_mark)
        since = since[next(index for index, state in enumerate(since) if state.cause in INHIBITS):]
        self.assertLessEqual({state.cause for state in since}, INHIBITS)
        self.assertEqual(self.duties(0, mark), {CENTER})
        if 1 in channels:
            self.assertEqual(self.duties(1, mark), {ESC_NEUTRAL})


class TurnArb(StandstillTest):
    def test_frozen_for_3_s_obeys_nothing_that_was_sent_meanwhile(self):
        process = self.start_turn_arb()
        self.hold("/e_stop", Bool(False))  # also while it is frozen: it is known at once when the node goes on
        self.arm()
        reports = self.topic("/diagnostics", DiagnosticArray)
        state_mark = self.states.mark()
        mark = self.freeze(process)
        self.check_nothing_old_is_obeyed(mark, state_mark)
        process.wait_for_line(STOOD_STILL)
        reasons = {state.reason for state in self.states.since(state_mark)}
        self.assertTrue(any("messages were dropped" in reason for reason in reasons), reasons)
        reports.wait_for(lambda array: any(
            status.name == "turn_arb: steering" and status.level >= DiagnosticStatus.WARN
            and "node stood still for" in status.message for status in array.status))
        self.arm()
        self.assertEqual(process.end(), 0)

    def test_deadman_that_is_held_all_the_time_has_to_be_let_go_after_it(self):
        process = self.start_turn_arb()
        self.arm()
        mark = self.freeze(process, meanwhile=())
        self.states.wait_for(lambda state: state.reason == NOT_REARMED, self.states.mark())
        self.assertEqual(self.duties(0, mark), {CENTER})
        self.arm()

    def test_delays_of_a_busy_computer_change_nothing(self):
        process = self.start_turn_arb()
        self.arm()

        def attempt():
            self.arm()
            errors = process.stderr.mark()
            for _ in range(5):
                mark = self.freeze(process, LATE_S, meanwhile=())
                eventually(lambda mark=mark: self.commands.mark() - mark > 20, "commands")
                self.assertNotIn(CENTER, self.duties(0, mark))
            self.assertEqual(process.stderr.since(errors), [])
        retried(attempt)

    def test_e_stop_that_is_latched_and_sent_once_still_counts_afterwards(self):
        e_stop = rospy.Publisher("/e_stop", Bool, queue_size=1, latch=True)
        self.addCleanup(e_stop.unregister)
        e_stop.publish(Bool(False))
        process = self.start_turn_arb(e_stop_timeout=0)
        self.arm()
        self.freeze(process)
        process.wait_for_line(STOOD_STILL)
        self.arm()
        mark = self.commands.mark()
        e_stop.publish(Bool(True))
        self.commands.wait_for(lambda command: command.data[0] == CENTER, mark)


class OneProcess(StandstillTest):
    """car_nodes, whose parts share connections."""

    def test_frozen_for_3_s_obeys_nothing_that_was_sent_meanwhile(self):
        values = {**one_process_params(self.folder, virtual_chip=os.path.join(self.folder, "chip")),
                  "car_nodes": {"throttle": True}}
        for part, parameters in values.items():
            set_params(self, f"/{part}", parameters)
        process = self.start("car_nodes", "generic_value_converter/input/control_cmd:=control_cmd",
                             "generic_value_converter/input/odometry:=odometry",
                             "throttle_arb/input/value:=generic_value_converter/output/value",
                             "throttle_arb/input/odometry:=odometry")
        process.wait_for_info("running at")
        self.hold("/av_turnrad_req", Float32(2.0))
        command, odometry = Control(), Odometry()
        command.longitudinal.acceleration = odometry.twist.twist.linear.x = 1.0
        self.hold("/control_cmd", command)
        self.hold("/odometry", odometry)
        self.hold("/e_stop", Bool(False))
        self.arm((0, 1))
        state_mark = self.states.mark()
        mark = self.freeze(process)
        self.check_nothing_old_is_obeyed(mark, state_mark, (0, 1))
        for part in ("turn_arb", "generic_value_converter", "throttle_arb", "pca9685"):
            process.wait_for_line(f"WARN.*{part}: node stood still")
        self.arm((0, 1))
        self.assertEqual(process.end(), 0)


if __name__ == "__main__":
    rospy.init_node("standstill_test")
    rostest.rosrun("car_interface", "standstill_test", "__main__")
