"""The Teensy's port and what is behind it, as the doctor judges them; the Teensy is the simulated one."""
import fcntl
import os
import random
from types import SimpleNamespace

import pytest

from car_interface.sim.teensy_firmware import FirmwareConfig, TeensyFirmware
from car_interface.teensy.link.health import FINE, PORT_FAULTS
from car_interface.tools.doctor import devices as port
from car_interface.tools.doctor.car import ABSENT, RUNNING, SILENT, Node
from car_interface.tools.doctor.devices import TeensyProbe, check_holders, check_link, check_virtual_port
from car_interface.tools.doctor.findings import BAD, OK, WARN, Finding

MS = 1_000_000


@pytest.mark.parametrize("holders, level, words, remedy", [
    ([(5, "minicom")], BAD, "minicom (process 5)", "fuser -v /dev/tty0"),
    ([(5, "ModemManager")], BAD, "ModemManager (process 5)", "setup_hardware"),
    ([(5, "agetty")], BAD, "agetty (process 5)", "disable --now serial-getty@tty0 (on a Jetson: nvgetty)"),
    ([(4, "car_sim"), (5, "teensy_sensor_hub")], WARN, "/dev/tty0: teensy_sensor_hub (process 5)", "--ns"),
    ([(pid, "a") for pid in range(5)], BAD, "a (process 2) and 2 more", "fuser"),
], ids=["any", "modem_manager", "console", "hub_elsewhere", "many"])
def test_port_that_another_program_has_is_told(holders, level, words, remedy):
    found, = check_holders("/dev/tty0", holders)
    assert found.level == level and words in found.what and remedy in found.remedy


# --- the Teensy ---

def probed(firmware=None, change=lambda data: data, baud=115200, begin_ns=50_000 * MS):
    """The finding about a Teensy behind a line that ``change`` spoils, and how long it took."""
    now_ns, data = begin_ns, b""
    firmware = firmware or TeensyFirmware(FirmwareConfig(seed=1), lambda sensor, at_ns: 0, now_ns)
    probe = TeensyProbe(baud, now_ns)
    while not probe.is_done(now_ns):
        firmware.receive(probe.step(data, now_ns), now_ns)
        data = change(firmware.transmit(now_ns))
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


@pytest.mark.parametrize("change, level, words, remedy", [
    (lambda data: b"", BAD, "nothing comes", "TX"),
    (lambda data: bytes(byte | 0x80 for byte in data), BAD, "but no frames", "baud"),
    (corrupting(0.4), WARN, "corrupt", "cable"),
    (corrupting(30), BAD, "checksum", "cable"),
    (without_pongs, WARN, "pings was answered", "TX"),
], ids=["silent", "no_frames", "a_few_corrupt", "nearly_all_corrupt", "no_pongs"])
def test_what_is_wrong_with_the_line_is_told(change, level, words, remedy):
    found, took_ms = probed(change=change)
    assert (found.subject, found.level) == ("Teensy", level)
    assert words in found.what and remedy in found.remedy
    assert took_ms < 4000


@pytest.mark.parametrize("corrected", (False, True), ids=("shipped", "corrected"))
def test_healthy_teensy_is_never_blamed_for_its_wire_whichever_checksum_its_receiver_wants(corrected):
    rng = random.Random(7)
    for seed in range(10):
        begin_ns = rng.randrange(10 ** 6) * MS + rng.randrange(MS)
        firmware = TeensyFirmware(FirmwareConfig(seed=seed, corrected_checksum=corrected,
                                                 clock_start_ms=rng.randrange(300, 3_600_000)),
                                  lambda sensor, at_ns: 4000, begin_ns)
        found, took_ms = probed(firmware, begin_ns=begin_ns)
        assert found.level == OK and "frames a second; pong after" in found.what, found
        assert (corrected or "(shipped checksum)" in found.what) and took_ms < 4000


@pytest.mark.parametrize("missing, words", [
    ((3,), "nothing came from the sonar rear_right in 2.5 s"),
    ((2, 5), "nothing came from the sonars front_left, rear_left in 2.5 s"),
    ((0,), "nothing came from any of the sonars in 2.5 s"),
], ids=("one", "two", "the_first_silences_all"))
def test_sonars_that_do_not_report_are_named_with_the_remedy(missing, words):
    firmware = TeensyFirmware(FirmwareConfig(seed=1), lambda sensor, at_ns: 4000, 50_000 * MS)
    for sensor in missing:
        firmware.set_sonar(sensor, "missing", 0)
    found, took_ms = probed(firmware)
    assert found.level == WARN and words in found.what and "Check their plugs" in found.remedy
    assert took_ms < 4000


def test_teensy_whose_receiver_is_out_of_step_is_brought_back_within_a_second():
    firmware = TeensyFirmware(FirmwareConfig(seed=1), lambda sensor, at_ns: 0, 50_000 * MS)
    firmware.receive(b"\x7e", 50_000 * MS)
    found, took_ms = probed(firmware)
    assert found.level == OK and took_ms < 1000


HUB = Node("teensy_sensor_hub", "/teensy_sensor_hub", RUNNING, "/car_nodes")


def link(level=OK, words="fine: 22 frames a second", next_step="", round_trip_s=0.004, state=FINE):
    return SimpleNamespace(level=level, state=state, words=words, next_step=next_step, round_trip=round_trip_s,
                           firmware_checksum="shipped")


@pytest.mark.parametrize("status, level, words, remedy", [
    (link(), OK, "fine: 22 frames a second; pong after 4.0 ms (shipped checksum)", ""),
    (link(round_trip_s=float("nan")), OK, "no pong yet", ""),
    (link(BAD, "nothing comes from it", "Check the power"), BAD, "nothing comes", "Check the power"),
    (link(WARN, "nothing is known yet"), WARN, "nothing is known", "rostopic echo /teensy_sensor_hub/link"),
], ids=["fine", "no_pong", "error", "no_next_step"])
def test_link_over_an_open_port_is_told_as_the_hub_sees_it(status, level, words, remedy):
    port, found = check_link(status, "/dev/tty0", HUB)
    assert (port.level, port.subject, port.what) == (OK, "port", "/dev/tty0 is /teensy_sensor_hub's")
    assert (found.level, found.subject) == (level, "Teensy") and words in found.what and remedy in found.remedy


@pytest.mark.parametrize("state", sorted(PORT_FAULTS))
def test_port_that_the_hub_cannot_open_is_not_told_to_be_fine(state):
    found, = check_link(link(BAD, "there is no such port", "Plug it in", state=state), "/dev/tty0", HUB)
    assert found == Finding(BAD, "port", "/dev/tty0: there is no such port", "Plug it in")


def test_hub_that_says_nothing_of_its_link_hangs_and_its_process_is_named():
    found, = check_link(None, "/dev/tty0", HUB)
    assert (found.level, found.what) == (BAD, "/teensy_sensor_hub runs, but its topic link is silent: it hangs")
    assert found.remedy == "Stop the car, then rosnode kill /car_nodes: roslaunch starts it again"


@pytest.mark.parametrize("simulator, hub_runs, level, words, remedy", [
    (ABSENT, False, WARN, "car_sim, which makes this port, doesn't run", "demo.launch"),
    (ABSENT, True, BAD, "car_sim, which makes this port, doesn't run", "demo.launch"),
    (SILENT, True, BAD, "car_sim, which is behind this port, doesn't answer", "See the nodes above"),
], ids=["nothing_runs", "hub_without_simulator", "simulator_hangs"])
def test_port_of_a_virtual_teensy_is_not_to_be_plugged_in(simulator, hub_runs, level, words, remedy):
    found, = check_virtual_port("/tmp/teensy", simulator, hub_runs)
    assert found.level == level and words in found.what and remedy in found.remedy


# --- the port on this computer ---

def test_console_that_only_root_sees_at_the_port_is_told_by_its_name(monkeypatch):
    monkeypatch.setattr(port, "device_number", lambda path: (204, 64))
    monkeypatch.setattr(port, "_may_be_terminal", lambda path: True)
    monkeypatch.setattr(port, "consoles", lambda path: [(612, "agetty")])
    found, = port.probe_port("/dev/ttyAMA7", 115200)
    assert (found.level, found.what) == (BAD, "/dev/ttyAMA7: another program has it open: agetty (process 612)")
    assert "log-in console" in found.remedy and "serial-getty@ttyAMA7" in found.remedy


@pytest.fixture
def listed(monkeypatch):
    """What the kernel lists of each device of characters; empty: nothing, as where there is no /sys."""
    kinds, realpath = {}, os.path.realpath
    monkeypatch.setattr(os.path, "realpath", lambda path: kinds.get(path, path) if "/sys/" in path else realpath(path))
    return kinds


@pytest.mark.parametrize("has_lists", [True, False], ids=["by_the_kernels_list", "without_it"])
def test_device_that_is_no_terminal_is_no_port_whoever_has_it_open(monkeypatch, listed, has_lists):
    """Any process may have /dev/null open: as its standard input."""
    if has_lists:
        listed["/sys/dev/char/1:3/subsystem"] = "/sys/class/mem"
    monkeypatch.setattr(port, "openers", lambda path: [(7, "teensy_sensor_hub")])
    found, = port.probe_port("/dev/null", 115200)
    assert (found.level, found.what) == (BAD, "/dev/null: this is not a serial port")


@pytest.mark.parametrize("device, kind, may_be", [
    ((4, 64), "/sys/class/tty", True), ((188, 511), "/sys/class/tty", True), ((10, 130), "/sys/class/misc", False),
    ((1, 3), "/nowhere", False), ((188, 0), "/nowhere", True)])
def test_terminals_are_those_of_the_kernel_s_list_and_without_one_all_but_memory(monkeypatch, listed, device, kind,
                                                                                 may_be):
    listed[f"/sys/dev/char/{device[0]}:{device[1]}/subsystem"] = kind
    monkeypatch.setattr(port, "device_number", lambda path: device)
    monkeypatch.setattr(port.os.path, "exists", lambda path: path.startswith("/sys/class"))
    assert port._may_be_terminal("/dev/some") is may_be


def test_folder_in_which_a_hub_works_is_no_port_that_it_has_open(monkeypatch, tmp_path):
    monkeypatch.setattr(port, "openers", lambda path: [(7, "teensy_sensor_hub")])
    found, = port.probe_port(str(tmp_path), 115200)
    assert (found.level, found.what) == (BAD, f"{tmp_path}: this is a directory, not a serial port")


@pytest.mark.parametrize("hub", ["teensy_sensor_hub", "car_nodes"])
def test_port_that_a_hub_has_locked_is_the_hub_s(hub, monkeypatch):
    near, far = os.openpty()
    fcntl.flock(far, fcntl.LOCK_EX)
    try:
        monkeypatch.setattr(port, "openers", lambda path: [(6, "car_sim"), (7, hub)])
        found, = port.probe_port(os.ttyname(far), 115200)
    finally:
        os.close(near)
        os.close(far)
    assert found.level == WARN and f"{hub} (process 7) has it open" in found.what
