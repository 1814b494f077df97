#!/usr/bin/env python3
"""Tuning while the car drives: launched as an owner does, tuned as rqt_reconfigure does, saved, and launched again."""
from __future__ import annotations

import os
import re
import shutil
import signal
import tempfile
import unittest
from pathlib import Path
from xmlrpc.client import ServerProxy

import rosgraph
import rospkg
import rospy
import rostest
import yaml
from car_interface.msg import SteeringState
from diagnostic_msgs.msg import DiagnosticArray
from dynamic_reconfigure.client import Client
from dynamic_reconfigure.msg import Config, DoubleParameter, GroupState, IntParameter, StrParameter
from dynamic_reconfigure.srv import Reconfigure
from rosgraph_msgs.msg import Log
from std_msgs.msg import Bool, Float32, Int32MultiArray
from std_srvs.srv import Trigger

from waiting import Repeater, Sender, Topic, eventually, retried, set_params, start, start_node

LEFT, CENTER, RIGHT, NEUTRAL = 3800, 5100, 6700, 4915
STEERS, DRIVES = 0, 1  # channels
RATE = 500  # duty per second
FASTEST_BEAT = 25 + 1  # duty: what a node that was held up may make up for at once
LAUNCH = """<launch>
  <include file="$(find car_interface)/launch/turn_arb.launch">
    <arg name="ns" value="tuned"/><arg name="config" value="{folder}/turn_arb.yaml"/>
  </include>
  <include file="$(find car_interface)/launch/pca9685.launch">
    <arg name="ns" value="tuned"/><arg name="config" value="{folder}/pca9685.yaml"/>
    <arg name="steering_config" value="{folder}/turn_arb.yaml"/>
    <arg name="throttle_config" value="{folder}/throttle.yaml"/>
    <arg name="throttle" value="true"/><arg name="device" value="virtual"/>
  </include>
  <include file="$(find car_interface)/launch/throttle_arb.launch">
    <arg name="ns" value="tuned"/><arg name="config" value="{folder}/throttle.yaml"/>
  </include>
</launch>
"""


def counts_16(duty):
    """The duty that the chip makes of one."""
    return (duty + 8) // 16 * 16


def shipped():
    return Path(rospkg.RosPack().get_path("car_interface")) / "config"


class LiveTest(unittest.TestCase):
    def setUp(self):
        self.folder = Path(tempfile.mkdtemp(prefix="live_test"))
        self.addCleanup(shutil.rmtree, str(self.folder))
        for path in shipped().glob("*.yaml"):
            shutil.copy(str(path), str(self.folder))
        (self.folder / "live.launch").write_text(LAUNCH.format(folder=self.folder), encoding="utf-8")
        self.commands = Topic("/tuned/servo/cmdVector", Int32MultiArray)
        self.outputs = Topic("/tuned/servo/output", Int32MultiArray)
        self.neutrals = Topic("/tuned/servo/neutral", Int32MultiArray)
        self.states = Topic("/tuned/turn_arb/state", SteeringState)
        self.log = Topic("/rosout", Log)
        self.diagnostics = Topic("/diagnostics", DiagnosticArray)
        for topic in (self.commands, self.outputs, self.neutrals, self.states, self.log, self.diagnostics):
            self.addCleanup(topic.close)
        self.launch()
        self.human = self.sender("/tuned/teleop_logi/human_in_loop", Bool)
        self.teleop = self.sender("/tuned/teleop_logi/tele_steer_req", Float32)
        self.planner = self.sender("/tuned/av_turnrad_req", Float32)
        self.inputs = Repeater()
        self.addCleanup(self.inputs.end)

    def sender(self, name, message_type, listeners=1):
        made = Sender(name, message_type, listeners)
        self.addCleanup(made.close)
        return made

    def launch(self):
        """Start the nodes from the files as they are now."""
        mark, outputs_mark = self.neutrals.mark(), self.outputs.mark()
        self.roslaunch = start(self, "roslaunch", str(self.folder / "live.launch"))
        self.addCleanup(self.roslaunch.end, signal.SIGINT, 30)  # it ends its nodes
        for channel in (STEERS, DRIVES):
            self.neutrals.wait_for(lambda vector, channel=channel: vector.data[channel] >= 0, mark)
        self.steering = self.client("/tuned/turn_arb")
        self.esc = self.client("/tuned/throttle_arb/servo")
        self.outputs.wait_for_count(1, outputs_mark)

    def client(self, name):
        made = Client(name, timeout=15)
        self.addCleanup(made.close)
        return made

    def end(self):
        self.roslaunch.end(signal.SIGINT, within_s=30)
        for topic in (self.commands, self.outputs):
            eventually(lambda topic=topic: not topic._subscriber.get_num_connections(), f"the end of {topic.name}")

    def drive(self, teleop=0.0, planner=0.0):
        self.inputs.hold(self.human, False)
        self.states.wait_for(lambda state: state.reason == "human_in_loop is false", self.states.mark())
        self.inputs.hold(self.teleop, teleop)
        self.inputs.hold(self.planner, planner)
        self.inputs.hold(self.human, False)  # one that comes after turn_arb began to count them
        self.inputs.hold(self.human, True)

    def wait_for_duty(self, channel, duty, since=None):
        return self.commands.wait_for(lambda vector: vector.data[channel] == duty,
                                      self.commands.mark() if since is None else since)

    def wait_for_output(self, channel, duty, since=None):
        return self.outputs.wait_for(lambda vector: vector.data[channel] == counts_16(duty),
                                     self.outputs.mark() if since is None else since)

    def wait_for_log(self, node, pattern, since):
        return self.log.wait_for(lambda entry: entry.name == node and re.search(pattern, entry.msg), since).what

    def save(self, node):
        return rospy.ServiceProxy(f"/tuned/{node}/save", Trigger)()

    def values(self, name):
        return yaml.safe_load((self.folder / name).read_text(encoding="utf-8"))

    def asides(self, name):
        return sorted(self.folder.glob(f"{name}.bak-*"))

    # --- steering ---

    def test_sliders_have_the_cars_own_values_and_limits(self):
        described = {parameter["name"]: (parameter["min"], parameter["max"], parameter["default"])
                     for parameter in self.steering.get_parameter_descriptions()}
        self.assertEqual(described, {"servo_left": (3300, 4300, LEFT), "servo_center": (4600, 5600, CENTER),
                                     "servo_right": (6200, 7200, RIGHT)})
        (neutral,) = self.esc.get_parameter_descriptions()
        self.assertEqual((neutral["name"], neutral["min"], neutral["max"], neutral["default"]),
                         ("neutral", 4815, 5015, NEUTRAL))
        self.assertEqual(self.steering.get_configuration()["servo_center"], CENTER)

    def test_center_moved_while_driving_glides_there_and_everything_moves_along(self):
        self.drive(teleop=0.0, planner=300.0)
        self.states.wait_for(lambda state: state.source == SteeringState.PLANNER and state.duty == CENTER)
        mark, state_mark = self.commands.mark(), self.states.mark()
        answer = self.steering.update_configuration({"servo_center": CENTER + 200})
        self.assertEqual(answer["servo_center"], CENTER + 200)
        arrived = self.wait_for_duty(STEERS, CENTER + 200, mark)
        heard = [h for h in self.commands.heard_since(mark) if h.what.data[STEERS] >= 0 and h.at_s <= arrived.at_s]
        duties = [h.what.data[STEERS] for h in heard]
        self.assertEqual(duties, sorted(duties))
        self.assertLessEqual(max(after - before for before, after in zip(duties, duties[1:])), FASTEST_BEAT)
        moving_s = arrived.at_s - next(h.at_s for h in heard if h.what.data[STEERS] > CENTER)
        self.assertGreater(moving_s, 0.9 * 200 / RATE - 0.1)
        self.states.wait_for(lambda state: state.source == SteeringState.PLANNER and state.duty == CENTER + 200,
                             state_mark)
        for radius, duty in ((-300.0, CENTER + 200), (1.0, LEFT), (-1.0, RIGHT)):
            self.inputs.hold(self.planner, radius)
            self.wait_for_duty(STEERS, duty)
        for request, duty in ((1.0, LEFT), (-1.0, RIGHT), (0.5, (LEFT + CENTER + 200) // 2)):
            self.inputs.hold(self.teleop, request)
            self.wait_for_duty(STEERS, duty)
        self.inputs.hold(self.human, False)
        self.wait_for_duty(STEERS, CENTER + 200)

    def test_ends_are_tuned_too(self):
        self.drive(teleop=1.0)
        self.wait_for_duty(STEERS, LEFT)
        self.steering.update_configuration({"servo_left": 3700, "servo_right": 6800})
        self.wait_for_duty(STEERS, 3700)
        self.inputs.hold(self.teleop, -1.0)
        self.wait_for_duty(STEERS, 6800)

    def test_what_is_beyond_the_limits_is_clamped_and_said(self):
        mark = self.log.mark()
        self.assertEqual(self.steering.update_configuration({"servo_center": 65535})["servo_center"], 5600)
        entry = self.wait_for_log("/tuned/turn_arb", "servo_center 65535 is beyond 4600 to 5600: clamped to 5600", mark)
        self.assertEqual(entry.level, Log.WARN)
        self.wait_for_duty(STEERS, 5600)

    def test_what_is_impossible_is_refused_and_said_and_nothing_moves(self):
        self.drive(teleop=0.0)
        values = self.values("turn_arb.yaml")
        values["servo_left"] = 5000  # so near to the center that it can be asked for the other side
        (self.folder / "turn_arb.yaml").write_text(yaml.safe_dump(values), encoding="utf-8")
        self.end()
        self.launch()
        mark, commands_mark = self.log.mark(), self.commands.mark()
        answer = self.steering.update_configuration({"servo_center": 4900, "servo_right": 6800})
        self.assertEqual((answer["servo_left"], answer["servo_center"], answer["servo_right"]), (5000, CENTER, RIGHT))
        self.wait_for_log("/tuned/turn_arb", "servo_center is 4900; accepted: a duty between servo_left 5000 and "
                                             "servo_right 6800: refused", mark)
        self.commands.wait_for_count(100, self.commands.mark())
        self.assertEqual({vector.data[STEERS] for vector in self.commands.since(commands_mark)}, {CENTER, -1})
        self.assertEqual(rospy.get_param("/tuned/turn_arb/servo_right"), RIGHT)

    def test_request_of_any_shape_is_answered_and_harms_nothing(self):
        ask = rospy.ServiceProxy("/tuned/turn_arb/set_parameters", Reconfigure)
        for config in (Config(), Config(strs=[StrParameter("servo_center", "straight")]),
                       Config(doubles=[DoubleParameter("servo_center", float("nan"))]),
                       Config(ints=[IntParameter("servo_channel", 3), IntParameter("groups", 1)]),
                       Config(groups=[GroupState("odd", True, 7, 9)])):
            answer = ask(config).config
            self.assertEqual({value.name: value.value for value in answer.ints},
                             {"servo_left": LEFT, "servo_center": CENTER, "servo_right": RIGHT})
        self.assertEqual(self.steering.update_configuration({"servo_center": 5110})["servo_center"], 5110)

    # --- the servo board, and the ESC ---

    def test_servo_board_rests_where_the_tuned_center_is(self):
        self.drive(teleop=1.0)
        self.wait_for_output(STEERS, LEFT)
        log_mark = self.log.mark()
        self.steering.update_configuration({"servo_center": 5200})
        self.neutrals.wait_for(lambda vector: vector.data[STEERS] == 5200)
        self.wait_for_log("/tuned/pca9685", "the timeout value of channel 0 follows servo/neutral, away from the YAML "
                                            "file's. To save it: ~save of the node that was tuned", log_mark)

        def attempt():  # without turn_arb, until roslaunch has started it again
            self.drive(teleop=1.0)
            self.wait_for_output(STEERS, LEFT)
            mark = self.outputs.mark()
            self.kill("turn_arb")
            self.assertEqual(self.outputs.wait_for(lambda vector: vector.data[STEERS] != counts_16(LEFT), mark)
                             .what.data[STEERS], counts_16(5200))
        retried(attempt)

    def test_servo_board_that_is_started_again_follows_what_was_tuned(self):
        self.steering.update_configuration({"servo_center": 5200})
        self.esc.update_configuration({"neutral": NEUTRAL + 40})
        self.wait_for_timeout_values([5200, NEUTRAL + 40] + [0] * 14, 0)
        before = self.uri("pca9685")
        self.kill("pca9685")
        eventually(lambda: self.uri("pca9685") != before, "the new pca9685")
        self.wait_for_timeout_values([5200, NEUTRAL + 40] + [0] * 14, self.diagnostics.mark())

    def wait_for_timeout_values(self, duties, since):
        """Wait until the servo board reports these."""
        def has(array):
            return any(value.key == "timeout values" and value.value == " ".join(map(str, duties))
                       for status in array.status for value in status.values)
        self.diagnostics.wait_for(has, since)

    def uri(self, node):
        return rosgraph.Master(rospy.get_name()).lookupNode(f"/tuned/{node}")

    def kill(self, node):
        """End it as a fault would. roslaunch starts it again a second later."""
        uri = self.uri(node)
        os.kill(ServerProxy(uri).getPid(rospy.get_name())[2], signal.SIGKILL)

    def test_node_that_is_started_again_by_roslaunch_keeps_what_was_tuned(self):
        self.drive(planner=300.0)
        self.steering.update_configuration({"servo_center": 5200})
        self.wait_for_duty(STEERS, 5200)
        self.inputs.drop()
        mark = self.states.mark()
        self.kill("turn_arb")
        self.states.wait_for(lambda state: state.reason == "human_in_loop was never heard", mark)
        mark = self.commands.mark()
        self.drive(planner=300.0)
        self.states.wait_for(lambda state: state.source == SteeringState.PLANNER, self.states.mark())
        self.commands.wait_for(lambda vector: vector.data[STEERS] >= 0, mark)  # its new publisher was found as well
        self.assertEqual({vector.data[STEERS] for vector in self.commands.since(mark)} - {-1}, {5200})

    def test_neutral_of_the_esc_is_tuned_on_the_wire_and_at_rest(self):
        self.wait_for_duty(DRIVES, NEUTRAL)
        mark = self.commands.mark()
        self.assertEqual(self.esc.update_configuration({"neutral": NEUTRAL + 40})["neutral"], NEUTRAL + 40)
        self.wait_for_duty(DRIVES, NEUTRAL + 40, mark)
        duties = [vector.data[DRIVES] for vector in self.commands.since(mark) if vector.data[DRIVES] >= 0]
        self.assertLessEqual(max(after - before for before, after in zip(duties, duties[1:])), 6)
        log_mark = self.log.mark()
        self.assertEqual(self.esc.update_configuration({"neutral": 6000})["neutral"], NEUTRAL + 100)
        self.wait_for_log("/tuned/throttle_arb", "neutral 6000 is beyond 4815 to 5015: clamped", log_mark)
        self.wait_for_duty(DRIVES, NEUTRAL + 100)
        self.wait_for_output(DRIVES, NEUTRAL + 100, 0)

        def attempt():
            mark = self.outputs.mark()
            self.kill("throttle_arb")
            self.commands.wait_for(lambda vector: vector.data[DRIVES] == NEUTRAL + 100, self.commands.mark())
            self.assertEqual({vector.data[DRIVES] for vector in self.outputs.since(mark)} - {counts_16(NEUTRAL + 100)},
                             set())
        retried(attempt)

    def test_neutral_that_is_too_far_or_nonsense_is_not_followed(self):
        rogue = self.sender("/tuned/servo/neutral", Int32MultiArray, listeners=2)  # this test is one
        mark = self.log.mark()
        rogue.publish(data=[5100] * 3)
        self.wait_for_log("/tuned/pca9685", "a vector of neutrals needs 16 values and has 3: refused", mark)
        rogue.publish(data=[-1] * 5 + [5100] + [-1] * 10)  # a channel of neither node
        rogue.publish(data=[9000] + [-1] * 15)
        self.wait_for_log("/tuned/pca9685", "channel 0 rests at 9000 by servo/neutral, its timeout value is 5100: "
                                            "too far to follow", mark)
        self.wait_for_timeout_values([CENTER, NEUTRAL] + [0] * 14, self.diagnostics.mark())

    # --- saving ---

    def test_saved_values_are_there_at_the_next_start_and_comments_and_old_files_stay(self):
        texts = {path.name: path.read_text(encoding="utf-8") for path in self.folder.glob("*.yaml")}
        self.steering.update_configuration({"servo_left": 3750, "servo_center": 5150})
        answer = self.save("turn_arb")  # while it glides: what was accepted is saved
        self.assertTrue(answer.success, answer.message)
        self.assertRegex(answer.message, rf"^saved to {self.folder}/turn_arb.yaml, the old one is "
                                         rf"{self.folder}/turn_arb.yaml.bak-[\d-]+$")
        self.esc.update_configuration({"neutral": NEUTRAL + 35})
        answer = self.save("throttle_arb")
        self.assertTrue(answer.success, answer.message)

        steering, throttle = self.values("turn_arb.yaml"), self.values("throttle.yaml")
        self.assertEqual((steering["servo_left"], steering["servo_center"], steering["servo_right"]),
                         (3750, 5150, RIGHT))
        for table, end in (("k_pwmcmd_left_table_servo", 3750), ("k_pwmcmd_right_table_servo", RIGHT)):
            self.assertEqual((steering[table][0], steering[table][-1]), (end, 5150))
        self.assertEqual((throttle["servo"]["neutral"], throttle["servo"]["duty_table"]), (4950, [3312, 4950, 6589]))
        for name in ("turn_arb.yaml", "throttle.yaml"):
            self.assertEqual(re.findall("#.*", (self.folder / name).read_text(encoding="utf-8")),
                             re.findall("#.*", texts[name]))
            (aside,) = self.asides(name)
            self.assertEqual(aside.read_text(encoding="utf-8"), texts[name])
        for name in ("sonars.yaml", "pca9685.yaml"):
            self.assertEqual((self.folder / name).read_text(encoding="utf-8"), texts[name])

        before = {**rospy.get_param("/tuned/turn_arb"), **rospy.get_param("/tuned/throttle_arb")}
        self.end()
        self.launch()
        after = {**rospy.get_param("/tuned/turn_arb"), **rospy.get_param("/tuned/throttle_arb")}
        self.assertEqual(after, before)
        self.assertEqual(rospy.get_param("/tuned/pca9685/steering"), yaml.safe_load(
            (self.folder / "turn_arb.yaml").read_text(encoding="utf-8")))
        self.assertEqual(rospy.get_param("/tuned/pca9685/esc/servo/neutral"), 4950)
        self.wait_for_timeout_values([5150, 4950] + [0] * 14, self.diagnostics.mark())
        described = {parameter["name"]: (parameter["min"], parameter["max"])
                     for parameter in self.steering.get_parameter_descriptions()}
        self.assertEqual(described["servo_center"], (4650, 5650))
        self.drive(planner=300.0)
        self.states.wait_for(lambda state: state.source == SteeringState.PLANNER and state.duty == 5150,
                             self.states.mark())
        self.wait_for_duty(DRIVES, 4950)
        for node in ("turn_arb", "throttle_arb"):
            self.assertTrue(self.save(node).success)
            self.assertEqual(len(self.asides(f"{node}.yaml" if node == "turn_arb" else "throttle.yaml")), 1)

    def test_nothing_is_written_unless_somebody_saves(self):
        before = {path: path.read_bytes() for path in self.folder.iterdir()}
        self.steering.update_configuration({"servo_center": 5150})
        self.esc.update_configuration({"neutral": 4950})
        self.wait_for_duty(STEERS, 5150)
        self.wait_for_duty(DRIVES, 4950)
        self.end()
        self.assertEqual({path: path.read_bytes() for path in self.folder.iterdir()}, before)

    def test_file_that_cannot_be_saved_is_named_and_the_drive_goes_on(self):
        self.steering.update_configuration({"servo_center": 5150})
        path = self.folder / "turn_arb.yaml"
        shipped_text = path.read_text(encoding="utf-8")
        laughs = "a0: &a0 [1]\n" + "".join(f"a{level}: &a{level} [{', '.join([f'*a{level - 1}'] * 9)}]\n"
                                           for level in range(1, 10))
        for text, fault in (("a: [1\n", ", line 2 is no YAML: "),
                            (shipped_text + laughs, r", line \d+ makes more than 100,000 values by its aliases"),
                            (shipped_text + "x: &x [*x]\n", r", line \d+ has \*x inside of what it stands for"),
                            (shipped_text + "x: " + "[" * 3000, r", line \d+ is nested more than 100 levels deep"),
                            (shipped_text + "servo_center: 5100\n", r", lines \d+ and \d+ both give servo_center"),
                            (shipped_text + "#" * 1_000_000, r" can't be saved \(it has 1.0 MB, more than 1 MB\)")):
            path.write_text(text, encoding="utf-8")
            answer = self.save("turn_arb")
            self.assertFalse(answer.success)
            self.assertRegex(answer.message, rf"^not saved: {path}{fault}")
            self.assertNotIn("\n", answer.message)
            self.assertEqual(path.read_text(encoding="utf-8"), text)
        path.unlink()
        self.assertRegex(self.save("turn_arb").message, r"turn_arb.yaml can't be saved \(No such file or directory\)")
        os.mkfifo(str(path))
        self.assertRegex(self.save("turn_arb").message, r"turn_arb.yaml can't be saved \(it is a pipe\)")
        self.assertEqual(self.asides("turn_arb.yaml"), [])
        self.wait_for_duty(STEERS, 5150)

    def test_node_without_save_to_saves_nowhere(self):
        values = yaml.safe_load((shipped() / "turn_arb.yaml").read_text(encoding="utf-8"))
        set_params(self, "/bare/turn_arb", values)
        start_node(self, "turn_arb", "__ns:=/bare", "/servo/cmdVector:=servo/cmdVector")
        rospy.wait_for_service("/bare/turn_arb/save", 15)
        answer = rospy.ServiceProxy("/bare/turn_arb/save", Trigger)()
        self.assertFalse(answer.success)
        self.assertRegex(answer.message, "^servo_left and .* not saved: the parameter ~save_to names no file$")
        set_params(self, "/bare2/turn_arb", {**values, "save_to": str(self.folder / "turn_arb.yaml"), "live_range": 0})
        start_node(self, "turn_arb", "__ns:=/bare2", "/servo/cmdVector:=servo/cmdVector")
        rospy.wait_for_service("/bare2/turn_arb/save", 15)
        answer = rospy.ServiceProxy("/bare2/turn_arb/save", Trigger)()
        self.assertTrue(answer.success)
        self.assertEqual(answer.message,
                         f"{self.folder}/turn_arb.yaml says so already")
        self.assertEqual(self.client("/bare2/turn_arb").update_configuration({"servo_center": 5101})["servo_center"],
                         CENTER)


if __name__ == "__main__":
    rospy.init_node("live_test")
    rostest.rosrun("car_interface", "live_test", LiveTest)
