#!/usr/bin/env python3
"""Wrong message types and second publishers on the topics that nodes obey are on /diagnostics within 2 s."""
from __future__ import annotations

import signal
import time
import unittest

import rosgraph
import rospy
import rostest
from diagnostic_msgs.msg import DiagnosticArray
from rosgraph_msgs.msg import Log

from waiting import Topic, config, eventually, retried, set_params, start, start_node

WITHIN_S = 2.0
START_S = 60.0  # for a program to start, on a busy machine
OK, WARN, ERROR = range(3)
FINE = "each has the publishers that it should have"
CARS = ("", "/one")
VECTOR = "{layout: {dim: [], data_offset: 0}, data: [%s]}"


class Reports(Topic):
    """The reports about command topics, of all nodes."""

    def __init__(self):
        super().__init__("/diagnostics", DiagnosticArray)

    def add(self, what):
        for status in what.status:
            if status.name.endswith(": command topics"):
                super().add(status)

    def wait_until(self, node, wanted, since, within_s=15.0):
        """The first report of a node that is wanted, and when it came."""
        name = f"{node.strip('/')}: command topics"
        heard = self.wait_for(lambda status: status.name == name and wanted(status), since, within_s)
        return heard.what, heard.at_s

    def newest(self, node):
        """A node's newest message."""
        name = f"{node.strip('/')}: command topics"
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


if __name__ == "__main__":
    rospy.init_node("command_topics_test")
    rostest.rosrun("car_interface", "command_topics_test", "__main__")
