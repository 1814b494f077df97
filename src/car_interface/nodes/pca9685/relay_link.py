"""The guard's link to its relay, the ROS node that publishes what the servo board holds while the guard acts alone.

The guard imports no rospy, so that it is small and can act at once; ``nodes.pca9685.output_relay`` is a process of
its own. It is started once the chip is safe, and nothing depends on it.
"""
from __future__ import annotations

import os
import signal
import sys

from car_interface.common.units import CHANNELS
from car_interface.pca9685.guard_protocol import HELD, LEFT_TO_NODE, OutputMessage

MODULE = "car_interface.nodes.pca9685.output_relay"
SUFFIX = "_guard"  # of the relay's name on the ROS graph, after the node's
DEFAULT_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGCHLD)


class RelayLink:
    """Starts the relay when there is something to tell, and ends it.

    Args:
        node_name, output_topic: the resolved names of the node and of the topic on which it would publish.
        log: called with a line.
    """

    def __init__(self, node_name: str, output_topic: str, log):
        namespace, _, name = node_name.rpartition("/")
        self._arguments = [f"__ns:={namespace or '/'}", f"__name:={name}{SUFFIX}", f"/servo/output:={output_topic}"]
        self._log = log
        self._fd = -1
        signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # a relay that has ended leaves no zombie

    def tell(self, readings: list) -> None:
        """Have what the channels held published: tuples of 16 counts, oldest first."""
        if self._fd < 0:
            self._start()
        for counts in readings:
            self._write(OutputMessage(HELD, counts))

    def end(self) -> None:
        """End the relay: a node tells by itself. When the guard itself ends, it ends once it has told the last."""
        if self._fd >= 0:
            self._write(OutputMessage(LEFT_TO_NODE, (0,) * CHANNELS))
            os.close(self._fd)
            self._fd = -1

    def _start(self):
        reader, self._fd = os.pipe()
        os.set_blocking(self._fd, False)
        command = [sys.executable, "-m", MODULE, *self._arguments]
        try:
            os.posix_spawn(sys.executable, command, os.environ, file_actions=[(os.POSIX_SPAWN_DUP2, reader, 0)],
                           setsigdef=DEFAULT_SIGNALS)
        except OSError as error:
            self._log(f"nobody publishes what the board holds: {error}")
        finally:
            os.close(reader)

    def _write(self, message):
        try:
            os.write(self._fd, message.encode())
        except OSError:
            pass  # it was ended, or hangs
