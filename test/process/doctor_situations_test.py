#!/usr/bin/env python3
"""Many situations of a car: the doctor says exactly what is the matter, and nothing bad of what is healthy."""
from __future__ import annotations

import os
import pty
import shutil
import signal
import socket
import sys
import tempfile
import unittest
import xmlrpc.client
from concurrent.futures import ThreadPoolExecutor

import rostest

from doctor_run import BAD, OK, WARN, check_order, examine
from waiting import PACKAGE, NodeProcess, eventually, executable, retried

NOWHERE = "http://127.0.0.1:1"
CALLER = "/doctor_situations_test"
# What depends on the computer that the tests run on, and no situation changes.
COMPUTERS = ("clock", "groups", "versions", "packages", "gamepad")
FIVE = ("turn_arb", "pca9685", "teensy_sensor_hub", "generic_value_converter", "throttle_arb")
HOLDER = """
import fcntl, os, sys
port = os.open(sys.argv[1], os.O_RDWR | os.O_NOCTTY)
fcntl.flock(port, fcntl.LOCK_EX)
print("open", flush=True)
sys.stdin.read()
"""


class Graph:
    """A master of its own, and what a test starts under it."""

    def __init__(self):
        self.folder = tempfile.mkdtemp()
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            port = probe.getsockname()[1]
        self.env = {"ROS_MASTER_URI": f"http://127.0.0.1:{port}", "ROS_IP": "127.0.0.1", "ROS_LOG_DIR": self.folder,
                    "PYTHONDONTWRITEBYTECODE": "1"}
        self._processes = []
        self.start(shutil.which("rosmaster"), "--core", "-p", str(port))
        eventually(self._answers, "a master")

    @property
    def master(self):
        """The master; a connection each time, since tests ask in several threads."""
        return xmlrpc.client.ServerProxy(self.env["ROS_MASTER_URI"])

    def _answers(self):
        try:
            return self.master.getPid(CALLER)
        except OSError:
            return None

    def start(self, *command):
        """Start a program."""
        process = NodeProcess(*command, env=self.env)
        self._processes.append(process)
        return process

    def launch(self, file, *arguments):
        """Start a launch file of this package."""
        return self.start(shutil.which("roslaunch"), "car_interface", file, *arguments)

    def node(self, node, *arguments):
        """Start a node of this package, and wait until it is there."""
        name = next((argument[6:] for argument in arguments if argument.startswith("__ns:=")), "") + f"/{node}"
        process = self.start(executable(node), *arguments)
        self.wait_for(name)
        return process

    def load(self, node, *names):
        """Set a node's parameters from files in config/."""
        for name in names:
            self.start(shutil.which("rosparam"), "load", os.path.join(PACKAGE, "config", name), node).wait_for_exit()

    def names(self):
        """The nodes of the graph."""
        return {name for kind in self.master.getSystemState(CALLER)[2] for _, names in kind for name in names}

    def wait_for(self, *names):
        """Wait until all of these nodes are there."""
        eventually(lambda: set(names) <= self.names(), lambda: f"{names} in the graph; there is {self.names()}", 40.0)

    def pid(self, name):
        """The process of a node."""
        return xmlrpc.client.ServerProxy(self.master.lookupNode(CALLER, name)[2]).getPid(CALLER)[2]

    def clean_up(self):
        """End everything: first in order, since roslaunch ends what it started, the master last."""
        for process in reversed(self._processes):
            if process.runs():
                process.send(signal.SIGCONT)
                process.send(signal.SIGINT)
            try:
                process.wait_for_exit(20.0)
            except AssertionError:
                process.clean_up()
        shutil.rmtree(self.folder, ignore_errors=True)


class Situations(unittest.TestCase):
    """Looks with the doctor, under one master."""

    graph = None

    def look(self, *expected, options=(), also_fine=(), **environment):
        """The doctor finds exactly this.

        Args:
            expected: level, subject, words of what is found, and words of its remedy, for each finding but the good.
            options: the doctor's.
            also_fine: subjects and words of findings that are good.
            environment: the doctor's.
        """
        def once():
            examination = examine(*options, **{**(self.graph.env if self.graph else {}), **environment})
            shown = str(examination)
            check_order(self, examination)
            found = [finding for finding in examination.findings if finding[0] != OK and finding[1] not in COMPUTERS]
            for level, subject, words, remedy in expected:
                matching = [each for each in found if each[:2] == (level, subject) and words in each[2]
                            and remedy in each[2].partition(" | remedy: ")[2]]
                self.assertEqual(len(matching), 1, f"{(level, subject, words, remedy)} in\n{shown}")
                found.remove(matching[0])
            self.assertEqual(found, [], shown)
            for subject, words in also_fine:
                self.assertTrue(any(level == OK and words in text for level, text in examination.of(subject)), shown)
            for subject in ("packages", "gamepad"):
                self.assertNotIn(BAD, [level for level, _ in examination.of(subject)], shown)
        retried(once, 4)


HEALTHY = (("nodes", "run in /"), ("steering", "NO_HUMAN"), ("topics", "has the publishers that it should have"),
           ("reports", "turn_arb: steering"))


class WithoutMaster(Situations):
    def test_01_no_master(self):
        self.look((WARN, "master", "none runs at", "roslaunch"), (BAD, "port", "/dev/absent: there is no such", ""),
                  options=("--port", "/dev/absent", "--i2c", "virtual"), ROS_MASTER_URI=NOWHERE,
                  also_fine=[("bus", "virtual")])


class FourProcesses(Situations):
    """The virtual car as launched, without the drive, and what is done to it."""

    @classmethod
    def setUpClass(cls):
        cls.graph = Graph()
        cls.addClassCleanup(cls.graph.clean_up)
        cls.port = os.path.join(cls.graph.folder, "teensy")
        cls.launch = cls.graph.launch("demo.launch", "drive:=false", f"port:={cls.port}")
        cls.graph.wait_for(*(f"/{node}" for node in (*FIVE, "teleop_logi", "car_sim")))

    def call(self, service, text):
        """Call a service of a node."""
        done = self.graph.start(shutil.which("rosservice"), "call", service, text)
        self.assertEqual(done.wait_for_exit(), 0)

    def publish(self, *arguments):
        """Publish until the test ends."""
        process = self.graph.start(shutil.which("rostopic"), "pub", "-r", "10", *arguments)
        self.addCleanup(process.end)
        return process

    def test_01_healthy_car_without_a_gamepad(self):
        self.look(also_fine=(*HEALTHY, ("port", "/teensy_sensor_hub's"), ("Teensy", "fine"), ("bus", "virtual")))

    def test_02_publisher_of_a_wrong_type(self):
        self.publish("/av_turnrad_req", "std_msgs/Float64", "2.0")
        self.look((BAD, "topics", "on 127.0.0.1 publishes std_msgs/Float64 on /av_turnrad_req, which takes std_msgs/Fl",
                   "publish std_msgs/Float32"))

    def test_03_second_publisher_which_two_nodes_report_is_one_finding(self):
        self.publish("/teleop_logi/human_in_loop", "std_msgs/Bool", "false")
        self.look((BAD, "topics", "2 nodes publish on /teleop_logi/human_in_loop, /rostopic_",
                   "rosnode kill /rostopic_"))

    def test_04_second_node_on_a_channel(self):
        self.publish("/servo/cmdVector", "std_msgs/Int32MultiArray",
                     "{data: [5100, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1]}")
        self.look((BAD, "topics", "2 nodes command channel 0, /rostopic_", "rosnode kill /rostopic_"))

    def test_05_dev_null_given_as_port(self):
        """It is the standard input of every node, which doesn't make it the Teensy's port."""
        self.look((BAD, "port", "/dev/null: this is not a serial port", "ls /dev/serial"),
                  options=("--port", "/dev/null"))

    def test_06_directory_given_as_port(self):
        self.look((BAD, "port", "this is a directory, not a serial port", "ls /dev/serial"),
                  options=("--port", self.graph.folder))

    def test_07_hub_whose_port_was_unplugged(self):
        self.addCleanup(self.call, "/car_sim/inject_fault", "{fault: plug, value: 0}")
        self.call("/car_sim/inject_fault", "{fault: unplug, value: 0}")
        self.look((BAD, "port", f"{self.port}: there is no such port", "Plug the Teensy in"))

    def test_08_silent_teensy(self):
        self.look(also_fine=[("Teensy", "fine")])
        self.addCleanup(self.call, "/car_sim/inject_fault", "{fault: silence, value: 0}")
        self.call("/car_sim/inject_fault", "{fault: silence, value: 60}")
        self.look((BAD, "Teensy", "the port is open, but nothing comes from it", "Check the Teensy's power"),
                  also_fine=[("port", "/teensy_sensor_hub's")])

    def test_09_servo_board_without_power(self):
        self.addCleanup(self.call, "/pca9685/inject_fault", "{fault: power, value: 1}")
        self.call("/pca9685/inject_fault", "{fault: power, value: 0}")
        self.look((BAD, "reports", "pca9685: servo board: nothing answers at this address", ""))

    def test_10_hub_that_hangs(self):
        pid = self.graph.pid("/teensy_sensor_hub")
        self.addCleanup(os.kill, pid, signal.SIGCONT)
        os.kill(pid, signal.SIGSTOP)
        self.look((BAD, "nodes", "/teensy_sensor_hub is registered, but doesn't answer: it hangs, or its ROS_IP", ""),
                  (WARN, "port", f"{self.port}: teensy_sensor_hub (process {pid}) has it open, but doesn't answer",
                   "See the nodes above"))

    def test_11_doctor_under_another_master(self):
        self.look((WARN, "master", "none runs at", "roslaunch"),
                  (WARN, "port", "teensy_sensor_hub (process", "ROS_MASTER_URI"),
                  options=("--port", self.port, "--i2c", "virtual"), ROS_MASTER_URI=NOWHERE)

    def test_12_after_a_clean_exit(self):
        """A log line at the end leaves a subscription to a parameter at the master: every node can be looked up."""
        self.launch.end(signal.SIGINT, 30.0)
        self.look((WARN, "port", f"{self.port}: there is no virtual Teensy: car_sim, which makes this port, doesn't",
                   "roslaunch car_interface demo.launch"), (WARN, "bus", "doesn't run", "demo.launch"),
                  also_fine=[("nodes", "none of this package's runs in /")])


class OneProcess(Situations):
    """The same as one process."""

    @classmethod
    def setUpClass(cls):
        cls.graph = Graph()
        cls.addClassCleanup(cls.graph.clean_up)
        cls.port = os.path.join(cls.graph.folder, "teensy")
        cls.launch = cls.graph.launch("demo.launch", "drive:=false", f"port:={cls.port}", "one_process:=true")
        cls.graph.wait_for("/car_nodes", "/teleop_logi", "/car_sim")

    def test_01_healthy_car(self):
        self.look(also_fine=(*HEALTHY, ("nodes", f"{', '.join(FIVE)} in one process, /car_nodes"),
                             ("port", "/teensy_sensor_hub's"), ("Teensy", "fine")))

    def test_02_process_that_drives_the_car_is_not_to_be_ended(self):
        self.look((WARN, "master", "none runs at", "roslaunch"),
                  (WARN, "port", f"car_nodes (process {self.graph.pid('/car_nodes')}) has it open", "ROS_MASTER_URI"),
                  options=("--port", self.port, "--i2c", "virtual"), ROS_MASTER_URI=NOWHERE)

    def test_03_process_that_hangs(self):
        pid = self.graph.pid("/car_nodes")
        self.addCleanup(os.kill, pid, signal.SIGCONT)
        os.kill(pid, signal.SIGSTOP)
        self.look((BAD, "nodes", "/car_nodes is registered, but doesn't answer: it hangs", "end its process"),
                  (WARN, "port", f"car_nodes (process {pid}) has it open, but doesn't answer", "See the nodes above"),
                  (WARN, "bus", "the pca9685 node doesn't answer", "See the nodes above"))

    def test_04_after_everything_was_killed(self):
        pids = [self.graph.pid(name) for name in ("/car_nodes", "/teleop_logi", "/car_sim")]
        self.launch.send(signal.SIGKILL)
        for pid in pids:
            os.kill(pid, signal.SIGKILL)
        self.look((BAD, "nodes", "/car_nodes, /teleop_logi, /car_sim: killed or crashed; the master still lists them",
                   "Start the launch file again: roslaunch car_interface demo.launch. To clear the list: rosnode"),
                  (BAD, "port", "car_sim, which is behind this port, doesn't answer", "See the nodes above"),
                  (WARN, "bus", "the pca9685 node doesn't answer", "See the nodes above"))


class CarsInNamespaces(Situations):
    @classmethod
    def setUpClass(cls):
        cls.graph = Graph()
        cls.addClassCleanup(cls.graph.clean_up)
        cls.launch("car1")

    @classmethod
    def launch(cls, space):
        cls.graph.launch("demo.launch", f"ns:={space}", "drive:=false", "one_process:=true",
                         f"port:={cls.graph.folder}/{space}")
        cls.graph.wait_for(*(f"/{space}/{node}" for node in ("car_nodes", "teleop_logi", "car_sim")))

    def test_01_car_in_a_namespace_is_found_without_being_named(self):
        self.look(also_fine=(("nodes", "run in /car1"), ("port", "/car1/teensy_sensor_hub's"), ("Teensy", "fine"),
                             ("topics", "has the publishers")))

    def test_02_nothing_runs_in_the_namespace_that_is_asked_for(self):
        port = f"{self.graph.folder}/car1"
        self.look((WARN, "port", f"{port}: car_nodes (process", "--ns"), (WARN, "bus", "virtual", "demo.launch"),
                  options=("--ns", "other", "--port", port, "--i2c", "virtual"),
                  also_fine=[("nodes", "none of this package's runs in /other; there is one in /car1")])

    def test_03_of_two_cars_none_is_chosen_and_each_can_be_looked_at(self):
        self.launch("car2")
        self.look((WARN, "nodes", "there are 2 cars, in /car1 and /car2: none was looked at", "doctor --ns /car1"))
        with ThreadPoolExecutor() as pool:
            for done in [pool.submit(self.look, options=("--ns", space),
                                     also_fine=(("nodes", f"run in /{space}"), ("Teensy", "fine")))
                         for space in ("car1", "car2")]:
                done.result()


class SomeNodes(Situations):
    """A master, and nodes that are started one by one; each hub in a namespace of its own."""

    @classmethod
    def setUpClass(cls):
        cls.graph = Graph()
        cls.addClassCleanup(cls.graph.clean_up)

    def test_01_master_only(self):
        self.look((BAD, "port", "/dev/absent: there is no such port", "Plug the Teensy in"),
                  (WARN, "bus", "virtual", "demo.launch"), options=("--port", "/dev/absent", "--i2c", "virtual"),
                  also_fine=[("nodes", "none of this package's runs in /"), ("parameters", "none on the server")])

    def hub(self, space, port):
        """A hub with a port that can't be, and its state once it has tried."""
        node = self.graph.node("teensy_sensor_hub", f"__ns:=/{space}", f"_port:={port}")
        node.wait_for_line("Teensy on")
        return space

    def look_at_hub(self, space, words, remedy):
        self.look((BAD, "port", words, remedy),
                  (WARN, "nodes", f"not running in /{space}: turn_arb (nobody steers), pca9685 (no servo moves), gen",
                   f"roslaunch car_interface car.launch ns:=/{space}"), (WARN, "bus", "virtual", "demo.launch"),
                  options=("--ns", space, "--i2c", "virtual"))

    def test_02_hubs_with_ports_that_cannot_be(self):
        near, far = pty.openpty()
        self.addCleanup(os.close, near)
        self.addCleanup(os.close, far)
        holder = self.graph.start(sys.executable, "-c", HOLDER, os.ttyname(far))
        holder.wait_for_info("open")
        cases = {
            "absent": ("/dev/absent", "/dev/absent: there is no such port", "Plug the Teensy in"),
            "null": ("/dev/null", "/dev/null: this is not a serial port", "Set ~port"),
            "folder": (self.graph.folder, "this is a directory, not a serial port", "Set ~port"),
            "busy": (os.ttyname(far), f"{os.ttyname(far)}: another program has it open: ", "fuser -v"),
        }
        with ThreadPoolExecutor() as pool:
            list(pool.map(self.hub, cases, (port for port, _, _ in cases.values())))
        with ThreadPoolExecutor(2) as pool:
            for done in [pool.submit(self.look_at_hub, space, words, remedy)
                         for space, (_, words, remedy) in cases.items()]:
                done.result()

    def test_03_half_the_nodes_and_a_board_that_is_absent(self):
        self.graph.load("/half/turn_arb", "turn_arb.yaml")
        self.graph.node("turn_arb", "__ns:=/half")
        self.graph.node("pca9685", "__ns:=/half", "_device:=/dev/i2c-absent")
        self.look((WARN, "nodes", "not running in /half: teensy_sensor_hub (no wheel and no sonar reports), generic_va",
                   "roslaunch car_interface car.launch ns:=/half"),
                  (BAD, "bus", "/dev/i2c-absent: there is no such bus", ""),
                  (BAD, "reports", "half/pca9685: servo board: there is no such bus", ""),
                  (BAD, "port", "/dev/absent: there is no such port", ""),
                  options=("--ns", "half", "--port", "/dev/absent"))


class Demo(Situations):
    def test_01_during_the_scripted_drive(self):
        type(self).graph = Graph()
        self.addCleanup(self.graph.clean_up)
        self.graph.launch("demo.launch", f"port:={self.graph.folder}/teensy")
        self.graph.wait_for("/demo_drive", *(f"/{node}" for node in FIVE))
        self.look(also_fine=(("nodes", "run in /"), ("Teensy", "fine"), ("topics", "has the publishers")))


if __name__ == "__main__":
    rostest.rosrun("car_interface", "doctor_situations_test", "__main__")
