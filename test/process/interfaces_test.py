#!/usr/bin/env python3
"""The interfaces of the originals as somebody at a terminal finds them, of nodes that their launch files started.

What the nodes decide, and when, is tested in test/graph.
"""
import os
import shlex
import shutil
import signal
import tempfile
import time
import unittest

import rosgraph
import rosnode
import rospy
import rostest
from car_interface.msg import Control, ConverterState, Float64Stamped, SteeringState, TeleopState, ThrottleState
from nav_msgs.msg import Odometry
from sensor_msgs.msg import Joy
from std_msgs.msg import Bool, Float32, Int8, Int32MultiArray, String

from car_interface.common import causes
from waiting import PACKAGE, Repeater, Topic, config, eventually, set_params, start, start_node

LEFT = 3800
NEUTRAL, BY_HAND = 4915, 5407
CENTER_ON_CHIP = 5104  # 319 counts: 5100 / 16 = 318.75
STATES = {"turn_arb": SteeringState, "throttle_arb": ThrottleState, "teleop_logi": TeleopState,
          "generic_value_converter": ConverterState}
# By topic: its type, and which of the four nodes publish or subscribe.
TOPICS = {
    "/servo/cmdVector": (Int32MultiArray, "turn_arb throttle_arb", ""),
    "/servo/neutral": (Int32MultiArray, "turn_arb throttle_arb", ""),
    "/servo/output": (Int32MultiArray, "", "throttle_arb"),
    "/e_stop": (Bool, "", "turn_arb throttle_arb"),
    "/phone/e_stop": (Bool, "", "turn_arb throttle_arb"),
    "/joy": (Joy, "", "teleop_logi"),
    "/phone/joy": (Joy, "", "teleop_logi"),
    "/teleop_logi/human_in_loop": (Bool, "teleop_logi", "turn_arb throttle_arb"),
    "/teleop_logi/tele_steer_req": (Float32, "teleop_logi", "turn_arb"),
    "/teleop_logi/tele_throt_req": (Float32, "teleop_logi", "throttle_arb"),
    "/teleop_logi/mode": (String, "teleop_logi", "throttle_arb"),
    "/teleop_logi/scale_button": (Int8, "teleop_logi", "throttle_arb"),
    "/av_turnrad_req": (Float32, "", "turn_arb"),
    "/av_steer_req": (Float32, "", "turn_arb"),
    "/odom": (Odometry, "", "turn_arb throttle_arb generic_value_converter"),
    "/control/command/control_cmd": (Control, "", "generic_value_converter"),
    "/generic/output/value": (Float64Stamped, "generic_value_converter", "throttle_arb"),
    "/turn_arb/state": (SteeringState, "turn_arb", "throttle_arb"),
    "/throttle_arb/state": (ThrottleState, "throttle_arb", ""),
    "/teleop_logi/state": (TeleopState, "teleop_logi", "turn_arb throttle_arb"),
    "/generic_value_converter/state": (ConverterState, "generic_value_converter", "throttle_arb"),
}
# Absolute names that a launch file moves below a namespace.
MOVED = [f"/{name}:={name}" for name in ("servo/cmdVector", "servo/output", "e_stop", *(
    f"teleop_logi/{each}" for each in ("human_in_loop", "tele_steer_req", "tele_throt_req", "mode", "scale_button")))]


class Inputs(Repeater):
    """Publishes by the names of topics, to who subscribes."""

    def __init__(self):
        self._publishers = {}
        super().__init__(0.03)

    def send(self, topic, message):
        if topic not in self._publishers:
            self._publishers[topic] = rospy.Publisher(topic, type(message), queue_size=20, tcp_nodelay=True)
        self._publishers[topic].publish(message)


class Car:
    """An arbiter's human, who lets go whenever a node asks for that, and what it commands."""

    def __init__(self, inputs):
        self.commands = Topic("/servo/cmdVector", Int32MultiArray)
        self.states = {name: Topic(f"/{name}/state", STATES[name]) for name in ("turn_arb", "throttle_arb")}
        inputs.hold("/e_stop", Bool(False))
        inputs.hold("/av_turnrad_req", Float32(2.0))

    def lets_go(self):
        """Whether a node waits for it, or for something else than the human."""
        newest = [topic.newest for topic in self.states.values() if topic.mark()]
        if any(getattr(state, "esc_cause", "") == causes.ESC_ARMING for state in newest):
            return True  # it takes a second of neutral
        return any("let go" in state.reason or state.cause in ("human absent", "e_stop on", "starting")
                   or "let go" in getattr(state, "esc_reason", "") for state in newest) and time.monotonic() % 0.4 < 0.2

    def wait_for(self, channel, duty, since=None):
        return self.commands.wait_for(lambda command: command.data[channel] == duty,
                                      self.commands.mark() if since is None else since)


class Interfaces(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.folder = tempfile.mkdtemp()
        cls.inputs = Inputs()
        cls.car = Car(cls.inputs)
        cls.values = Topic("/generic/output/value", Float64Stamped)
        cls.human = Topic("/teleop_logi/human_in_loop", Bool)
        cls.pressed = False  # the manual deadman, with the sticks at full left and full ahead
        cls.inputs.hold("/joy", cls.joy)
        for name, message_type in STATES.items():
            topic = Topic(f"/{name}/state", message_type)
            topic.wait_for(lambda _: True)
            topic.close()

    @classmethod
    def tearDownClass(cls):
        cls.inputs.end()
        shutil.rmtree(cls.folder, ignore_errors=True)

    @classmethod
    def joy(cls):
        held = cls.pressed and not cls.car.lets_go()
        message = Joy(axes=[0.0] * 8, buttons=[0] * 4 + [int(held)] + [0] * 6)
        if held:
            message.axes[0] = message.axes[4] = 1.0
        return message

    def setUp(self):
        type(self).pressed = False
        self.addCleanup(setattr, type(self), "pressed", False)

    def press(self):
        type(self).pressed = True
        self.car.wait_for(0, LEFT)
        self.car.wait_for(1, BY_HAND)

    def test_each_topic_has_the_originals_name_and_type_and_who_publishes_and_subscribes(self):
        master = rosgraph.Master("/interfaces_test")
        expected = {(topic, end, f"/{node}") for topic, (_, *ends) in TOPICS.items()
                    for end, nodes in enumerate(ends) for node in nodes.split()}

        def found():
            return {(topic, end, node) for end, listed in enumerate(master.getSystemState()[:2])
                    for topic, nodes in listed for node in nodes if node[1:] in STATES and topic in TOPICS}
        eventually(lambda: found() == expected, lambda: f"{found() ^ expected}")
        types = dict(master.getTopicTypes())
        for topic, (message_type, *_) in TOPICS.items():
            self.assertEqual(types[topic], message_type._type, topic)
        services = {name for name, _ in master.getSystemState()[2]}
        self.assertLessEqual({"/turn_arb/set_parameters", "/turn_arb/save", "/throttle_arb/servo/set_parameters",
                              "/throttle_arb/save"}, services)

    def test_commands_have_sixteen_channels_of_which_each_node_sets_its_own(self):
        mark = self.car.commands.mark()
        for channel, sender in ((0, "/turn_arb"), (1, "/throttle_arb")):
            vector = self.car.commands.wait_for(
                lambda vector, sender=sender: vector._connection_header["callerid"] == sender, mark).what
            self.assertEqual((len(vector.data), vector.data[:channel] + vector.data[channel + 1:]), (16, (-1,) * 15))
            self.assertGreaterEqual(vector.data[channel], 0)
            self.assertEqual(vector.layout.data_offset, 0)
            self.assertEqual([(dim.label, dim.size, dim.stride) for dim in vector.layout.dim], [("pwm_channel", 16, 1)])

    def test_line_of_the_install_page_commands_a_servo_board_as_typed(self):
        with open(os.path.join(PACKAGE, "docs/install.md"), encoding="utf-8") as file:
            line = next(line for line in file if line.startswith("    rostopic pub /command "))
        board = start_node(self, "pca9685", "_device:=virtual", "/servo/output:=bare/output",
                           "/servo/cmdVector:=bare/cmdVector", name="bare")
        outputs = Topic("/bare/output", Int32MultiArray)
        self.addCleanup(outputs.close)
        outputs.wait_for(lambda output: output.data == (0,) * 16)
        typed = start(self, *shlex.split(line))
        outputs.wait_for(lambda output: output.data == (CENTER_ON_CHIP,) + (0,) * 15)
        typed.end()
        outputs.wait_for(lambda output: output.data == (0,) * 16, outputs.mark())
        self.assertEqual(board.end(), 0)

    def test_acceleration_becomes_a_value_by_the_map_that_the_launch_file_names(self):
        command, odometry = Control(), Odometry()
        command.longitudinal.acceleration, odometry.twist.twist.linear.x = 1.479, 1.0  # the map's point for 1.2
        self.inputs.hold("/control/command/control_cmd", command)
        self.inputs.hold("/odom", odometry)
        self.addCleanup(self.inputs.drop, "/control/command/control_cmd", "/odom")
        self.values.wait_for(lambda value: abs(value.data - 1.2) < 1e-6)

    def test_originals_parameters_are_found_in_the_root_namespace_from_two_namespaces_within(self):
        """Where the original's params.yaml is loaded."""
        set_params(self, "/", {
            "servo_left": 4000, "servo_center": 5000, "servo_right": 7000, "servo_channel": 3,
            "m_turnrad_axis_servo": [1, 10], "k_pwmcmd_left_table_servo": [4000, 5000],
            "k_pwmcmd_right_table_servo": [7000, 5000]})
        commands = Topic("/outer/inner/servo/cmdVector", Int32MultiArray)
        self.addCleanup(commands.close)
        process = start_node(self, "turn_arb", "__ns:=/outer/inner", *MOVED)
        self.assertEqual(commands.wait_for(lambda _: True).what.data, (-1, -1, -1, 5000) + (-1,) * 12)
        self.assertEqual((process.end(), process.stderr.since()), (0, []))

    def test_node_that_ends_leaves_neutral_a_released_deadman_and_nothing_on_the_master(self):
        self.press()
        commands, human = self.car.commands.mark(), self.human.mark()
        rosnode.kill_nodes(["/throttle_arb", "/teleop_logi"])
        self.human.wait_for(lambda message: not message.data, human)
        self.car.wait_for(1, NEUTRAL, commands)
        type(self).pressed = False
        set_params(self, "/ending/teleop_logi", config("teleop_logi.yaml"))
        deadman = Topic("/ending/teleop_logi/human_in_loop", Bool)
        self.addCleanup(deadman.close)
        self.inputs.hold("/ending/joy", lambda: Joy(
            axes=[0.0] * 8, buttons=[0] * 4 + [int(time.monotonic() % 1.0 > 0.3)] + [0] * 6))
        self.addCleanup(self.inputs.drop, "/ending/joy")
        for end in (lambda process: process.send(signal.SIGTERM),
                    lambda process: rosnode.kill_nodes(["/ending/teleop_logi"])):
            process = start_node(self, "teleop_logi", *MOVED, "__ns:=/ending")
            eventually(lambda: deadman.mark() and deadman.newest.data, "a deadman that is held")
            end(process)
            self.assertEqual(process.wait_for_exit(), 0)
            eventually(lambda: not deadman.newest.data, "a deadman that was let go")
            self.assertNotIn("/ending/teleop_logi", rosnode.get_node_names())

if __name__ == "__main__":
    rospy.init_node("interfaces_test")
    rostest.rosrun("car_interface", "interfaces_test", Interfaces)
