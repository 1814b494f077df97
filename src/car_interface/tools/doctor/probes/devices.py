"""What the doctor finds out about port, Teensy, bus and chip. Devices that others use are only read, or left alone."""
from __future__ import annotations

import glob
import os
import select
import stat
import time

from car_interface.common.processes import openers
from car_interface.common.units import NS_PER_S
from car_interface.teensy.link.console import PSEUDO_TERMINALS, consoles
from car_interface.teensy.link.health import BUSY
from car_interface.tools.doctor.checks.board import (
    Bus,
    check_bus,
    check_chip,
    check_no_answer,
    find_others,
    read_registers,
)
from car_interface.tools.doctor.checks.findings import BAD, OK, Finding
from car_interface.tools.doctor.checks.port import HUBS, TeensyProbe, check_holders, is_terminal
from car_interface.tools.doctor.probes.computer import group_of

MEMORY_MAJOR, I2C_MAJOR = 1, 89  # Documentation/admin-guide/devices.txt of the kernel
LIST_PORTS = "See which there are: ls /dev/serial/by-id /dev/ttyA*"


def is_pseudo_terminal(port: str) -> bool:
    """Return whether there is a program behind a port, as with car_sim."""
    return os.path.realpath(port).startswith(PSEUDO_TERMINALS)


def probe_port(port: str, baud: int):
    """Open the port, unless another program has it, and examine what is behind it."""
    if _subsystem(port) not in (None, "tty"):
        return [Finding(BAD, "port", f"{port}: this is not a serial port", LIST_PORTS)]
    # The program behind a pseudo-terminal may hold this end, too.
    is_real = _is_character_device(port) and not is_pseudo_terminal(port)
    holders = openers(port) or consoles(port) if is_real else []
    if holders:
        return check_holders(port, holders)
    from car_interface.teensy.link.port import PortError, SerialLink  # it needs pyserial, which may be what is missing
    link = SerialLink(port, baud)
    try:
        link.open()
        teensy = _probe(link, baud)
    except PortError as error:
        # Any process may have something else open at this path, such as /dev/null.
        hubs = [holder for holder in openers(port) if holder[1] in HUBS] if error.state == BUSY else []
        return check_holders(port, hubs) or [Finding(BAD, "port", f"{port}: {error.cause}", error.remedy)]
    finally:
        link.close()
    kind = "a pseudo-terminal: a virtual Teensy" if is_pseudo_terminal(port) else "a serial port, and nobody has it"
    return [Finding(OK, "port", f"{port} is {kind}"), teensy]


def _subsystem(path):
    """Return what kind of device the kernel says it is, such as ``tty``; ``None`` when it says nothing."""
    try:
        number = os.stat(path).st_rdev
    except OSError:
        return None
    try:
        return os.path.basename(os.readlink(f"/sys/dev/char/{os.major(number)}:{os.minor(number)}/subsystem"))
    except OSError:
        pass  # pseudo-terminals aren't in there, and in a chroot nothing may be
    if not _is_character_device(path):
        return None
    if os.major(number) == MEMORY_MAJOR:
        return "mem"
    try:
        with open("/proc/tty/drivers", encoding="ascii", errors="replace") as file:
            return "tty" if is_terminal(os.major(number), os.minor(number), file.read()) else "unknown"
    except OSError:
        return None


def _probe(link, baud):
    """Return the finding about the Teensy behind an open port."""
    now_ns = time.monotonic_ns()
    probe = TeensyProbe(baud, now_ns)
    while not probe.is_done(now_ns):
        to_send = probe.step(now_ns)
        if to_send:
            link.write(to_send)
        left_ns = max(0, min(probe.next_event_ns() - time.monotonic_ns(), NS_PER_S // 10))
        if select.select([link.fileno()], [], [], left_ns / NS_PER_S)[0]:
            probe.update(link.read(), time.monotonic_ns())
        now_ns = time.monotonic_ns()
    return probe.finding()


def probe_board(device: str, address: int, prescale: int | None, driven: bool, oscillator_hz: float):
    """Read two registers of the chip; look for others where it doesn't answer."""
    name = f"0x{address:02x} on {device}"
    found = check_bus(_bus(device))
    if found[0].level != OK:
        return found
    import smbus2  # it may be what is missing
    bus = smbus2.SMBus()
    try:
        bus.open(device)
        try:
            return found + check_chip(name, read_registers(bus, address), prescale, driven, oscillator_hz)
        except OSError as error:
            return found + check_no_answer(name, error, find_others(bus, address))
    except OSError as error:
        return [Finding(BAD, "bus", f"{device} can't be opened ({error.strerror})", "See what it is: ls -l /dev/i2c-*")]
    finally:
        bus.close()


def _bus(device):
    return Bus(device, exists=os.path.exists(device), is_i2c=_is_i2c(device),
               usable=os.access(device, os.R_OK | os.W_OK, effective_ids=True), group=group_of(device, "root"),
               others=tuple(path for path in sorted(glob.glob("/dev/i2c-*")) if path != device and _is_i2c(path)))


def _is_i2c(path):
    return _is_character_device(path) and os.major(os.stat(path).st_rdev) == I2C_MAJOR


def _is_character_device(path):
    try:
        return stat.S_ISCHR(os.stat(path).st_mode)
    except OSError:
        return False
