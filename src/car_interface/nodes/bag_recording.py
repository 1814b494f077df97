"""Programs beside a node: rosbag, which records topics, bag_report, which makes the page, and any other one."""
from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import tempfile
from pathlib import Path
from typing import Sequence

import rospy

from car_interface.common.errors import ConfigError
from car_interface.common.vehicle_geometry import SONARS
from car_interface.ros.clocks import SYSTEM

# Why a car drives, or has stopped.
DECISIONS = (
    "turn_arb/state", "throttle_arb/state", "planner_interface/state", "generic_value_converter/state",
    "teleop_logi/state", "teleop_logi/mode", "joy", "e_stop", "phone/joy", "phone/e_stop", "av_steer_req",
    "av_speed_req", "servo/output", "odom", "imu/data", "teensy_sensor_hub/link", "teensy_clock", "teensy_pong",
    "teensy_error", *(f"sonar/{name}" for name in SONARS), "/tf_static", "/diagnostics", "/rosout")
# What planners ask for, and the battery.
PLANNERS = ("drive", "cmd_vel", "av_turnrad_req", "control/command/control_cmd", "control/command/gear_cmd",
            "battery_state")
# Of a calibration drive: all that the calibrations and bag_report read, and no cameras.
TOPICS = (
    *DECISIONS, "joint_states", "car_sim/truth", "servo/cmdVector", "planner_interface/output/control_cmd",
    "generic/output/value", "teleop_logi/human_in_loop", "teleop_logi/tele_steer_req", "teleop_logi/tele_throt_req",
    "teensy_wheel", "teensy_distance", "/tf")
# Where rosbags isn't among the system's libraries, as on Debian 12: docs/recordings.md, Install the tools.
TOOLS = "~/car_tools/bin/car-interface"
RECORDER = "record_"  # rosbag's node, before what makes its name unique
LOG_PREFIX = re.compile(r"^(\x1b\[\d+m)?\[[A-Z]+\] \[[\d.]+\]: ", re.M)  # of rospy, in a terminal's colours
TAIL_BYTES = 4000


class Program:
    """A program in a session of its own: a terminal's Ctrl-C and hang-up are for the node, which ends it then.

    It ends with this process, however that ends; else rosbag would record for ever.

    Args:
        shows_errors: they go where the node's go, and nothing of the rest is kept for ``tail``.
        variables: of its environment, beside the node's.
    """

    def __init__(self, command: Sequence[str], shows_errors: bool = False, **variables: str):
        self._output = None if shows_errors else tempfile.TemporaryFile()  # noqa: SIM115 - read once it has ended
        with_parent = ("setpriv", "--pdeathsig", "INT") if shutil.which("setpriv") else ()
        self._process = subprocess.Popen(
            [*with_parent, *command], stdin=subprocess.DEVNULL,
            stdout=self._output or subprocess.DEVNULL,
            stderr=None if shows_errors else subprocess.STDOUT, start_new_session=True,
            env={**os.environ, **variables})

    @property
    def exit_code(self) -> int | None:
        """Return it; None while it runs."""
        return self._process.poll()

    def interrupt(self) -> None:
        """End it as Ctrl-C does; it closes its recording."""
        if self.exit_code is None:
            self._process.send_signal(signal.SIGINT)

    def tail(self, count: int) -> str:
        """Return the last lines of its output, so many at most."""
        size = self._output.seek(0, os.SEEK_END)
        self._output.seek(max(0, size - TAIL_BYTES))
        lines = LOG_PREFIX.sub("", self._output.read().decode(errors="replace")).strip().splitlines()
        return "\n".join(lines[-count:])


class BagRecording(Program):
    """A ``rosbag record``, in a file of its own under ``folder``; and the bag's page, once it is closed.

    Args:
        folder: made where it isn't there.
        topics: by their resolved names, also those that nobody publishes yet; none = all.
        stem: what the file's name begins with.
    """

    is_ending = False  # ``end`` was called
    _page: Program | None = None  # which makes it

    def __init__(self, folder: str, topics: Sequence[str] = (), stem: str = "car"):
        try:
            os.makedirs(folder, exist_ok=True)
        except OSError as error:
            raise ConfigError("bag_dir", folder, f"a folder that can be written to ({error.strerror})") from error
        self.path = os.path.join(folder, SYSTEM.local_time(f"{stem}_%Y-%m-%d_%H-%M-%S.bag"))
        super().__init__(["rosrun", "rosbag", "record", *(topics or ("--all",)), "--quiet", "-O", self.path],
                         shows_errors=True)

    def has_subscribed(self, topic: str) -> bool:
        """Return whether a recorder has subscribed to a topic: rosbag takes a second to start, or some."""
        try:
            code, _, state = rospy.get_master().getSystemState()
        except OSError:
            return False
        return code == 1 and any(node.rpartition("/")[2].startswith(RECORDER) for name, nodes in state[1]
                                 if name == topic for node in nodes)

    @property
    def has_ended(self) -> bool:
        """Return whether the recorder has closed the bag, or has failed."""
        return self.exit_code is not None

    def end(self) -> None:
        """Begin to close the bag; ``report`` then makes its page."""
        self.is_ending = True
        self.interrupt()

    def report(self) -> list[str] | None:
        """Go on; return where bag and page are, once both are there; ``None`` = not yet, or it wasn't ended."""
        if not (self.is_ending and self.has_ended):
            return None
        if not os.path.exists(self.path):
            return ["no recording: rosbag wrote none (rosrun rosbag record says why)"]
        if self._page is None:
            self._page = Program(["nice", *_command(), self.path])
        if self._page.exit_code is None:
            return None
        page = Path(self.path).with_suffix(".html")
        if self._page.exit_code == 0 and page.exists():
            return [f"recording: {self.path}", f"report: {page}"]
        return [f"recording: {self.path}", f"no report: {self._page.tail(1) or 'bag_report failed'}"]

    def stop(self) -> str:
        """Close the bag, give up a page that isn't there yet, and return the bag's path."""
        if self._page is not None:
            self._page.interrupt()
        self.interrupt()
        self._process.wait()
        return self.path


def _command():
    tools = os.path.expanduser(TOOLS)
    found = shutil.which("car-interface") or (tools if os.access(tools, os.X_OK) else None)
    return [found, "bag_report"] if found else ["rosrun", "car_interface", "bag_report"]
