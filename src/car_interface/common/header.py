"""Knows the 40-pin headers of the computers that such cars carry, by the model that the kernel names.

The numbers are documented ones; nothing here was tried on the computers themselves.
"""
from __future__ import annotations

import os
import re
from types import MappingProxyType
from typing import Mapping, NamedTuple, Sequence

MODEL_FILE = "/proc/device-tree/model"


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
