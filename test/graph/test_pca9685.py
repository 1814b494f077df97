"""pca9685 by its topics, on a chip at register level; and beside it the guard, which acts in its place."""
from __future__ import annotations

import errno
import os
import tempfile
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from i2c_computer import Computer, Ina3221
from std_msgs.msg import Int32MultiArray

from car import CENTER, ESC, ESC_NEUTRAL, STEERING, Board, config
from car_interface.common.devices import header_of
from car_interface.common.errors import DeviceError
from car_interface.nodes.pca9685 import node as pca9685_node
from car_interface.nodes.pca9685 import virtual_board
from car_interface.nodes.pca9685.node import Pca9685
from car_interface.sim.pca9685_chip import VirtualPca9685
from graph import Graph, Node

MS = 1_000_000
OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR
COMMAND, VECTOR, OUTPUT = "/command", "/servo/cmdVector", "/servo/output"
FAILSAFE = (5104,) + (0,) * 15  # the shipped center, 319 counts
OFF, UNKNOWN = (0,) * 16, (-1,) * 16


def vector(*first: int, length: int = 16, rest: int = -1) -> Int32MultiArray:
    """A command with its first duties, and ``rest`` for the other channels."""
    return Int32MultiArray(data=([*first] + [rest] * length)[:length])


class Servos:
    """A node on a board, with the shipped steering unless other parameters are given."""

    def __init__(self, graph: Graph | None = None, board: Board | None = None, name: str = "pca9685",
                 **parameters: Any):
        self.graph = graph or Graph()
        self.board = board or Board(self.graph)
        self.graph.record(OUTPUT, "/diagnostics")
        shipped = parameters or {**config("pca9685.yaml"), "steering": config("turn_arb.yaml")}
        self.node = self.graph.add(self.board.node, name, {"device": "virtual", "guard": False, **shipped})
        self.graph.run(0.05)

    def send(self, *duties: int, topic: str = VECTOR, **arguments: int) -> int:
        """Publish a command; return when."""
        self.graph.publish(topic, vector(*duties, **arguments))
        self.graph.run(0)
        return self.graph.now_ns

    def hold(self, *duties: int, topic: str = VECTOR) -> None:
        self.graph.hold(topic, vector(*duties))
        self.graph.run(0)

    @property
    def output(self) -> tuple[int, ...]:
        return self.graph.newest(OUTPUT).data

    def outputs(self, since_ns: int) -> list[tuple[int, tuple[int, ...]]]:
        """Return the changes of /servo/output since a time, as (ms after that, duties)."""
        found: list = []
        for record in self.graph.recorded[OUTPUT]:
            if record.at_ns >= since_ns and (not found or found[-1][1] != record.message.data):
                found.append(((record.at_ns - since_ns) / MS, record.message.data))
        return found

    def warnings(self, since_ns: int = 0) -> list[str]:
        return self.graph.lines("/pca9685", since_ns, level=30)


@pytest.fixture
def servos():
    return Servos()


# --- commands ---

def test_output_has_the_layout_of_a_command_is_latched_and_comes_on_change_and_at_10_hz(servos):
    since_ns = servos.graph.now_ns
    servos.graph.run(1.0)
    assert len(servos.graph.messages(OUTPUT, since_ns)) == 10
    servos.send(4000)
    assert [record.at_ns for record in servos.graph.recorded[OUTPUT]][-1] == servos.graph.now_ns
    output = servos.graph.newest(OUTPUT)
    assert [(dim.label, dim.size, dim.stride) for dim in output.layout.dim] == [("pwm_channel", 16, 1)]
    assert output.data == (4000,) + (0,) * 15
    assert [publisher.latch for publisher in servos.graph.publishers[OUTPUT]] == [True]


def test_both_topics_set_channels_at_once_and_minus_one_leaves_them_alone(servos):
    servos.hold(-1, -1, 1000, 65535, topic=COMMAND)
    assert servos.output == (5104, 0, 1008, 65535) + (0,) * 12
    for duty, on_chip in ((7, 0), (8, 16)):  # a count is 16
        servos.hold(3800, duty)
        assert servos.output == (3808, on_chip, 1008, 65535) + (0,) * 12
    assert servos.board.counts[:4] == (238, 1, 63, 4096)


def test_command_of_another_length_is_refused_as_a_whole(servos):
    servos.send(4000, length=15, rest=3000)
    assert servos.output == FAILSAFE
    assert servos.warnings() == ["a command needs 16 values and has 15: refused"]


@pytest.mark.parametrize("wrong", [65536, -2])
def test_what_is_no_duty_is_refused_and_its_neighbours_are_taken(servos, wrong):
    servos.send(wrong, 1600, wrong, 3200)
    assert servos.output == (5104, 1600, 0, 3200) + (0,) * 12
    assert servos.warnings() == [
        f"channels 0, 2 refused: {wrong} of channel 0 is no duty; accepted: 0 to 65535, -1"]
    servos.graph.run(1.0)
    report = servos.graph.report("pca9685: servo board")
    assert (report.values["commands refused"], report.values["commands length"]) == ("1", "0")
    assert report.values["commands dropped after this node stood still"] == "0"


def test_each_channel_goes_to_its_timeout_value_after_250_ms_without_a_command_for_it(servos):
    servos.hold(6000)
    at_ns = servos.send(-1, 2000, topic=COMMAND)
    servos.graph.run(1.0)
    assert servos.outputs(at_ns)[-2:] == [(0, (6000, 2000) + (0,) * 14), (250, (6000,) + (0,) * 15)]
    assert servos.warnings(at_ns)[0] == "no command for channel 1: now at timeout value"
    servos.graph.silence(VECTOR)
    at_ns = servos.send(6000)
    servos.graph.run(1.0)
    assert servos.outputs(at_ns)[1:] == [(250, FAILSAFE)]
    assert servos.graph.report("pca9685: servo board").values["timeouts of channel 0"] == "1"
    servos.graph.hold(VECTOR, vector(6000), 3)  # too slow: each time it expires, which is reported once a second
    since_ns = servos.graph.now_ns
    servos.graph.run(4.0)
    assert len(servos.graph.messages("/diagnostics", since_ns)) <= 9
    assert int(servos.graph.report("pca9685: servo board").values["timeouts of channel 0"]) > 10


# --- the timeout values follow ---

def test_timeout_values_follow_the_neutrals_of_those_who_command_the_channels_within_a_range(servos):
    def follow(duty):
        servos.graph.publish("/servo/neutral", vector(duty))
        servos.graph.run(0)
        return servos.board.counts[STEERING]
    assert follow(5200) == 325
    assert servos.warnings()[-1].startswith("the timeout value of channel 0 follows servo/neutral, away from the YAML")
    assert follow(5601) == 325
    assert servos.warnings()[-1] == (
        "channel 0 rests at 5601 by servo/neutral, its timeout value is 5200: too far to follow. Start both nodes with "
        "the same YAML file")
    servos.graph.publish("/servo/neutral", vector(length=15))
    servos.graph.run(0.9)
    assert servos.warnings()[-1] == "a vector of neutrals needs 16 values and has 15: refused"
    assert servos.graph.report("pca9685: servo board").values["timeout values"] == "5200" + " 0" * 15


# --- bus and chip ---

def real_bus(graph: Graph, **parameters: Any) -> Node:
    graph.record(OUTPUT)
    return graph.add(Pca9685, "pca9685", {"guard": False, **parameters})


def test_bus_that_is_not_there_is_told_in_one_line_and_the_node_goes_on(graph):
    real_bus(graph, device="/dev/i2c-250")
    graph.run(9.0)
    line, = graph.lines("/pca9685", level=30)
    assert line.startswith("PCA9685 at 0x40 on /dev/i2c-250: there is no such bus. ")
    assert line.endswith("ls /dev/i2c-*. Without any: sudo modprobe i2c-dev. Trying again")
    assert {output.data for output in graph.messages(OUTPUT)} == {UNKNOWN} and len(graph.messages(OUTPUT)) == 91


def test_required_bus_that_is_not_there_ends_the_node(graph):
    with pytest.raises(DeviceError, match="PCA9685 at 0x40 on /dev/i2c-250: there is no such bus"):
        real_bus(graph, device="/dev/i2c-250", required=True)


MAIN, OTHER = "/dev/i2c-7", "/dev/i2c-1"


class Guard:
    """A guard's process that does nothing; what it was started for, and what had been written to the chip by then."""

    pid = 1

    def __init__(self, kind, path, *_):
        self.started.append((kind, path, list(self.computer.written)))

    def read(self):
        return b""

    def write(self, data):
        pass

    close = kill = exit_text = lambda self: ""


@pytest.fixture
def jetson(monkeypatch):
    """A Jetson Orin Nano with nothing on its header; bus 1 has a power monitor of its own, by a kernel driver."""
    computer = Computer({MAIN: {}, OTHER: {0x40: Ina3221()}}, taken=[(OTHER, 0x40)])
    monkeypatch.setattr(pca9685_node.smbus2, "SMBus", computer.make_bus)
    monkeypatch.setattr(pca9685_node, "lock_byte", lambda fd, address: None)
    monkeypatch.setattr(pca9685_node, "read_header", lambda: header_of("NVIDIA Jetson Orin Nano Developer Kit"))
    monkeypatch.setattr(pca9685_node.os.path, "exists", lambda path: path in computer.buses)
    monkeypatch.setattr(Guard, "started", [], raising=False)
    monkeypatch.setattr(Guard, "computer", computer, raising=False)
    monkeypatch.setenv("CAR_INTERFACE_RESPAWN", "true")
    return computer


def auto_bus(graph):
    return graph.add(lambda params, inbox: Pca9685(params, inbox, start_guard=Guard), "pca9685", {"device": "auto"})


def test_auto_finds_the_board_whenever_it_gets_its_power_and_starts_the_guard_on_its_bus(graph, jetson):
    graph.record("/diagnostics")
    auto_bus(graph)
    graph.run(5.0)
    line, = graph.lines("/pca9685", level=30)
    assert line.startswith("PCA9685 at 0x40 on /dev/i2c-7 or /dev/i2c-1: no PCA9685 answers at this address on ")
    assert (jetson.written, Guard.started) == ([], [])
    assert graph.report("pca9685: guard").message == "starts as soon as the board's bus is known"
    jetson.buses[MAIN][0x40] = VirtualPca9685()
    graph.run(3.0)
    assert graph.report("pca9685: servo board").values["bus"] == MAIN
    assert Guard.started[0] == ("i2c", MAIN, []) and jetson.written
    assert {path for path, *_ in jetson.asked if path} == {MAIN, OTHER}


def test_auto_keeps_its_bus_in_a_restart_until_the_next_launch_clears_the_parameters(graph, jetson):
    jetson.buses[MAIN][0x40] = VirtualPca9685()
    node = auto_bus(graph)
    graph.run(1.0)
    node.kill()
    jetson.buses.update({MAIN: {}, OTHER: {0x40: VirtualPca9685()}})
    jetson.taken = []
    jetson.asked.clear()
    node.start()
    graph.run(3.0)
    assert graph.lines("/pca9685", level=30)[-1].startswith("PCA9685 at 0x40 on /dev/i2c-7: nothing answers")
    assert {path for path, *_ in jetson.asked} == {MAIN}


def test_auto_refuses_two_boards_with_their_list_and_writes_to_neither(graph, jetson):
    jetson.taken = []
    jetson.buses.update({MAIN: {0x40: VirtualPca9685()}, OTHER: {0x40: VirtualPca9685()}})
    auto_bus(graph)
    graph.run(3.0)
    line, = graph.lines("/pca9685", level=30)
    assert "there is one on /dev/i2c-7 and on /dev/i2c-1. Choose the car's: i2c:=/dev/i2c-7" in line
    assert jetson.written == []


@pytest.mark.skipif(os.getuid() != 0, reason="only root can be two users")
def test_another_users_folder_for_a_virtual_chip_is_told_and_not_used_until_it_is_gone(graph, tmp_path_factory,
                                                                                       monkeypatch):
    started, tmp_path = [], tmp_path_factory.mktemp("a")  # a socket's path is short
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setattr(virtual_board.subprocess, "Popen", lambda *_, **__: started.append(1))
    monkeypatch.setattr(virtual_board, "START_S", 0.0)
    monkeypatch.setattr(virtual_board.rosgraph, "get_master_uri", lambda: "http://car:11311")
    tmp_path.chmod(0o1777)
    folder = tmp_path / f"car_interface-{os.getuid()}"
    folder.mkdir()
    os.chown(folder, 65534, 65534)
    real_bus(graph, device="virtual")
    graph.run(3.0)
    line, = graph.lines("/pca9685", level=30)
    assert line.startswith(f"PCA9685 at 0x40 on virtual: {folder} is another user's: nobody's. Have it removed (sudo ")
    assert graph.newest(OUTPUT).data == UNKNOWN and not [*folder.iterdir()] and not started
    folder.rmdir()
    graph.run(3.0)
    assert started and folder.stat().st_mode & 0o7777 == 0o700


def test_transfer_that_fails_once_is_repeated_and_told(servos):
    servos.board.bus.nacks_left = 1
    at_ns = servos.graph.now_ns
    servos.hold(6000)
    assert servos.output[0] == 6000
    assert servos.warnings(at_ns) == ["PCA9685 at 0x40 on virtual: [Errno 121] Remote I/O error; tried again"]
    servos.graph.run(1.0)
    report = servos.graph.report("pca9685: servo board")
    assert (report.level, report.values["failed transfers"], report.values["reopened"]) == (OK, "1", "0")


def test_chip_that_lost_its_power_is_noticed_within_half_a_second_and_told_again():
    servos = Servos(timeout_value=4912)
    servos.hold(6000)
    before = servos.board.counts
    servos.graph.run(0.3)
    at_ns = servos.graph.now_ns
    servos.board.brown_out()
    servos.graph.run_until(lambda: servos.board.counts == before, 0.51)
    servos.graph.run(0.6)
    assert (0, OFF) not in servos.outputs(at_ns)[-1:] and OFF in [data for _, data in servos.outputs(at_ns)]
    text, = servos.warnings(at_ns)
    assert text == ("PCA9685 at 0x40 on virtual has forgotten what it was told (MODE1 is 0x11 and PRE_SCALE 30, not "
                    "0x20 and 121): it lost its power, or another program writes to it. Initialising it anew")
    servos.graph.run(0.5)
    values = servos.graph.report("pca9685: servo board").values
    assert values["initialised anew after a loss of power"] == "1"


def test_what_another_program_writes_is_told_and_written_anew_within_half_a_second(servos):
    servos.board.bus.write_i2c_block_data(0x40, 6, [0, 0, 0x00, 0x01])
    at_ns = servos.graph.now_ns
    servos.graph.run_until(lambda: servos.board.counts[STEERING] == CENTER, 0.5)
    text, = servos.warnings(at_ns)
    assert text == ("foreign write to PCA9685 at 0x40 on virtual: channel 0 holds 256 counts, not 319. Written anew. "
                    "See which other program writes to it")
    servos.graph.run(1.0)
    assert servos.graph.report("pca9685: servo board").values["channels that another program wrote"] == "1"


def test_commands_while_the_chip_is_away_are_dropped_and_counted_and_none_of_them_is_written_later():
    servos = Servos(timeout_value=4912)
    servos.board.bus.chips.pop(0x40)
    servos.graph.hold(VECTOR, vector(3000))
    at_ns = servos.graph.now_ns
    servos.graph.run(1.0)
    assert servos.warnings(at_ns)[1] == (
        "PCA9685 at 0x40 on virtual was lost: nothing answers at this address (Remote I/O error). Check power, SDA and "
        "SCL, and see what is on the bus: i2cdetect -y virtual. Trying again")
    servos.graph.run(0.1)
    report = servos.graph.report("pca9685: servo board")
    assert report.level == ERROR and int(report.values["commands dropped while it was away"]) > 20
    assert servos.output == (4912,) * 16  # its last pulses
    servos.graph.silence(VECTOR)
    servos.graph.run(0.3)
    servos.board.bus.chips[0x40] = servos.board.chip
    at_ns = servos.graph.now_ns
    servos.graph.run(3.0)
    assert servos.graph.lines("/pca9685", at_ns)[0].endswith("running at 50.03 Hz (prescale 121)")
    assert servos.board.counts == (307,) * 16 and not servos.board.since(at_ns, 0)


def test_bus_that_is_held_for_long_replays_no_stale_command(servos):
    servos.hold(6000)
    servos.graph.run(0.1)
    servos.board.bus.held = True
    servos.graph.silence(VECTOR)
    at_ns = servos.send(3000)  # two transfers, each of which ends after a second
    servos.graph.run(2.5)
    servos.board.bus.held = False
    servos.graph.run(3.0)
    assert [counts for _, counts in servos.board.since(at_ns, STEERING)] == [CENTER]


# --- the end ---

def test_end_brings_timeout_values_for_two_periods_and_then_full_off_also_on_a_bus_that_fails_for_a_moment():
    servos = Servos(timeout=60000, timeout_value=[5104, 4912] + [0] * 14)
    servos.send(6000, 6000, 6000)
    servos.board.bus.nacks_left = 7
    at_ns = servos.graph.now_ns
    servos.node.end()
    (_, _), (first_ms, first), (off_ms, off) = servos.outputs(at_ns - 1)[-3:]
    assert (first[:3], off) == ((5104, 4912, 0), OFF)
    assert off_ms - first_ms == pytest.approx(2e3 / 50.03, abs=0.01) and off_ms < 1000
    assert servos.node.fault == "" and servos.board.counts == OFF


class TestGuard:
    @staticmethod
    def driven(**parameters: Any) -> Servos:
        servos = Servos(guard=True, timeout_value=[5104, 4912] + [0] * 14, **parameters)
        servos.hold(3800, 6000)
        servos.graph.run(1.0)
        assert servos.output[:2] == (3808, 6000)
        return servos

    def test_chip_that_cannot_be_reached_at_the_end_is_left_to_the_guard_which_goes_on_trying(self):
        servos = self.driven(guard_off_after=0.5)
        servos.board.bus.nacks_left = 10**6
        servos.graph.run(1.0)
        servos.node.end()
        assert servos.node.fault == (
            "PCA9685 at 0x40 on virtual: it can't be switched off and goes on pulsing what it was last told. Cut its "
            "power; its guard goes on trying for 10 minutes")
        servos.graph.run(5.0)
        at_ns = servos.graph.now_ns
        servos.board.bus.nacks_left = 0
        servos.graph.run(1.0)
        neutral, off = servos.board.since(at_ns, ESC)
        assert (neutral[1], off[1]) == (ESC_NEUTRAL, 0)
        assert 0 < neutral[0] - at_ns <= 200 * MS and 100 * MS <= off[0] - neutral[0] <= 150 * MS
        assert not servos.board.guards[-1].is_alive

    def test_node_that_waits_for_the_board_takes_over_and_the_guard_of_the_dead_one_leaves_it_alone(self):
        servos = self.driven()
        second = servos.graph.add(servos.board.node, "second", {"device": "virtual", "guard": True,
                                                                "timeout_value": [5104, 4912] + [0] * 14})
        servos.graph.run(3.0)
        assert servos.graph.lines("/second", level=30) == [
            "PCA9685 at 0x40 on virtual: another pca9685 node has this board. See which: rosnode list. Trying again"]
        at_ns = servos.graph.now_ns
        servos.node.kill()
        servos.graph.run(3.0)
        assert [counts for _, counts in servos.board.since(at_ns, STEERING)] == [CENTER, 238]
        guards = servos.board.guards
        assert [guard.is_alive for guard in guards] == [False, True] and "another node has the board" in guards[0].log
        assert second.is_alive and servos.graph.newest(OUTPUT).data[:2] == (3808, 6000)

    def test_node_that_wakes_up_publishes_what_the_guard_left_before_it_writes(self):
        servos = self.driven(guard_off_after=0.5)
        servos.node.stall(2.0)
        servos.graph.run(1.95)
        at_ns = servos.graph.now_ns
        servos.graph.run(0.2)
        outputs = [message.data for message in servos.graph.messages(OUTPUT, at_ns)]
        assert outputs[:2] == [OFF, (5104, 4912) + (0,) * 14] and outputs[-1][:2] == (3808, 6000)

    def test_new_node_of_the_same_name_takes_over_from_the_guard_and_begins_with_what_the_chip_holds(self):
        servos = self.driven()
        at_ns = servos.graph.now_ns
        servos.node.kill()
        servos.graph.run(2.0)
        servos.graph.silence(VECTOR)
        started_ns = servos.graph.now_ns
        servos.node.start()
        servos.graph.run(1.0)
        assert not servos.board.since(started_ns, STEERING)
        assert servos.graph.messages(OUTPUT, started_ns)[0].data[:2] == (5104, 4912)
        assert [counts for _, counts in servos.board.since(at_ns, ESC)] == [ESC_NEUTRAL]
        assert [guard.is_alive for guard in servos.board.guards] == [False, True]

    def test_node_without_a_guard_says_what_that_means(self, servos):
        servos.graph.run(1.0)
        report = servos.graph.report("pca9685: guard")
        assert (report.level, report.message) == (
            OK, "off (guard: false): the board goes on pulsing if this node dies or hangs")
        at_ns = servos.send(6000)
        servos.node.kill()
        servos.graph.run(60.0)
        assert not servos.board.since(at_ns + 1, STEERING) and not servos.board.guards

    def test_reports_name_a_guard_that_watches_was_lost_or_cannot_reach_the_board(self):
        servos = self.driven()

        def report():
            servos.graph.run(1.0)
            found = servos.graph.report("pca9685: guard")
            return found.level, found.message, found.values.get("cause", "")
        assert report() == (OK, "watches", "")
        lost = servos.board.guards[-1]
        lost.kill()
        assert report() == (WARN, "it was lost (it has ended (killed by signal 9)) and started anew", "guard absent")
        values = servos.graph.report("pca9685: guard").values
        assert (values["started anew"], values["process"]) == ("1", str(servos.board.guards[-1].pid)) != str(lost.pid)
        servos.graph.run(10.0)
        assert report()[:2] == (OK, "watches")
        servos.board.guard_error = OSError(errno.EACCES, "denied")
        servos.board.guards[-1].kill()
        servos.graph.run(11.0)
        assert report() == (WARN, "guard blocked: it can't reach the board (Permission denied)", "guard blocked")
        servos.board.guard_start_error = OSError(errno.ENOMEM, "Cannot allocate memory")
        servos.board.guards[-1].kill()
        assert report()[:2] == (ERROR, (
            "guard absent: it can't be started (Cannot allocate memory). Until there is one PCA9685 at 0x40 on virtual "
            "goes on pulsing if this node dies or hangs"))
