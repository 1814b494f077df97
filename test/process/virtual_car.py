"""A master and a car's nodes, each a process that a test may kill or stop, and what the chip under them was given."""
import bisect
import os
import shutil
import socket
import subprocess
import sys
import tempfile

import rospkg
import yaml

from waiting import PATIENCE_S, NodeProcess, eventually, executable, one_process_params

PACKAGE = rospkg.RosPack().get_path("car_interface")
HERE = os.path.dirname(os.path.abspath(__file__))
DRIVER = os.path.join(HERE, "chain_driver.py")
CENTER, LEFT, RIGHT, ESC_NEUTRAL = 319, 238, 419, 307  # counts of 5100, 3800, 6700, 4915
CONVERTER = ("generic_value_converter/input/control_cmd:=control/command/control_cmd",
             "generic_value_converter/input/odometry:=localization/kinematic_state")
THROTTLE = ("throttle_arb/input/value:=generic_value_converter/output/value",
            "throttle_arb/input/odometry:=localization/kinematic_state")
START_WITHIN_S = 60  # of a program on a machine with much other work
PYTHON38 = os.environ.get("CAR_INTERFACE_PYTHON38")  # one that can import rospy, with its PYTHONPATH
OTHER_PYTHONPATH = os.environ.get("CAR_INTERFACE_OTHER_PYTHONPATH")


class Chip:
    """What the virtual chip's channels were given, and when: its log, read as it grows."""

    def __init__(self, path):
        self.path = path
        self._offset = 0
        self._times_ns = [[] for _ in range(16)]  # by channel
        self._counts = [[] for _ in range(16)]

    def _read(self):
        if not os.path.exists(self.path):
            return
        with open(self.path, encoding="ascii") as file:
            file.seek(self._offset)
            text = file.read()
        whole = text[:text.rfind("\n") + 1]
        self._offset += len(whole)
        for line in whole.splitlines():
            at_ns, _, register, data = line.split()
            first, data = int(register, 16), bytes.fromhex(data)
            if first == 0xFD:  # all off
                for channel in range(16):
                    self._add(channel, int(at_ns), 0)
            elif 6 <= first < 70:
                for offset in range(0, len(data), 4):
                    _, on_high, low, high = data[offset:offset + 4]
                    counts = 4096 if on_high & 0x10 else 0 if high & 0x10 else 256 * high + low
                    self._add((first - 6) // 4 + offset // 4, int(at_ns), counts)

    def _add(self, channel, at_ns, counts):
        self._times_ns[channel].append(at_ns)
        self._counts[channel].append(counts)

    def counts(self, channel):
        self._read()
        return self._counts[channel][-1] if self._counts[channel] else None

    def wait_for(self, channel, wanted, since_ns=0, within_s=PATIENCE_S):
        """When a channel was first given what ``wanted`` accepts, from then on, ns; or since when it holds it."""
        times_ns, counts = self._times_ns[channel], self._counts[channel]

        def found():
            self._read()
            first = bisect.bisect_right(times_ns, since_ns)
            if since_ns and first and wanted(counts[first - 1]):
                return since_ns
            return next((times_ns[index] for index in range(first, len(times_ns)) if wanted(counts[index])), None)
        return eventually(found, lambda: f"channel {channel} as wanted; it holds {self.counts(channel)}", within_s)

    def share(self, channel, wanted, since_ns, until_ns):
        """The part of a time in which a channel held what ``wanted`` accepts."""
        self._read()
        first = bisect.bisect_right(self._times_ns[channel], since_ns)
        edges = [since_ns, *(at_ns for at_ns in self._times_ns[channel][first:] if at_ns < until_ns), until_ns]
        return sum(end_ns - at_ns for at_ns, end_ns, counts in zip(edges, edges[1:], self._counts[channel][first - 1:])
                   if wanted(counts)) / (until_ns - since_ns)

    def values_since(self, channel, since_ns):
        self._read()
        return self._counts[channel][bisect.bisect_right(self._times_ns[channel], since_ns):]


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


class Car:
    """A master and the nodes of a car, each a process.

    Args:
        add_cleanup: of the test or the class that it all ends with.
        node_env: what the environment of the nodes has besides.
        python38: run the nodes on that Python.
    """

    def __init__(self, add_cleanup, node_env=None, python38=False):
        self._add_cleanup = add_cleanup
        self.folder = tempfile.mkdtemp()
        add_cleanup(shutil.rmtree, self.folder, ignore_errors=True)
        self._python38 = python38
        self._port = free_port()
        self.env = {"ROS_MASTER_URI": f"http://127.0.0.1:{self._port}", "ROS_IP": "127.0.0.1",
                    "ROS_LOG_DIR": self.folder}
        self._node_env = {**self.env, **(node_env or {})}
        if python38:
            self._node_env["PYTHONPATH"] = OTHER_PYTHONPATH
        self.processes = {}
        self.chip = Chip(os.path.join(self.folder, "chip"))
        self.start_master()

    def start_master(self):
        self.start("master", shutil.which("rosmaster"), "--core", "-p", str(self._port))
        eventually(self._master_answers, "a master")

    def _master_answers(self):
        with socket.socket() as probe:
            return probe.connect_ex(("127.0.0.1", self._port)) == 0

    def on_host(self, name, command):
        """The command that runs a program on the host that it belongs to: here there is one only."""
        return command

    def start(self, name, *command, env=None):
        process = NodeProcess(*self.on_host(name, command), env=env or self.env)
        self._add_cleanup(process.clean_up)
        self.processes[name] = process
        return process

    def node(self, node, *arguments):
        program = (PYTHON38, os.path.join(PACKAGE, "scripts", node)) if self._python38 else (executable(node),)
        return self.start(node, *program, *arguments, env=self._node_env)

    def load(self, **nodes):
        """Put parameters on the server: those of nodes by name, and what the nodes of car_nodes have."""
        values = {**one_process_params(self.folder, virtual_log=self.chip.path), **nodes}
        path = os.path.join(self.folder, "params.yaml")
        with open(path, "w", encoding="utf-8") as file:
            yaml.safe_dump(values, file)
        subprocess.run(self.on_host("rosparam", (shutil.which("rosparam"), "load", path, "/")), check=True,
                       env={**os.environ, **self.env}, stdout=subprocess.DEVNULL)

    def pca9685(self):
        return self.node("pca9685")

    def turn_arb(self):
        return self.node("turn_arb")

    def converter(self):
        return self.node("generic_value_converter", *CONVERTER)

    def throttle_arb(self):
        return self.node("throttle_arb", *THROTTLE)

    def one_process(self):
        return self.node("car_nodes", *CONVERTER, *THROTTLE)

    def driver(self, name, *names):
        """Start a chain_driver that may publish these names."""
        process = self.start(name, sys.executable, DRIVER, name, ",".join(names))
        process.stdout.wait_for(lambda line: line.startswith("ready"), within_s=START_WITHIN_S)
        return process

    def sent(self, driver, name, value):
        """Have a driver publish a value; when it did, ns."""
        mark = driver.stdout.mark()
        driver.tell(f"{name} {value}")
        return int(driver.stdout.wait_for(lambda line: line.startswith(f"{name} {value} "), mark).what.split()[2])


def guard_of(pid):
    for name in filter(str.isdigit, os.listdir("/proc")):
        try:
            with open(f"/proc/{name}/stat", encoding="utf-8") as stat, open(f"/proc/{name}/cmdline", "rb") as command:
                parent = int(stat.read().rpartition(")")[2].split()[1])
                if parent == pid and b"pca9685_guard" in command.read():
                    return int(name)
        except OSError:
            continue  # it has just ended
    return None


def has_ended(pid):
    """Whether a process has ended, be it that its parent has yet to notice."""
    try:
        with open(f"/proc/{pid}/stat", encoding="utf-8") as file:
            return file.read().rpartition(")")[2].split()[0] == "Z"
    except OSError:
        return True


class FakeBus:
    """An I²C bus with a chip for processes of environment ``env``, which fake_i2c.c is preloaded into."""

    def __init__(self, folder):
        self.path = os.path.join(folder, "i2c-1")
        library = os.path.join(folder, "fake_i2c.so")
        subprocess.run(["cc", "-shared", "-fPIC", "-o", library, os.path.join(HERE, "fake_i2c.c"), "-ldl"], check=True)
        self.env = {"LD_PRELOAD": library, "FAKE_I2C": self.path, "FAKE_I2C_LOG": f"{self.path}.log"}
        registers = bytearray(256)  # the data sheet's reset values
        registers[:6], registers[254] = bytes((0x11, 0x04, 0xE2, 0xE4, 0xE8, 0xE0)), 0x1E
        registers[9:70:4] = bytes((0x10,)) * 16
        with open(self.path, "wb") as file:
            file.write(registers)

    def registers(self, first, length):
        with open(self.path, "rb") as file:
            return file.read()[first: first + length]

    def lines(self):
        """What was done to the bus, and tried on other devices."""
        if not os.path.exists(f"{self.path}.log"):
            return []
        with open(f"{self.path}.log", encoding="ascii") as file:
            return file.read().splitlines()

    def texts(self, pid, since_ns=0):
        """What a process did since then."""
        found = (line.split(" ", 2) for line in self.lines())
        return [text for at_ns, who, text in found if int(who) == pid and int(at_ns) >= since_ns]

    def hold(self, on):
        if on:
            open(f"{self.path}.held", "wb").close()
        else:
            os.unlink(f"{self.path}.held")
