"""Port, Teensy, bus and chip, as the doctor judges them; the devices are the simulated ones."""
from __future__ import annotations

import errno
import grp
import os
import random
import sys
import types

import pytest

from car_interface.common.processes import openers, process_name
from car_interface.doctor.checks import board
from car_interface.doctor.checks.findings import BAD, OK, WARN
from car_interface.doctor.checks.port import Link, TeensyProbe, check_holders, check_link, is_terminal
from car_interface.doctor.probes import computer, devices
from car_interface.pca9685.board import Board
from car_interface.sim.pca9685_chip import VirtualBus, VirtualPca9685
from car_interface.sim.teensy_config import FirmwareConfig
from car_interface.sim.teensy_firmware import TeensyFirmware
from car_interface.teensy.link.console import consoles, is_consoles, take_off

MS = 1_000_000

# --- who has a device open ---


@pytest.fixture
def proc(tmp_path):
    """A /proc in which process 7, a script, has a device open by a link, and process 8 something else."""
    device = tmp_path / "ttyACM0"
    device.write_text("")
    (tmp_path / "by-id").symlink_to(device)
    for pid, target, words in ((7, device, ["/usr/bin/python3", "-u", "/opt/pca9685"]), (8, "/dev/null", ["agetty:"])):
        (tmp_path / "proc" / str(pid) / "fd").mkdir(parents=True)
        (tmp_path / "proc" / str(pid) / "fd" / "3").symlink_to(target)
        (tmp_path / "proc" / str(pid) / "cmdline").write_bytes(b"\0".join(word.encode() for word in words) + b"\0")
    (tmp_path / "proc" / "9").mkdir()
    (tmp_path / "proc" / "uptime").write_text("")
    return tmp_path


def test_openers_are_found_through_links(proc):
    assert openers(str(proc / "by-id"), str(proc / "proc")) == [(7, "pca9685")]
    assert openers(str(proc / "ttyACM1"), str(proc / "proc")) == []


def test_processes_that_hide_or_have_ended_are_passed_over(proc):
    assert process_name(8, str(proc / "proc")) == "agetty"
    assert process_name(9, str(proc / "proc")) == "unknown"
    assert openers(str(proc / "by-id"), str(proc / "nowhere")) == []


def test_this_process_is_not_among_the_openers(tmp_path):
    with open(tmp_path / "port", "w", encoding="ascii") as file:
        assert os.readlink(f"/proc/self/fd/{file.fileno()}") == str(tmp_path / "port")
        assert openers(str(tmp_path / "port")) == []


@pytest.mark.parametrize(
    ("holders", "level", "words", "remedy"),
    [
        ([(5, "minicom")], BAD, "minicom (process 5)", "fuser -v /dev/tty0"),
        ([(5, "ModemManager")], BAD, "ModemManager (process 5)", "setup_hardware"),
        ([(5, "agetty")], BAD, "agetty (process 5)", "disable --now serial-getty@tty0 (on a Jetson: nvgetty)"),
        ([(5, "agetty")], BAD, "agetty (process 5)", "console= out of the kernel's command line, and reboot"),
        ([(4, "car_sim"), (5, "teensy_sensor_hub")], WARN, "/dev/tty0: teensy_sensor_hub (process 5)", "--ns"),
        ([(pid, "a") for pid in range(5)], BAD, "a (process 2) and 2 more", "fuser"),
    ],
    ids=["any", "modem_manager", "console", "console_that_the_kernel_asks_for", "hub_elsewhere", "many"],
)
def test_port_that_another_program_has_is_told(holders, level, words, remedy):
    found, = check_holders("/dev/tty0", holders)
    assert found.level == level and words in found.what and remedy in found.remedy


@pytest.fixture
def consoles_port(tmp_path, monkeypatch):
    """A port as agetty leaves it, behind a link, and the group tty; the path of the link."""
    port = tmp_path / "ttyAMA0"
    port.write_text("")
    (tmp_path / "serial0").symlink_to(port)
    status = os.stat_result((0o20620, 3, 26, 1, 0, 5, 0, 0, 0, 0))
    stat = os.stat
    monkeypatch.setattr(os, "stat", lambda path, **how: (
        status if os.path.basename(str(path)) in ("ttyAMA0", "serial0") else stat(path, **how)))
    monkeypatch.setattr(grp, "getgrgid", lambda number: grp.struct_group(("tty", "x", number, [])))
    return str(tmp_path / "serial0")


def test_console_is_found_by_the_port_s_name_among_its_arguments(tmp_path):
    commands = {5: ["/sbin/agetty", "-o", "-p -- \\u", "--keep-baud", "115200,9600", "ttyACM7", "vt220"],
                6: ["/sbin/agetty", "--noclear", "tty1", "linux"], 7: ["vi", "ttyACM7"], 8: [],
                9: ["getty", "/dev/ttyACM7"]}
    for pid, words in commands.items():
        (tmp_path / str(pid)).mkdir()
        (tmp_path / str(pid) / "cmdline").write_bytes(b"".join(word.encode() + b"\0" for word in words))
    (tmp_path / "10").mkdir()
    assert consoles("/dev/ttyACM7", str(tmp_path)) == [(5, "agetty"), (9, "getty")]
    assert consoles("/dev/ttyACM8", str(tmp_path)) == consoles("/dev/ttyACM7", str(tmp_path / "nowhere")) == []


def test_console_that_only_root_sees_at_the_port_is_told_by_its_name(monkeypatch):
    monkeypatch.setattr(devices, "_is_character_device", lambda path: True)
    monkeypatch.setattr(devices, "_subsystem", lambda path: "tty")
    monkeypatch.setattr(devices, "consoles", lambda path: [(612, "agetty")])
    found, = devices.probe_port("/dev/ttyAMA7", 115200)
    assert (found.level, found.what) == (BAD, "/dev/ttyAMA7: another program has it open: agetty (process 612)")
    assert "log-in console" in found.remedy and "serial-getty@ttyAMA7" in found.remedy


def test_port_that_a_console_has_is_its_console_s_and_asks_for_no_group_tty(consoles_port):
    assert is_consoles(consoles_port) and "serial-getty@ttyAMA0 " in take_off(consoles_port)
    assert computer.group_of(consoles_port, "dialout") == "dialout"


@pytest.mark.parametrize(("mode", "group"), [(0o20660, 5), (0o20620, 20), (0o20600, 987)],
                         ids=["open_to_tty", "dialout_s", "nameless_group_s"])
def test_port_that_is_otherwise_is_no_console_s(consoles_port, monkeypatch, mode, group):
    names = {5: "tty", 20: "dialout"}
    monkeypatch.setattr(os, "stat", lambda path, **how: os.stat_result((mode, 3, 26, 1, 0, group, 0, 0, 0, 0)))
    monkeypatch.setattr(grp, "getgrgid", lambda number: grp.struct_group((names[number], "x", number, [])))
    assert not is_consoles(consoles_port)


def test_pseudo_terminal_is_no_console_s():
    ours, theirs = os.openpty()
    assert not is_consoles(os.ttyname(theirs))
    os.close(ours)
    os.close(theirs)


TTY_DRIVERS = """\
/dev/tty             /dev/tty        5       0 system:/dev/tty
usbserial            /dev/ttyUSB   188 0-511 serial
serial               /dev/ttyS       4 64-95 serial
pty_slave            /dev/pts      136 0-1048575 pty:slave
unknown              /dev/tty        4 1-63 console
"""


@pytest.mark.parametrize(("number", "expected"), [
    ((4, 64), True), ((4, 95), True), ((4, 96), False), ((188, 511), True), ((136, 70_000), True), ((5, 0), True),
    ((5, 1), False), ((1, 3), False), ((64, 0), False)])
def test_terminals_are_those_of_the_kernel_s_drivers(number, expected):
    assert is_terminal(*number, TTY_DRIVERS) is expected
    assert not is_terminal(*number, "")


def test_device_that_is_no_terminal_is_no_port_whoever_has_it_open_in_a_chroot_without_sys_too(monkeypatch):
    def readlink(path):
        raise FileNotFoundError(path)
    monkeypatch.setattr(os, "readlink", readlink)
    monkeypatch.setattr(devices, "openers", lambda path: [(7, "teensy_sensor_hub")])
    found, = devices.probe_port("/dev/null", 115200)
    assert (found.level, found.what) == (BAD, "/dev/null: this is not a serial port")


def test_port_that_nobody_has_is_nothing_to_tell():
    assert check_holders("/dev/tty0", []) == []


# --- the Teensy ---


def probed(firmware=None, change=lambda data: data, baud=115200, begin_ns=50_000 * MS):
    """The finding about a Teensy behind a line that ``change`` spoils, and how long it took."""
    now_ns = begin_ns
    firmware = firmware or TeensyFirmware(FirmwareConfig(seed=1), lambda sensor, at_ns: 0, now_ns)
    probe = TeensyProbe(baud, now_ns)
    while not probe.is_done(now_ns):
        firmware.receive(probe.step(now_ns), now_ns)
        probe.update(change(firmware.transmit(now_ns)), now_ns)
        now_ns += 2 * MS
    return probe.finding(), (now_ns - begin_ns) // MS


def corrupting(share):
    """Spoils so many bytes of a hundred, evenly."""
    count = 0

    def change(data):
        nonlocal count
        spoiled = bytearray(data)
        for index in range(len(spoiled)):
            count += share
            if count >= 100:
                count -= 100
                spoiled[index] ^= 0x01
        return bytes(spoiled)
    return change


def without_pongs(data):
    """A pong's frame opens with 7e 01 02 02."""
    return b"" if b"\x7e\x01\x02\x02" in data else data


def test_teensy_that_answers_is_fine_within_a_second():
    found, took_ms = probed()
    assert found.level == OK and "frames a second; pong after" in found.what and "shipped checksum" in found.what
    assert took_ms < 1500


@pytest.mark.parametrize(
    ("change", "level", "words", "remedy"),
    [
        (lambda data: b"", BAD, "nothing comes", "TX"),
        (lambda data: bytes(byte | 0x80 for byte in data), BAD, "but no frames", "baud"),
        (corrupting(0.4), WARN, "corrupt", "cable"),
        (corrupting(1), WARN, "corrupt", "cable"),
        (corrupting(30), BAD, "checksum", "cable"),
        (without_pongs, WARN, "pings was answered", "TX"),
    ],
    ids=["silent", "no_frames", "a_few_corrupt", "some_corrupt", "nearly_all_corrupt", "no_pongs"],
)
def test_what_is_wrong_with_the_line_is_told(change, level, words, remedy):
    found, took_ms = probed(change=change)
    assert (found.subject, found.level) == ("Teensy", level)
    assert words in found.what and remedy in found.remedy
    assert took_ms < 4000


@pytest.mark.parametrize("corrected", (False, True), ids=("shipped", "corrected"))
def test_healthy_teensy_is_never_blamed_for_its_wire_whichever_checksum_its_receiver_wants(corrected):
    rng = random.Random(7)
    for seed in range(30):
        begin_ns = rng.randrange(10 ** 6) * MS + rng.randrange(MS)
        firmware = TeensyFirmware(FirmwareConfig(seed=seed, corrected_checksum=corrected,
                                                 clock_start_ms=rng.randrange(300, 3_600_000)),
                                  lambda sensor, at_ns: 4000, begin_ns)
        found, took_ms = probed(firmware, begin_ns=begin_ns)
        assert found.level == OK and "pong after" in found.what, found
        assert took_ms < 4000


@pytest.mark.parametrize("missing, words", [
    ((3,), "nothing came from the sonar rear_right in 2.5 s"),
    ((2, 5), "nothing came from the sonars front_left, rear_left in 2.5 s"),
    ((0,), "nothing came from any of the sonars in 2.5 s"),
], ids=("one", "two", "the_first_silences_all"))
def test_sonars_that_do_not_report_are_named_with_the_remedy(missing, words):
    firmware = TeensyFirmware(FirmwareConfig(seed=1, sonars_missing=missing), lambda sensor, at_ns: 4000, 50_000 * MS)
    found, took_ms = probed(firmware)
    assert found.level == WARN and words in found.what and "Check their plugs" in found.remedy
    assert took_ms < 4000


def test_teensy_whose_receiver_is_out_of_step_is_brought_back():
    firmware = TeensyFirmware(FirmwareConfig(seed=1), lambda sensor, at_ns: 0, 50_000 * MS)
    firmware.receive(b"\x7e", 50_000 * MS)
    found, took_ms = probed(firmware)
    assert found.level == OK and took_ms < 1000


def link(level=OK, words="fine: 22 frames a second", next_step="", round_trip_s=0.004):
    return Link(level, words, next_step, round_trip_s, "shipped")


@pytest.mark.parametrize(
    ("status", "level", "words", "remedy"),
    [
        (link(), OK, "fine: 22 frames a second; pong after 4.0 ms (shipped checksum)", ""),
        (link(round_trip_s=float("nan")), OK, "no pong yet", ""),
        (link(WARN, "the Teensy rebooted", "Check its power"), WARN, "rebooted", "Check its power"),
        (link(BAD, "there is no such port", "Plug it in"), BAD, "no such port", "Plug it in"),
        (link(WARN, "nothing is known yet"), WARN, "nothing is known", "rostopic echo /hub/link"),
        (None, BAD, "/hub is registered, but its topic link is silent", "rosnode ping /hub"),
    ],
    ids=["fine", "no_pong", "warning", "error", "no_next_step", "silent_hub"],
)
def test_link_is_told_as_the_hub_sees_it(status, level, words, remedy):
    found, = check_link(status, "/hub")
    assert found.level == level and words in found.what and remedy in found.remedy


# --- the bus ---


def bus(exists=True, is_i2c=True, usable=True, others=()):
    return board.Bus("/dev/i2c-1", exists, is_i2c, usable, "i2c", others)


@pytest.mark.parametrize(
    ("facts", "level", "words", "remedy"),
    [
        (bus(), OK, "/dev/i2c-1", ""),
        (bus(exists=False, is_i2c=False), BAD, "there is no such bus", "raspi-config"),
        (bus(exists=False, is_i2c=False), BAD, "there is no such bus", "Jetson"),
        (bus(exists=False, others=("/dev/i2c-7", "/dev/i2c-8")), BAD, "there are /dev/i2c-7, /dev/i2c-8", "/dev/i2c-7"),
        (bus(is_i2c=False), BAD, "not an I2C bus", "ls /dev/i2c-*"),
        (bus(usable=False), BAD, "its group is i2c", "setup_hardware"),
    ],
    ids=["fine", "absent", "absent_on_a_jetson", "absent_among_others", "no_bus", "no_permission"],
)
def test_bus(facts, level, words, remedy):
    found, = board.check_bus(facts)
    assert (found.subject, found.level) == ("bus", level) and words in found.what and remedy in found.remedy


# --- the chip ---

FRESH, DRIVEN = board.Registers(0x11, 0x1E), board.Registers(0x20, 121)


def test_virtual_chip_reads_as_fresh_and_then_as_driven():
    chip = VirtualPca9685()
    virtual = VirtualBus({0x40: chip})
    assert board.read_registers(virtual, 0x40) == FRESH
    Board(virtual, 0x40, 121, 25e6, lambda seconds: None).initialise()
    assert board.read_registers(virtual, 0x40) == DRIVEN


@pytest.mark.parametrize(
    ("registers", "prescale", "driven", "level", "words"),
    [
        (FRESH, 121, False, OK, "fresh from power-up"),
        (DRIVEN, 121, True, OK, "driven at 50.0 Hz"),
        (board.Registers(0xA0, 122), None, True, OK, "driven at 49.6 Hz"),
        (FRESH, 121, True, BAD, "doesn't run as"),
        (board.Registers(0x20, 122), 121, True, BAD, "doesn't run as"),
        (board.Registers(0x01, 121), 121, True, BAD, "doesn't run as"),
        (board.Registers(0x21, 121), None, False, OK, "left so by another program"),
        (board.Registers(0x31, 121), None, False, OK, "sleeps"),
        (board.Registers(0x21, 5), None, False, WARN, "which no servo takes"),
        (board.Registers(0x60, 121), None, False, BAD, "EXTCLK"),
        (board.Registers(0x41, 0x54), None, False, BAD, "EXTCLK"),
        (board.Registers(0x39, 0x9F), None, False, BAD, "not as a PCA9685"),
        (board.Registers(0x00, 0), None, False, BAD, "not as a PCA9685"),
        (board.Registers(0xFF, 0xFF), None, False, BAD, "not as a PCA9685"),
    ],
    ids=["fresh", "driven", "driven_with_its_own_prescale", "lost_power", "other_prescale", "no_auto_increment",
         "left_running", "asleep", "too_fast", "external_clock", "ina226", "ina219", "zeros", "ones"],
)
def test_chip_is_judged_by_its_registers(registers, prescale, driven, level, words):
    found, = board.check_chip("0x40 on /dev/i2c-1", registers, prescale, driven)
    assert found.level == level and words in found.what and bool(found.remedy) == (level != OK)


def test_chip_at_another_address_is_found_and_nothing_is_written():
    written = []
    virtual = VirtualBus({0x41: VirtualPca9685()}, on_write=lambda *write: written.append(write))
    with pytest.raises(OSError) as caught:
        board.read_registers(virtual, 0x40)
    others = board.find_others(virtual, 0x40)
    assert others == [(0x41, FRESH)]
    found, = board.check_no_answer("0x40 on /dev/i2c-1", caught.value, others)
    assert found.level == BAD and "something like it at 0x41" in found.what and "0x41" in found.remedy
    assert written == []


@pytest.mark.parametrize("address", [0x40, 0x43, 0x60])
def test_chips_of_other_kinds_are_not_asked_for_the_question_is_a_write_to_them(address):
    """At 0x71, say, a TCA9548A takes a register's number for the channels that it shall connect."""
    asked = set()

    class EmptyBus:
        def read_byte_data(self, address, register):
            asked.add(address)
            raise OSError(errno.EREMOTEIO, "nobody")

    assert board.find_others(EmptyBus(), address) == []
    assert asked == set(range(0x40, 0x48)) - {address}


def test_search_for_other_chips_ends_when_the_bus_fails():
    asked = []

    class HeldBus:
        def read_byte_data(self, address, register):
            asked.append(address)
            raise OSError(errno.ETIMEDOUT, "timed out")

    assert board.find_others(HeldBus(), 0x40) == []
    assert asked == [0x41]


@pytest.mark.parametrize(
    ("number", "words", "remedy"),
    [
        (errno.EREMOTEIO, "nothing answers at 0x40", "i2cdetect -y 1"),
        (errno.EREMOTEIO, "nothing answers at 0x40", "at 0x40 to 0x47 only"),
        (errno.ENXIO, "nothing answers at 0x40", "power, SDA and SCL"),
        (errno.EBUSY, "a kernel driver", "--address"),
        (errno.ETIMEDOUT, "holds the bus down", "short"),
        (errno.EAGAIN, "the bus failed", "power"),
    ],
)
def test_chip_that_can_not_be_read_is_told(number, words, remedy):
    found, = board.check_no_answer("0x40 on /dev/i2c-1", OSError(number, os.strerror(number)), [])
    assert (found.subject, found.level) == ("chip", BAD) and words in found.what and remedy in found.remedy


# --- bus and chip together, as the doctor looks at them ---


@pytest.fixture
def smbus2(monkeypatch):
    """A bus that is there and usable, with a smbus2 that opens it; what was opened, and still is."""
    module = types.SimpleNamespace(chips={0x40: VirtualPca9685()}, opened=[], refuses=None)

    class SMBus(VirtualBus):
        def __init__(self):
            super().__init__(module.chips)

        def open(self, device):
            if module.refuses is not None:
                raise module.refuses
            module.opened.append(device)

        def close(self):
            module.opened.clear()

    module.SMBus = SMBus
    monkeypatch.setitem(sys.modules, "smbus2", module)
    monkeypatch.setattr(devices, "_bus", lambda device: board.Bus(device, True, True, True, "i2c"))
    return module


def levels_and_words(address=0x40, driven=False):
    found = devices.probe_board("/dev/i2c-1", address, 121, driven, 25e6)
    return [(finding.subject, finding.level) for finding in found], found[-1].what


def test_bus_and_chip_are_ok(smbus2):
    assert levels_and_words() == ([("bus", OK), ("chip", OK)],
                                  "0x40 on /dev/i2c-1 is fresh from power-up: MODE1 0x11, PRE_SCALE 30")
    assert smbus2.opened == []


def test_chip_that_lost_its_power_under_the_node_is_bad(smbus2):
    assert levels_and_words(driven=True)[0] == [("bus", OK), ("chip", BAD)]


def test_chip_at_another_address_is_named(smbus2):
    levels, words = levels_and_words(address=0x60)
    assert levels == [("bus", OK), ("chip", BAD)]
    assert words == "nothing answers at 0x60 on /dev/i2c-1, but something like it at 0x40"
    assert smbus2.opened == []


def test_bus_that_can_not_be_opened_is_bad(smbus2):
    smbus2.refuses = PermissionError(errno.EACCES, "Permission denied")
    levels, words = levels_and_words()
    assert levels == [("bus", BAD)] and "Permission denied" in words
