"""Records all topics into a bag by rosbag, as a process beside a node."""
from __future__ import annotations

import os
import signal
import subprocess
import time

from car_interface.common.errors import ConfigError


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

    def stop(self) -> str:
        """Close the bag; its path."""
        if self._process.poll() is None:
            self._process.send_signal(signal.SIGINT)
        self._process.wait()
        return self._path
