"""Examines the Teensy's port: which programs have it open, and what comes through it when none has."""
from __future__ import annotations

import math
import os
import select
import time
from typing import Any, Sequence

from car_interface.common.device_access import SETUP_COMMAND, openers
from car_interface.common.header import port_note, read_header
from car_interface.common.units import NS_PER_MS, NS_PER_S
from car_interface.common.vehicle_geometry import SONARS
from car_interface.teensy.link import protocol
from car_interface.teensy.link.console import PROGRAMS, PSEUDO_TERMINALS, consoles, removal_remedy
from car_interface.teensy.link.health import BUSY, FINE, PORT_FAULTS, WAITING
from car_interface.teensy.link.pinging import AUTO
from car_interface.teensy.link.session import Session
from car_interface.tools.doctor.car import ABSENT, Node, restart_remedy
from car_interface.tools.doctor.computer import is_character_device
from car_interface.tools.doctor.findings import BAD, OK, WARN, Finding, first

HUBS = ("teensy_sensor_hub", "car_nodes")  # the processes that the hub may be
MEMORY_MAJOR = 1  # Documentation/admin-guide/devices.txt of the kernel
LIST_PORTS = "See which there are: ls /dev/serial/by-id /dev/ttyA*"
MAX_NAMES = 3
PING_PERIOD_NS = 300 * NS_PER_MS
SONARS_WITHIN_NS = 2500 * NS_PER_MS  # a round of all six takes 0.6 s at most, unless their wait was set longer
SONARS_REMEDY = ("Check their plugs, wires and supply; were they stopped, or left out of the sequence? The hub starts "
                 "them, and says more: roslaunch car_interface teensy_sensor_hub.launch")
MAX_TRANSMIT_NS = 3600 * NS_PER_MS  # five unanswered pings at 0.5 s each, and one with the other checksum


def is_pseudo_terminal(port: str) -> bool:
    """Return whether there is a program behind a port, as with car_sim."""
    return os.path.realpath(port).startswith(PSEUDO_TERMINALS)


def probe_port(port: str, baud: int):
    """Open the port, unless another program has it, and examine what is behind it."""
    if not _may_be_terminal(port):
        return [Finding(BAD, "port", f"{port}: this is not a serial port", LIST_PORTS)]
    # The program behind a pseudo-terminal may hold this end, too.
    is_real = is_character_device(port) and not is_pseudo_terminal(port)
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
    note = port_note(port, read_header())
    if note and teensy.level == BAD:
        teensy = teensy._replace(remedy=f"{port}: {note}. {teensy.remedy}")
    return [Finding(OK, "port", f"{port} is {kind}"), teensy]


def _may_be_terminal(path):
    """Return whether a path may be opened for a look: to open another kind of device may do anything."""
    if not is_character_device(path):
        return True  # opening it says more
    number = os.stat(path).st_rdev
    try:
        with open("/proc/tty/drivers", encoding="ascii", errors="replace") as file:
            return is_terminal(os.major(number), os.minor(number), file.read())
    except OSError:
        return os.major(number) != MEMORY_MAJOR


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
    return probe.findings()[0]


def check_holders(path: str, holders: Sequence[tuple[int, str]]) -> list[Finding]:
    """Return a finding when other programs have the port open; bytes that they read, the hub can't."""
    if not holders:
        return []
    names = [f"{name} (process {pid})" for pid, name in holders]
    programs = [name for _, name in holders]
    hub = next((name for name, program in zip(names, programs) if program in HUBS), None)
    if hub is not None:
        return [Finding(WARN, "port", f"{path}: {hub} has it open, but doesn't answer under "
                                      "this master and namespace",
                        "See the nodes above; or run the doctor with that node's ROS_MASTER_URI, and --ns")]
    if "ModemManager" in programs:
        remedy = f"It tries every new port. Keep it off: {SETUP_COMMAND}, then plug the Teensy in anew"
    elif set(programs) & set(PROGRAMS):
        remedy = f"That is a log-in console: {removal_remedy(path)}"
    else:
        remedy = f"End it; more about it: fuser -v {path}"
    others = f" and {len(names) - MAX_NAMES} more" if len(names) > MAX_NAMES else ""
    open_in = f"{', '.join(names[:MAX_NAMES])}{others}"
    return [Finding(BAD, "port", f"{path}: another program has it open: {open_in}", remedy)]


def is_terminal(major: int, minor: int, drivers: str) -> bool:
    """Return whether a device of this number is a serial port or another terminal.

    Args:
        drivers: /proc/tty/drivers, a driver in each line: ``serial /dev/ttyS 4 64-95 serial``.
    """
    for line in drivers.splitlines():
        fields = line.split()
        if len(fields) >= 4 and fields[2] == str(major):
            first, _, last = fields[3].partition("-")
            if int(first) <= minor <= int(last or first):
                return True
    return False


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
    if simulator != ABSENT:
        return [Finding(BAD, "port", f"{port}: nothing comes from the virtual Teensy: car_sim, which is behind this "
                                     "port, doesn't answer", "See the nodes above")]
    return [Finding(BAD if hub_runs else WARN, "port", f"{port}: there is no virtual Teensy: car_sim, which makes this "
                                                       "port, doesn't run",
                    "roslaunch car_interface demo.launch; or give the real port by --port")]


def _describe_pong(round_trip_s, checksum):
    if math.isnan(round_trip_s):
        return "no pong yet"
    return f"pong after {1e3 * round_trip_s:.1f} ms ({checksum} checksum)"


class TeensyProbe:
    """Pings a Teensy and judges the link, until its state is known. No clock, no port: bytes and ``now_ns`` in."""

    def __init__(self, baud: int, now_ns: int):
        self._session = Session(baud, PING_PERIOD_NS, AUTO, now_ns)
        self._session.opened(now_ns)
        self._end_ns = now_ns + MAX_TRANSMIT_NS
        self._sonars: set = set()  # that have reported
        self._sonars_ns = now_ns + SONARS_WITHIN_NS

    def update(self, data: bytes, now_ns: int) -> None:
        """Take what came from the port."""
        self._sonars.update(event.sensor for event in self._session.receive(data, now_ns)
                            if isinstance(event, protocol.SonarStatus))

    def step(self, now_ns: int) -> bytes:
        """Judge, and return what to send now; often nothing."""
        self._session.expire(now_ns)
        self._session.judge(now_ns)
        if now_ns < self._session.pinger.due_ns:
            return b""
        return self._session.ping(now_ns // NS_PER_MS % protocol.UINT32, now_ns)

    def next_event_ns(self) -> int:
        """Return when ``step`` has something to do."""
        return min(self._session.pinger.next_event_ns(), self._end_ns)

    def is_done(self, now_ns: int) -> bool:
        """Return whether the state is known, or it took too long."""
        has_sonar_reports = len(self._sonars) == len(SONARS) or now_ns >= self._sonars_ns
        is_fine = self._session.health.verdict.state == FINE and self._session.pinger.answered > 1 and has_sonar_reports
        return now_ns >= self._end_ns or is_fine and not self._session.tally.bad_frames

    def findings(self) -> list[Finding]:
        """Return the finding about the Teensy."""
        verdict, pinger = self._session.health.verdict, self._session.pinger
        missing = [name for sensor, name in enumerate(SONARS) if sensor not in self._sonars]
        within = f"{SONARS_WITHIN_NS / 1e9:g} s"
        pong = _describe_pong(self._session.round_trip_ns / 1e9, pinger.answered_checksum)
        return first(
            "Teensy",
            (verdict.state == FINE and not pinger.answered, WARN, f"{verdict.description}, but no ping was answered",
             "Check the wire from this port's TX to the Teensy's RX"),
            (verdict.state == WAITING, WARN, "too little came to judge it", "Run the doctor again"),
            (verdict.level != OK, verdict.level, verdict.description, verdict.next_step),
            (missing, WARN, f"{verdict.description}, but nothing came from {_describe_sonars(missing)} in {within}",
             SONARS_REMEDY),
            (True, OK, f"{verdict.description}; {pong}"))


def _describe_sonars(names):
    if len(names) == len(SONARS):
        return "any of the sonars"
    return ("the sonar " if len(names) == 1 else "the sonars ") + ", ".join(names)
