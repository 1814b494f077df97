"""Records all topics into a bag by rosbag, as a process beside a node."""
from __future__ import annotations

import os
import signal
import subprocess
import time

import rospy

from car_interface.common.errors import ConfigError

RECORDER = "record_"  # rosbag's node, before what makes its name unique


class BagRecording:
    """A ``rosbag record`` of all topics, in a file of its own under ``folder``."""

    def __init__(self, folder: str):
        try:
            os.makedirs(folder, exist_ok=True)
        except OSError as error:
            raise ConfigError("bag_dir", folder, f"a folder that can be written to ({error.strerror})") from error
        self._path = os.path.join(folder, time.strftime("car_%Y-%m-%d_%H-%M-%S.bag"))
        self._process = subprocess.Popen(["rosrun", "rosbag", "record", "--all", "--quiet", "-O", self._path],
                                         stdout=subprocess.DEVNULL)

    def has_subscribed(self, topic: str) -> bool:
        """Whether a recorder has subscribed to a topic: rosbag takes a second to start, on a busy computer some."""
        try:
            code, _, state = rospy.get_master().getSystemState()
        except OSError:
            return False
        return code == 1 and any(node.rpartition("/")[2].startswith(RECORDER) for name, nodes in state[1]
                                 if name == topic for node in nodes)

    def stop(self) -> str:
        """Close the bag; its path."""
        if self._process.poll() is None:
            self._process.send_signal(signal.SIGINT)
        self._process.wait()
        return self._path
