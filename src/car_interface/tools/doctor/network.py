"""Examines the ROS network: where the master is, who can reach it, and whether others can reach what starts here."""
from __future__ import annotations

import ipaddress
import os
import socket
from typing import Callable, Iterable, Mapping, NamedTuple
from urllib.parse import urlsplit

from car_interface.tools.doctor.findings import BAD, OK, WARN, Finding

DEFAULT_PORT = 11311
LISTENING = "0A"  # as /proc/net/tcp has it
LOCAL_ONLY = "export ROS_IP=127.0.0.1 ROS_MASTER_URI=http://127.0.0.1:{port}"


def probe_network(uri: str, ask_master: Callable[[], str]) -> tuple[list[Finding], list[Finding], bool]:
    """Return the findings about the master and about this computer's address, and whether the master answers.

    Args:
        uri: ROS_MASTER_URI.
        ask_master: returns why the master doesn't answer; empty when it does.
    """
    place = host_and_port(uri) if uri else None
    if place is None:
        return check_master(MasterAddress(uri)), [], False
    here = leads_here(place[0])
    trouble = ask_master() if here is not None else "its host can't be found"
    master = MasterAddress(uri, trouble, here, listeners(_tcp_tables(), place[1]) if here else ())
    name = os.environ.get("ROS_HOSTNAME") or os.environ.get("ROS_IP") or socket.gethostname()  # as ROS has it
    is_here = leads_here(name)
    own = LocalAddress(name, is_here is not None, bool(is_here), _leads_to_loopback(name))
    return check_master(master), check_local_address(os.environ, own, here is not False), not trouble


def _addresses(host):
    try:
        return {info[4][0] for info in socket.getaddrinfo(host, None, type=socket.SOCK_STREAM)}
    except (OSError, UnicodeError):
        return set()


def leads_here(host: str) -> bool | None:
    """Return whether a name leads to this computer; ``None`` when it leads nowhere."""
    addresses = _addresses(host)
    return any(map(_is_local, addresses)) if addresses else None


def _is_local(address):
    family = socket.AF_INET6 if ":" in address else socket.AF_INET
    with socket.socket(family, socket.SOCK_STREAM) as probe:
        try:
            probe.bind((address, 0))
        except OSError:
            return False
    return True


def _leads_to_loopback(host):
    addresses = _addresses(host)
    return bool(addresses) and all(address == "::1" or address.startswith("127.") for address in addresses)


def _tcp_tables():
    for path in ("/proc/net/tcp", "/proc/net/tcp6"):
        try:
            with open(path, encoding="ascii") as file:
                yield file.read()
        except OSError:
            continue


class MasterAddress(NamedTuple):
    """Where the master is, and whether it's there."""

    uri: str  # ROS_MASTER_URI; empty when it isn't set
    trouble: str = ""  # why it didn't answer; empty when it did
    is_here: bool | None = True  # whether its host is this one; None when the host's name can't be resolved
    listens_on: tuple = ()  # the addresses that something on this host listens on at its port


def host_and_port(uri: str) -> tuple[str, int] | None:
    """Return host and port of a master's URI; ``None`` when it's none."""
    try:
        parts = urlsplit(uri)
        if parts.scheme != "http" or not parts.hostname:
            return None
        return parts.hostname, parts.port or DEFAULT_PORT
    except ValueError:
        return None


def check_master(master: MasterAddress) -> list[Finding]:
    """Check whether it answers, and who else can reach it."""
    if not master.uri:
        return [Finding(BAD, "master", "ROS_MASTER_URI is not set: no ROS program can run",
                        "Source the workspace: source devel/setup.bash")]
    place = host_and_port(master.uri)
    if place is None:
        return [Finding(BAD, "master", f"ROS_MASTER_URI is {master.uri}, which is no master's address",
                        f"export ROS_MASTER_URI=http://localhost:{DEFAULT_PORT}")]
    if master.is_here is None:
        return [Finding(BAD, "master", f"its host, {place[0]}, can't be found",
                        "Correct ROS_MASTER_URI, or add the name to /etc/hosts")]
    if not master.trouble:
        return [_exposure(master, *place)]
    if not master.is_here:
        return [Finding(BAD, "master", f"it's on another host, and {master.uri} doesn't answer ({master.trouble})",
                        f"Start it there, or see whether the network lets you: ping {place[0]}")]
    if master.listens_on:
        return [Finding(BAD, "master", f"something listens at {master.uri}, but doesn't answer as a master does "
                                       f"({master.trouble})", "End it, and start roslaunch again")]
    return [Finding(WARN, "master", f"none runs at {master.uri}; all that needs one was left out below",
                    "roslaunch starts one: roslaunch car_interface car.launch")]


def _exposure(master, host, port):
    """Return who can reach a master that answers."""
    lock_in = LOCAL_ONLY.format(port=port)
    if not master.is_here:
        return Finding(WARN, "master", f"{master.uri} is on another host: whoever reaches it drives the car",
                       "Keep both in a VPN, as the README says under 'Who can drive the car'")
    exposed = [address for address in master.listens_on if not ipaddress.ip_address(address).is_loopback]
    if exposed:
        is_any = any(ipaddress.ip_address(address).is_unspecified for address in exposed)
        where = "every interface" if is_any else ", ".join(exposed)
        return Finding(WARN, "master", f"{master.uri} listens on {where}: whoever reaches it drives the car",
                       f"Before roslaunch: {lock_in}; or a firewall or VPN, see the README")
    return Finding(OK, "master", f"{master.uri} answers, on the loopback only" if master.listens_on else
                   f"{master.uri} answers")


def listeners(tables: Iterable[str], port: int) -> tuple[str, ...]:
    """Return the addresses that something listens on at a TCP port, by the texts of /proc/net/tcp and tcp6."""
    found = set()
    for table in tables:
        for line in table.splitlines()[1:]:
            fields = line.split()
            address, _, number = fields[1].rpartition(":")
            if fields[3] == LISTENING and int(number, 16) == port:
                found.add(_address(address))
    return tuple(sorted(found))


def _address(hexadecimal):
    """Return an address of the kernel's table: groups of four bytes, the lowest first on a little-endian computer."""
    data = bytes.fromhex(hexadecimal)
    data = b"".join(data[start:start + 4][::-1] for start in range(0, len(data), 4))
    address = ipaddress.ip_address(data)
    mapped = getattr(address, "ipv4_mapped", None)
    return str(mapped or address)


class LocalAddress(NamedTuple):
    """The name or address by which nodes that are started here ask others to call them."""

    name: str  # ROS_HOSTNAME, ROS_IP or this host's name
    resolves: bool  # whether it can be looked up from here
    is_here: bool  # whether it leads to this host
    is_loopback: bool  # whether it can be reached from this host only


def check_local_address(environment: Mapping[str, str], own: LocalAddress, master_is_here: bool) -> list[Finding]:
    """Check whether other nodes can reach what is started here."""
    both = [name for name in ("ROS_HOSTNAME", "ROS_IP") if environment.get(name)]
    source = both[0] if both else "this host's name"
    remedy = ("export ROS_IP=127.0.0.1" if master_is_here else
            "export ROS_IP to this computer's address in the network that it shares with the master: ip -br address")
    if own.name == "":
        return [Finding(BAD, "address", "this host has no name, and ROS_IP is not set", remedy)]
    if not own.resolves:
        return [Finding(BAD, "address", f"{source}, {own.name}, can't be looked up: no node can reach another", remedy)]
    if not own.is_here:
        return [Finding(BAD, "address", f"{source}, {own.name}, isn't this computer's: no node here can be reached",
                        remedy)]
    if own.is_loopback and not master_is_here:
        return [Finding(BAD, "address", f"{source} is {own.name}, but the master is on another host: nodes there "
                                        "can't reach those here", remedy)]
    if len(both) == 2:
        return [Finding(WARN, "address", f"ROS_HOSTNAME ({own.name}) and ROS_IP ({environment['ROS_IP']}) are both "
                                         "set; the first one counts", "unset ROS_IP, or the other one")]
    return [Finding(OK, "address", f"{source}, {own.name}" + (": reached from this computer only" if own.is_loopback
                                                              else ""))]
