#!/usr/bin/env python3
"""The real doctor: a healthy car without hardware is ok, each thing that is broken is bad, and nothing is disturbed."""
from __future__ import annotations

import os
import pty
import re
import shutil
import signal
import socket
import struct
import subprocess
import tempfile
import termios
import unittest
from fcntl import ioctl
from xmlrpc.client import ServerProxy

import rosgraph
import rosnode
import rospy
import rostest
from car_interface.msg import LinkStatus, SteeringState
from car_interface.srv import InjectFault

from doctor_run import BAD, OK, WARN, check_order, examine, run
from waiting import PATIENCE_S, Topic, eventually, executable, retried, start, start_node

NOWHERE = "http://127.0.0.1:1"
HOLDER = """
import fcntl, os, sys
port = os.open(sys.argv[1], os.O_RDWR | os.O_NOCTTY)
fcntl.flock(port, fcntl.LOCK_EX)
print("open", flush=True)
sys.stdin.read()
"""


def pid_of(node):
    """The process of a node that roslaunch started."""
    uri = rosnode.get_api_uri(rosgraph.Master(rospy.get_name()), node)
    return ServerProxy(uri).getPid(rospy.get_name())[2]


class DoctorTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.port = rospy.get_param("~port")
        cls.links = Topic("/teensy_sensor_hub/link", LinkStatus).connected()
        cls.states = Topic("/turn_arb/state", SteeringState).connected()

    def setUp(self):
        self.wait_until_fine()

    def wait_until_fine(self):
        self.links.wait_for(lambda link: link.state == "fine", max(0, self.links.mark() - 1))
        self.states.wait_for_count(2, self.states.mark())

    def check(self, examination, subject, level, words="", remedy=""):
        """A finding with this level and these words is there; the whole is in order."""
        shown = str(examination)
        self.assertIn(level, [found for found, _ in examination.of(subject)], shown)
        texts = [text for found, text in examination.of(subject) if found == level]
        self.assertTrue(any(words in text and remedy in text.partition(" | remedy: ")[2] for text in texts), shown)
        check_order(self, examination)

    def replace_param(self, path, value):
        """Set a parameter until the test ends."""
        if rospy.has_param(path):
            self.addCleanup(rospy.set_param, path, rospy.get_param(path))
        else:
            self.addCleanup(rospy.delete_param, path)
        rospy.set_param(path, value)


class HealthyCar(DoctorTest):
    def test_nothing_is_bad_and_everything_was_looked_at(self):
        examination = examine()
        self.assertIn(examination.code, (0, 1), "\n".join(examination.lines))  # no NTP, no doubt
        for subject, words in (("versions", "Python 3."), ("address", "127.0.0.1"), ("nodes", "car_sim"),
                               ("parameters", "/pca9685"), ("port", "/teensy_sensor_hub's"),
                               ("Teensy", "frames a second; pong after"), ("bus", "virtual"),
                               ("steering", "NO_HUMAN"), ("reports", "pca9685: servo board")):
            self.check(examination, subject, OK, words)
        self.check(examination, "master", OK, "on the loopback only")
        for subject in ("groups", "clock"):
            self.assertTrue(examination.of(subject))

    def test_it_leaves_no_trace(self):
        marks = self.links.mark(), self.states.mark()
        duty = self.states.since(marks[1] - 1)[-1].duty
        examine()
        eventually(lambda: not any(re.match(r"/doctor_\d", name) for name in rosnode.get_node_names()),
                   "no doctor among the nodes")
        self.links.wait_for_count(2, self.links.mark())
        links = self.links.since(marks[0])
        self.assertEqual({link.state for link in links}, {"fine"})
        self.assertEqual({link.reconnects for link in links}, {links[0].reconnects})
        self.assertEqual({link.bad_frames for link in links}, {links[0].bad_frames})
        self.assertEqual({state.duty for state in self.states.since(marks[1])}, {duty})

    def test_it_leaves_no_file_behind(self):
        """It reads the parameters of a virtual chip that writes a log, and listens by rospy, which would, too."""
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        log = os.path.join(folder.name, "chip")
        self.replace_param("/pca9685/virtual_log", log)
        places = {name: os.path.join(folder.name, name) for name in ("HOME", "ROS_HOME", "ROS_LOG_DIR", "TMPDIR")}
        examination = examine(**places, cwd=folder.name)
        self.check(examination, "parameters", OK, "/pca9685")
        self.check(examination, "steering", OK, "NO_HUMAN")
        self.assertEqual([path for path, _, _ in os.walk(folder.name)] + os.listdir(folder.name), [folder.name])

    def test_other_namespace_has_no_car(self):
        examination = examine("--ns", "car1", "--i2c", "virtual")
        self.check(examination, "nodes", OK, "none of this package's runs in /car1")
        self.check(examination, "parameters", OK, "none on the server")

    def test_virtual_teensy_without_a_hub_is_heard_through_its_port(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        port = os.path.join(folder.name, "teensy")
        start_node(self, "car_sim", f"_port:={port}", name="other_sim")
        eventually(lambda: os.path.exists(port), "the other Teensy's port")

        def hear():
            examination = examine("--port", port)
            self.check(examination, "port", OK, "a virtual Teensy")
            self.check(examination, "Teensy", OK, "pong after")
        retried(hear, times=3)

    def test_setup_is_shown_and_not_done(self):
        done = run(executable("setup_hardware"), "--dry-run", "--user", "nobody")
        self.assertEqual((done.returncode, done.stderr), (0, ""))
        self.assertIn("usermod --append --groups dialout,i2c,input nobody", done.stdout)
        self.assertIn("log out and in again", done.stdout)
        self.assertEqual(run(executable("setup_hardware"), "--dry-run", "--user", "nobody").stdout, done.stdout)


class BrokenSetUps(DoctorTest):
    def test_without_a_master_it_says_so_and_goes_on(self):
        examination = examine("--port", self.port, "--i2c", "virtual", ROS_MASTER_URI=NOWHERE)
        self.check(examination, "master", WARN, f"none runs at {NOWHERE}", "roslaunch")
        self.check(examination, "port", WARN, "teensy_sensor_hub (process", "ROS_MASTER_URI")
        self.assertEqual(examination.code, 1)
        self.assertFalse(examination.of("parameters") or examination.of("reports"))

    def test_unset_master_uri_is_bad(self):
        self.check(examine(ROS_MASTER_URI=""), "master", BAD, "not set")

    def test_something_else_in_the_masters_place_is_bad(self):
        with socket.socket() as other:
            other.bind(("127.0.0.1", 0))
            other.listen(10)
            uri = f"http://127.0.0.1:{other.getsockname()[1]}"
            self.check(examine(ROS_MASTER_URI=uri), "master", BAD, "doesn't answer as a master", "End it")

    def test_exposed_master_is_a_warning(self):
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            port = probe.getsockname()[1]
        environment = {**os.environ, "ROS_IP": ""}
        master = subprocess.Popen(["rosmaster", "--core", "-p", str(port)], env=environment, stdout=subprocess.DEVNULL,
                                  stderr=subprocess.DEVNULL)
        self.addCleanup(master.wait)
        self.addCleanup(master.kill)
        with socket.socket() as probe:
            eventually(lambda: probe.connect_ex(("127.0.0.1", port)) == 0, "a master")
        self.check(examine(ROS_MASTER_URI=f"http://127.0.0.1:{port}"), "master", WARN, "every interface", "ROS_IP")

    def test_address_of_another_computer_is_bad(self):
        self.check(examine(ROS_IP="192.0.2.1"), "address", BAD, "isn't this computer's", "ROS_IP")

    def test_absent_port_and_bus_are_bad(self):
        examination = examine("--port", "/dev/absent", "--i2c", "/dev/i2c-absent")
        self.check(examination, "port", BAD, "/dev/absent: there is no such port", "ls /dev/serial/by-id")
        self.check(examination, "bus", BAD, "there is no such bus")

    def test_directory_file_and_other_device_are_no_port_and_no_bus(self):
        with tempfile.NamedTemporaryFile() as file:
            for path, words in ((tempfile.gettempdir(), "directory"), (file.name, "not a serial port"),
                                ("/dev/null", "not a serial port")):
                examination = examine("--port", path, "--i2c", path)
                self.check(examination, "port", BAD, words)
                self.check(examination, "bus", BAD, "not an I2C bus")

    def test_port_that_another_program_has_is_bad_and_the_program_is_named(self):
        near, far = pty.openpty()
        self.addCleanup(os.close, near)
        self.addCleanup(os.close, far)
        holder = start(self, "/usr/bin/python3", "-c", HOLDER, os.ttyname(far))
        holder.wait_for_info("open")
        self.check(examine("--port", os.ttyname(far)), "port", BAD, f"(process {holder.pid})", "fuser")

    def test_silent_teensy_is_bad(self):
        near, far = pty.openpty()
        self.addCleanup(os.close, near)
        self.addCleanup(os.close, far)
        self.check(examine("--port", os.ttyname(far)), "Teensy", BAD, "nothing comes", "TX")

    def test_table_that_makes_no_sense_and_map_that_is_not_there_are_told(self):
        table = rospy.get_param("/turn_arb/k_pwmcmd_left_table_servo")
        self.replace_param("/turn_arb/k_pwmcmd_left_table_servo", table[:-1])
        self.replace_param("/generic_value_converter/csv_path_value_map", "/nowhere.csv")
        self.replace_param("/pca9685/virtual_log", "chip.log")
        examination = examine()
        for words in ("k_pwmcmd_left_table_servo is [",
                      "csv_path_value_map is '/nowhere.csv'; accepted: a file that can",
                      "virtual_log is 'chip.log'; accepted: a whole path, from / on"):
            self.check(examination, "parameters", BAD, words, "YAML")

    def test_name_that_comes_twice_in_a_file_of_the_car_is_told(self):
        folder = tempfile.mkdtemp()
        self.addCleanup(shutil.rmtree, folder)
        path = os.path.join(folder, "turn_arb.yaml")
        with open(path, "w", encoding="utf-8") as file:
            file.write("servo_left: 3800\nservo_center: 5100\nservo_left: 3700\n")
        self.replace_param("/turn_arb/save_to", path)
        self.check(examine(), "files", WARN, f"{path}, lines 1 and 3 both give servo_left", "Correct the file")

    def test_bad_parameters_are_told_as_the_node_would(self):
        for path, value in (("/turn_arb/servo_left", 99999), ("/pca9685/frequnecy", 60),
                            ("/teensy_sensor_hub/ping_period", "soon"), ("/teleop_logi/steer_axis", 3000),
                            ("/generic_value_converter/odometry_timeout", -1), ("/car_sim/wheelbase", 0),
                            ("/throttle_arb/esc/profile", "xl5")):
            self.replace_param(path, value)
        examination = examine()
        for words in ("/turn_arb: it will not start again with these: servo_left is 99999",
                      "unknown parameter frequnecy is 60", "ping_period is 'soon'", "odometry_timeout is -1",
                      "steer_axis is 3000", "wheelbase is 0", "esc/profile is 'xl5'"):
            self.check(examination, "parameters", BAD, words, "YAML")
        self.assertNotIn(OK, [level for level, _ in examination.of("parameters")])

    def test_lost_servo_board_is_bad(self):
        inject = rospy.ServiceProxy("/pca9685/inject_fault", InjectFault)
        self.addCleanup(inject, "power", 1)
        inject("power", 0)

        def report():
            self.check(examine(), "reports", BAD, "pca9685: servo board: nothing answers at this address")
        retried(report)

    def test_silent_teensy_is_told_by_its_hub(self):
        inject = rospy.ServiceProxy("/car_sim/inject_fault", InjectFault)
        self.addCleanup(self.wait_until_fine)
        self.addCleanup(inject, "plug", 0)
        inject("unplug", 0)
        self.links.wait_for(lambda link: link.state == "port absent", self.links.mark())
        examination = examine()
        self.check(examination, "port", BAD, "there is no such port")
        self.assertEqual([level for level, _ in examination.of("port")], [BAD])

    def test_frozen_nodes_are_bad_and_do_not_hold_it_up(self):
        pids = [pid_of(node) for node in ("/turn_arb", "/teensy_sensor_hub", "/pca9685")]
        for pid in pids:
            self.addCleanup(os.kill, pid, signal.SIGCONT)
            os.kill(pid, signal.SIGSTOP)
        examination = examine()
        for node in ("turn_arb", "teensy_sensor_hub", "pca9685"):
            self.check(examination, "nodes", BAD, f"/{node} is registered, but doesn't answer")
        self.check(examination, "port", WARN, "teensy_sensor_hub (process")

    def test_missing_library_is_told_and_the_rest_goes_on(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        for name in ("serial", "smbus2", "rospy"):
            with open(os.path.join(folder.name, f"{name}.py"), "w", encoding="ascii") as file:
                file.write("raise ImportError('not there')\n")
        path = f"{folder.name}:{os.environ['PYTHONPATH']}"
        # A pseudo-terminal of our own: the hub, which has the other one, can't be asked without rospy.
        near, far = pty.openpty()
        self.addCleanup(os.close, near)
        self.addCleanup(os.close, far)
        examination = examine("--port", os.ttyname(far), PYTHONPATH=path)
        for name, remedy in (("serial", "python3-serial"), ("smbus2", "python3-smbus2"), ("rospy", "rospy")):
            self.check(examination, "versions", BAD, f"{name} can't be imported", remedy)
        self.check(examination, "parameters", BAD, "can't be imported")
        self.check(examination, "port", BAD, "the doctor couldn't look at it")
        self.check(examination, "master", OK)


class OnATerminal(DoctorTest):
    def show(self, columns, **environment):
        """What the doctor shows on a terminal so wide."""
        near, far = pty.openpty()
        ioctl(far, termios.TIOCSWINSZ, struct.pack("HHHH", 24, columns, 0, 0))
        clean = {name: value for name, value in os.environ.items() if name not in ("COLUMNS", "NO_COLOR")}
        process = subprocess.Popen([executable("doctor"), "--port", "/dev/absent"], stdin=far, stdout=far, stderr=far,
                                   env={**clean, "TERM": "xterm", **environment})
        os.close(far)
        shown = b""
        while True:
            try:
                data = os.read(near, 4096)
            except OSError:  # how Linux says that nobody has the far end open any more
                break
            if not data:
                break
            shown += data
        os.close(near)
        self.assertEqual(process.wait(PATIENCE_S), 2)
        return shown.decode().replace("\r\n", "\n")

    def test_lines_are_wrapped_and_coloured(self):
        for columns in (80, 120):
            shown = self.show(columns)
            self.assertIn("\033[1;31mbad \033[0m  port", shown)
            self.assertRegex(shown, "\n {18}remedy: ")
            plain = re.sub("\033\\[[0-9;]*m", "", shown)
            self.assertNotIn("\033", plain)
            self.assertLessEqual(max(map(len, plain.split("\n"))), columns)

    def test_no_color_is_heeded(self):
        self.assertNotIn("\033", self.show(80, NO_COLOR="1"))
        self.assertNotIn("\033", self.show(80, TERM="dumb"))

    def test_reader_that_leaves_is_no_fault(self):
        done = run("bash", "-c", f"{executable('doctor')} | head -n 1")
        self.assertEqual((len(done.stdout.splitlines()), done.stderr), (1, ""), done.stderr)

    def test_wrong_option_is_refused(self):
        for options in (["--address", "0x99"], ["--address", "x"], ["--what"]):
            examination = examine(*options)
            self.assertEqual(examination.code, 2)
            self.assertIn("usage: doctor", examination.errors)
            self.assertNotIn("Traceback", examination.errors)


if __name__ == "__main__":
    rospy.init_node("doctor_test")
    rostest.rosrun("car_interface", "doctor_test", "__main__")
