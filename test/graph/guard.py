"""The guard of a servo board in a ``Graph``: the guard's code beside its node, as a process of its own.

It has the board by the same registers as the node, pipes with a delay, and it can be killed or stand still.
"""
from __future__ import annotations

import itertools
from typing import Any, Callable

from std_msgs.msg import Int32MultiArray

from car_interface.nodes.pca9685.pca9685_guard import GuardProcess
from car_interface.pca9685.guard import Guard
from car_interface.pca9685.guard_output import OutputReadings
from car_interface.ros.topics import duty_vector
from graph import NS_PER_S, Graph, NodeClocks, TopicPublisher

PIDS = itertools.count(1000)


class Relay:
    """What ``RelayLink`` and its process, which takes ``start_s`` to start, are to a guard."""

    def __init__(self, graph: Graph, node_name: str, topic: str, start_s: float):
        self._graph, self._name, self._topic, self._start_s = graph, f"{node_name}_guard", topic, start_s
        self._readings = OutputReadings()
        self._publisher: TopicPublisher | None = None
        self._life: object | None = None

    def tell(self, readings: list) -> None:
        if self._life is None:
            self._life = life = object()
            self._readings = OutputReadings()
            self._graph.after(self._start_s, lambda: self._start(life))
        for counts in readings:
            self._readings.update(counts, self._graph.now_ns)
        self._publish()

    def _start(self, life):
        if life is self._life:
            self._publisher = TopicPublisher(self._graph, self._name, self._topic, Int32MultiArray, True,
                                             NodeClocks(self._graph))
            self._publish()

    def _publish(self):
        while self._publisher is not None and self._readings.pending:
            self._publisher.publish(duty_vector(self._readings.pending.pop(0)))

    def end(self) -> None:
        self._life = None
        if self._publisher is not None:
            self._publisher.unregister()
            self._publisher = None


class GuardActor:
    """What ``GuardChild`` is to a node's ``GuardLink``, on a ``car.Board``, whose attributes have the delays.

    Attributes:
        log: its lines.
        signs_sent: how many signs of life its node has given it.
    """

    def __init__(self, board: Any, node_pid: int, off_after_ns: int, node_name: str, output_topic: str):
        self._board, self._graph = board, board.graph
        self.pid, self.node_pid = next(PIDS), node_pid
        self.is_alive = True
        self.signs_sent = 0
        self.log: list[str] = []
        self._exit_text = "exit code 0"
        self._answers = b""
        self._stalled_until_ns = self._graph.now_ns + round(board.guard_start_s * NS_PER_S)
        self._waiting: list[bytes] = []
        self._planned_ns = -1
        self._clocks = NodeClocks(self._graph)
        self._guard = Guard(off_after_ns)
        self._relay = Relay(self._graph, node_name, output_topic, board.relay_start_s)
        self._process = GuardProcess(Device(board, self), self._guard, node_pid, self._answer, self._relay,
                                     self.log.append, self._clocks.now_ns)

    # --- for its node ---

    def write(self, data: bytes) -> None:
        self.signs_sent += 1
        self._later(lambda: self._receive(data))

    def read(self) -> bytes | None:
        data, self._answers = self._answers, b""
        return data if data or self.is_alive else None

    def exit_text(self) -> str:
        return self._exit_text

    def close(self) -> None:
        self._later(lambda: self._receive(b""))

    def wait_or_kill(self, within_s: float) -> None:
        pass

    def kill(self) -> None:
        """End it without a word, as SIGKILL does."""
        if self.is_alive:
            self._exit_text = "killed by signal 9"
            self._end()

    # --- for the test ---

    def stall(self, duration_s: float) -> None:
        """Have it stand still; what is written to it meanwhile waits."""
        self._stalled_until_ns = self._graph.now_ns + round(duration_s * NS_PER_S)
        self._plan(self._stalled_until_ns)

    # --- its process ---

    def _later(self, event: Callable[[], None]):
        self._graph.after(self._board.guard_delay_s, event)

    def _answer(self, data):
        def arrive():
            self._answers += data
        self._later(arrive)

    def _receive(self, data):
        self._waiting.append(data)
        self._plan(self._graph.now_ns)

    def _plan(self, at_ns):
        if at_ns != float("inf"):
            self._planned_ns = at_ns = max(at_ns, self._stalled_until_ns, self._graph.now_ns)
            self._graph.at(at_ns, lambda: self._step(at_ns))

    def _step(self, at_ns):
        if not self.is_alive or at_ns != self._planned_ns or self._graph.now_ns < self._stalled_until_ns:
            return
        waiting, self._waiting = self._waiting or [None], []
        with self._board.used_by(self._clocks):
            goes_on = all(self._process.step(data) for data in waiting)
        self._stalled_until_ns, self._clocks.paused_ns = self._clocks.now_ns(), 0
        if goes_on:
            self._plan(self._guard.next_due_ns())
        else:
            self._end()

    def _end(self):
        self.is_alive = False
        self._relay.end()
        self._board.generations.pop(self, None)


class Device:
    """What ``I2cDevice`` is to a guard."""

    def __init__(self, board: Any, guard: GuardActor):
        self._board, self._guard = board, guard

    def open(self) -> None:
        if self._board.guard_error is not None:
            raise self._board.guard_error

    def close(self) -> None:
        pass

    def lock_holder(self) -> int:
        return self._board.holder

    def claim(self, generation: int) -> None:
        self._board.generations[self._guard] = generation

    def successor(self, generation: int) -> bool:
        return any(each > generation for each in self._board.generations.values())

    def is_gone(self, error: OSError) -> bool:
        return False

    def read(self, register: int, length: int) -> bytes:
        return bytes(self._board.bus.read_i2c_block_data(self._board.address, register, length))

    def write(self, register: int, data: bytes) -> None:
        self._board.bus.write_i2c_block_data(self._board.address, register, list(data))
