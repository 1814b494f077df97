"""Records topics into a bag by rosbag, as a process beside a node."""
from __future__ import annotations

import os
import shutil
import signal
import subprocess
from typing import Sequence

import rospy

from car_interface.common.errors import ConfigError
from car_interface.ros.clocks import SYSTEM

RECORDER = "record_"  # rosbag's node, before what makes its name unique


class BagRecording:
    """A ``rosbag record``, in a file of its own under ``folder``. It ends with this process, however that ends.

    Args:
        folder: made where it isn't there.
        topics: by their resolved names, also those that nobody publishes yet; none = all.
        stem: what the file's name begins with.
    """

    def __init__(self, folder: str, topics: Sequence[str] = (), stem: str = "car"):
        try:
            os.makedirs(folder, exist_ok=True)
        except OSError as error:
            raise ConfigError("bag_dir", folder, f"a folder that can be written to ({error.strerror})") from error
        self._path = os.path.join(folder, SYSTEM.local_time(f"{stem}_%Y-%m-%d_%H-%M-%S.bag"))
        command = [*_ending_with_parent(), "rosrun", "rosbag", "record", *(topics or ("--all",)), "--quiet", "-O",
                   self._path]
        # In a session of its own, a terminal's Ctrl-C and hang-up are for the node, which closes the bag then.
        self._process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
                                         start_new_session=True)

    def has_subscribed(self, topic: str) -> bool:
        """Whether a recorder has subscribed to a topic: rosbag takes a second to start, on a busy computer some."""
        try:
            code, _, state = rospy.get_master().getSystemState()
        except OSError:
            return False
        return code == 1 and any(node.rpartition("/")[2].startswith(RECORDER) for name, nodes in state[1]
                                 if name == topic for node in nodes)

    @property
    def path(self) -> str:
        """Of the bag."""
        return self._path

    @property
    def has_ended(self) -> bool:
        """Whether the recorder has closed the bag, or has failed."""
        return self._process.poll() is not None

    def begin_stop(self) -> None:
        """Have the bag closed; ``has_ended`` says when it is."""
        if self._process.poll() is None:
            self._process.send_signal(signal.SIGINT)

    def stop(self) -> str:
        """Close the bag; its path."""
        self.begin_stop()
        self._process.wait()
        return self._path


def _ending_with_parent():
    """What has a command closed by SIGINT when the node is killed, and can't: rosbag would record for ever."""
    return ("setpriv", "--pdeathsig", "INT") if shutil.which("setpriv") else ()
