#!/usr/bin/env python3
"""Two cars beside each other, /four of four processes and more, /one of one process: names, reports, sockets."""
import os
import re
import signal
import time

import rosgraph
import rosnode
import rospy
import rostest
from car_interface.msg import SteeringState
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from sensor_msgs.msg import Joy
from std_msgs.msg import Int32MultiArray

from car_interface.common import causes
from closing import LAUNCH_S, PARTS, Closing, ask, graph_of, joy, pid_of
from virtual_car import HERE
from waiting import config, eventually, examine, set_params, start, start_node

STRICT = bool(os.environ.get("CAR_INTERFACE_ALL"))
PEERS = os.path.join(HERE, "half_open_peers.py")
LEFT_DUTY = 238 * 16


class TwoCars(Closing):
    def test_both_have_the_same_topics_services_parameters_and_reports_and_the_doctor_sees_all_parts(self):
        heard, names = self.topic("/diagnostics", DiagnosticArray), {"four": set(), "one": set()}

        def both():
            return graph_of("/four", PARTS), graph_of("/one", ["car_nodes"])
        eventually(lambda: both()[0] == both()[1] and len(both()[0][2]) >= 8, lambda: f"the same names: {both()}")
        published, subscribed, services = both()[1]
        self.assertLessEqual({"/turn_arb/state"}, published)
        self.assertLessEqual({"/servo/cmdVector"}, subscribed)
        self.assertLessEqual({"/teensy_sensor_hub/ping", "/pca9685/inject_fault"}, services)
        for part in PARTS:
            four, one = ({name: value for name, value in rospy.get_param(f"/{namespace}/{part}").items()
                          if name not in ("port", "frame_prefix")} for namespace in ("four", "one"))
            self.assertEqual(four, one)
        self.assertNotIn("/one/turn_arb", rosnode.get_node_names())
        for namespace in names:  # a topic latches one message in a process, and in the one two parts publish
            neutrals = self.topic(f"/{namespace}/servo/neutral", Int32MultiArray)
            for channel in (0, 1):
                neutrals.wait_for(lambda neutral, channel=channel: neutral.data[channel] != -1)

        def same_reports():
            for array in heard.since():
                for status in array.status:
                    namespace, _, name = status.name.partition("/")
                    names.setdefault(namespace, set()).add(re.sub("_four|_one", "", name))
            return names["four"] == names["one"] and len(names["one"]) > 12
        eventually(same_reports, lambda: f"the same names: {names}")
        shown = examine("--ns", "/one").stdout
        self.assertRegex(shown, f"{', '.join(PARTS)}, .* run in /one")
        self.assertNotIn("not running", shown)

    def test_publishers_of_the_wrong_type_on_an_unknown_host_or_killed_are_told_by_name(self):
        set_params(self, "/late/turn_arb", config("turn_arb.yaml"))
        reports = self.topic("/diagnostics", DiagnosticArray)
        master = rosgraph.Master("/ros_test")
        lost = ("env", "--unset=ROS_IP", "ROS_HOSTNAME=no-such-host.invalid")
        publishers = {topic: start(self, *before, "rostopic", "pub", "-r", "10", topic, f"std_msgs/{kind}", "2.0")
                      for topic, kind, before in (
                          ("/late/av_turnrad_req", "Float64", ()), ("/late/av_steer_req", "Float32", lost),
                          ("/one/av_turnrad_req", "Float64", ()), ("/four/av_turnrad_req", "Float64", ()))}

        def name_on(topic):
            return next((name for name in dict(master.getSystemState()[0]).get(topic, []) if "rostopic" in name), None)
        names = {topic: eventually(lambda topic=topic: name_on(topic), topic, LAUNCH_S) for topic in publishers}
        start_node(self, "turn_arb", "__ns:=/late")  # the master takes the first publisher's type for the topic's

        def wait_until(node, is_wanted):
            reports.wait_for(lambda array: any(status.name == f"{node}: command topics" and is_wanted(status)
                                               for status in array.status), reports.mark())

        def wait_for_error(node, *texts):
            wait_until(node, lambda status: status.level == DiagnosticStatus.ERROR
                       and all(text in f"{status.message} {status.values}" for text in texts))
        wait_for_error(
            "late/turn_arb", "set ROS_IP",
            f"{names['/late/av_turnrad_req']} on 127.0.0.1 publishes std_msgs/Float64 on /late/av_turnrad_req",
            f"{names['/late/av_steer_req']} publishes on /late/av_steer_req from a computer that it calls "
            "no-such-host.invalid, which can't be looked up here: none of its messages is received")
        for car in ("one", "four"):
            topic = f"/{car}/av_turnrad_req"
            wait_for_error(f"{car}/turn_arb", names[topic], f"publishes std_msgs/Float64 on {topic}, which takes "
                           "std_msgs/Float32: none of its messages is received")
            publishers[topic].end(signal.SIGKILL)
            # By the values: a node that stood still warns of that in each of its reports.
            wait_until(f"{car}/turn_arb", lambda status: {value.value for value in status.values
                                                          if value.key in ("cause", topic)} == {"", "no publisher"})
            self.assertEqual(name_on(topic), names[topic])  # it is still registered

    def test_nodes_come_back_while_silent_connections_are_opened_on_the_others_again_and_again(self):
        stick, output = self.sender("/four/joy", Joy), self.topic("/four/servo/output", Int32MultiArray)
        states = self.topic("/four/turn_arb/state", SteeringState)

        def drive():
            began_s = time.monotonic()
            while True:
                self.repeater.hold(stick, joy(False))
                states.wait_for(lambda state: state.cause == causes.HUMAN_ABSENT, states.mark())
                self.wait_s(0.3)  # the stick's rest
                self.repeater.hold(stick, joy(True))
                try:
                    return output.wait_for(lambda message: message.data[0] == LEFT_DUTY, output.mark(), 3.0)
                except AssertionError:  # a connection was not there yet
                    if time.monotonic() - began_s > LAUNCH_S:
                        raise
        drive()
        published = {"/four/turn_arb": "/four/turn_arb/state", "/four/throttle_arb": "/four/throttle_arb/state",
                     "/four/teleop_logi": "/four/teleop_logi/human_in_loop"}
        ports = [str(eventually(lambda node=node, topic=topic: ask(node, "requestTopic", topic, [["TCPROS"]]), node)[2])
                 for node, topic in published.items()]
        for mode in ("hold", "reopen"):
            peers = start(self, PEERS, *ports, "200", mode)
            peers.stdout.wait_for(lambda line: line == "open")
            mark, killed_s = output.mark(), time.monotonic()
            os.kill(pid_of("/four/pca9685"), signal.SIGKILL)
            output.wait_for(lambda message: message.data[0] != LEFT_DUTY, mark)  # its guard
            back = drive()  # with that many connections a node may have stood still: it wants the deadman let go
            print(f"{mode}: pca9685 is back after {back.at_s - killed_s:.2f} s", flush=True)
            if STRICT:
                self.assertLess(back.at_s - killed_s, 5.0)
            if mode == "hold":
                peers.clean_up()
        os.kill(pid_of("/four/turn_arb"), signal.SIGKILL)
        mark = states.mark()
        # It hears teleop_logi, and wants the deadman let go.
        states.wait_for(lambda state: state.cause in (causes.NOT_REARMED, causes.HUMAN_ABSENT), mark)
        drive()


if __name__ == "__main__":
    rospy.init_node("cars_test")
    rostest.rosrun("car_interface", "cars_test", "__main__")
