#!/usr/bin/env python3
"""Parameters that are lost, exchanged or refused while a car runs."""
import os
import signal
from xmlrpc.client import ServerProxy

import rosgraph
import rospy
import rostest
import yaml
from car_interface.msg import SteeringState
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from std_msgs.msg import Int32MultiArray

from car_interface.common import causes
from closing import LAUNCH_S, PARTS, Closing, output_of, pid_of
from virtual_car import Car, FakeBus
from waiting import config, eventually, examine, start_node

BY_LAUNCH = "by the launch file that started this process"
REFUSED = "servo_left is 'x'; accepted: an integer from 0 to 65535"


class LostParameters(Closing):
    """Nodes that are started again after their parameters were deleted or exchanged open no real car's devices."""

    def setUp(self):
        super().setUp()
        self.bus = FakeBus(self.folder)

    def parameters(self, name):
        """A node's parameters, which are gone with the test."""
        self.addCleanup(lambda: rospy.has_param(name) and rospy.delete_param(name))
        return rospy.get_param(name)

    @staticmethod
    def refused(launch, mark, reason):
        line = launch.stderr.wait_for(lambda line: "FATAL" in line and reason in line, mark, LAUNCH_S).what
        assert f"{reason}. This node waits, and reads its parameters again in" in line, line

    def test_board_is_not_exchanged_for_another_one_also_not_when_the_master_was_replaced(self):
        car = Car(self.addCleanup)  # for its master
        master = rosgraph.Master("/test", car.env["ROS_MASTER_URI"])
        launch = self.launch("pca9685.launch", "i2c:=virtual", "address:=0x41", env={**car.env, **self.bus.env})
        launch.stdout.wait_for(lambda line: "running at" in line, within_s=LAUNCH_S)
        values = master.getParam("/pca9685")

        def replace_master():
            car.processes["master"].end(signal.SIGKILL)
            car.start_master()
            self.assertFalse(master.hasParam("/pca9685"))
        for change, reason in (
                (lambda: master.deleteParam("/pca9685"), f"device is missing; accepted: virtual, {BY_LAUNCH}"),
                (lambda: master.setParam("/pca9685/device", "/dev/i2c-1"),
                 f"device is '/dev/i2c-1'; accepted: virtual, {BY_LAUNCH}"),
                (lambda: master.setParam("/pca9685/address", 0x40), f"address is 64; accepted: 0x41, {BY_LAUNCH}"),
                (lambda: master.setParam("/pca9685/virtual_chip", f"{self.folder}/chip"),
                 (f"virtual_chip is '{self.folder}/chip'; accepted: none, {BY_LAUNCH}; its argument virtual_chip sets "
                  "it")),
                (replace_master, f"device is missing; accepted: virtual, {BY_LAUNCH}")):
            with self.subTest(reason):
                pid = ServerProxy(master.lookupNode("/pca9685")).getPid("/test")[2]
                change()
                marks = launch.stderr.mark(), launch.stdout.mark()
                os.kill(pid, signal.SIGKILL)
                self.refused(launch, marks[0], reason)
                if change is replace_master:
                    shown = examine(env=car.env).stdout
                    self.assertIn(reason, shown)
                    self.assertNotIn("/dev/i2c-1", shown)
                master.setParam("/pca9685", values)
                launch.stdout.wait_for(lambda line: "the parameters are accepted now" in line, marks[1], LAUNCH_S)
                launch.stdout.wait_for(lambda line: "running at" in line, marks[1])
        self.assertFalse(os.path.exists(f"{self.folder}/chip"))
        self.assertEqual(self.bus.lines(), [])
        self.assertFalse([line for line in output_of(launch) if "Traceback" in line])
        real = self.launch("pca9685.launch", env={**car.env, **self.bus.env, "ROS_NAMESPACE": "/real"})
        real.stderr.wait_for(lambda line: "already running" in line, within_s=LAUNCH_S)
        self.assertEqual(launch.end(), 0)
        real.stdout.wait_for(lambda line: "running at" in line)  # what was looked for is there to be found
        self.assertTrue([line for line in self.bus.lines() if line.endswith("lock 40: 0")])

    def test_parts_of_one_process_refuse_each_for_itself_and_the_others_run(self):
        port = os.path.join(self.folder, "my teensy")  # a path may have a space
        states, outputs = self.topic("/turn_arb/state", SteeringState), self.topic("/servo/output", Int32MultiArray)
        reports = self.topic("/diagnostics", DiagnosticArray)
        launch = self.launch("car_nodes.launch", "i2c:=virtual", f"port:={port}", "throttle:=true", env=self.bus.env)
        outputs.wait_for(lambda output: output.data[0] > 0, within_s=LAUNCH_S)
        values = {name: self.parameters(f"/{name}") for name in (*PARTS, "car_nodes")}
        for path in ("/pca9685/device", "/teensy_sensor_hub", "/car_nodes/throttle"):
            rospy.delete_param(path)
        marks = launch.stderr.mark(), launch.stdout.mark()
        os.kill(pid_of("/car_nodes"), signal.SIGKILL)
        self.refused(launch, marks[0], f"throttle is missing; accepted: true, {BY_LAUNCH}")
        rospy.set_param("/car_nodes/throttle", True)
        for part, parameter, reason in (
                ("pca9685", "device", f"device is missing; accepted: virtual, {BY_LAUNCH}"),
                ("teensy_sensor_hub", "port", f"port is missing; accepted: {port}, {BY_LAUNCH}")):
            self.refused(launch, marks[0], reason)
            status = next(status for status in reports.wait_for(lambda array, part=part: any(
                status.name == f"{part}: parameters" and status.level == DiagnosticStatus.ERROR
                for status in array.status)).what.status)
            self.assertEqual(status.message, f"this node doesn't run, as it refuses a parameter: {reason}")
            self.assertEqual({value.key: value.value for value in status.values},
                             {"cause": causes.PARAMETER_REFUSED, "parameter": parameter})
            states.wait_for(lambda _: True, states.mark())  # another part
            rospy.set_param(f"/{part}", values[part])
            launch.stdout.wait_for(lambda line, part=part: f"{part}: the parameters are accepted now" in line, marks[1],
                                   LAUNCH_S)
        outputs.wait_for(lambda output: output.data[0] > 0, outputs.mark())
        eventually(lambda: "/throttle_arb/state" in dict(rospy.get_published_topics()), "throttle_arb")
        self.assertEqual(self.bus.lines(), [])
        self.assertEqual(launch.end(), 0)

    def test_node_under_respawn_that_refuses_a_parameter_says_so_once_and_starts_when_it_is_repaired(self):
        path = os.path.join(self.folder, "turn_arb.yaml")
        with open(path, "w", encoding="utf-8") as file:
            yaml.safe_dump({**config("turn_arb.yaml"), "servo_left": "x"}, file)
        reports = self.topic("/diagnostics", DiagnosticArray)
        launch = self.launch("turn_arb.launch", f"config:={self.folder}")
        line = launch.stderr.wait_for(lambda line: "FATAL" in line, within_s=LAUNCH_S).what
        self.parameters("/turn_arb")
        self.assertTrue(line.endswith(
            f"{REFUSED}. This node waits, and reads its parameters again in 1 s, later every 30 s"), line)
        reports.wait_for(lambda array: array.status[0].name == "turn_arb: parameters"
                         and array.status[0].level == DiagnosticStatus.ERROR)
        by_hand = start_node(self, "turn_arb", "__ns:=by_hand", "_servo_left:=x")
        self.assertEqual(by_hand.wait_for_exit(), 1)
        self.assertEqual(len([line for line in by_hand.stderr.since() if "FATAL" in line]), 1)
        state = self.topic("/turn_arb/state", SteeringState)
        rospy.set_param("/turn_arb/servo_left", 3800)
        launch.stdout.wait_for(lambda line: "the parameters are accepted now" in line, within_s=LAUNCH_S)
        state.wait_for(lambda message: True)
        reports.wait_for(lambda array: array.status[0].name == "turn_arb: parameters"
                         and array.status[0].level != DiagnosticStatus.ERROR)
        self.assertEqual(len([line for line in launch.stderr.since() if "FATAL" in line]), 1)
        self.assertEqual(len([line for line in launch.stdout.since() if "launched with config" in line]), 1)
        self.assertFalse([line for line in output_of(launch) if "has died" in line or "Traceback" in line])
        rospy.set_param("/turn_arb/servo_left", "x")
        mark = launch.stderr.mark()
        os.kill(pid_of("/turn_arb"), signal.SIGKILL)
        launch.stderr.wait_for(lambda line: "FATAL" in line, mark, LAUNCH_S)
        self.assertEqual(launch.end(), 0)  # a signal ends its wait
        self.assertFalse([line for line in launch.stderr.since() if "escalating" in line])


if __name__ == "__main__":
    rospy.init_node("parameters_test")
    rostest.rosrun("car_interface", "parameters_test", "__main__")
