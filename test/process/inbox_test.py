#!/usr/bin/env python3
"""What waits for a node's thread, and what becomes of the node when that is too much: all that was heard is lost."""
from __future__ import annotations

import os
import sys
import threading
import time
import unittest
from unittest import mock

import rospy
import rostest
from car_interface.msg import Float64Stamped, SteeringState
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from dynamic_reconfigure.msg import Config, IntParameter
from dynamic_reconfigure.srv import Reconfigure
from nav_msgs.msg import Odometry
from sensor_msgs.msg import Joy
from std_msgs.msg import Bool, Float32, Int32MultiArray

from car_interface.common.params import Params
from car_interface.nodes.pca9685 import Pca9685
from car_interface.nodes.teensy_sensor_hub import TeensySensorHub
from car_interface.nodes.teleop_logi import TeleopLogi
from car_interface.nodes.throttle_arb import ThrottleArb
from car_interface.nodes.turn_arb import TurnArb
from car_interface.ros.inbox import Inbox
from waiting import Repeater, Sender, Topic, config, eventually, set_params, start

HANGING = os.path.join(os.path.dirname(os.path.abspath(__file__)), "hanging_node.py")
LEFT, CENTER = 3800, 5100
ESC_NEUTRAL, ESC_FULL = 4915, 6554
LIMIT = 20  # of the inboxes in here


class AnInbox(unittest.TestCase):
    def setUp(self):
        self.inbox = Inbox(limit=5)
        self.taken = []
        self.inbox.on_overflow(lambda now_ns: self.taken.append("overflow"))

    def put(self, *items):
        for item in items:
            self.inbox.put(lambda item, now_ns: self.taken.append(item), item)

    def take(self):
        """What a node's thread does."""
        for handler, item, arrival_ns in self.inbox.drain():
            handler(item, arrival_ns)
        return self.taken

    def test_that_is_full_has_lost_nothing(self):
        self.put(*range(5))
        self.assertEqual(self.take(), [0, 1, 2, 3, 4])
        self.assertEqual(self.inbox.dropped, 0)
        self.assertFalse(self.inbox.overflowed_recently(time.monotonic_ns()))

    def test_that_overflows_drops_all_that_waits_says_so_and_goes_on_with_what_is_newer(self):
        self.put(*range(7))
        self.assertEqual(self.take(), ["overflow", 5, 6])
        self.assertEqual(self.inbox.dropped, 5)
        self.assertTrue(self.inbox.overflowed_recently(time.monotonic_ns()))
        self.put("more")
        self.assertEqual(self.take()[3:], ["more"])

    def test_that_overflows_again_and_again_counts_each_item_once_and_says_so_once(self):
        self.put(*range(100))
        taken = self.take()
        self.assertEqual(taken, ["overflow", *range(100 - len(taken) + 1, 100)])
        self.assertEqual(self.inbox.dropped, 100 - len(taken) + 1)

    def test_overflow_is_an_error_in_the_log_at_most_every_ten_seconds(self):
        with mock.patch.object(self.inbox._overflow_warnings, "_log") as log:
            for _ in range(3):
                self.put(*range(6))
                self.take()
        lines = [call[0][0] % call[0][1:] for call in log.call_args_list]
        self.assertEqual(len(lines), 1)
        self.assertEqual(lines[0], "the inbox of this node overflowed: messages were dropped, 5 in all; all that was "
                                   "heard before counts as lost")

    def test_request_that_is_dropped_is_answered_with_an_error(self):
        answers = []

        def ask():
            try:
                self.inbox.ask(lambda request, done: done.set_result(request), "request")
            except rospy.ServiceException as error:
                answers.append(str(error))
        thread = threading.Thread(target=ask, daemon=True)
        thread.start()
        eventually(lambda: len(self.inbox._items) == 1, "the request")
        self.put(*range(5))
        thread.join(10)
        self.assertEqual(len(answers), 1)
        self.assertEqual(answers[0], "the node was held up for too long: messages were dropped, and this request with "
                                     "them")
        self.assertEqual(self.take(), ["overflow", 4])

    def test_items_of_several_threads_are_taken_or_counted(self):
        def put_many():
            self.put(*range(2000))
        threads = [threading.Thread(target=put_many) for _ in range(3)]
        for thread in threads:
            thread.start()
        while any(thread.is_alive() for thread in threads):
            self.take()
        self.take()
        self.assertEqual(sum(item != "overflow" for item in self.taken) + self.inbox.dropped, 6000)


class Built:
    """A node in this process, with an inbox for few messages, and the doors into and out of it."""

    def __init__(self, node_class, values):
        self.callbacks, self.published = {}, {}
        self._ahead_ns = 0
        self.inbox = Inbox(limit=LIMIT)
        with mock.patch.multiple(rospy, Subscriber=self._subscribe, Publisher=self._advertise, Service=mock.Mock()), \
                mock.patch("car_interface.ros.reconfigure.Server", mock.MagicMock()):
            self.node = node_class(Params(values), self.inbox)

    def _subscribe(self, topic, _, callback, **__):
        self.callbacks[topic] = callback
        return mock.Mock()

    def _advertise(self, topic, *_, **__):
        publisher = mock.Mock()
        publisher.publish = self.published.setdefault(topic, []).append
        publisher.get_num_connections.return_value = 1
        return publisher

    def hear(self, topic, message):
        """As rospy's thread does; then the node's thread has its turn."""
        self.callbacks[topic](message)
        self.node.step(time.monotonic_ns())

    def beat(self):
        """Its heartbeat is due, whatever the machine's pace."""
        self._ahead_ns += 1_000_000_000
        self.node.step(time.monotonic_ns() + self._ahead_ns)

    def flood(self, topic, message):
        """More than the inbox holds, while the node's thread is held up; then that goes on."""
        for _ in range(LIMIT + 1):
            self.callbacks[topic](message)
        assert self.inbox.dropped >= LIMIT
        self.node.step(time.monotonic_ns())

    def newest(self, topic):
        """What it published last."""
        return self.published[topic][-1]


class NodesThatLoseMessages(unittest.TestCase):
    """Each is driven by what it heard, and stops with the messages that it couldn't take."""

    def test_turn_arb_centers_until_the_deadman_was_let_go(self):
        node = Built(TurnArb, {**config("turn_arb.yaml"), "grant_at_start": True, "e_stop_timeout": 0,
                               "input_timeout": 0})
        node.hear("/teleop_logi/human_in_loop", Bool(True))
        node.hear("/teleop_logi/tele_steer_req", Float32(1.0))
        self.assertEqual(node.newest("/servo/cmdVector").data[0], LEFT)
        node.flood("av_turnrad_req", Float32(5.0))
        self.assertEqual(node.newest("/servo/cmdVector").data[0], CENTER)
        mark = len(node.published["/servo/cmdVector"])
        node.hear("/teleop_logi/tele_steer_req", Float32(0.9))
        node.hear("/teleop_logi/human_in_loop", Bool(True))
        node.beat()
        self.assertEqual({vector.data[0] for vector in node.published["/servo/cmdVector"][mark:]}, {CENTER})
        node.hear("/teleop_logi/human_in_loop", Bool(False))
        node.hear("/teleop_logi/human_in_loop", Bool(True))
        self.assertEqual(node.newest("/servo/cmdVector").data[0], 3930)

    def test_throttle_arb_has_the_esc_at_neutral_until_the_deadman_was_let_go(self):
        node = Built(ThrottleArb, {
            **config("throttle.yaml"), "grant_at_start": True, "e_stop_timeout": 0, "human_timeout": 0,
            "steering_timeout": 0, "command_timeout": 0, "odometry_timeout": 0, "output_required": False})

        def all_heard(*deadman):
            node.hear("turn_arb/state", SteeringState(source=SteeringState.TELEOP))
            node.hear("~input/odometry", Odometry())
            node.hear("~input/value", Float64Stamped(data=100.0))
            for held in deadman:
                node.hear("/teleop_logi/human_in_loop", Bool(held))
        all_heard(False, True)

        def is_driven():
            node.beat()
            return node.newest("/servo/cmdVector").data[1] == ESC_FULL
        eventually(is_driven, "the ESC to be armed")
        node.flood("~input/odometry", Odometry())
        self.assertEqual(node.newest("/servo/cmdVector").data[1], ESC_NEUTRAL)
        all_heard(True)
        node.beat()
        self.assertEqual(node.newest("/servo/cmdVector").data[1], ESC_NEUTRAL)
        all_heard(False, True)
        node.beat()
        self.assertEqual(node.newest("/servo/cmdVector").data[1], ESC_FULL)

    def test_teleop_logi_holds_nothing_until_all_deadmen_were_let_go(self):
        node = Built(TeleopLogi, {**config("teleop_logi.yaml"), "joy_timeout": 0})
        released, held = (Joy(axes=[0.0] * 8, buttons=[0] * 4 + [pressed] + [0] * 6) for pressed in (0, 1))
        node.hear("joy", released)
        node.hear("joy", held)
        self.assertIs(node.newest("/teleop_logi/human_in_loop"), True)
        node.flood("joy", held)
        self.assertIs(node.newest("/teleop_logi/human_in_loop"), False)
        node.hear("joy", released)
        node.hear("joy", held)
        self.assertIs(node.newest("/teleop_logi/human_in_loop"), True)

    def test_teleop_logi_publishes_a_silence_that_ended_before_its_next_tick(self):
        node = Built(TeleopLogi, {**config("teleop_logi.yaml"), "joy_timeout": 0.05})
        released, held = (Joy(axes=[0.0] * 8, buttons=[0] * 4 + [pressed] + [0] * 6) for pressed in (0, 1))
        node.hear("joy", released)
        node.hear("joy", held)
        time.sleep(0.06)  # what is tested; the node's thread has no turn meanwhile
        node.hear("joy", held)
        causes = [state.cause for state in node.published["~state"]]
        self.assertEqual(causes[-3:], ["manual", "joy silent", "not re-armed"])

    def test_pca9685_has_each_channel_at_its_timeout_value_until_a_new_command(self):
        node = Built(Pca9685, {**config("pca9685.yaml"), "steering": config("turn_arb.yaml"), "timeout": 0,
                               "device": "virtual", "guard": False})
        left = Int32MultiArray(data=[LEFT] + [-1] * 15)
        node.hear("/servo/cmdVector", left)
        self.assertEqual(node.newest("/servo/output").data[0], 3808)
        node.flood("command", Int32MultiArray(data=[-1] * 15 + [9600]))
        self.assertEqual((node.newest("/servo/output").data[0], node.newest("/servo/output").data[15]), (5104, 9600))
        node.hear("/servo/cmdVector", left)
        self.assertEqual(node.newest("/servo/output").data[0], 3808)

    def test_teensy_sensor_hub_no_longer_knows_the_commanded_turn(self):
        node = Built(TeensySensorHub, {"port": "/dev/absent"})
        node.hear("turn_arb/state", SteeringState(turn_radius=2.0))

        def commanded():
            status = mock.Mock(spec=["summary", "add"])
            node.node._measurements.reports["steering by the wheels"](status)
            return dict(call[0] for call in status.add.call_args_list)["commanded turn radius"]
        self.assertEqual(commanded(), "2.00 m")
        temperature = mock.Mock(temperature=20.0)
        node.flood("temperature", temperature)
        self.assertEqual(commanded(), "nan m")


class TurnArbThatIsHeldUp(unittest.TestCase):
    """A process of its own: its thread hangs, rospy's go on hearing."""

    def setUp(self):
        set_params(self, "/held/turn_arb", config("turn_arb.yaml"))
        self.process = start(self, sys.executable, HANGING, "__ns:=/held", "/servo/cmdVector:=servo/cmdVector",
                             "/teleop_logi/human_in_loop:=human", "/teleop_logi/tele_steer_req:=steering",
                             "/e_stop:=e_stop")
        self.states, self.reports = Topic("/held/turn_arb/state", SteeringState), Topic("/diagnostics", DiagnosticArray)
        self.human, self.e_stop = Sender("/held/human", Bool), Sender("/held/e_stop", Bool)
        self.hang = Sender("/held/turn_arb/hang", Float32)
        self.inputs = Repeater(0.005)
        self.addCleanup(self.inputs.end)
        self.inputs.hold(Sender("/held/steering", Float32), Float32(1.0))
        self.inputs.hold(self.e_stop, Bool(False))
        self.arm()

    def arm(self):
        self.inputs.hold(self.human, Bool(False))
        self.states.wait_for(lambda state: state.reason == "human_in_loop is false", self.states.mark())
        self.inputs.hold(self.human, Bool(False))
        self.inputs.hold(self.human, Bool(True))
        self.states.wait_for(lambda state: state.duty == LEFT, self.states.mark())

    def test_takes_all_for_lost_says_so_and_drives_only_when_it_was_re_armed(self):
        set_parameters = rospy.ServiceProxy("/held/turn_arb/set_parameters", Reconfigure)
        answers = []

        def ask():
            try:
                set_parameters(Config(ints=[IntParameter("servo_center", 5200)]))
            except rospy.ServiceException as error:
                answers.append(str(error))
        asking = threading.Thread(target=ask, daemon=True)
        states, lines = self.states.mark(), self.process.stderr.mark()
        self.hang.publish(Float32(1.5))
        self.inputs.drop(self.e_stop)
        self.e_stop.publish(Bool(True))  # which will be among the dropped
        asking.start()
        self.states.wait_for(lambda state: (state.source, state.reason) == (
            SteeringState.LOCKED, "e_stop was not heard since messages were dropped"), states)
        self.states.wait_for_count(10, self.states.mark())
        after = [state for state in self.states.since(states) if state.source != SteeringState.TELEOP]
        self.assertEqual({state.duty for state in after}, {CENTER})
        self.process.wait_for_line(r"ERROR.*the inbox of this node overflowed: messages were dropped, \d+ in all; all "
                                   r"that was heard before counts as lost$", lines)
        asking.join(10)
        self.assertEqual(len(answers), 1)
        self.assertIn("held up for too long: messages were dropped", answers[0])
        report = self.reports.wait_for(lambda array: any(
            status.name == "held/turn_arb: steering" and status.level == DiagnosticStatus.ERROR
            and "the inbox of this node overflowed" in status.message for status in array.status), 0).what
        self.assertIn("messages dropped by its inbox", [pair.key for pair in report.status[0].values])
        self.inputs.hold(self.e_stop, Bool(False))
        self.states.wait_for(lambda state: state.reason == "messages were dropped; let go once: publish false, then "
                                                           "true", self.states.mark())
        self.arm()


if __name__ == "__main__":
    rospy.init_node("inbox_test")
    rostest.rosrun("car_interface", "inbox_test", "__main__")
