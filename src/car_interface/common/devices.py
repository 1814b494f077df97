"""Explains the devices in /dev: who may open one, what gives a user access (groups, log-ins), which processes have it
open, and which of them the 40-pin headers of such cars' computers lead to.

The processes are found by /proc. Only root sees other users' files there.
"""
from __future__ import annotations

import glob
import grp
import os
import pwd
import re
import stat
from contextlib import suppress
from types import MappingProxyType
from typing import Mapping, NamedTuple, Sequence

SETUP_COMMAND = "rosrun car_interface setup_hardware"
SETUP_REMEDY = f"{SETUP_COMMAND}, then log in anew"
GROUPS = ("dialout", "i2c", "input")  # that setup_hardware has the user join: the Teensy, the servo board, the gamepad
INTERPRETERS = ("python", "bash", "sh", "perl")
STABLE_PORT = "/dev/teensy_sensor_hub"  # the name that setup_hardware's udev rule gives to a Teensy on USB
MODEL_FILE = "/proc/device-tree/model"


class Membership(NamedTuple):
    """The user who runs this process, and the groups."""

    user: str
    is_root: bool  # root may open everything
    of_process: frozenset  # from the log-in
    of_user: frozenset  # by /etc/group, from the next log-in on
    existing: frozenset


def read_membership() -> Membership:
    """Return the membership of this process."""
    try:
        entry = pwd.getpwuid(os.geteuid())
        user, primary = entry.pw_name, entry.pw_gid
    except KeyError:
        user, primary = str(os.geteuid()), os.getegid()
    of_process = {os.getegid(), *os.getgroups()}
    return Membership(
        user=user, is_root=os.geteuid() == 0,
        of_process=frozenset(group.gr_name for group in grp.getgrall() if group.gr_gid in of_process),
        of_user=groups_of(user, primary), existing=existing_groups())


def groups_of(user: str, primary: int) -> frozenset:
    """Return the groups that /etc/group gives a user, and the one of a number, by their names."""
    return frozenset(group.gr_name for group in grp.getgrall() if user in group.gr_mem or group.gr_gid == primary)


def existing_groups() -> frozenset:
    """Return the names of all groups."""
    return frozenset(group.gr_name for group in grp.getgrall())


def group_name(number: int) -> str:
    """Return a group's name, or its number when it has none."""
    try:
        return grp.getgrgid(number).gr_name
    except KeyError:
        return str(number)


def explain_denial(path: str) -> tuple[str, str]:
    """Return cause and remedy of a refused access, by the device's group and mode and this user's groups."""
    try:
        status = os.stat(path)
    except OSError:
        return "no permission to open it", SETUP_REMEDY
    group, who = group_name(status.st_gid), read_membership()
    if status.st_gid == 0:  # as a device is before the udev rules are installed
        return "no permission to open it: it is open to root only", SETUP_REMEDY
    if not status.st_mode & stat.S_IRGRP or not status.st_mode & stat.S_IWGRP:
        return (f"no permission to open it, nor has its group, {group}",
                f"See whom it is open to: ls -lL {path}; for a Teensy on USB and the I2C bus: {SETUP_COMMAND}")
    if status.st_gid in os.getgroups():
        return f"no permission to open it, in spite of its group, {group}", f"See whom it is open to: ls -lL {path}"
    if group in who.of_user:
        return f"no permission to open it: {who.user} joined its group, {group}, after logging in", "Log in anew"
    return (f"no permission to open it: {who.user} is not in its group, {group}",
            SETUP_REMEDY if group in GROUPS else f"Join it and log in anew: sudo usermod -aG {group} {who.user}")


def openers(path: str, proc: str = "/proc") -> list[tuple[int, str]]:
    """Return the other processes that have a file open, as (process id, name); links to the file are followed."""
    wanted, found = os.path.realpath(path), set()
    for link in glob.iglob(os.path.join(glob.escape(proc), "[0-9]*", "fd", "*")):  # it passes over what it can't read
        with suppress(OSError):  # it was closed just now
            if os.readlink(link) == wanted:
                found.add(int(link.split(os.sep)[-3]))
    return [(pid, process_name(pid, proc)) for pid in sorted(found - {os.getpid()})]


def process_name(pid: int, proc: str = "/proc") -> str:
    """Return the name of a program; for an interpreter the name of its script."""
    names = [os.path.basename(part) for part in command_line(pid, proc) if part]
    if not names:
        return "unknown"
    scripts = [name for name in names[1:] if not name.startswith("-")]
    if names[0].startswith(INTERPRETERS) and scripts:
        return scripts[0]
    return names[0].rstrip(":")


def script_arguments(pid: int, script: str, proc: str = "/proc") -> list[str]:
    """Return the arguments of a process that runs a script of this name; empty: it runs something else or has ended."""
    words = command_line(pid, proc)
    places = [place for place, word in enumerate(words) if os.path.basename(word) == script]
    return words[places[0] + 1:] if places else []


def command_line(pid: int, proc: str = "/proc") -> list[str]:
    """Return program and arguments; empty: the process has ended, or is the kernel's."""
    try:
        with open(os.path.join(proc, str(pid), "cmdline"), "rb") as file:
            return file.read().decode(errors="replace").split("\0")[:-1]
    except OSError:
        return []


# --- headers ---
# The numbers are documented ones; nothing here was tried on the computers themselves.


class Header(NamedTuple):
    """What the pins of a computer's header are to Linux."""

    computer: str  # its name in messages; empty = an unknown one
    pattern: str  # that is found in its model
    buses: Sequence[int] = (1,)  # I²C: first that of pins 3 and 5, then that of pins 27 and 28
    bus_remedy: str = "See which there are: ls /dev/i2c-*. Without any: sudo modprobe i2c-dev"  # for a missing bus
    port: str = ""  # the serial port of pins 8 and 10
    ports: Mapping[str, str] = MappingProxyType({})  # what to know about a port, by its path
    console_remedy: str = (  # for a log-in console on a port
        "sudo systemctl disable --now serial-getty@{port} (on a Jetson: nvgetty), take console= out of the kernel's "
        "command line, and reboot. Raspberry Pi: raspi-config does it")

    @property
    def bus_paths(self) -> list[str]:
        """Return the paths of the buses."""
        return [f"/dev/i2c-{number}" for number in self.buses]


# Raspberry Pi: pins 27 and 28 are for the ROM of a HAT. www.raspberrypi.com/documentation/computers/configuration.html,
# "Configure UARTs"; golemparts/rppal#166 and raspberrypi/documentation#3294 about Raspberry Pi 5.
_PI = Header("Raspberry Pi", "Raspberry Pi", (1,), "Switch I2C on: sudo raspi-config nonint do_i2c 0", "/dev/serial0",
             console_remedy="sudo raspi-config, Interface Options, Serial Port: no log-in shell, but the hardware; "
                            "then reboot")
_DEBUG_PLUG = "it is the debug plug; pins 8 and 10 are /dev/ttyAMA0"
_BLUETOOTH = ("it is Bluetooth's, unless dtoverlay=disable-bt stands in /boot/firmware/config.txt; pins 8 and 10 are "
              "/dev/serial0")
# Jetson: Adafruit_Blinka, microcontroller/tegra/t234, t194, t186 and t210; sparkfun/Qwiic_I2C_Py#24 and
# autorope/donkeycar#1151 about Orin Nano. Which of /dev/ttyTHS* the header has differs between versions of JetPack.
_THS = "one of /dev/ttyTHS*"
_JETSON = Header("Jetson", "", (), "Load its driver: sudo modprobe i2c-dev", _THS,
                 {"/dev/ttyAMA0": f"a Jetson has no such port; pins 8 and 10 are {_THS}"},
                 "sudo systemctl disable --now nvgetty, and reboot")

HEADERS = (
    _PI._replace(computer="Raspberry Pi 5", pattern="Raspberry Pi 5", port="/dev/ttyAMA0", ports={
        "/dev/ttyAMA0": "pins 8 and 10 need dtoverlay=uart0-pi5 in /boot/firmware/config.txt, and a reboot",
        "/dev/ttyAMA10": _DEBUG_PLUG, "/dev/serial0": _DEBUG_PLUG}),
    _PI._replace(pattern="Raspberry Pi (3|4|Zero W|Zero 2 W)", ports={"/dev/ttyAMA0": _BLUETOOTH}),
    _PI,
    # Their models: "NVIDIA Jetson Orin Nano Engineering Reference Developer Kit Super", "NVIDIA Orin NX Developer Kit".
    _JETSON._replace(computer="Jetson Orin", pattern="Orin.*Developer Kit", buses=(7, 1)),
    _JETSON._replace(computer="Jetson Xavier", pattern="Xavier.*Developer Kit|^Jetson-AGX$", buses=(8, 1)),
    _JETSON._replace(pattern="Jetson (Nano|TX2).*Developer Kit|^quill$", buses=(1, 0)),
)
UNKNOWN = Header("", "")


def header_of(model: str) -> Header:
    """Return the header of a computer by its model; ``UNKNOWN`` has one bus, /dev/i2c-1."""
    return next((header for header in HEADERS if re.search(header.pattern, model)), UNKNOWN)


def read_header() -> Header:
    """Return the header of this computer."""
    try:
        with open(MODEL_FILE, encoding="utf-8", errors="replace") as file:
            return header_of(file.read().rstrip("\0\n"))
    except OSError:
        return UNKNOWN


def port_note(path: str, header: Header) -> str:
    """Return what to know about a serial port of this computer; empty = nothing. Links are followed."""
    return header.ports.get(path) or header.ports.get(os.path.realpath(path), "")
