"""Records topics into a bag by rosbag, and has bag_report make its page, as processes beside a node."""
from __future__ import annotations

import os
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

# Of a calibration drive: all that the calibrations and bag_report read, and no cameras.
TOPICS = (
    "odom", "joint_states", "imu/data", "car_sim/truth", "servo/output", "servo/cmdVector", "e_stop", "joy",
    "phone/joy", "phone/e_stop",
    "turn_arb/state", "throttle_arb/state", "planner_interface/state", "generic_value_converter/state",
    "av_steer_req", "av_speed_req", "planner_interface/output/control_cmd", "generic/output/value",
    "teleop_logi/state", "teleop_logi/human_in_loop", "teleop_logi/mode", "teleop_logi/tele_steer_req",
    "teleop_logi/tele_throt_req", "teensy_sensor_hub/link", "teensy_clock", "teensy_pong", "teensy_wheel",
    "teensy_distance", "teensy_error", *(f"sonar/{name}" for name in SONARS), "/tf", "/tf_static", "/diagnostics",
    "/rosout")
# Where rosbags isn't among the system's libraries, as on Debian 12: docs/recordings.md, Install the tools.
TOOLS = "~/car_tools/bin/car-interface"
RECORDER = "record_"  # rosbag's node, before what makes its name unique


class BagRecording:
    """A ``rosbag record``, in a file of its own under ``folder``. It ends with this process, however that ends.

    Args:
        folder: made where it isn't there.
        topics: by their resolved names, also those that nobody publishes yet; none = all.
        stem: what the file's name begins with.

    Attributes:
        path: of the bag.
    """

    def __init__(self, folder: str, topics: Sequence[str] = (), stem: str = "car"):
        try:
            os.makedirs(folder, exist_ok=True)
        except OSError as error:
            raise ConfigError("bag_dir", folder, f"a folder that can be written to ({error.strerror})") from error
        self.path = os.path.join(folder, SYSTEM.local_time(f"{stem}_%Y-%m-%d_%H-%M-%S.bag"))
        command = [*ending_with_parent(), "rosrun", "rosbag", "record", *(topics or ("--all",)), "--quiet", "-O",
                   self.path]
        # In a session of its own, a terminal's Ctrl-C and hang-up are for the node, which closes the bag then.
        self._process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
                                         start_new_session=True)

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
        return self._process.poll() is not None

    def begin_stop(self) -> None:
        """Have the bag closed; ``has_ended`` says when it is."""
        if self._process.poll() is None:
            self._process.send_signal(signal.SIGINT)

    def stop(self) -> str:
        """Close the bag; its path."""
        self.begin_stop()
        self._process.wait()
        return self.path


def ending_with_parent():
    """Return what has a command closed by SIGINT when the node is killed, and can't: rosbag would record for ever."""
    return ("setpriv", "--pdeathsig", "INT") if shutil.which("setpriv") else ()


class BagPage:
    """The end of a recording: ``step`` until it says that it is over."""

    def __init__(self, recording: BagRecording):
        self._recording = recording
        self._process: subprocess.Popen | None = None
        self._output = None
        recording.begin_stop()

    def step(self) -> list[str] | None:
        """Go on; where bag and page are, once both are; ``None`` = not yet."""
        if not self._recording.has_ended:
            return None
        if not os.path.exists(self._recording.path):
            return ["no recording: rosbag wrote none (rosrun rosbag record says why)"]
        if self._process is None:
            self._output = tempfile.TemporaryFile()  # noqa: SIM115 - it is read once the process has ended
            self._process = subprocess.Popen(["nice", *_command(), self._recording.path], stdin=subprocess.DEVNULL,
                                             stdout=self._output, stderr=subprocess.STDOUT)
        if self._process.poll() is None:
            return None
        return [f"recording: {self._recording.path}", self._page_line()]

    def close(self) -> None:
        """Close the bag; no page any more, where it isn't there yet."""
        if self._process is not None and self._process.poll() is None:
            self._process.terminate()
        self._recording.stop()

    def _page_line(self):
        page = Path(self._recording.path).with_suffix(".html")
        if self._process.returncode == 0 and page.exists():
            return f"report: {page}"
        self._output.seek(0)
        lines = self._output.read().decode(errors="replace").strip().splitlines()
        return f"no report: {lines[-1] if lines else 'bag_report failed'}"


def _command():
    tools = os.path.expanduser(TOOLS)
    found = shutil.which("car-interface") or (tools if os.access(tools, os.X_OK) else None)
    return [found, "bag_report"] if found else ["rosrun", "car_interface", "bag_report"]
