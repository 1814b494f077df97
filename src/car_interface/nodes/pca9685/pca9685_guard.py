"""The guard of a servo board: a small process beside the pca9685 node, which acts when that is dead or frozen.

The node starts it, see ``nodes.pca9685.guard_link``; it is no ROS node. ``pca9685.guard`` decides,
``pca9685.guard_board`` writes. It has a session of its own and ignores the signals that end a node: the node
tells it when all is well. Its arguments: ``i2c`` and the bus's path, or ``virtual`` and the chip's socket; the chip's
address, the node's process, the time to full off in ns, the descriptors of the two pipes, and the resolved names of the
node and of its /servo/output.

While it acts alone it has what the chip holds published in the node's place, by ``nodes.pca9685.output_relay``, a
process of its own: the guard imports no rospy, so that it is small and can act at once.
"""
from __future__ import annotations

import os
import select
import signal
import sys
import time

from car_interface.common.units import CHANNELS, NS_PER_MS, NS_PER_S
from car_interface.pca9685 import guard_board
from car_interface.pca9685.guard import ASSERT, END, NOTHING, PROBE, SWITCH_OFF, Guard
from car_interface.pca9685.guard_protocol import ACTING, HELD, LEFT_TO_NODE, OFF, SAFE, WATCHING, OutputMessage

MAX_WAIT_S = 60.0
EVENTS = {WATCHING: "the node is back", SAFE: "every channel is at its timeout value", OFF: "every output is off"}
RELAY = "car_interface.nodes.pca9685.output_relay"
RELAY_SUFFIX = "_guard"  # of the relay's name on the ROS graph, after the node's
DEFAULT_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGCHLD)


class GuardProcess:
    """Does what the guard decides, and answers the node.

    Args:
        device: the chip, as ``pca9685.i2c_device.I2cDevice``.
        node_pid: whose lock doesn't stop the guard.
        answer: called with bytes for the node.
    """

    def __init__(self, device, guard: Guard, node_pid: int, answer, relay: RelayLink, log, clock_ns=time.monotonic_ns):
        self._device = device
        self._relay = relay
        self._guard = guard
        self._node_pid = node_pid
        self._answer = answer
        self._log = log
        self._clock_ns = clock_ns
        self._state = guard.state
        self._generation = clock_ns() // NS_PER_MS

    def run(self, node_fd: int) -> None:
        """Guard until the node has ended and the chip is safe, or another node has it."""
        received: bytes | None = None
        while self.step(received):
            wait_s = (self._guard.next_due_ns() - self._clock_ns()) / NS_PER_S
            watched = [] if self._guard.node_is_dead else [node_fd]
            ready, _, _ = select.select(watched, [], [], max(0.0, min(wait_s, MAX_WAIT_S)))
            received = os.read(node_fd, 4096) if ready else None

    def step(self, received: bytes | None) -> bool:
        """Act on what the node has written, and on the time; return whether to go on.

        Args:
            received: ``None`` = nothing; no bytes = the node has ended.
        """
        if received is not None:
            self._guard.receive(received, self._clock_ns())
        action = self._guard.action(self._clock_ns())
        if not self._guard.is_acting:
            self._relay.end()
        if action == END:
            return False
        self._report(received is not None)  # before a transfer, which may last
        if action != NOTHING:
            self._do(action)
            self._report(False)
        return True

    def _do(self, action):
        device, guard = self._device, self._guard
        try:
            device.open()
            if action != PROBE and self._is_replaced():
                self._log("another node has the board")
                self._relay.end()
                guard.finish()
                return
            if action != PROBE or guard.node_has_reached:
                device.claim(self._generation)
            held = self._transfer(action)
        except OSError as error:
            device.close()
            if guard.is_acting:
                self._log(f"it can't be reached: {error}")
            guard.failed(action, error.errno, self._clock_ns())
            if guard.node_is_dead and device.is_gone(error):
                guard.finish()
        else:
            guard.succeeded(action, self._clock_ns())
            if guard.acts_alone(self._clock_ns()):
                self._relay.tell(held)

    def _is_replaced(self):
        """Return whether a node has the board that isn't this guard's, or had it and left it to a guard of its own."""
        return self._device.lock_holder() not in (0, self._node_pid) or self._device.successor(self._generation)

    def _transfer(self, action):
        """Do it; return what the channels are known to have held."""
        device, counts = self._device, self._guard.timeout_counts
        if action == PROBE:
            guard_board.probe(device)
            return []
        if action == ASSERT:
            return guard_board.write_counts(device, counts)
        if action == SWITCH_OFF:
            return guard_board.switch_off(device)
        held = guard_board.keep_counts(device, counts)
        if len(held) > 1:
            self._log("a channel held something else: brought back to its timeout value")
        return held

    def _report(self, is_heard):
        """Answer a sign of life, and report a new state to the node and the log."""
        state = self._guard.state
        if state != self._state:
            if state == ACTING and self._state == WATCHING:
                self._log("the node is " + ("dead" if self._guard.node_is_dead else "silent"))
            elif self._state >= ACTING and state in EVENTS:
                self._log(EVENTS[state])
        if is_heard or state != self._state:
            self._answer(self._guard.status())
        self._state = state


class RelayLink:
    """Starts the relay when there is something to publish, and ends it. Nothing depends on it.

    Args:
        node_name, output_topic: the resolved names of the node and of the topic on which it would publish.
    """

    def __init__(self, node_name: str, output_topic: str, log):
        namespace, _, name = node_name.rpartition("/")
        self._arguments = [f"__ns:={namespace or '/'}", f"__name:={name}{RELAY_SUFFIX}",
                           f"/servo/output:={output_topic}"]
        self._log = log
        self._fd = -1
        signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # a relay that has ended leaves no zombie

    def tell(self, readings: list) -> None:
        """Have what the channels held published: tuples of 16 counts, oldest first."""
        if self._fd < 0:
            self._start()
        for counts in readings:
            _write(self._fd, OutputMessage(HELD, counts).encode())

    def end(self) -> None:
        """End the relay: a node publishes by itself. When the guard ends, it publishes the last reading before."""
        if self._fd >= 0:
            _write(self._fd, OutputMessage(LEFT_TO_NODE, (0,) * CHANNELS).encode())
            os.close(self._fd)
            self._fd = -1

    def _start(self):
        reader, self._fd = os.pipe()
        os.set_blocking(self._fd, False)
        command = [sys.executable, "-m", RELAY, *self._arguments]
        try:
            os.posix_spawn(sys.executable, command, os.environ, file_actions=[(os.POSIX_SPAWN_DUP2, reader, 0)],
                           setsigdef=DEFAULT_SIGNALS)
        except OSError as error:
            self._log(f"nobody publishes what the board holds: {error}")
        finally:
            os.close(reader)


def make_device(kind: str, path: str, address: int):
    """Return the chip at an address of a bus, or behind a virtual one's socket. Only what is needed is imported."""
    if kind == "virtual":
        from car_interface.sim.chip_link import ChipLink
        return ChipLink(path, address)
    from car_interface.pca9685.i2c_device import I2cDevice
    return I2cDevice(path, address)


def make_log(name: str):
    """Return a function that writes lines, none twice in a row, to the standard error: a file of the node's."""
    last = ""

    def log(text):
        nonlocal last
        if text != last:
            last = text
            _write(sys.stderr.fileno(), f"{time.strftime('%Y-%m-%d %H:%M:%S')} {name}: {text}\n".encode())
    return log


def main() -> None:
    kind, path = sys.argv[1:3]
    address, node_pid, off_after_ns, node_fd, answer_fd = map(int, sys.argv[3:8])
    node_name, output_topic = sys.argv[8:10]
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    os.set_blocking(answer_fd, False)
    for fd in (node_fd, answer_fd):
        os.set_inheritable(fd, False)

    log = make_log(f"guard of 0x{address:02x} on {path}, node {node_pid}")
    relay = RelayLink(node_name, output_topic, log)
    GuardProcess(make_device(kind, path, address), Guard(off_after_ns), node_pid,
                 lambda data: _write(answer_fd, data), relay, log).run(node_fd)


def _write(fd, data):
    try:
        os.write(fd, data)
    except OSError:
        pass  # who reads it is dead or frozen, or the disk is full
