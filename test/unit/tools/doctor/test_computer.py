"""Groups, clock and packages, as the doctor judges them, with fakes for files, groups and kernel."""
import ctypes
import grp
import os
import time
import types

import pytest
from pads import F710_X, listed

from car_interface.common.devices import Membership
from car_interface.teleop.input_devices import parse_pads
from car_interface.tools.doctor import computer
from car_interface.tools.doctor.findings import BAD, OK, WARN

# --- groups ---

@pytest.fixture
def member(monkeypatch):
    """A user in no group, on a computer without a gamepad; another user, if a test says so."""
    def be(process=(), user=(), existing=("dialout", "i2c", "input"), is_root=False):
        who = Membership("ann", is_root, frozenset(process), frozenset(user), frozenset(existing))
        monkeypatch.setattr(computer, "read_membership", lambda: who)
    be()
    monkeypatch.setattr(computer, "group_of", lambda path, usual: usual)
    monkeypatch.setattr(computer, "find_pads", list)
    monkeypatch.setattr(computer.os.path, "exists", lambda path: path in ("/dev/ttyACM0", "/dev/i2c-1"))
    return be


@pytest.mark.parametrize("who, virtual_port, virtual_bus, level, what, remedy", [
    ({"process": ["dialout", "i2c"], "user": ["dialout", "i2c"]}, False, False, OK, "ann is in dialout, i2c", ""),
    ({"is_root": True}, False, False, OK, "this is root", ""),
    ({}, True, True, OK, "none needed", ""),
    ({"user": ["i2c"]}, True, False, BAD, "after this log-in", "Log in anew"),
    ({}, False, True, BAD, "ann is not in dialout (the Teensy's port)", "setup_hardware"),
    ({"existing": ["dialout"]}, True, False, BAD, "there is no group i2c", "setup_hardware"),
], ids=["in_all", "root", "virtual_devices", "from_the_next_log_in", "outside", "no_such_group"])
def test_user_is_in_the_groups_that_are_needed_or_told_why_not(member, who, virtual_port, virtual_bus, level, what,
                                                               remedy):
    member(**who)
    found, = computer.probe_groups("/dev/ttyACM0", "/dev/i2c-1", virtual_port, virtual_bus)
    assert found.level == level and what in found.what and remedy in found.remedy


@pytest.mark.parametrize("mode, name, usual, group", [
    (0o20660, "gpio", "i2c", "gpio"), (0o20620, "tty", "dialout", "dialout"), (0o20600, "root", "dialout", "dialout"),
    (0o20660, None, "dialout", "dialout"), (None, "gpio", "dialout", "dialout"),
], ids=["its_own", "a_consoles", "roots", "without_a_name", "absent"])
def test_group_of_a_device_is_its_own_where_that_is_one_to_join_and_else_the_usual_one(monkeypatch, mode, name, usual,
                                                                                       group):
    def stat(path, **how):
        if mode is None:
            raise FileNotFoundError(path)
        return os.stat_result((mode, 3, 26, 1, 0, 0 if name == "root" else 5, 0, 0, 0, 0))

    def group_by_number(number):
        if name is None:
            raise KeyError(number)
        return grp.struct_group((name, "x", number, []))
    monkeypatch.setattr(os, "stat", stat)
    monkeypatch.setattr(grp, "getgrgid", group_by_number)
    assert computer.group_of("/dev/ttyAMA0", usual) == group


def missing_groups(virtual_port=False, virtual_bus=False, bus="/dev/i2c-1"):
    found = computer.probe_groups("/dev/ttyACM0", bus, virtual_port, virtual_bus)
    return [(finding.level, finding.what) for finding in found]


def test_port_and_bus_need_their_groups_unless_they_are_virtual_and_a_missing_one_s_is_a_warning_beside_that(member):
    port, bus = (BAD, "ann is not in dialout (the Teensy's port)"), (BAD, "ann is not in i2c (the servo board's bus)")
    assert missing_groups() == [port, bus]
    assert missing_groups(virtual_bus=True) == [port] and missing_groups(virtual_port=True) == [bus]
    assert missing_groups(True, True) == [(OK, "none needed: the devices are virtual")]
    assert missing_groups(bus="auto") == [port, bus]
    assert [level for level, _ in missing_groups(bus="/dev/i2c-9")] == [BAD, WARN]


@pytest.mark.parametrize("readable, found", [(True, [(OK, "none needed: the devices are virtual")]),
                                             (False, [(WARN, "ann is not in input (the gamepad)")])])
def test_gamepad_needs_its_group_only_while_it_cannot_be_read(member, monkeypatch, readable, found):
    (pad,) = parse_pads(listed(F710_X, 5), 64)
    monkeypatch.setattr(computer, "find_pads", lambda: [pad])
    monkeypatch.setattr(os, "access", lambda path, mode: readable)
    assert missing_groups(True, True) == found


# --- clock ---

def kernel(monkeypatch, state=0, year=2026):
    """A C library whose adjtimex returns ``state``; an exception = it is raised by loading it. And a year."""
    def load(name, use_errno):
        if isinstance(state, Exception):
            raise state
        return types.SimpleNamespace(adjtimex=lambda buffer: state)
    monkeypatch.setattr(ctypes, "CDLL", load)
    monkeypatch.setattr(time, "gmtime", lambda: time.struct_time((year, 1, 1, 0, 0, 0, 3, 1, 0)))


UNSYNCHRONISED = 5  # TIME_ERROR of adjtimex(2)


@pytest.mark.parametrize("reading, uses_sim_time, level, words", [
    ({}, False, OK, "synchronised"),
    ({"state": -1}, False, OK, "the kernel doesn't say"),
    ({"state": OSError("no libc")}, False, OK, "the kernel doesn't say"),
    ({"state": UNSYNCHRONISED}, False, WARN, "not synchronised"),
    ({"year": 1970}, False, BAD, "it's the year 1970"),
    ({"year": 2150, "state": UNSYNCHRONISED}, False, BAD, "it's the year 2150"),
    ({}, True, WARN, "/use_sim_time"),
], ids=["fine", "refused", "no_library", "unsynchronised", "epoch", "far_future", "simulated"])
def test_clock(monkeypatch, reading, uses_sim_time, level, words):
    kernel(monkeypatch, **reading)
    found, = computer.probe_clock(uses_sim_time)
    assert (found.level, bool(found.remedy)) == (level, level != OK) and found.what.startswith(words)


def test_each_trouble_of_the_clock_is_told(monkeypatch):
    kernel(monkeypatch, UNSYNCHRONISED)
    assert len(computer.probe_clock(True)) == 2


# --- packages ---

@pytest.mark.parametrize("missing, environment, level, words", [
    ([], "", OK, ""),
    (["rosbags"], "~/car_tools/bin/car-interface", OK,
     "the tools for recordings are in ~/car_tools/bin/car-interface"),
    (["rosbags"], "", WARN, "rosbags is missing for bag_report, check_map and the calibration; driving needs none"),
    (["matplotlib", "rosbags"], "", WARN, "matplotlib, rosbags are missing for bag_report"),
], ids=["none", "in_a_virtual_environment", "one", "two"])
def test_libraries_that_the_tools_lack_are_a_warning_that_names_them(missing, environment, level, words, monkeypatch):
    monkeypatch.setattr(computer, "find_spec", lambda name: name not in missing)
    monkeypatch.setattr(computer.os.path, "exists", lambda path: bool(environment))
    found, = computer.probe_packages()
    assert found.level == level and found.what.startswith(words)
    assert found.remedy == ("" if level == OK else "rosdep install, or on Debian a virtual environment: "
                            "docs/recordings.md, Install the tools")
