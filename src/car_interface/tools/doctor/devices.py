"""Examines the devices: the servo board's bus, what the chip's registers say, and the Teensy's port.

Registers are only read, never written. Of a port: which programs have it open, and what comes through it when none has.
"""
from __future__ import annotations

import errno
import glob
import math
import os
import select
import time
from contextlib import closing
from typing import Any, Callable, Sequence

from car_interface.common.devices import SETUP_COMMAND, Header, explain_denial, openers, port_note, read_header
from car_interface.common.units import NS_PER_MS
from car_interface.common.vehicle_geometry import SONARS
from car_interface.pca9685.bus import NOT_ACKNOWLEDGED, PROBE, BoardNotFound, choose_bus, explain, is_pca9685
from car_interface.pca9685.config import AUTO
from car_interface.pca9685.registers import AUTO_INCREMENT, EXTCLK, MODE1, PRE_SCALE, SLEEP, frequency_for
from car_interface.teensy.link import pinging, protocol
from car_interface.teensy.link.console import PROGRAMS, PSEUDO_TERMINALS, consoles, removal_remedy
from car_interface.teensy.link.health import BUSY, FINE, PORT_FAULTS, WAITING
from car_interface.teensy.link.session import Session
from car_interface.tools.doctor.car import ABSENT, Node, restart_remedy
from car_interface.tools.doctor.computer import device_number
from car_interface.tools.doctor.findings import BAD, OK, WARN, Finding, first
from car_interface.tools.doctor.master import Car

ADDRESSES = range(0x40, 0x80)  # that the six pins can choose (data sheet 7.1)
# Where others are looked for: what three pins choose. Who reads a register writes its number first, and chips of other
# kinds take that for an order: at 0x70 to 0x77 a multiplexer switches its channels, from 0x48 on a PCF8591 its inputs.
NEIGHBOURS = range(0x40, 0x48)
RESET_MODE1, RESET_PRESCALE = 0x11, 0x1E  # after power-up (data sheet 7.3.1, 7.3.5)
SERVO_HZ = (40.0, 400.0)  # what servos and ESCs understand, digital ones included
I2C_MAJOR = 89  # Documentation/admin-guide/devices.txt of the kernel
HUBS = ("teensy_sensor_hub", "car_nodes")  # the processes that the hub may be
MEMORY_MAJOR = 1  # Documentation/admin-guide/devices.txt of the kernel
LIST_PORTS = "See which there are: ls /dev/serial/by-id /dev/ttyA*"
MAX_NAMES = 3
POLL_S = 0.02
PING_PERIOD_NS = 300 * NS_PER_MS
SONARS_WITHIN_NS = 2500 * NS_PER_MS  # a round of all six takes 0.6 s at most, unless their wait was set longer
SONARS_REMEDY = ("Check their plugs, wires and supply; were they stopped, or left out of the sequence? The hub starts "
                 "them, and says more: roslaunch car_interface teensy_sensor_hub.launch")
MAX_TRANSMIT_NS = 3600 * NS_PER_MS  # five unanswered pings at 0.5 s each, and one with the other checksum


def probe_board(car: Car, asks_all: bool) -> list[Finding]:
    """Read registers of the chip; look for others where it doesn't answer.

    Args:
        asks_all: look for boards on all other buses, too.
    """
    header, there, found = read_header(), _buses(), []
    import smbus2  # it may be what is missing
    device = car.bus
    if device == AUTO:  # the header's, as the pca9685 node finds it
        device = header.bus_paths[0]
        try:
            device = choose_bus(header, car.address, smbus2.SMBus)
        except BoardNotFound as error:
            if error.is_ambiguous:
                found = [Finding(BAD, "bus", error.cause, error.remedy)]
    if not found:
        found = [check_bus(device, header, there)]
        if found[0].level == OK:
            found += _probe_chip(device, header, car, smbus2.SMBus())
    others = [path for path in there if os.path.realpath(path) != os.path.realpath(device)]
    return found + (ask_buses(others, smbus2.SMBus) if asks_all else [])


def _probe_chip(device, header, car, bus):
    address, name = car.address, f"0x{car.address:02x} on {device}"
    with closing(bus):
        try:
            bus.open(device)
        except OSError as error:
            return [Finding(BAD, "bus", f"{device} can't be opened ({error.strerror})",
                            "See what it is: ls -l /dev/i2c-*")]
        try:
            mode1, prescale = (bus.read_byte_data(address, register) for register in (MODE1, PRE_SCALE))
            return check_chip(name, mode1, prescale, is_pca9685(bus, address), car)
        except OSError as error:
            return check_no_answer(name, error, device, header, find_others(bus, address))


def _buses():
    """Return the paths of the I²C buses, each once, whatever links lead to it."""
    paths = {os.path.realpath(path): path for path in sorted(glob.glob("/dev/i2c-*"), reverse=True) if _is_i2c(path)}
    return sorted(paths.values())


def _is_i2c(path):
    return (device_number(path) or (None,))[0] == I2C_MAJOR


def check_bus(path: str, header: Header, there: Sequence[str]) -> Finding:
    """Check whether a bus is there, an I²C bus, and open to this user; ``there`` are those that are."""
    exists, denial = os.path.exists(path), None
    if not (exists and _is_i2c(path)):
        cause, remedy = explain(OSError(errno.ENOTTY if exists else errno.ENOENT, ""), path, exists, header)
        denial = cause + (f"; there are {', '.join(there)}" if there else ""), remedy
    elif not os.access(path, os.R_OK | os.W_OK, effective_ids=True):
        denial = explain_denial(path)
    if denial:
        return Finding(BAD, "bus", f"{path}: {denial[0]}", denial[1])
    pins = f", pins 3 and 5 of this {header.computer}" if header.computer and path == header.bus_paths[0] else ""
    return Finding(OK, "bus", f"{path}{pins}")


def find_others(bus: Any, address: int | None) -> list[int]:
    """Return where PCA9685s answer at the other ``NEIGHBOURS``; stops where the bus itself fails."""
    found = []
    for other in NEIGHBOURS:
        try:
            if other != address and is_pca9685(bus, other):
                found.append(other)
        except OSError as error:
            if error.errno not in (*NOT_ACKNOWLEDGED, errno.EBUSY):
                break
    return found


def ask_buses(paths: Sequence[str], make_bus: Callable[[], Any]) -> list[Finding]:
    """Return one finding for each bus with PCA9685s, and one for those that have none or can't be asked."""
    found, empty = [], []
    for path in paths:
        with closing(make_bus()) as bus:
            try:
                bus.open(path)
            except OSError as error:
                empty.append(f"{path} ({error.strerror})")
                continue
            boards = find_others(bus, None)
        found += [Finding(WARN, "bus", f"a PCA9685 answers at 0x{address:02x} on {path}",
                          f"If that is the car's: i2c:={path} address:=0x{address:02x}") for address in boards]
        if not boards:
            empty.append(path)
    return found + ([Finding(OK, "bus", f"no PCA9685 on {', '.join(empty)}")] if empty else [])


def check_chip(name: str, mode1: int, prescale: int, is_marked: bool, car: Car) -> list[Finding]:
    """Judge what a chip's registers say; ``is_marked``: see ``is_pca9685``."""
    registers = f"MODE1 0x{mode1:02x}, PRE_SCALE {prescale}"
    frequency_hz, driven = frequency_for(prescale, car.oscillator_hz), car.runs("pca9685")
    is_reset = (mode1, prescale) == (RESET_MODE1, RESET_PRESCALE)
    is_as_set = mode1 & AUTO_INCREMENT and not mode1 & SLEEP and car.prescale in (None, prescale)
    return first(
        "chip",
        (not is_marked, BAD, f"{name} answers, but not as a PCA9685 does: {registers}",
         "See which chip that is: an INA sensor also likes 0x40; move one of them by its solder pads"),
        (mode1 & EXTCLK, BAD, f"{name} waits for a clock at its EXTCLK pin: {registers}",
         "Cut its power for a moment: this bit can't be cleared"),
        (driven and not is_as_set, BAD, f"{name} doesn't run as the pca9685 node set it: {registers}",
         "See who else writes to it, and whether its power holds"),
        (driven, OK, f"{name} is driven at {frequency_hz:.1f} Hz: {registers}"),
        (is_reset, OK, f"{name} is fresh from power-up: {registers}"),
        (mode1 & SLEEP, OK, f"{name} sleeps: {registers}"),
        (not SERVO_HZ[0] <= frequency_hz <= SERVO_HZ[1], WARN,
         f"{name} runs at {frequency_hz:.1f} Hz, which no servo takes: {registers}",
         "Nothing, if another program left it so: the pca9685 node sets it"),
        (True, OK, f"{name} runs at {frequency_hz:.1f} Hz, left so by another program: {registers}"))


def check_no_answer(name: str, error: OSError, device: str, header: Header, others: Sequence[int]) -> list[Finding]:
    """Return the finding about a chip that can't be read; ``others`` are what ``find_others`` found."""
    is_absent, (cause, remedy) = error.errno in NOT_ACKNOWLEDGED, explain(error, device, True, header)
    listed = [f"0x{address:02x}" for address in others]
    return first(
        "chip",
        (is_absent and listed, BAD, f"nothing answers at {name}, but a PCA9685 at {', '.join(listed)}",
         f"If that is your board: address:={listed and listed[0]}"),
        (True, BAD, f"{name}: {cause}", remedy + (f". {PROBE}" if is_absent else "")))


# --- the Teensy's port ---

def is_pseudo_terminal(port: str) -> bool:
    """Return whether there is a program behind a port, as with car_sim."""
    return os.path.realpath(port).startswith(PSEUDO_TERMINALS)


def probe_port(port: str, baud: int):
    """Open the port, unless another program has it, and examine what is behind it."""
    if not _may_be_terminal(port):
        return [Finding(BAD, "port", f"{port}: this is not a serial port", LIST_PORTS)]
    # The program behind a pseudo-terminal may hold this end, too.
    is_real = device_number(port) and not is_pseudo_terminal(port)
    holders = openers(port) or consoles(port) if is_real else []
    if holders:
        return check_holders(port, holders)
    from car_interface.teensy.link.port import PortError, SerialLink  # it needs pyserial, which may be what is missing
    with closing(SerialLink(port, baud)) as link:
        try:
            link.open()
            teensy = _probe(link, baud)
        except PortError as error:
            # Any process may have something else open at this path, such as /dev/null.
            hubs = [holder for holder in openers(port) if holder[1] in HUBS] if error.state == BUSY else []
            return check_holders(port, hubs) or [Finding(BAD, "port", f"{port}: {error.cause}", error.remedy)]
    kind = "a pseudo-terminal: a virtual Teensy" if is_pseudo_terminal(port) else "a serial port, and nobody has it"
    note = port_note(port, read_header())
    if note and teensy.level == BAD:
        teensy = teensy._replace(remedy=f"{port}: {note}. {teensy.remedy}")
    return [Finding(OK, "port", f"{port} is {kind}"), teensy]


def _may_be_terminal(path):
    """Return whether a path may be opened for a look: to open another kind of device may do anything."""
    number = device_number(path)
    if number is None or is_pseudo_terminal(path):
        return True  # opening it says more
    kind = os.path.realpath("/sys/dev/char/{}:{}/subsystem".format(*number))
    return os.path.basename(kind) == "tty" or not os.path.exists(kind) and number[0] != MEMORY_MAJOR


def _probe(link, baud):
    """Return the finding about the Teensy behind an open port."""
    now_ns, data = time.monotonic_ns(), b""
    probe = TeensyProbe(baud, now_ns)
    while not probe.is_done(now_ns):
        to_send = probe.step(data, now_ns)
        if to_send:
            link.write(to_send)
        has_data, _, _ = select.select([link.fileno()], [], [], POLL_S)
        data, now_ns = link.read() if has_data else b"", time.monotonic_ns()
    return probe.finding()


def check_holders(path: str, holders: Sequence[tuple[int, str]]) -> list[Finding]:
    """Return a finding when other programs have the port open; bytes that they read, the hub can't."""
    names = [f"{name} (process {pid})" for pid, name in holders]
    programs = [name for _, name in holders]
    hubs = [name for name, program in zip(names, programs) if program in HUBS]
    open_in = ", ".join(names[:MAX_NAMES]) + (f" and {len(names) - MAX_NAMES} more" if names[MAX_NAMES:] else "")
    what = f"{path}: another program has it open: {open_in}"
    return first(
        "port",
        (hubs, WARN, f"{path}: {hubs and hubs[0]} has it open, but doesn't answer under this master and namespace",
         "See the nodes above; or run the doctor with that node's ROS_MASTER_URI, and --ns"),
        ("ModemManager" in programs, BAD, what,
         f"It tries every new port. Keep it off: {SETUP_COMMAND}, then plug the Teensy in anew"),
        (set(programs) & set(PROGRAMS), BAD, what, f"That is a log-in console: {removal_remedy(path)}"),
        (holders, BAD, what, f"End it; more about it: fuser -v {path}"))


def check_link(link: Any, port: str, node: Node) -> list[Finding]:
    """Judge port and link by the running hub's LinkStatus; ``None`` = no message came."""
    if link is None:
        return [Finding(BAD, "Teensy", f"{node.path} runs, but its topic link is silent: it hangs",
                        restart_remedy(node.process), by_silence=True)]
    level, remedy = min(link.level, BAD), link.next_step or f"rostopic echo {node.path}/link"
    if link.state in PORT_FAULTS:
        return [Finding(level, "port", f"{port}: {link.words}", remedy)]
    pong = _describe_pong(link.round_trip, link.firmware_checksum)
    return [Finding(OK, "port", f"{port} is {node.path}'s"),
            Finding(level, "Teensy", link.words, remedy) if level else Finding(OK, "Teensy", f"{link.words}; {pong}")]


def check_virtual_port(port: str, simulator: str, hub_runs: bool) -> list[Finding]:
    """Judge a virtual Teensy's port while car_sim, which makes it, doesn't run; ``simulator`` is its state."""
    return first(
        "port",
        (simulator != ABSENT, BAD,
         f"{port}: nothing comes from the virtual Teensy: car_sim, which is behind this port, doesn't answer",
         "See the nodes above"),
        (True, BAD if hub_runs else WARN,
         f"{port}: there is no virtual Teensy: car_sim, which makes this port, doesn't run",
         "roslaunch car_interface demo.launch; or give the real port by --port"))


def _describe_pong(round_trip_s, checksum):
    if math.isnan(round_trip_s):
        return "no pong yet"
    return f"pong after {1e3 * round_trip_s:.1f} ms ({checksum} checksum)"


class TeensyProbe:
    """Pings a Teensy and judges the link, until its state is known. No clock, no port: bytes and ``now_ns`` in."""

    def __init__(self, baud: int, now_ns: int):
        self._session = Session(baud, PING_PERIOD_NS, pinging.AUTO, now_ns)
        self._session.opened(now_ns)
        self._end_ns = now_ns + MAX_TRANSMIT_NS
        self._sonars: set = set()  # that have reported
        self._sonars_ns = now_ns + SONARS_WITHIN_NS

    def step(self, data: bytes, now_ns: int) -> bytes:
        """Take what came from the port, judge, and return what to send now; often nothing."""
        self._sonars.update(event.sensor for event in self._session.receive(data, now_ns)
                            if isinstance(event, protocol.SonarStatus))
        self._session.expire(now_ns)
        self._session.judge(now_ns)
        if now_ns < self._session.pinger.due_ns:
            return b""
        return self._session.ping(now_ns // NS_PER_MS % protocol.UINT32, now_ns)

    def is_done(self, now_ns: int) -> bool:
        """Return whether the state is known, or it took too long."""
        has_sonar_reports = len(self._sonars) == len(SONARS) or now_ns >= self._sonars_ns
        is_fine = self._session.health.verdict.state == FINE and self._session.pinger.answered > 1 and has_sonar_reports
        return now_ns >= self._end_ns or is_fine and not self._session.tally.bad_frames

    def finding(self) -> Finding:
        """Return the finding about the Teensy."""
        verdict, pinger = self._session.health.verdict, self._session.pinger
        missing = [name for sensor, name in enumerate(SONARS) if sensor not in self._sonars]
        named = "any of the sonars" if len(missing) == len(SONARS) else (
            f"the sonar{'' if len(missing) == 1 else 's'} {', '.join(missing)}")
        pong = _describe_pong(self._session.round_trip_ns / 1e9, pinger.answered_checksum)
        return first(
            "Teensy",
            (verdict.state == FINE and not pinger.answered, WARN, f"{verdict.description}, but no ping was answered",
             "Check the wire from this port's TX to the Teensy's RX"),
            (verdict.state == WAITING, WARN, "too little came to judge it", "Run the doctor again"),
            (verdict.level != OK, verdict.level, verdict.description, verdict.next_step),
            (missing, WARN,
             f"{verdict.description}, but nothing came from {named} in {SONARS_WITHIN_NS / 1e9:g} s", SONARS_REMEDY),
            (True, OK, f"{verdict.description}; {pong}"))[0]
