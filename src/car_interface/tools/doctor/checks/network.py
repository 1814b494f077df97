"""The ROS network: where the master is, who can reach it, and whether others can reach what is started here."""
from __future__ import annotations

import ipaddress
from typing import Iterable, Mapping, NamedTuple
from urllib.parse import urlsplit

from car_interface.tools.doctor.checks.findings import BAD, OK, WARN, Finding

DEFAULT_PORT = 11311
LISTENING = "0A"  # as /proc/net/tcp has it
LOCAL_ONLY = "export ROS_IP=127.0.0.1 ROS_MASTER_URI=http://127.0.0.1:{port}"


class MasterAddress(NamedTuple):
    """Where the master is, and whether it's there."""

    uri: str  # ROS_MASTER_URI; empty when it isn't set
    trouble: str = ""  # why it didn't answer; empty when it did
    is_here: bool | None = True  # whether its host is this one; None when the host's name can't be resolved
    listens_on: tuple = ()  # the addresses that something on this host listens on at its port


def host_and_port(uri: str) -> tuple[str, int] | None:
    """Host and port of a master's URI; ``None`` when it's none."""
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
    exposed = [address for address in master.listens_on if not _is_loopback(address)]
    if exposed:
        where = "every interface" if any(_is_any(address) for address in exposed) else ", ".join(exposed)
        return Finding(WARN, "master", f"{master.uri} listens on {where}: whoever reaches it drives the car",
                       f"Before roslaunch: {lock_in}; or a firewall or VPN, see the README")
    return Finding(OK, "master", f"{master.uri} answers, on the loopback only" if master.listens_on else
                   f"{master.uri} answers")


def _is_loopback(address):
    return ipaddress.ip_address(address).is_loopback


def _is_any(address):
    return ipaddress.ip_address(address).is_unspecified


def listeners(tables: Iterable[str], port: int) -> tuple[str, ...]:
    """Return the addresses that something listens on at a TCP port.

    Args:
        tables: the texts of /proc/net/tcp and /proc/net/tcp6, on a little-endian computer.
    """
    found = set()
    for table in tables:
        for line in table.splitlines()[1:]:
            fields = line.split()
            address, _, number = fields[1].rpartition(":")
            if fields[3] == LISTENING and int(number, 16) == port:
                found.add(_address(address))
    return tuple(sorted(found))


def _address(hexadecimal):
    """Groups of four bytes, each with its lowest byte first."""
    data = bytes.fromhex(hexadecimal)
    data = b"".join(data[start:start + 4][::-1] for start in range(0, len(data), 4))
    address = ipaddress.ip_address(data)
    mapped = getattr(address, "ipv4_mapped", None)
    return str(mapped or address)


class LocalAddress(NamedTuple):
    """Under which name or address the nodes that are started here tell others to call them."""

    name: str  # ROS_HOSTNAME, ROS_IP or this host's name
    resolves: bool  # whether it can be looked up from here
    is_here: bool  # whether it leads to this host
    is_loopback: bool  # whether it can be reached from this host only


def local_name(environment: Mapping[str, str], host_name: str) -> str:
    """Return the name that ROS would take: ROS_HOSTNAME, else ROS_IP, else the host's."""
    return environment.get("ROS_HOSTNAME") or environment.get("ROS_IP") or host_name


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
