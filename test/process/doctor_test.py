#!/usr/bin/env python3
"""The doctor, as a user types it, about one car in one situation after another: it says exactly what is the matter."""
from __future__ import annotations

import os
import pty
import re
import shutil
import signal
import socket
import struct
import subprocess
import sys
import tempfile
import termios
import unittest
from concurrent.futures import ThreadPoolExecutor
from fcntl import ioctl
from typing import NamedTuple

import rosnode
import rospy
import rostest
from car_interface.msg import LinkStatus
from car_interface.srv import InjectFault

from closing import HOLDER, pid_of
from waiting import PATIENCE_S, NodeProcess, Topic, eventually, examine, executable, set_params, start

OK, WARN, BAD = "ok", "warn", "bad"
CODES = {OK: 0, WARN: 1, BAD: 2}
NOWHERE = "http://127.0.0.1:1"
# What depends on the computer that the tests run on, and no situation changes.
COMPUTERS = ("clock", "groups", "versions", "packages")
NODES = ("turn_arb", "pca9685", "teensy_sensor_hub", "generic_value_converter", "throttle_arb", "teleop_logi",
         "car_sim")
NO_JOY = (WARN, "gamepad", "no node publishes /car1/joy, so that no deadman can be held", "gamepad:=true")
VIRTUAL_BUS = (WARN, "bus", "virtual", "demo.launch")


class Examination(NamedTuple):
    code: int
    lines: list
    errors: str

    @classmethod
    def of(cls, done):
        return cls(done.returncode, done.stdout.splitlines(), done.stderr)

    @property
    def findings(self):
        found = [re.match(r"(ok|warn|bad) +(\S+) +(.*)", line) for line in self.lines[:-1]]
        return [match.groups() for match in found]

    def __str__(self):
        return "\n".join([*self.lines, self.errors])


def run(*command):
    return subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=120, check=False)


class Doctor(unittest.TestCase):
    """One car, which is launched once, in a namespace. The methods run by their names; the last one ends it."""

    @classmethod
    def setUpClass(cls):
        cls.folder = tempfile.mkdtemp(prefix="doctor_test")
        cls.addClassCleanup(shutil.rmtree, cls.folder, ignore_errors=True)
        cls.port = os.path.join(cls.folder, "teensy")
        cls.links = Topic("/car1/teensy_sensor_hub/link", LinkStatus)
        cls.launch = NodeProcess("roslaunch", "car_interface", "demo.launch", "ns:=car1", "drive:=false",
                                 f"port:={cls.port}")
        cls.addClassCleanup(cls.launch.clean_up)
        cls.addClassCleanup(cls.launch.end)
        cls.wait_for_nodes(*(f"/car1/{node}" for node in NODES))
        cls.links.wait_for(lambda link: link.state == "fine")

    @staticmethod
    def wait_for_nodes(*names):
        eventually(lambda: set(names) <= set(rosnode.get_node_names()),
                   lambda: f"{names} in the graph; there is {rosnode.get_node_names()}")

    def look(self, *expected, options=(), fine=(), cwd=None, **environment):
        """The doctor finds exactly this; what it shows is in order.

        Args:
            expected: level, subject, words of what is found and of its remedy, for each finding but the good.
            options: the doctor's.
            fine: subject and words of findings that are good.
            environment: the doctor's.
        """
        examination = Examination.of(examine(*options, env=environment, cwd=cwd))
        shown = str(examination)
        levels = [level for level, _, _ in examination.findings]
        self.assertEqual((examination.errors, len(levels)), ("", len(examination.lines) - 1), shown)
        self.assertEqual([" | remedy: " in line for line in examination.lines[:-1]], [level != OK for level in levels],
                         shown)
        counts = ", ".join(f"{levels.count(level)} {level}" for level in (BAD, WARN, OK) if level in levels)
        self.assertTrue(examination.lines[-1].startswith(f"{counts}: "), shown)
        self.assertEqual(examination.code, max(CODES[level] for level in levels), shown)
        found = [finding for finding in examination.findings if finding[0] != OK and finding[1] not in COMPUTERS]
        for level, subject, words, remedy in expected:
            matching = [each for each in found if each[:2] == (level, subject) and words in each[2]
                        and remedy in each[2].partition(" | remedy: ")[2]]
            self.assertEqual(len(matching), 1, f"{(level, subject, words, remedy)} in\n{shown}")
            found.remove(matching[0])
        self.assertEqual(found, [], shown)
        for subject, words in fine:
            self.assertTrue(any(level == OK and about == subject and words in text
                                for level, about, text in examination.findings), f"{subject} {words} in\n{shown}")
        return examination

    def look_at_each(self, *cases):
        """Several examinations side by side: (what is expected, keywords)."""
        with ThreadPoolExecutor(2) as pool:
            for done in [pool.submit(self.look, *expected, **keywords) for expected, keywords in cases]:
                done.result()

    def publish(self, *arguments):
        process = start(self, "rostopic", "pub", "-r", "10", *arguments)

        def end():
            if process.runs():  # a signal that comes between two of rospy's own threads may be missed
                process.send(signal.SIGINT)
            return not process.runs()
        self.addCleanup(eventually, end, "rostopic ends")

    def inject(self, service, fault, value, cure, cured):
        """Have a fault until the test ends."""
        rospy.wait_for_service(service, PATIENCE_S)
        call = rospy.ServiceProxy(service, InjectFault)
        self.addCleanup(call, cure, cured)
        call(fault, value)

    def stop(self, *nodes):
        pids = [pid_of(node) for node in nodes]
        for pid in pids:
            self.addCleanup(os.kill, pid, signal.SIGCONT)
            os.kill(pid, signal.SIGSTOP)
        return pids

    def test_1_healthy_car_is_fine_and_the_doctor_leaves_no_trace_and_no_file(self):
        place = os.path.join(self.folder, "empty")
        os.mkdir(place)
        set_params(self, "/car1/pca9685", {"virtual_log": os.path.join(place, "chip")})
        before = self.links.newest
        self.look(NO_JOY, cwd=place, fine=(
            ("address", "127.0.0.1"), ("master", "on the loopback only"), ("nodes", "car_sim run in /car1"),
            ("parameters", "/car1/pca9685"), ("port", "/car1/teensy_sensor_hub's"), ("Teensy", "fine"),
            ("Teensy", "frames a second; pong after"), ("bus", "virtual"), ("steering", "NO_HUMAN"),
            ("topics", "has the publishers that it should have"), ("reports", "car1/turn_arb: steering"),
            ("reports", "car1/pca9685: servo board")),
            **{name: os.path.join(place, name) for name in ("HOME", "ROS_HOME", "ROS_LOG_DIR", "TMPDIR")})
        self.assertEqual(os.listdir(place), [])
        eventually(lambda: not any(re.match(r"/doctor_\d", name) for name in rosnode.get_node_names()),
                   "no doctor among the nodes")
        # A hub that stood still meanwhile may have been "silent" for a second.
        after = self.links.wait_for(lambda link: link.state == "fine", self.links.mark()).what
        self.assertEqual((after.reconnects, after.bad_frames), (before.reconnects, before.bad_frames))

    def test_2_wrong_type_second_publisher_and_second_node_on_a_channel_are_named(self):
        self.publish("/car1/control/command/control_cmd", "std_msgs/Float64", "2.0")
        self.publish("/car1/teleop_logi/human_in_loop", "std_msgs/Bool", "false")
        self.publish("/car1/servo/cmdVector", "std_msgs/Int32MultiArray", f"{{data: [5100{', -1' * 15}]}}")
        eventually(lambda: sum(name.startswith("/rostopic_") for name in rosnode.get_node_names()) >= 3,
                   "the publishers")
        self.look(NO_JOY,
                  *((BAD, "topics", words, remedy) for words, remedy in (
                      ("publishes std_msgs/Float64 on /car1/control/command/control_cmd, which takes car_interface/C",
                       "publish car_interface/Control"),
                      ("2 nodes publish on /car1/teleop_logi/human_in_loop, /car1/teleop_logi on 127.0.0.1 and /rosto",
                       "rosnode kill /rostopic_"),
                      ("2 nodes command channel 0, /car1/turn_arb on 127.0.0.1 and /rostopic_",
                       "rosnode kill /rostopic_"))))

    def test_3_bad_parameters_and_files_are_told_as_the_nodes_would(self):
        path = os.path.join(self.folder, "turn_arb.yaml")
        with open(path, "w", encoding="utf-8") as file:
            file.write("servo_left: 3800\nservo_center: 5100\nservo_left: 3700\n")
        cases = {"turn_arb/servo_left": (99999, "/turn_arb: it will not start again with these: servo_left is 99999"),
                 "pca9685/frequnecy": (60, "unknown parameter frequnecy is 60"),
                 "teensy_sensor_hub/ping_period": ("soon", "ping_period is 'soon'"),
                 "teleop_logi/steer_axis": (3000, "steer_axis is 3000"), "car_sim/track": (0, "track is 0"),
                 "generic_value_converter/csv_path_value_map": (
                     "/nowhere.csv", "csv_path_value_map is '/nowhere.csv'; accepted: a file that can"),
                 "throttle_arb/esc/profile": ("xl5", "profile is 'xl5'"), "turn_arb/save_to": (path, None)}
        for each, (value, _) in cases.items():
            name = f"/car1/{each}"
            restore = (rospy.set_param, name, rospy.get_param(name)) if rospy.has_param(name) else (
                rospy.delete_param, name)
            self.addCleanup(*restore)
            rospy.set_param(name, value)
        self.look(NO_JOY, (WARN, "files", f"{path}, lines 1 and 3 both give servo_left", "Correct the file"),
                  *((BAD, "parameters", words, "YAML") for _, words in cases.values() if words))

    def test_4_ports_and_buses_that_cannot_be_are_named(self):
        (near, far), (near_held, held) = pty.openpty(), pty.openpty()
        for fd in (near, far, near_held, held):
            self.addCleanup(os.close, fd)
        holder = start(self, sys.executable, "-c", HOLDER, os.ttyname(held))
        holder.wait_for_info("open")
        self.look_at_each(*(
            ((NO_JOY, (BAD, "port", port_words, port_remedy), (BAD, "bus", bus_words, "")),
             {"options": ("--port", path, "--i2c", path)})
            for path, port_words, port_remedy, bus_words in (
                ("/dev/absent", "/dev/absent: there is no such port", "ls /dev/serial/by-id", "there is no such bus"),
                (self.folder, "this is a directory, not a serial port", "ls /dev/serial", "not an I2C bus"),
                ("/dev/null", "/dev/null: this is not a serial port", "ls /dev/serial", "not an I2C bus"))),
            ((NO_JOY, (BAD, "port", f"(process {holder.pid})", "fuser")), {"options": ("--port", os.ttyname(held))}),
            ((NO_JOY, (BAD, "Teensy", "nothing comes", "TX")), {"options": ("--port", os.ttyname(far))}))

    def test_5_teensy_that_is_unplugged_and_a_board_without_power_are_told_by_their_nodes(self):
        self.addCleanup(lambda: self.links.wait_for(lambda link: link.state == "fine", self.links.mark()))
        self.inject("/car1/car_sim/inject_fault", "unplug", 0, "plug", 0)
        self.inject("/car1/pca9685/inject_fault", "power", 0, "power", 1)
        self.links.wait_for(lambda link: link.state == "port absent", self.links.mark())
        self.look(NO_JOY, (BAD, "port", f"{self.port}: there is no such port", "Plug the Teensy in"),
                  (BAD, "reports", "car1/pca9685: servo board: nothing answers at this address", ""))

    def test_6_nodes_that_hang_are_named_and_do_not_hold_it_up(self):
        _, hub, _ = self.stop(*(f"/car1/{node}" for node in ("turn_arb", "teensy_sensor_hub", "pca9685")))
        self.look(NO_JOY,
                  *((BAD, "nodes", f"/car1/{node} is registered, but doesn't answer: it hangs, or its ROS_IP", "")
                    for node in ("turn_arb", "teensy_sensor_hub", "pca9685")),
                  (WARN, "port", f"{self.port}: teensy_sensor_hub (process {hub}) has it open, but doesn't answer",
                   "See the nodes above"), (WARN, "bus", "the pca9685 node doesn't answer", "See the nodes above"))

    def test_7_masters_addresses_and_libraries_that_are_not_as_they_should_be(self):
        other = socket.socket()
        self.addCleanup(other.close)
        other.bind(("127.0.0.1", 0))
        other.listen(10)
        libraries = os.path.join(self.folder, "libraries")
        os.mkdir(libraries)
        for name in ("serial", "smbus2", "rospy"):
            with open(os.path.join(libraries, f"{name}.py"), "w", encoding="ascii") as file:
                file.write("raise ImportError('not there')\n")
        near, far = pty.openpty()
        self.addCleanup(os.close, near)
        self.addCleanup(os.close, far)
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            port = probe.getsockname()[1]
        exposed = subprocess.Popen(["rosmaster", "--core", "-p", str(port)], env={**os.environ, "ROS_IP": ""},
                                   stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        self.addCleanup(exposed.wait)
        self.addCleanup(exposed.kill)
        with socket.socket() as probe:
            eventually(lambda: probe.connect_ex(("127.0.0.1", port)) == 0, "a master")
        absent = {"options": ("--port", "/dev/absent", "--i2c", "virtual")}
        no_port = (BAD, "port", "/dev/absent: there is no such port", "")
        held = (WARN, "port", "teensy_sensor_hub (process", "ROS_MASTER_URI")
        self.look_at_each(
            (((WARN, "master", f"none runs at {NOWHERE}", "roslaunch"), held),
             {"options": ("--port", self.port, "--i2c", "virtual"), "ROS_MASTER_URI": NOWHERE,
              "fine": [("bus", "virtual")]}),
            (((BAD, "master", "doesn't answer as a master", "End it"), no_port),
             {**absent, "ROS_MASTER_URI": f"http://127.0.0.1:{other.getsockname()[1]}"}),
            (((WARN, "master", "every interface", "ROS_IP"), VIRTUAL_BUS, no_port),
             {**absent, "ROS_MASTER_URI": f"http://127.0.0.1:{port}"}))
        found = Examination.of(examine("--port", os.ttyname(far), env={
            "ROS_IP": "192.0.2.1", "PYTHONPATH": f"{libraries}:{os.environ['PYTHONPATH']}"}))
        for subject, words in (*(("versions", f"{name} can't be imported") for name in ("serial", "smbus2", "rospy")),
                               ("address", "isn't this computer's"),
                               ("port", "the doctor couldn't look at it")):
            self.assertTrue(any((BAD, subject) == each[:2] and words in each[2] for each in found.findings), found)
        self.assertEqual(found.errors, "")

    def test_8_what_it_shows_on_a_terminal_and_in_pipes(self):
        def show(columns, **environment):
            near, far = pty.openpty()
            ioctl(far, termios.TIOCSWINSZ, struct.pack("HHHH", 24, columns, 0, 0))
            clean = {name: value for name, value in os.environ.items() if name not in ("COLUMNS", "NO_COLOR")}
            process = subprocess.Popen([executable("doctor"), "--port", "/dev/absent", "--ns", "other"],
                                       stdin=far, stdout=far, stderr=far, env={**clean, "TERM": "xterm", **environment})
            os.close(far)
            shown = b""
            while True:
                try:
                    shown += os.read(near, 4096)
                except OSError:  # how Linux says that nobody has the far end open any more
                    break
            os.close(near)
            self.assertEqual(process.wait(PATIENCE_S), 2)
            return shown.decode().replace("\r\n", "\n")
        coloured, plain = show(80), show(80, NO_COLOR="1")
        self.assertIn("\033[1;31mbad \033[0m  port", coloured)
        text = re.sub("\033\\[[0-9;]*m", "", coloured)
        self.assertRegex(text, "\n {18}remedy: ")
        self.assertLessEqual(max(map(len, text.split("\n"))), 80)
        self.assertNotIn("\033", text + plain)
        done = run("bash", "-c", f"{executable('doctor')} --ns other | head -n 1")
        self.assertEqual((len(done.stdout.splitlines()), done.stderr), (1, ""))
        done = run(executable("doctor"), "--address", "0x99")
        self.assertEqual((done.returncode, "usage: doctor" in done.stderr), (2, True))
        done = run(executable("setup_hardware"), "--dry-run", "--user", "nobody")
        self.assertEqual((done.returncode, done.stderr), (0, ""))
        self.assertIn("usermod --append --groups dialout,i2c,input nobody", done.stdout)

    def test_9_a_second_car_in_one_process_then_both_are_gone(self):
        second = start(self, "roslaunch", "car_interface", "car_nodes.launch", "ns:=car2", "port:=/dev/absent",
                       "i2c:=/dev/i2c-absent")
        self.addCleanup(second.end)
        self.wait_for_nodes("/car2/car_nodes")
        pid = pid_of("/car2/car_nodes")
        lacks = (WARN, "nodes", "not running in /car2: ", "roslaunch car_interface car.launch ns:=/car2")
        absent = (BAD, "bus", "/dev/i2c-absent: there is no such bus", "")
        files = (WARN, "files", "the nodes were launched with the package's own files", "config:=$HOME/my_car")
        self.look_at_each(
            (((WARN, "nodes", "there are 2 cars, in /car1 and /car2: none was looked at",
               "doctor --ns /car1"),), {}),
            ((lacks, files, absent, (BAD, "port", "/dev/absent: there is no such port", "Plug the Teensy in")),
             {"options": ("--ns", "car2"), "fine": [("nodes", "in one process, /car2/car_nodes")]}),
            (((WARN, "port", f"{self.port}: teensy_sensor_hub (process", "--ns"), VIRTUAL_BUS),
             {"options": ("--ns", "other", "--port", self.port, "--i2c", "virtual"),
              "fine": [("nodes", "none of this package's runs in /other; there "),
                       ("parameters", "none on the server")]}))
        self.launch.end(signal.SIGINT)
        second.send(signal.SIGKILL)
        os.kill(pid, signal.SIGKILL)
        self.look((BAD, "nodes", "/car2/car_nodes: killed or crashed; the master still lists",
                   "To clear the list: rosnode cleanup"), lacks, files, absent,
                  (BAD, "port", "/dev/absent: there is no such port", ""),
                  options=("--ns", "car2"))
        self.look((WARN, "port", f"{self.port}: there is no virtual Teensy: car_sim, which makes this port, doesn't",
                   "roslaunch car_interface demo.launch"), (WARN, "bus", "doesn't run", "demo.launch"),
                  options=("--ns", "car1"), fine=[("nodes", "none of this package's runs in /car1")])


if __name__ == "__main__":
    rospy.init_node("doctor_test")
    rostest.rosrun("car_interface", "doctor_test", "__main__")
