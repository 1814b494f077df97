"""Examines the ROS network: where the master is, who can reach it, and whether others can reach what starts here."""
from __future__ import annotations

import ipaddress
import os
import socket
from typing import Callable, Iterable, Mapping, Sequence
from urllib.parse import urlsplit

from car_interface.tools.doctor.findings import BAD, OK, WARN, Finding, first

DEFAULT_PORT = 11311
LISTENING = "0A"  # as /proc/net/tcp has it
LOCAL_ONLY = "export ROS_IP=127.0.0.1 ROS_MASTER_URI=http://127.0.0.1:{port}"


def probe_network(uri: str, ask_master: Callable[[], str]) -> tuple[list[Finding], list[Finding], bool]:
    """Return the findings about the master and about this computer's address, and whether the master answers.

    Args:
        uri: ROS_MASTER_URI.
        ask_master: returns why the master doesn't answer; empty when it does.
    """
    place = host_and_port(uri)
    if place is None:
        return check_master(uri), [], False
    here = leads_here(place[0])
    trouble = ask_master() if here is not None else "its host can't be found"
    master = check_master(uri, trouble, here, listeners(_tcp_tables(), place[1]) if here else ())
    name = os.environ.get("ROS_HOSTNAME") or os.environ.get("ROS_IP") or socket.gethostname()  # as ROS has it
    own = check_local_address(os.environ, here is not False, name, leads_here(name), _leads_to_loopback(name))
    return master, own, not trouble


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


def host_and_port(uri: str) -> tuple[str, int] | None:
    """Return host and port of a master's URI; ``None`` when it's none."""
    try:
        parts = urlsplit(uri)
        if parts.scheme != "http" or not parts.hostname:
            return None
        return parts.hostname, parts.port or DEFAULT_PORT
    except ValueError:
        return None


def check_master(uri: str, trouble: str = "", is_here: bool | None = True,
                 listens_on: Sequence[str] = ()) -> list[Finding]:
    """Check whether the master answers, and who else can reach it.

    Args:
        uri: ROS_MASTER_URI; empty when it isn't set.
        trouble: why it didn't answer; empty when it did.
        is_here: whether its host is this one; ``None`` when the host's name can't be resolved.
        listens_on: the addresses that something on this host listens on at its port.
    """
    host, port = host_and_port(uri) or ("", DEFAULT_PORT)
    exposed = [ipaddress.ip_address(address) for address in listens_on]
    exposed = [address for address in exposed if not address.is_loopback]
    where = "every interface" if any(address.is_unspecified for address in exposed) else ", ".join(map(str, exposed))
    return first(
        "master",
        (not uri, BAD, "ROS_MASTER_URI is not set: no ROS program can run",
         "Source the workspace: source devel/setup.bash"),
        (not host, BAD, f"ROS_MASTER_URI is {uri}, which is no master's address",
         f"export ROS_MASTER_URI=http://localhost:{DEFAULT_PORT}"),
        (is_here is None, BAD, f"its host, {host}, can't be found",
         "Correct ROS_MASTER_URI, or add the name to /etc/hosts"),
        (trouble and not is_here, BAD, f"it's on another host, and {uri} doesn't answer ({trouble})",
         f"Start it there, or see whether the network lets you: ping {host}"),
        (trouble and listens_on, BAD, f"something listens at {uri}, but doesn't answer as a master does ({trouble})",
         "End it, and start roslaunch again"),
        (trouble, WARN, f"none runs at {uri}; all that needs one was left out below",
         "roslaunch starts one: roslaunch car_interface car.launch"),
        (not is_here, WARN, f"{uri} is on another host: whoever reaches it drives the car",
         "Keep both in a VPN, as the README says under 'Who can drive the car'"),
        (exposed, WARN, f"{uri} listens on {where}: whoever reaches it drives the car",
         f"Before roslaunch: {LOCAL_ONLY.format(port=port)}; or a firewall or VPN, see the README"),
        (listens_on, OK, f"{uri} answers, on the loopback only"),
        (True, OK, f"{uri} answers"))


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


def check_local_address(environment: Mapping[str, str], master_is_here: bool, name: str, is_here: bool | None = True,
                        is_loopback: bool = False) -> list[Finding]:
    """Check whether other nodes can reach what is started here.

    Args:
        name: by which nodes here ask others to call them: ROS_HOSTNAME, ROS_IP or this host's name.
        is_here: whether it leads to this host; ``None`` = it can't be looked up.
        is_loopback: whether it can be reached from this host only.
    """
    both = [variable for variable in ("ROS_HOSTNAME", "ROS_IP") if environment.get(variable)]
    source = both[0] if both else "this host's name"
    remedy = ("export ROS_IP=127.0.0.1" if master_is_here else
              "export ROS_IP to this computer's address in the network that it shares with the master: ip -br address")
    return first(
        "address",
        (not name, BAD, "this host has no name, and ROS_IP is not set", remedy),
        (is_here is None, BAD, f"{source}, {name}, can't be looked up: no node can reach another", remedy),
        (not is_here, BAD, f"{source}, {name}, isn't this computer's: no node here can be reached", remedy),
        (is_loopback and not master_is_here, BAD,
         f"{source} is {name}, but the master is on another host: nodes there can't reach those here", remedy),
        (len(both) == 2, WARN,
         f"ROS_HOSTNAME ({name}) and ROS_IP ({environment.get('ROS_IP')}) are both set; the first one counts",
         "unset ROS_IP, or the other one"),
        (is_loopback, OK, f"{source}, {name}: reached from this computer only"),
        (True, OK, f"{source}, {name}"))
