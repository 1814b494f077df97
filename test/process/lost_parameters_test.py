#!/usr/bin/env python3
"""A virtual car's nodes that die after their parameters were deleted or exchanged open no real car's devices.

They are started by their launch files, and again by roslaunch's respawn. fake_i2c.c is preloaded: it has an I²C bus
wherever one is opened, and notes that, as it does attempts to open the usual port of a Teensy.
"""
from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import tempfile
import unittest
from xmlrpc.client import ServerProxy

import rosgraph
import rospy
import rostest
from car_interface.msg import LinkStatus, SteeringState
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from nav_msgs.msg import Odometry
from std_msgs.msg import Int32MultiArray

from car_interface.common import causes
from virtual_car import HERE, Car
from waiting import PACKAGE, NodeProcess, Topic, eventually

LAUNCH_S = 60
RESPAWN_S = 90  # with pauses of 1, 2, 4 … s between two looks at the parameters
BY_LAUNCH = "by the launch file that started this process"
USUAL_SIM_PORT = "/tmp/car_sim_teensy"


def pid_of(name, master=None):
    """The process of a node; None when there is none that answers."""
    try:
        return ServerProxy((master or rosgraph.Master("/test")).lookupNode(name)).getPid("/test")[2]
    except (rosgraph.MasterException, OSError):
        return None


class LostParameters(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.build = tempfile.mkdtemp()
        cls.library = os.path.join(cls.build, "fake_i2c.so")
        subprocess.run(["cc", "-shared", "-fPIC", "-o", cls.library, os.path.join(HERE, "fake_i2c.c"), "-ldl"],
                       check=True)

    @classmethod
    def tearDownClass(cls):
        shutil.rmtree(cls.build)

    def setUp(self):
        self.folder = tempfile.mkdtemp()
        self.addCleanup(shutil.rmtree, self.folder, ignore_errors=True)
        self.bus = os.path.join(self.folder, "i2c-1")
        with open(self.bus, "wb") as file:
            file.write(bytes(256))
        self.port = os.path.join(self.folder, "my teensy")  # a path may have a space
        self.chip = os.path.join(self.folder, "chip")
        self.reports = Topic("/diagnostics", DiagnosticArray)
        self.addCleanup(self.reports.close)

    def launch(self, file, *arguments, env=None):
        """Start a launch file, by its path or its name in this package; it ends with the test."""
        given = [file] if os.path.isabs(file) else ["car_interface", file]
        process = NodeProcess("roslaunch", *given, *arguments, env={
            "LD_PRELOAD": self.library, "FAKE_I2C": self.bus, "FAKE_I2C_LOG": self.log_path(), **(env or {})})
        self.addCleanup(lambda: process.runs() and process.end())  # with its nodes
        return process

    def log_path(self):
        return f"{self.bus}.log"

    def opened(self):
        """What was done to real devices."""
        if not os.path.exists(self.log_path()):
            return []
        with open(self.log_path(), encoding="ascii") as file:
            return file.read().splitlines()

    def parameters(self, name):
        """A node's parameters, which are gone with the test."""
        values = rospy.get_param(name)
        self.addCleanup(lambda: rospy.has_param(name) and rospy.delete_param(name))
        return values

    def kill(self, launch, process):
        """Kill a node; where the log of its launch file is by then."""
        marks = launch.stderr.mark(), launch.stdout.mark(), self.reports.mark()
        os.kill(eventually(lambda: pid_of(process), process), signal.SIGKILL)
        return marks

    def assert_refused(self, launch, marks, node, parameter, reason):
        """It is started again, refuses, says so on /diagnostics, too, and stays."""
        line = launch.stderr.wait_for(lambda line: "FATAL" in line and reason in line, marks[0], LAUNCH_S).what
        self.assertRegex(line, re.escape(f"{reason}. This node waits, and reads its parameters again in"))

        def wanted(array):
            return any(status.name == f"{node.strip('/')}: parameters" and status.level == DiagnosticStatus.ERROR
                       for status in array.status)
        status = self.reports.wait_for(wanted, marks[2]).what.status[0]
        self.assertEqual(status.message, f"this node doesn't run, as it refuses a parameter: {reason}")
        self.assertEqual({value.key: value.value for value in status.values},
                         {"cause": causes.PARAMETER_REFUSED, "parameter": parameter})

    def assert_goes_on(self, launch, marks):
        launch.stdout.wait_for(lambda line: "the parameters are accepted now" in line, marks[1], RESPAWN_S)
        self.assertFalse([line for line in launch.stderr.since() + launch.stdout.since() if "Traceback" in line])

    def lose(self, launch, process, node, changes, parameter, reason):
        """Change parameters on the server (None = deleted), kill the node, and put them back.

        Args:
            process: to be killed.
            node: whose parameters.
            changes: by path.
            parameter, reason: what the node refuses and says.
        """
        values = self.parameters(node)
        for path, value in changes.items():
            if value is None:
                rospy.delete_param(path)
            else:
                rospy.set_param(path, value)
        marks = self.kill(launch, process)
        self.assert_refused(launch, marks, node, parameter, reason)
        self.assertTrue(pid_of(process))
        rospy.set_param(node, values)
        self.assert_goes_on(launch, marks)

    def test_pca9685_with_a_chip_in_software_opens_no_bus(self):
        outputs = Topic("/servo/output", Int32MultiArray)
        self.addCleanup(outputs.close)
        launch = self.launch("pca9685.launch", "device:=virtual", f"virtual_chip:={self.chip}", "address:=0x41")
        center = 5104  # 319 counts of the shipped center
        for changes, parameter, reason in (
                ({"/pca9685": None}, "device", f"device is missing; accepted: virtual, {BY_LAUNCH}"),
                ({"/pca9685/device": None}, "device", f"device is missing; accepted: virtual, {BY_LAUNCH}"),
                ({"/pca9685/device": "/dev/i2c-1"}, "device",
                 f"device is '/dev/i2c-1'; accepted: virtual, {BY_LAUNCH}"),
                ({"/pca9685/address": 0x40}, "address", f"address is 64; accepted: 0x41, {BY_LAUNCH}"),
                ({"/pca9685/virtual_chip": None}, "virtual_chip",
                 f"virtual_chip is missing; accepted: {self.chip}, {BY_LAUNCH}"),
                ({"/pca9685/virtual_chip": f"{self.chip}_of_another_car"}, "virtual_chip",
                 f"virtual_chip is '{self.chip}_of_another_car'; accepted: {self.chip}, {BY_LAUNCH}")):
            with self.subTest(reason):
                eventually(lambda: pid_of("/pca9685"), "the node", LAUNCH_S)
                outputs.wait_for(lambda output: output.data[0] == center, outputs.mark(), LAUNCH_S)
                self.lose(launch, "/pca9685", "/pca9685", changes, parameter, reason)
                outputs.wait_for(lambda output: output.data[0] == center, outputs.mark(), LAUNCH_S)
        self.assertFalse(os.path.exists(f"{self.chip}_of_another_car"))
        self.assertEqual(self.opened(), [])
        self.assertEqual(launch.end(), 0)

    def test_pca9685_whose_master_was_replaced_opens_no_bus(self):
        car = Car(self)
        env = car._env
        launch = self.launch("pca9685.launch", "device:=virtual", env=env)
        launch.stdout.wait_for(lambda line: "running at" in line, within_s=LAUNCH_S)
        master = rosgraph.Master("/test", env["ROS_MASTER_URI"])
        values = master.getParam("/pca9685")
        pid = eventually(lambda: pid_of("/pca9685", master), "the node")
        car.master.end(signal.SIGKILL)
        car.master = car.start("master", shutil.which("rosmaster"), "--core", "-p", str(car._port))
        eventually(car._master_answers, "another master")
        self.assertFalse(master.hasParam("/pca9685"))
        mark = launch.stderr.mark(), launch.stdout.mark()
        os.kill(pid, signal.SIGKILL)
        launch.stderr.wait_for(lambda line: f"device is missing; accepted: virtual, {BY_LAUNCH}" in line, mark[0],
                               LAUNCH_S)
        master.setParam("/pca9685", values)
        self.assert_goes_on(launch, mark)
        launch.stdout.wait_for(lambda line: "running at" in line, mark[1])
        self.assertEqual(self.opened(), [])

    def test_launch_file_with_a_real_bus_still_opens_it(self):
        """What the others look for is there to be found."""
        launch = self.launch("pca9685.launch")
        self.addCleanup(lambda: rospy.has_param("/pca9685") and rospy.delete_param("/pca9685"))
        launch.stdout.wait_for(lambda line: "running at" in line, within_s=LAUNCH_S)
        self.assertTrue([line for line in self.opened() if line.endswith("lock 40: 0")])

    def test_chip_that_the_launch_file_leaves_to_the_default_is_not_exchanged(self):
        launch = self.launch("pca9685.launch", "device:=virtual")
        launch.stdout.wait_for(lambda line: "running at" in line, within_s=LAUNCH_S)
        self.lose(launch, "/pca9685", "/pca9685", {"/pca9685/virtual_chip": self.chip}, "virtual_chip",
                  f"virtual_chip is '{self.chip}'; accepted: none, {BY_LAUNCH}; its argument virtual_chip sets it")
        self.assertFalse(os.path.exists(self.chip))

    def test_teensy_sensor_hub_opens_no_other_port(self):
        links = Topic("/teensy_sensor_hub/link", LinkStatus)
        self.addCleanup(links.close)
        launch = self.launch("teensy_sensor_hub.launch", f"port:={self.port}")
        for changes, reason in (
                ({"/teensy_sensor_hub": None}, f"port is missing; accepted: {self.port}, {BY_LAUNCH}"),
                ({"/teensy_sensor_hub/port": None}, f"port is missing; accepted: {self.port}, {BY_LAUNCH}"),
                ({"/teensy_sensor_hub/port": "/dev/ttyAMA0"},
                 f"port is '/dev/ttyAMA0'; accepted: {self.port}, {BY_LAUNCH}")):
            with self.subTest(reason):
                links.wait_for(lambda _: True, links.mark(), LAUNCH_S)
                self.lose(launch, "/teensy_sensor_hub", "/teensy_sensor_hub", changes, "port", reason)
                links.wait_for(lambda _: True, links.mark(), LAUNCH_S)
        self.assertEqual(self.opened(), [])
        self.assertTrue([line for line in launch.stderr.since() if f"Teensy on {self.port}: there is no such port" in
                         line])

    def test_car_sim_takes_no_other_port_and_follows_no_other_chip(self):
        """By its launch file, but started again as one of a user's own might do."""
        with open(os.path.join(PACKAGE, "launch", "car_sim.launch"), encoding="utf-8") as file:
            text = file.read()
        respawned = re.sub(r'required="true"(.*?)>', r'respawn="true" respawn_delay="1" \1>'
                           '<env name="CAR_INTERFACE_RESPAWN" value="true"/>', text, flags=re.DOTALL)
        self.assertNotEqual(respawned, text)
        path = os.path.join(self.folder, "car_sim.launch")
        with open(path, "w", encoding="utf-8") as file:
            file.write(respawned)
        truths = Topic("/car_sim/truth", Odometry)
        self.addCleanup(truths.close)
        launch = self.launch(path, f"port:={self.port}", f"virtual_chip:={self.chip}")
        for changes, parameter, reason in (
                ({"/car_sim": None}, "port", f"port is missing; accepted: {self.port}, {BY_LAUNCH}"),
                ({"/car_sim/port": None}, "port", f"port is missing; accepted: {self.port}, {BY_LAUNCH}"),
                ({"/car_sim/port": "/dev/ttyAMA0"}, "port",
                 f"port is '/dev/ttyAMA0'; accepted: {self.port}, {BY_LAUNCH}"),
                ({"/car_sim/virtual_chip": None}, "virtual_chip",
                 f"virtual_chip is missing; accepted: {self.chip}, {BY_LAUNCH}")):
            with self.subTest(reason):
                truths.wait_for(lambda _: True, truths.mark(), LAUNCH_S)
                self.lose(launch, "/car_sim", "/car_sim", changes, parameter, reason)
                truths.wait_for(lambda _: True, truths.mark(), LAUNCH_S)
        lines = launch.stdout.since() + launch.stderr.since()
        self.assertTrue([line for line in lines if f"a virtual Teensy is on {self.port}" in line])
        self.assertFalse([line for line in lines if f"a virtual Teensy is on {USUAL_SIM_PORT}" in line])

    def test_one_process_refuses_for_each_of_its_nodes_and_the_others_run(self):
        states = Topic("/turn_arb/state", SteeringState)
        outputs = Topic("/servo/output", Int32MultiArray)
        self.addCleanup(states.close)
        self.addCleanup(outputs.close)
        launch = self.launch("car_nodes.launch", "device:=virtual", f"port:={self.port}", "throttle:=true")
        outputs.wait_for(lambda output: output.data[0] > 0, within_s=LAUNCH_S)
        board, hub = self.parameters("/pca9685"), self.parameters("/teensy_sensor_hub")
        for name in ("/turn_arb", "/generic_value_converter", "/throttle_arb", "/car_nodes"):
            self.parameters(name)
        self.assertEqual((board["device"], hub["port"]), ("virtual", self.port))
        rospy.delete_param("/pca9685/device")
        rospy.delete_param("/teensy_sensor_hub")
        marks = self.kill(launch, "/car_nodes")
        board_refuses = f"device is missing; accepted: virtual, {BY_LAUNCH}"
        hub_refuses = f"port is missing; accepted: {self.port}, {BY_LAUNCH}"
        self.assert_refused(launch, marks, "/pca9685", "device", board_refuses)
        self.assert_refused(launch, marks, "/teensy_sensor_hub", "port", hub_refuses)
        states.wait_for(lambda _: True, states.mark())
        rospy.set_param("/pca9685", board)
        launch.stdout.wait_for(lambda line: "pca9685: the parameters are accepted now" in line, marks[1], RESPAWN_S)
        outputs.wait_for(lambda output: output.data[0] > 0, outputs.mark())
        rospy.set_param("/teensy_sensor_hub", hub)
        launch.stdout.wait_for(lambda line: "teensy_sensor_hub: the parameters are accepted now" in line, marks[1],
                               RESPAWN_S)

        self.lose(launch, "/car_nodes", "/car_nodes", {"/car_nodes": None}, "throttle",
                  f"throttle is missing; accepted: true, {BY_LAUNCH}")
        outputs.wait_for(lambda output: output.data[0] > 0, outputs.mark())
        eventually(lambda: "/throttle_arb/state" in dict(rospy.get_published_topics()), "throttle_arb", LAUNCH_S)
        self.assertEqual(self.opened(), [])
        self.assertEqual(launch.end(), 0)

    def test_node_that_is_started_by_hand_takes_its_parameters_as_they_are(self):
        process = NodeProcess(shutil.which("rosrun"), "car_interface", "pca9685", "__name:=by_hand", "_device:=virtual",
                              env={"LD_PRELOAD": self.library, "FAKE_I2C": self.bus, "FAKE_I2C_LOG": self.log_path()})
        self.addCleanup(process.clean_up)
        self.addCleanup(rospy.delete_param, "/by_hand")
        process.wait_for_info("PCA9685 at 0x40 on virtual: running at")
        self.assertEqual(self.opened(), [])

    def test_doctor_knows_the_devices_of_a_node_that_lost_its_parameters(self):
        launch = self.launch("pca9685.launch", "device:=virtual")
        launch.stdout.wait_for(lambda line: "running at" in line, within_s=LAUNCH_S)
        self.parameters("/pca9685")
        rospy.delete_param("/pca9685")
        doctor = NodeProcess(shutil.which("rosrun"), "car_interface", "doctor")
        self.addCleanup(doctor.clean_up)
        doctor.wait_for_exit()
        shown = "\n".join(doctor.stdout.since())
        self.assertIn(f"device is missing; accepted: virtual, {BY_LAUNCH}", shown)
        self.assertIn("virtual: the chip is a piece of software that /pca9685 writes to", shown)
        self.assertNotIn("/dev/i2c-1", shown)


if __name__ == "__main__":
    rospy.init_node("lost_parameters_test")
    rostest.rosrun("car_interface", "lost_parameters_test", "__main__")
