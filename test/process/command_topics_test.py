#!/usr/bin/env python3
"""What is wrong with the publishers of the topics that nodes obey is on /diagnostics within 2 s.

Wrong message types, second publishers, and channels of the servo board that nobody commands any more.
"""
from __future__ import annotations

import signal
import time
import unittest

import rosgraph
import rospy
import rostest
from diagnostic_msgs.msg import DiagnosticArray
from rosgraph_msgs.msg import Log
from std_msgs.msg import Int32MultiArray

from waiting import Repeater, Sender, Topic, config, eventually, retried, set_params, start, start_node

WITHIN_S = 2.0
START_S = 60.0  # for a program to start, on a busy machine
OK, WARN, ERROR = range(3)
FINE = "each has the publishers that it should have"
CARS = ("", "/one")
VECTOR = "{layout: {dim: [], data_offset: 0}, data: [%s]}"


class Reports(Topic):
    """The reports of one kind, of all nodes."""

    def __init__(self, kind="command topics"):
        self.kind = kind
        super().__init__("/diagnostics", DiagnosticArray)

    def add(self, what):
        for status in what.status:
            if status.name.endswith(f": {self.kind}"):
                super().add(status)

    def wait_until(self, node, wanted, since, within_s=15.0):
        """The first report of a node that is wanted, and when it came."""
        name = f"{node.strip('/')}: {self.kind}"
        heard = self.wait_for(lambda status: status.name == name and wanted(status), since, within_s)
        return heard.what, heard.at_s

    def newest(self, node):
        """A node's newest message."""
        name = f"{node.strip('/')}: {self.kind}"
        return next((status.message for status in reversed(self.since()) if status.name == name), None)


def end(process):
    """End a rostopic as Ctrl-C does; now and then one hangs after that, which is no concern of the nodes."""
    try:
        process.end(signal.SIGINT, 10.0)
    except AssertionError:
        process.end(signal.SIGKILL)


class CommandTopicsTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.master = rosgraph.Master(rospy.get_name())
        cls.reports = Reports()
        cls.log = Topic("/rosout", Log).connected()

    def publish(self, topic, message_type, message, *options, env=()):
        """Publish as its user does, from a process of its own; its name, and when the master knew it, s."""
        before = set(self.publishers(topic))
        process = start(self, "env", *env, "rostopic", "pub", *(options or ("-r", "10")), topic, message_type, message)
        name, = eventually(lambda: set(self.publishers(topic)) - before, f"a publisher of {topic}", START_S)
        return process, name, time.monotonic()

    def publishers(self, topic):
        """The names of a topic's publishers, as the master has them."""
        return dict(self.master.getSystemState()[0]).get(topic, [])

    def expect(self, node, topic, message_type, message, words, level=None):
        """A publisher's fault is reported in time by a node, with these words, and its end, too."""
        mark = self.reports.mark()
        process, name, began_s = self.publish(topic, message_type, message)
        try:
            status, at_s = self.reports.wait_until(  # a machine is known up to a second after a node's first command
                node, lambda status: status.level != OK and "an unknown machine" not in status.message, mark)
            for wanted in (*words, f"{name} on 127.0.0.1"):
                self.assertIn(wanted, status.message)
            if level is not None:
                self.assertEqual(status.level, level)
            values = {value.key: value.value for value in status.values}
            self.assertIn(f"{name} on 127.0.0.1", values.get(topic, status.message))
            self.assertTrue(values["remedy"])
        finally:
            mark = self.reports.mark()
            end(process)
            self.reports.wait_until(node, lambda status: status.message == FINE, mark)
        self.assertLess(at_s - began_s, WITHIN_S)
        return values

    def test_healthy_cars_have_nothing_to_report(self):
        for namespace in CARS:
            for node in ("turn_arb", "pca9685", "generic_value_converter", "teleop_logi"):
                path = f"{namespace}/{node}"
                self.reports.wait_until(path, lambda status: status.message == FINE, 0, START_S)
                self.assertEqual(self.reports.newest(path), FINE)

    def test_wrong_type_is_reported_with_node_machine_and_both_types(self):
        for namespace in CARS:
            def look(namespace=namespace):
                values = self.expect(
                    f"{namespace}/turn_arb", f"{namespace}/av_turnrad_req", "std_msgs/Float64", "2.0",
                    [f"publishes std_msgs/Float64 on {namespace}/av_turnrad_req, which takes std_msgs/Float32:",
                     "none of its messages is received"], ERROR)
                self.assertEqual(values["cause"], "wrong type")
                self.assertIn("publish std_msgs/Float32, or publish on another topic", values["remedy"])
            with self.subTest(car=namespace):
                retried(look, 4)

    def test_twist_on_the_remapped_acceleration_command_is_reported_by_its_resolved_name(self):
        for namespace in CARS:
            with self.subTest(car=namespace):
                retried(lambda namespace=namespace: self.expect(
                    f"{namespace}/generic_value_converter", f"{namespace}/control/command/control_cmd",
                    "geometry_msgs/Twist", "{}",
                    [f"geometry_msgs/Twist on {namespace}/control/command/control_cmd",
                     "which takes car_interface/Control"], ERROR), 4)

    def test_second_publisher_of_the_deadman_is_reported(self):
        for namespace in CARS:
            def look(namespace=namespace):
                values = self.expect(f"{namespace}/turn_arb", f"{namespace}/teleop_logi/human_in_loop",
                                     "std_msgs/Bool", "false",
                                     [f"2 nodes publish on {namespace}/teleop_logi/human_in_loop",
                                      f"{namespace}/teleop_logi on 127.0.0.1", "each undoes what the other commands"],
                                     WARN)
                self.assertEqual(values["cause"], "second publisher")
                self.assertIn("rosnode kill /rostopic_", values["remedy"])
            with self.subTest(car=namespace):
                retried(look, 4)

    def test_second_publisher_of_a_channel_is_reported_and_two_nodes_on_two_channels_are_not(self):
        for namespace, owner in (("", "/turn_arb"), ("/one", "/one/car_nodes")):
            with self.subTest(car=namespace):
                retried(lambda namespace=namespace, owner=owner: self.expect(
                    f"{namespace}/pca9685", f"{namespace}/servo/cmdVector", "std_msgs/Int32MultiArray",
                    VECTOR % ", ".join(["5100"] + ["-1"] * 15),
                    ["2 nodes command channel 0", f"{owner} on 127.0.0.1"]), 4)
        process, _, _ = self.publish("/servo/cmdVector", "std_msgs/Int32MultiArray",
                                     VECTOR % ", ".join(["-1"] * 15 + ["5100"]))
        mark = self.reports.mark()
        status, _ = self.reports.wait_until("/pca9685", lambda status: "/rostopic_" in str(status.values), mark)
        self.assertEqual((status.level, status.message), (OK, FINE))
        end(process)

    def test_publisher_of_the_wrong_type_that_was_there_first_is_reported(self):
        """The master takes the first publisher's type for that of the topic."""
        set_params(self, "/late/turn_arb", config("turn_arb.yaml"))
        _, name, _ = self.publish("/late/av_turnrad_req", "std_msgs/Float64", "2.0")
        mark = self.reports.mark()
        start_node(self, "turn_arb", "__ns:=/late")
        status, _ = self.reports.wait_until("/late/turn_arb", lambda status: status.level != OK, mark)
        self.assertIn(f"{name} on 127.0.0.1 publishes std_msgs/Float64 on /late/av_turnrad_req", status.message)

    def test_publisher_on_a_computer_that_calls_itself_by_an_unknown_name_is_reported(self):
        """As a laptop does where ROS_IP was forgotten."""
        set_params(self, "/lost/turn_arb", config("turn_arb.yaml"))
        _, name, _ = self.publish("/lost/av_turnrad_req", "std_msgs/Float32", "2.0",
                                  env=("--unset=ROS_IP", "ROS_HOSTNAME=no-such-host.invalid"))
        mark = self.reports.mark()
        start_node(self, "turn_arb", "__ns:=/lost")
        status, _ = self.reports.wait_until("/lost/turn_arb", lambda status: status.level == ERROR, mark)
        self.assertIn(f"{name} publishes on /lost/av_turnrad_req from a computer that it calls no-such-host.invalid, "
                      "which can't be looked up here: none of its messages is received", status.message)
        self.assertIn(f"Where {name} runs, set ROS_IP", str(status.values))

    def test_publisher_that_was_killed_but_is_still_registered_is_none(self):
        process, name, _ = self.publish("/one/av_turnrad_req", "std_msgs/Float64", "2.0")
        mark = self.reports.mark()
        self.reports.wait_until("/one/turn_arb", lambda status: status.level == ERROR, mark)
        process.end(signal.SIGKILL)
        mark = self.reports.mark()
        self.reports.wait_until("/one/turn_arb", lambda status: status.message == FINE, mark)
        self.assertIn(name, self.publishers("/one/av_turnrad_req"))

    def test_publisher_that_sends_once_and_goes_is_shown_but_not_logged(self):
        marks = self.reports.mark(), self.log.mark()
        process, name, _ = self.publish("/teleop_logi/human_in_loop", "std_msgs/Bool", "false", "-1")
        self.reports.wait_until("/turn_arb", lambda status: status.level == WARN and name in status.message, marks[0])
        process.wait_for_exit()
        mark = self.reports.mark()
        self.reports.wait_until("/turn_arb", lambda status: status.message == FINE, mark)
        self.assertEqual([line.msg for line in self.log.since(marks[1]) if "nodes publish" in line.msg], [])

    def test_publisher_that_stays_becomes_an_error_and_is_logged_once(self):
        marks = self.reports.mark(), self.log.mark()
        process, _, _ = self.publish("/e_stop", "std_msgs/Bool", "false")
        other, _, _ = self.publish("/e_stop", "std_msgs/Bool", "false")
        status, _ = self.reports.wait_until("/turn_arb", lambda status: status.level == ERROR, marks[0])
        self.assertIn("2 nodes publish on /e_stop", status.message)
        end(process)
        end(other)
        lines = [line for line in self.log.since(marks[1]) if "publish on /e_stop" in line.msg]
        self.assertEqual([line.name for line in lines if line.name == "/turn_arb"], ["/turn_arb"])
        self.assertIn("End all but the one that shall command: rosnode kill /rostopic_", lines[0].msg)


class ChannelThatTimedOut(unittest.TestCase):
    """A pca9685 of the test's own; its channel 3 is commanded, and no longer."""

    @classmethod
    def setUpClass(cls):
        cls.master = rosgraph.Master(rospy.get_name())
        cls.boards, cls.topics = Reports("servo board"), Reports()
        cls.log = Topic("/rosout", Log).connected()

    def start(self, namespace):
        """Its node in a namespace; it reports that all is well, since no channel was ever commanded."""
        self.node, self.topic = f"{namespace}/pca9685", f"{namespace}/servo/cmdVector"
        process = start_node(self, "pca9685", f"__ns:={namespace}", "_device:=virtual",
                             f"/servo/cmdVector:={self.topic}", f"/servo/output:={namespace}/servo/output")
        self.wait_until_fine((0, 0))
        return process

    def marks(self):
        return self.boards.mark(), self.topics.mark()

    def wait_until_fine(self, marks):
        self.boards.wait_until(self.node, lambda status: status.message == "running at 50.03 Hz", marks[0], START_S)
        self.topics.wait_until(self.node, lambda status: status.message == FINE, marks[1], START_S)

    def publish(self):
        """Command channel 3 as a person does, with a program of its own; it and its name."""
        before = set(dict(self.master.getSystemState()[0]).get(self.topic, []))
        marks = self.marks()
        process = start(self, "rostopic", "pub", "-r", "20", self.topic, "std_msgs/Int32MultiArray",
                        VECTOR % ", ".join(["-1"] * 3 + ["5100"] + ["-1"] * 12))
        name, = eventually(lambda: set(dict(self.master.getSystemState()[0]).get(self.topic, [])) - before,
                           "a publisher", START_S)
        self.topics.wait_until(self.node, lambda status: any(value.key == self.topic and name in value.value
                                                             for value in status.values), marks[1], START_S)
        return process, name

    def assert_error(self, marks, reason, remedy):
        """Both reports are errors with this reason and remedy, and the cause."""
        for reports, mark in zip((self.boards, self.topics), marks):
            status, _ = reports.wait_until(self.node, lambda status: reason in status.message, mark)
            self.assertEqual(status.level, ERROR)
            self.assertRegex(status.message, r"channel timed out: channel 3, for \d+\.\d s")
            values = {value.key: value.value for value in status.values}
            self.assertEqual(values["cause"], "channel timed out")
            self.assertIn(remedy, values["remedy"])

    def test_commander_that_is_killed_or_ends_is_named_until_the_channel_is_commanded_again(self):
        self.start("/gone")
        for number in (signal.SIGKILL, signal.SIGINT):
            with self.subTest(number.name):
                process, name = self.publish()
                self.wait_until_fine(self.marks())
                marks, log = self.marks(), self.log.mark()
                process.end(number)
                ended_s = time.monotonic()
                _, at_s = self.boards.wait_until(self.node, lambda status: status.level == ERROR, marks[0])
                self.assertLess(at_s - ended_s, WITHIN_S)
                self.assert_error(marks, f"; {name}, which commanded it last, is gone",
                                  f"Start {name} again; or, where nobody is to command channel 3 any more, start this "
                                  f"node again: rosnode kill {self.node}")
                self.log.wait_for(
                    lambda line: line.name == self.node and "channel timed out: channel 3" in line.msg, log)
        process, _ = self.publish()
        self.wait_until_fine(self.marks())
        end(process)

    def test_commander_that_falls_silent_is_named_and_the_doctor_passes_it_on(self):
        self.start("/silent")
        inputs = Repeater(period_s=0.02)
        self.addCleanup(inputs.end)
        sender = Sender(self.topic, Int32MultiArray)
        self.addCleanup(sender.close)
        inputs.hold(sender, Int32MultiArray(data=[-1] * 3 + [5100] + [-1] * 12))
        self.wait_until_fine(self.marks())
        marks = self.marks()
        inputs.drop(sender)
        self.assert_error(marks, f"{rospy.get_name()} on 127.0.0.1, which commanded it last, publishes, but commands "
                                 "nothing there", f"rosnode ping {rospy.get_name()}")
        doctor = start_node(self, "doctor", "--ns", "/silent")
        self.assertEqual(doctor.wait_for_exit(), 2)
        shown = doctor.stdout.since()
        for subject in ("topics", "reports"):
            self.assertTrue([line for line in shown if subject in line and "channel timed out: channel 3" in line],
                            shown)

    def test_channel_that_was_made_safe_when_the_node_stood_still_is_told_so(self):
        process = self.start("/still")
        inputs = Repeater(period_s=0.02)
        self.addCleanup(inputs.end)
        sender = Sender(self.topic, Int32MultiArray)
        self.addCleanup(sender.close)
        inputs.hold(sender, Int32MultiArray(data=[-1] * 3 + [5100] + [-1] * 12))
        outputs = Topic("/still/servo/output", Int32MultiArray)
        self.addCleanup(outputs.close)
        outputs.wait_for(lambda output: output.data[3] == 5104)
        process.send(signal.SIGSTOP)
        outputs.wait_for(lambda output: output.data[3] == 0, outputs.mark())  # its guard
        marks = self.marks()
        inputs.drop(sender)
        process.send(signal.SIGCONT)
        self.assert_error(marks, ", since this node stood still or lost messages: no command has come after that; ",
                          f"rosnode ping {rospy.get_name()}")


if __name__ == "__main__":
    rospy.init_node("command_topics_test")
    rostest.rosrun("car_interface", "command_topics_test", "__main__")
