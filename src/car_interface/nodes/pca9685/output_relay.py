"""The relay of a guard: publishes what the servo board holds while the guard acts and no pca9685 node can tell it.

A ROS node, named as the pca9685 node with ``_guard`` added. ``nodes.pca9685.pca9685_guard`` starts it, and its standard
input carries the guard's readings. It never touches the bus. It ends at once when a node has the chip
again, and when the guard has ended, once it has published the last reading. It has a session of its own: signals to
that of the node or of a launch file don't end it, ``rosnode kill`` does. Without a ROS master it waits for one.

Publishes:
    /servo/output (std_msgs/Int32MultiArray, latched): the duties in the chip; on change and at 10 Hz.
"""
from __future__ import annotations

import os
import select
import signal
import sys
import threading

import rosgraph
import rospy
from std_msgs.msg import Int32MultiArray

from car_interface.pca9685.guard_output import OutputReadings
from car_interface.pca9685.guard_protocol import LEFT_TO_NODE, output_reader
from car_interface.ros.clocks import SYSTEM
from car_interface.ros.tcpros_limits import limit_connections
from car_interface.ros.topics import duty_vector

MASTER_POLL_S = 1.0
REGISTER_POLL_S = 0.05
IDLE_POLL_S = 0.5  # to see that ROS has ended this node
LAST_S = 2.0  # how long the last reading may wait for its publication once the guard has ended
DELIVERY_S = 0.5  # for subscribers to connect and receive it
SHUT_DOWN_S = 2.0  # of ROS, whose master may have gone
READ_SIZE = 4096


class OutputRelay:
    """Publishes the readings that a pipe carries."""

    def __init__(self, fd: int):
        self._fd = fd
        self._messages = output_reader()
        self._readings = OutputReadings()
        self._publisher: rospy.Publisher | None = None
        self._is_left = False  # a node has the chip again
        self._guard_has_ended = False

    def run(self) -> None:
        """Publish until a node has the chip again, the guard has ended, or ROS ends this node."""
        threading.Thread(target=self._register, daemon=True).start()
        while not self._guard_has_ended and not rospy.is_shutdown():
            self._receive()
            if self._is_left:
                return
            self._publish()
        SYSTEM.wait_for(lambda: self._publish() or rospy.is_shutdown(), LAST_S, REGISTER_POLL_S)
        if self._publisher is not None:
            SYSTEM.sleep(DELIVERY_S)

    def _register(self):
        """Join the ROS graph; that may take as long as there is no master."""
        while not rosgraph.is_master_online():
            SYSTEM.sleep(MASTER_POLL_S)
        without_limits = limit_connections()
        if without_limits:
            print(without_limits, file=sys.stderr, flush=True)
        try:
            rospy.init_node("pca9685_guard", disable_signals=True, disable_rosout=True)
            self._publisher = rospy.Publisher("/servo/output", Int32MultiArray, queue_size=10, latch=True)
        except Exception as error:  # the master has gone again in this moment
            print(f"nobody publishes what the board holds: no ROS master ({error})", file=sys.stderr, flush=True)

    def _receive(self):
        """Wait for a while, and take all that the guard wrote."""
        wait_s = IDLE_POLL_S if self._publisher is not None else REGISTER_POLL_S
        if not select.select([self._fd], [], [], wait_s)[0]:
            return
        data = os.read(self._fd, READ_SIZE)
        self._guard_has_ended = not data
        for message in self._messages.feed(data):
            self._is_left |= message.kind == LEFT_TO_NODE
            self._readings.update(message.counts, SYSTEM.now_ns())

    def _publish(self):
        """Publish what is pending; return whether nothing is any more."""
        while self._publisher is not None and self._readings.pending:
            self._publisher.publish(duty_vector(self._readings.pending.pop(0)))
        return not self._readings.pending


def main() -> None:
    os.setsid()
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, lambda *_: rospy.signal_shutdown("signal"))
    OutputRelay(sys.stdin.fileno()).run()
    if rospy.core.is_initialized():
        ending = threading.Thread(target=rospy.signal_shutdown, args=("ended",), daemon=True)
        ending.start()
        ending.join(SHUT_DOWN_S)
    os._exit(0)  # a thread may still be waiting for the master


if __name__ == "__main__":
    main()
