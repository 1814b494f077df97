"""What the doctor reads from this computer, with fakes for its files, groups, kernel and network."""
from __future__ import annotations

import ctypes
import grp
import io
import os
import time
import types

import pytest

from car_interface.common.device_access import Membership
from car_interface.tools.doctor.checks.findings import BAD, OK, WARN
from car_interface.tools.doctor.probes import computer

NOBODY = Membership("ann", False, frozenset(), frozenset(), frozenset({"dialout", "i2c", "input"}))
MASTER = "http://car:11311"


# --- groups ---

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


@pytest.fixture
def member(monkeypatch):
    """A user in no group, on a computer without a gamepad."""
    monkeypatch.setattr(computer, "read_membership", lambda: NOBODY)
    monkeypatch.setattr(computer, "group_of", lambda path, usual: usual)
    monkeypatch.setattr(computer.glob, "glob", lambda pattern: [])


def missing_groups(virtual_port=False, virtual_bus=False):
    found = computer.probe_groups("/dev/ttyACM0", "/dev/i2c-1", virtual_port, virtual_bus)
    return [(finding.level, finding.what) for finding in found]


def test_port_and_bus_need_their_groups_unless_they_are_virtual(member):
    port, bus = (BAD, "ann is not in dialout (the Teensy's port)"), (BAD, "ann is not in i2c (the servo board's bus)")
    assert missing_groups() == [port, bus]
    assert missing_groups(virtual_bus=True) == [port] and missing_groups(virtual_port=True) == [bus]
    assert missing_groups(True, True) == [(OK, "none needed: the devices are virtual")]


@pytest.mark.parametrize("readable, found", [(True, [(OK, "none needed: the devices are virtual")]),
                                             (False, [(WARN, "ann is not in input (the gamepad)")])])
def test_gamepad_needs_its_group_only_while_it_cannot_be_read(member, monkeypatch, readable, found):
    monkeypatch.setattr(computer.glob, "glob", lambda pattern: ["/dev/input/js0"])
    monkeypatch.setattr(os, "access", lambda path, mode: readable)
    assert missing_groups(True, True) == found


# --- clock ---

def kernel(monkeypatch, state):
    """A C library whose adjtimex returns ``state``; an exception = it is raised by loading it."""
    def load(name, use_errno):
        if isinstance(state, Exception):
            raise state
        return types.SimpleNamespace(adjtimex=lambda buffer: state)
    monkeypatch.setattr(ctypes, "CDLL", load)
    monkeypatch.setattr(time, "gmtime", lambda: time.struct_time((2026, 1, 1, 0, 0, 0, 3, 1, 0)))


@pytest.mark.parametrize("state, level, what", [
    (0, OK, "synchronised"),
    (5, WARN, "not synchronised"),  # TIME_ERROR of adjtimex(2)
    (-1, OK, "the kernel doesn't say"),
    (OSError("no libc"), OK, "the kernel doesn't say"),
], ids=["synchronised", "not_synchronised", "refused", "no_library"])
def test_clock_is_as_synchronised_as_the_kernel_has_it(monkeypatch, state, level, what):
    kernel(monkeypatch, state)
    (found,) = computer.probe_clock(False)
    assert found.level == level and found.what.startswith(what)
    monkeypatch.setattr(time, "gmtime", lambda: time.struct_time((1970, 1, 1, 0, 0, 0, 3, 1, 0)))
    assert [finding.level for finding in computer.probe_clock(True)][:1] == [BAD], "a wrong year"


# --- packages ---

@pytest.mark.parametrize("is_virtual, joy, levels", [
    (False, True, [OK, OK]), (False, False, [OK, WARN]), (True, False, [OK])],
    ids=["joy_is_installed", "joy_is_missing", "virtual_car_needs_none"])
def test_packages_are_those_of_the_tools_and_joy_for_a_car_with_hardware(is_virtual, joy, levels, monkeypatch):
    monkeypatch.setenv("ROS_DISTRO", "noetic")
    monkeypatch.setattr(computer, "TOOLS", {"json": "json"})
    monkeypatch.setattr(computer, "_has_ros_package", {"joy": joy}.__getitem__)
    assert [finding.level for finding in computer.probe_packages(False, is_virtual)] == levels


# --- network ---

@pytest.fixture
def network(monkeypatch):
    """Hosts by name, of which 10.0.0.1 and the loopback are this computer's; /proc/net is empty. A master that answers
    is asked by ``str``: no fault.
    """
    hosts = {"car": ["10.0.0.1"], "other": ["10.0.0.2"], "localhost": ["127.0.0.1", "::1"]}
    tables = {"/proc/net/tcp": "header\n"}

    def getaddrinfo(host, port, **how):
        if host not in hosts:
            raise OSError("unknown host")
        return [(0, 0, 0, "", (address, 0)) for address in hosts[host]]

    def opened(path, encoding):
        if path not in tables:
            raise FileNotFoundError(path)
        return io.StringIO(tables[path])
    monkeypatch.setattr(computer.socket, "getaddrinfo", getaddrinfo)
    monkeypatch.setattr(computer.socket, "gethostname", lambda: "car")
    monkeypatch.setattr(computer, "_is_local", lambda address: address in ("10.0.0.1", "127.0.0.1", "::1"))
    monkeypatch.setattr(computer, "open", opened, raising=False)
    for name in ("ROS_HOSTNAME", "ROS_IP"):
        monkeypatch.delenv(name, raising=False)
    return types.SimpleNamespace(hosts=hosts, tables=tables)


def test_master_on_this_computer_that_answers_is_ok_and_one_that_does_not_is_not_there(network):
    master, address, is_there = computer.probe_network(MASTER, str)
    assert is_there and [(one.level, one.what) for one in master] == [(OK, "http://car:11311 answers")]
    assert [(one.level, one.what) for one in address] == [(OK, "this host's name, car")]
    (found,), _, is_there = computer.probe_network(MASTER, lambda: "Connection refused")
    assert not is_there and (found.level, found.what.split(";")[0]) == (WARN, "none runs at http://car:11311")


def test_listening_address_is_read_from_the_kernels_table(network):
    # 0x2C2F is port 11311; state 0A listens.
    network.tables["/proc/net/tcp"] += "   0: 00000000:2C2F 00000000:0000 0A\n"
    (found,), _, _ = computer.probe_network(MASTER, str)
    assert found.level == WARN and "listens on every interface" in found.what


def test_master_on_another_host_is_named_and_needs_an_address_that_is_reached_from_there(network, monkeypatch):
    monkeypatch.setenv("ROS_HOSTNAME", "localhost")
    (master,), (address,), is_there = computer.probe_network("http://other:11311", str)
    assert is_there and (master.level, address.level) == (WARN, BAD)
    assert "is on another host" in master.what and "nodes there can't reach those here" in address.what
    for name, what in (("nowhere", "can't be looked up"), ("other", "isn't this computer's")):
        monkeypatch.setenv("ROS_HOSTNAME", name)
        _, (found,), _ = computer.probe_network(MASTER, str)
        assert found.level == BAD and what in found.what


@pytest.mark.parametrize("uri, what", [
    ("http://nowhere:11311", "its host, nowhere, can't be found"), ("", "ROS_MASTER_URI is not set"),
    ("car:11311", "which is no master's address")])
def test_master_whose_host_is_unknown_is_not_asked(network, uri, what):
    def asked():
        raise AssertionError("asked")
    (found,), _, is_there = computer.probe_network(uri, asked)
    assert not is_there and found.level == BAD and what in found.what
