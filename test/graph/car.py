"""A whole virtual car in a ``Graph``: the package's nodes as its launch files start them, on virtual devices.

The chip of the servo board is modelled at register level, the Teensy byte by byte, and the car by ``car_sim``.
"""
from __future__ import annotations

import errno
import itertools
import os
from contextlib import contextmanager
from copy import deepcopy
from functools import lru_cache, partial
from types import SimpleNamespace
from typing import Any, Callable, Iterator

import yaml
from car_interface.srv import InjectFaultRequest
from sensor_msgs.msg import Joy
from std_msgs.msg import Bool
from virtual_bus import VirtualBus

from car_interface.nodes.car_sim.node import CarSim
from car_interface.nodes.car_sim.virtual_line import VirtualLine
from car_interface.nodes.generic_value_converter import GenericValueConverter
from car_interface.nodes.pca9685.node import Pca9685
from car_interface.nodes.planner_interface.node import PlannerInterface
from car_interface.nodes.teensy_sensor_hub.node import TeensySensorHub
from car_interface.nodes.teleop_logi import TeleopLogi
from car_interface.nodes.throttle_arb import ThrottleArb
from car_interface.nodes.turn_arb import TurnArb
from car_interface.pca9685.registers import duty_of_counts
from car_interface.sim.pca9685_chip import VirtualPca9685
from car_interface.teensy.link.health import ABSENT, BUSY, FAILING
from car_interface.teensy.link.port import PortError
from graph import NS_PER_S, Graph, Node, NodeClocks
from guard import PIDS, GuardActor

CONFIG = os.path.join(os.path.dirname(os.path.abspath(__file__)), "..", "..", "config")
ADDRESS = 0x40
STEERING, ESC = 0, 1  # channels
CENTER, LEFT, RIGHT, ESC_NEUTRAL = 319, 238, 419, 307  # counts of 5100, 3800, 6700 and 4915
MANUAL, AUTONOMOUS = 4, 5  # buttons of config/teleop_logi.yaml
THIRD = 2  # and one for a third deadman, which that doesn't name
STEER_AXIS, THROTTLE_AXIS = 0, 4
JOY_HZ = 50
WHOLE = ("pca9685", "sim", "hub", "turn_arb", "converter", "throttle_arb", "teleop")  # methods of Car
CONTROL, AUTOWARE, GEAR = "/control/command/control_cmd", "/autoware/control_cmd", "/autoware/gear_cmd"


def config(name: str) -> dict:
    """Return what a shipped file has; a new copy each time."""
    return deepcopy(_loaded(os.path.join(CONFIG, name)))


@lru_cache(maxsize=None)
def _loaded(path):
    with open(path, encoding="utf-8") as file:
        return yaml.safe_load(file)


class Board:
    """A PCA9685 on its bus, and what its pins did.

    Attributes:
        bus: with the faults of a real one.
        changes: (time in ns, counts of the 16 pins), each time that they changed.
        holder: the process that has locked the chip; 0 = none.
        guards: all that were started, oldest first.
        guard_error, guard_start_error: what keeps a guard from the chip, and one from being started.
        guard_delay_s: of the pipes between a node and its guard.  guard_start_s, relay_start_s: a process's start.
    """

    address = ADDRESS
    guard_error: OSError | None = None
    guard_start_error: OSError | None = None
    guard_delay_s, guard_start_s, relay_start_s = 0.0, 0.1, 0.5

    def __init__(self, graph: Graph):
        self.graph = graph
        self._clocks = NodeClocks(graph)
        self.chip = VirtualPca9685()
        self.bus = VirtualBus({ADDRESS: self.chip}, self._pause, lambda *_: self.note())
        self.changes: list[tuple[int, tuple[int, ...]]] = [(graph.now_ns, self.counts)]
        self.holder = 0
        self.guards: list[GuardActor] = []
        self.generations: dict[GuardActor, int] = {}

    def _pause(self, duration_s):
        self._clocks.sleep(duration_s)

    def node(self, params: Any, inbox: Any) -> Pca9685:
        client = BoardClient(self, inbox)
        return Pca9685(params, inbox, client.make_bus, client.start_guard)

    def open(self, pid: int, clocks: Any) -> VirtualBus:
        if self.holder not in (0, pid):
            raise BlockingIOError(errno.EAGAIN, "locked")
        self.holder, self._clocks = pid, clocks
        return self.bus

    def close(self, pid: int) -> None:
        if self.holder == pid:
            self.holder = 0

    @contextmanager
    def used_by(self, clocks: Any) -> Iterator[None]:
        """Have what is done meanwhile take time of other clocks."""
        before, self._clocks = self._clocks, clocks
        yield
        self._clocks = before

    def brown_out(self) -> None:
        self.chip.power_up()
        self.note()

    def note(self) -> None:
        if self.counts != self.changes[-1][1]:
            self.changes.append((self._clocks.now_ns(), self.counts))
            self.graph.readable(self)

    @property
    def counts(self) -> tuple[int, ...]:
        """For how many of 4096 counts each pin is high now."""
        return tuple(self.chip.high_counts(channel) for channel in range(16))

    def since(self, at_ns: int, channel: int) -> list[tuple[int, int]]:
        """Return the changes of a pin since a time, as (time in ns, counts)."""
        found, before = [], None
        for change_ns, counts in self.changes:
            if counts[channel] != before and change_ns >= at_ns and before is not None:
                found.append((change_ns, counts[channel]))
            before = counts[channel]
        return found


class BoardClient:
    """What one life of a pca9685 node has of the board: its bus, as ``Pca9685`` takes it, and its guards."""

    kind, path, name, exists = "virtual", "the test's board", "virtual", True

    def __init__(self, board: Board, inbox: Any):
        self._board, self._inbox = board, inbox
        self._pid = next(PIDS)
        inbox.node.exit_actions.append(self._exit)

    def make_bus(self, config: Any, inbox: Any) -> BoardClient:
        return self

    def open(self) -> VirtualBus:
        bus = self._board.open(self._pid, self._inbox.clocks)
        bus.close = partial(self._board.close, self._pid)
        return bus

    def start_guard(self, kind: str, path: str, address: int, off_after_ns: int, node_name: str,
                    output_topic: str) -> GuardActor:
        if self._board.guard_start_error is not None:
            raise self._board.guard_start_error
        guard = GuardActor(self._board, self._pid, off_after_ns, node_name, output_topic)
        self._board.guards.append(guard)
        return guard

    def _exit(self):
        self._board.close(self._pid)
        for guard in self._board.guards:
            if guard.node_pid == self._pid:
                guard.close()


@lru_cache(maxsize=64)
def _duties(counts):
    return [duty_of_counts(each) for each in counts]


class Pins:
    """What ``car_sim`` follows: the board's pins, as duties; without a board the topic /servo/output."""

    problem = ""

    def __init__(self, board: Board | None):
        self._board = board

    @property
    def duties(self) -> list[int] | None:
        return self._board and _duties(self._board.changes[-1][1])

    def step(self, now_ns: int) -> None:
        pass

    def close(self) -> None:
        pass


class Cable:
    """The serial line between the Teensy and the computer, as both see it. A real one differs from case to case.

    Attributes:
        terminal: the Teensy's end, while it is plugged in.
        port: the computer's end, while it is open.
        delay_s: until bytes arrive at the other end.
        frame_s, phase_s: they arrive with USB frames, which follow each other like this; 0 = at any time.
        read_sizes: how many bytes each read returns at most, over and over.
        capacity: bytes that wait for the computer to read them; what does not fit is lost.
        attempts_ns: when it was tried to open the port.
    """

    def __init__(self, graph: Graph):
        self.graph = graph
        self.terminal: Terminal | None = None
        self.port: Port | None = None
        self.delay_s = self.frame_s = self.phase_s = 0.0
        self.read_sizes: tuple[int, ...] = (4096,)
        self.capacity = 65536
        self.attempts_ns: list[int] = []

    def carry(self, data: bytes, deliver: Callable[[bytes], None]) -> None:
        """Deliver bytes when they arrive, unless the Teensy was unplugged meanwhile."""
        if not data:
            return
        terminal, at_ns = self.terminal, self.graph.now_ns + round(self.delay_s * NS_PER_S)
        if self.frame_s:
            frame_ns, phase_ns = round(self.frame_s * NS_PER_S), round(self.phase_s * NS_PER_S)
            at_ns = phase_ns - (phase_ns - at_ns) // frame_ns * frame_ns
        if self.frame_s or self.delay_s:
            self.graph.at(at_ns, lambda: deliver(data) if self.terminal is terminal else None)
        else:
            deliver(data)

    def to_computer(self, data: bytes) -> None:
        port = self.port
        if port is not None:
            port.received += data[:max(0, self.capacity - len(port.received))]
            self.graph.readable(port)


class Terminal:
    """The Teensy's end: what ``PseudoTerminal`` is to ``VirtualLine``."""

    def __init__(self, cable: Cable, path: str):
        self._cable = cable
        self.name = path
        self.received = bytearray()
        cable.terminal = self

    def fileno(self) -> Terminal:
        return self

    @property
    def is_readable(self) -> bool:
        return bool(self.received)

    def take(self, data: bytes) -> None:
        self.received += data
        self._cable.graph.readable(self)

    def read(self) -> bytes:
        data = bytes(self.received[:4096])
        del self.received[:4096]
        return data

    def write(self, data: bytes) -> None:
        self._cable.carry(data, self._cable.to_computer)

    def close(self) -> None:
        if self._cable.terminal is self:
            self._cable.terminal = None
            if self._cable.port is not None:
                self._cable.graph.readable(self._cable.port)


class Port:
    """The computer's end: what ``SerialLink`` is to teensy_sensor_hub."""

    def __init__(self, cable: Cable, path: str, baud: int):
        self._cable, self._path = cable, path
        self._terminal: Terminal | None = None
        self._sizes = itertools.cycle(cable.read_sizes)
        self.received = bytearray()

    @property
    def is_open(self) -> bool:
        return self._cable.port is self

    def fileno(self) -> Port:
        return self

    @property
    def is_readable(self) -> bool:
        return bool(self.received) or self._cable.terminal is not self._terminal

    def open(self) -> None:
        self._cable.attempts_ns.append(self._cable.graph.now_ns)
        if self._cable.terminal is None:
            raise PortError(self._path, ABSENT, "there is no such port", "Plug the Teensy in")
        if self._cable.port is not None:
            raise PortError(self._path, BUSY, "another program has it open", "End it")
        self.received.clear()
        self._cable.port, self._terminal = self, self._cable.terminal

    def read(self) -> bytes:
        self._check()
        size = next(self._sizes)
        data = bytes(self.received[:size])
        del self.received[:size]
        return data

    def write(self, data: bytes) -> None:
        self._check()
        self._cable.carry(data, self._terminal.take)

    def close(self) -> None:
        if self._cable.port is self:
            self._cable.port = None

    def _check(self):
        if self._cable.terminal is not self._terminal:
            self.close()
            raise PortError(self._path, FAILING, "the port was lost", "Check its cable and power")


class Car:
    """A car's nodes and devices. A method for each node starts it, with the shipped parameters and the given ones."""

    def __init__(self, graph: Graph | None = None):
        self.graph = graph or Graph()
        self.board = Board(self.graph)
        self.cable = Cable(self.graph)
        self.pad()
        self.graph.record("/turn_arb/state", "/throttle_arb/state", "/servo/output",
                          "/teleop_logi/state", "/car_sim/truth", "/diagnostics")

    # --- nodes ---

    def turn_arb(self, **parameters: Any) -> Node:
        return self.graph.add(TurnArb, "turn_arb", {**config("turn_arb.yaml"), **parameters},
                              {"/turn_arb/input/odometry": "/odom"})

    def throttle_arb(self, **parameters: Any) -> Node:
        remap = {"/throttle_arb/input/value": "/generic/output/value", "/throttle_arb/input/odometry": "/odom"}
        return self.graph.add(ThrottleArb, "throttle_arb", {**config("throttle.yaml"), **parameters}, remap)

    def converter(self, **parameters: Any) -> Node:
        shipped = config("generic_value_converter.yaml")
        table = next(name for name in sorted(os.listdir(CONFIG)) if name.endswith(".csv"))
        remap = {"/generic_value_converter/input/odometry": "/odom",
                 "/generic_value_converter/input/control_cmd": CONTROL,
                 "/generic_value_converter/output/value": "/generic/output/value"}
        return self.graph.add(GenericValueConverter, "generic_value_converter",
                              {**shipped, "csv_path_value_map": os.path.join(CONFIG, table), **parameters}, remap)

    def teleop(self, **parameters: Any) -> Node:
        return self.graph.add(TeleopLogi, "teleop_logi", {**config("teleop_logi.yaml"), **parameters})

    def planner_interface(self, source: str = "speed", **parameters: Any) -> Node:
        shipped = {**config("planner_interface.yaml"), "wheels": config("teensy_sensor_hub.yaml"), "source": source}
        remap = {"/planner_interface/input/control_cmd": AUTOWARE, "/planner_interface/input/gear_cmd": GEAR,
                 "/planner_interface/input/odometry": "/odom", "/planner_interface/output/control_cmd": CONTROL}
        return self.graph.add(PlannerInterface, "planner_interface", {**shipped, **parameters}, remap)

    def pca9685(self, **parameters: Any) -> Node:
        shipped = {**config("pca9685.yaml"), "steering": config("turn_arb.yaml"), "esc": config("throttle.yaml"),
                   "device": "virtual", "guard": False}
        return self.graph.add(self.board.node, "pca9685", {**shipped, **parameters})

    def hub(self, **parameters: Any) -> Node:
        shipped = {**config("teensy_sensor_hub.yaml"), **config("sonars.yaml")}
        return self.graph.add(partial(TeensySensorHub, make_link=partial(Port, self.cable)), "teensy_sensor_hub",
                              {**shipped, **parameters})

    def sim(self, follows_board: bool = True, **parameters: Any) -> Node:
        board = self.board if follows_board else None
        line = partial(VirtualLine, make_terminal=partial(Terminal, self.cable),
                       make_claim=lambda path: SimpleNamespace(close=lambda: None))
        return self.graph.add(partial(CarSim, make_chip=lambda path, inbox: Pins(board), make_line=line),
                              "car_sim", {"seed": 1, **parameters})

    def whole(self, planner: str = "", nodes: dict[str, dict] | None = None, **sim: Any) -> Car:
        """Start everything that a car with planner and gamepad has; the gamepad rests.

        Args:
            planner: planner_interface's source; empty = without.
            nodes: parameters by the name of this class's method that starts the node.
            sim: car_sim's.
        """
        nodes = {"sim": sim, **(nodes or {}), **({"planner_interface": {"source": planner}} if planner else {})}
        for name in WHOLE + ("planner_interface",) * bool(planner):
            getattr(self, name)(**nodes.get(name, {}))
        self.graph.hold("/e_stop", Bool(False), 10)
        self.joy()
        return self

    # --- people and planners ---

    def joy(self, is_there: bool = True) -> None:
        self.graph.silence("/joy", sender="/joy_node")
        if is_there:
            self.graph.hold("/joy", lambda: self._pad, JOY_HZ, sender="/joy_node")

    def pad(self, manual: bool = False, autonomous: bool = False, steering: float = 0.0, throttle: float = 0.0,
            third: bool = False, axes: int = 6, buttons: int = 11) -> None:
        """Hold the gamepad's buttons and sticks from now on; it has so many axes and buttons."""
        self._pad = Joy(axes=[0.0] * axes, buttons=[0] * buttons)
        self._pad.axes[STEER_AXIS], self._pad.axes[THROTTLE_AXIS] = steering, throttle
        for index, held in ((MANUAL, manual), (AUTONOMOUS, autonomous), (THIRD, third)):
            self._pad.buttons[index] = int(held)

    @property
    def joy_now(self) -> Joy:
        """The gamepad's message as it is repeated."""
        return self._pad

    def inject(self, fault: str, value: float = 0.0) -> None:
        answer = self.graph.call("/car_sim/inject_fault", InjectFaultRequest(fault, value))
        assert answer.success, answer.message

    def truth(self) -> Any:
        return self.graph.newest("/car_sim/truth")

    @property
    def speed_mps(self) -> float:
        return self.truth().twist.twist.linear.x

    def seconds_since(self, at_ns: int) -> float:
        return (self.graph.now_ns - at_ns) / NS_PER_S
