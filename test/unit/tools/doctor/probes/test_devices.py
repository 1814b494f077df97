"""What the doctor's probes make of ports, consoles, bus and chip."""
from __future__ import annotations

import errno
import fcntl
import os
import sys
import types

import pytest

from car_interface.sim.pca9685_chip import VirtualBus, VirtualPca9685
from car_interface.tools.doctor.checks import board
from car_interface.tools.doctor.checks.findings import BAD, OK, WARN
from car_interface.tools.doctor.probes import devices


def test_console_that_only_root_sees_at_the_port_is_told_by_its_name(monkeypatch):
    monkeypatch.setattr(devices, "_is_character_device", lambda path: True)
    monkeypatch.setattr(devices, "_subsystem", lambda path: "tty")
    monkeypatch.setattr(devices, "consoles", lambda path: [(612, "agetty")])
    found, = devices.probe_port("/dev/ttyAMA7", 115200)
    assert (found.level, found.what) == (BAD, "/dev/ttyAMA7: another program has it open: agetty (process 612)")
    assert "log-in console" in found.remedy and "serial-getty@ttyAMA7" in found.remedy


@pytest.mark.parametrize("has_lists", [True, False], ids=["without_sys", "without_the_kernels_lists_too"])
def test_device_that_is_no_terminal_is_no_port_whoever_has_it_open(monkeypatch, has_lists):
    """Any process may have /dev/null open: as its standard input."""
    def unreadable(*arguments, **keywords):
        raise FileNotFoundError(arguments[0])
    monkeypatch.setattr(os, "readlink", unreadable)
    if not has_lists:
        monkeypatch.setattr(devices, "open", unreadable, raising=False)
    monkeypatch.setattr(devices, "openers", lambda path: [(7, "teensy_sensor_hub")])
    found, = devices.probe_port("/dev/null", 115200)
    assert (found.level, found.what) == (BAD, "/dev/null: this is not a serial port")


def test_folder_in_which_a_hub_works_is_no_port_that_it_has_open(monkeypatch, tmp_path):
    monkeypatch.setattr(devices, "openers", lambda path: [(7, "teensy_sensor_hub")])
    found, = devices.probe_port(str(tmp_path), 115200)
    assert (found.level, found.what) == (BAD, f"{tmp_path}: this is a directory, not a serial port")


@pytest.mark.parametrize("hub", ["teensy_sensor_hub", "car_nodes"])
def test_port_that_a_hub_has_locked_is_the_hub_s(hub, monkeypatch):
    near, far = os.openpty()
    fcntl.flock(far, fcntl.LOCK_EX)
    try:
        monkeypatch.setattr(devices, "openers", lambda path: [(6, "car_sim"), (7, hub)])
        found, = devices.probe_port(os.ttyname(far), 115200)
    finally:
        os.close(near)
        os.close(far)
    assert found.level == WARN and f"{hub} (process 7) has it open" in found.what


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


def test_bus_and_chip_are_ok_unless_the_chip_lost_its_power_under_the_node(smbus2):
    assert levels_and_words() == ([("bus", OK), ("chip", OK)],
                                  "0x40 on /dev/i2c-1 is fresh from power-up: MODE1 0x11, PRE_SCALE 30")
    assert levels_and_words(address=0x60) == ([("bus", OK), ("chip", BAD)],
                                              "nothing answers at 0x60 on /dev/i2c-1, but something like it at 0x40")
    assert smbus2.opened == []
    assert levels_and_words(driven=True)[0] == [("bus", OK), ("chip", BAD)]


def test_bus_that_can_not_be_opened_is_bad(smbus2):
    smbus2.refuses = PermissionError(errno.EACCES, "Permission denied")
    levels, words = levels_and_words()
    assert levels == [("bus", BAD)] and "Permission denied" in words
