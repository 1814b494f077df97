"""Examines the computer itself: its network, whom its devices are open to, what its clock says, and what is installed.

Of the network: where the master is, who can reach it, and whether others can reach what starts here.
"""
from __future__ import annotations

import ctypes
import glob
import grp
import importlib
import importlib.metadata
import ipaddress
import os
import socket
import stat
import sys
import time
from contextlib import suppress
from importlib.util import find_spec
from typing import Any, Callable
from urllib.parse import urlsplit

from car_interface.common.devices import SETUP_REMEDY, read_header, read_membership
from car_interface.pca9685.config import AUTO
from car_interface.teensy.link.console import is_consoles
from car_interface.teleop.input_devices import find_pads
from car_interface.tools.doctor.findings import BAD, OK, WARN, Finding, all_of, first

PLAUSIBLE_YEARS = range(2024, 2100)
TIME_ERROR = 5  # what adjtimex returns while the clock is not synchronised: adjtimex(2)
TIMEX_SIZE = 512  # more than struct timex on any computer
DEFAULT_PORT = 11311  # the master's
LISTENING = "0A"  # as /proc/net/tcp has it
LOCAL_ONLY = "export ROS_IP=127.0.0.1 ROS_MASTER_URI=http://127.0.0.1:{port}"


def install(name: str) -> str:
    """Return the command that installs a ROS package, in the distribution that this terminal has sourced."""
    distribution = os.environ.get("ROS_DISTRO", "Debian")  # as Debian's own packages call it
    prefix = "python3" if distribution == "Debian" else f"ros-{distribution}"
    return f"sudo apt install {prefix}-{name.replace('_', '-')}"


# Class, subclass and protocol of an Xbox gamepad's first interface, and of a Logitech's in X mode: Linux,
# drivers/input/joystick/xpad.c. An Xbox One's gamepad has others that look alike and need no driver.
XBOX_INTERFACES = (("ff", "5d", "01"), ("ff", "5d", "81"), ("ff", "47", "d0"))
NO_XPAD_REMEDY = ("sudo modprobe xpad. If there is no such module, as on a Jetson: set the switch of a Logitech at D, "
                  "connect an Xbox gamepad by Bluetooth, or build xpad")
# What nodes import: how it's distributed, and what installs it.
LIBRARIES = (
    ("rospy", "rospy", f"Source the workspace; or {install('rospy')}"),
    ("car_interface.msg", "", "Build the workspace and source it: catkin_make && source devel/setup.bash"),
    ("diagnostic_updater", "diagnostic_updater", install("diagnostic_updater")),
    ("dynamic_reconfigure", "dynamic_reconfigure", install("dynamic_reconfigure")),
    ("evdev", "evdev", "sudo apt install python3-evdev"),
    ("serial", "pyserial", "sudo apt install python3-serial"),
    ("smbus2", "smbus2", "sudo apt install python3-smbus2 (Ubuntu 20.04: pip3 install smbus2)"),
)

# Definitions of messages that nodes import.
MESSAGES = ("diagnostic_msgs", "geometry_msgs", "nav_msgs", "sensor_msgs", "std_msgs", "std_srvs", "tf2_msgs",
            "visualization_msgs")
# What the commands for recordings import, and where docs/recordings.md has them installed.
TOOLS = {"jinja2": "Jinja2", "matplotlib": "matplotlib", "numpy": "numpy", "rosbags": "rosbags", "scipy": "scipy",
         "tqdm": "tqdm", "yaml": "PyYAML"}
TOOLS_ENVIRONMENT = "~/car_tools/bin/car-interface"
INSTALL_TOOLS = "docs/recordings.md, Install the tools"


def probe_groups(port: str, bus: str, virtual_port: bool, virtual_bus: bool) -> list[Finding]:
    """Return one finding for all groups of the car's devices that this process is in, and one for each other."""
    path = read_header().bus_paths[0] if bus == AUTO else bus
    is_closed = any(not os.access(pad.path, os.R_OK) for pad in find_pads())
    # Groups, what each is for, and how bad it is to be outside. Of a device that is missing, that is the first thing to
    # be told as bad.
    needs = [need for is_needed, *need in (
        (not virtual_port, group_of(port, "dialout"), "the Teensy's port", BAD if os.path.exists(port) else WARN),
        (not virtual_bus, group_of(path, "i2c"), "the servo board's bus", BAD if os.path.exists(path) else WARN),
        (is_closed, "input", "the gamepad", WARN)) if is_needed]
    who = read_membership()
    if who.is_root or not needs:
        return first("groups", (who.is_root, OK, "this is root, which needs none; the nodes don't need root"),
                     (True, OK, "none needed: the devices are virtual"))
    inside = [group for group, _, _ in needs if group in who.of_process]
    return all_of("groups", (inside, OK, f"{who.user} is in {', '.join(inside)}")) + [
        finding for group, purpose, level in needs if group not in inside for finding in first(
            "groups",
            (group in who.of_user, level, f"{who.user} joined {group} ({purpose}) after this log-in",
             f"Log in anew; for this terminal alone: newgrp {group}"),
            (group not in who.existing, level, f"there is no group {group} ({purpose})", SETUP_REMEDY),
            (True, level, f"{who.user} is not in {group} ({purpose})", SETUP_REMEDY))]


def group_of(path: str, usual: str) -> str:
    """Return a device's group; the usual one when it's absent, a console's, or root's (without a udev rule)."""
    try:
        gid = os.stat(path).st_gid
        return grp.getgrgid(gid).gr_name if gid and not is_consoles(path) else usual
    except (OSError, KeyError):
        return usual


def device_number(path: str) -> tuple[int, int] | None:
    """Return the major and minor number of a character device, as each port and bus is one; ``None`` = it isn't one."""
    with suppress(OSError):
        status = os.stat(path)
        if stat.S_ISCHR(status.st_mode):
            return os.major(status.st_rdev), os.minor(status.st_rdev)
    return None


def probe_clock(uses_sim_time: bool) -> list[Finding]:
    """Check the wall clock and ROS time; the driving itself goes by the monotonic clock and minds neither."""
    year, synchronised = time.gmtime().tm_year, _is_synchronised()
    return all_of(
        "clock",
        (year not in PLAUSIBLE_YEARS, BAD, f"it's the year {year}: stamps and bags will be wrong",
         "Connect to a network, or set it: sudo date -s 'YYYY-MM-DD hh:mm'"),
        (year in PLAUSIBLE_YEARS and synchronised is False, WARN,
         "not synchronised: stamps of two computers, and the dates of bags, may be off; driving doesn't depend on it",
         "sudo timedatectl set-ntp true, and a network; see timedatectl"),
        (uses_sim_time, WARN, "/use_sim_time is true: stamps stand still unless something publishes /clock",
         "On a car: rosparam delete /use_sim_time, and start again")) or [Finding(
             OK, "clock", "synchronised" if synchronised else "the kernel doesn't say whether it's synchronised")]


def _is_synchronised():
    """Return whether the clock is, as the kernel has it; ``None`` where it isn't known."""
    try:
        state = ctypes.CDLL(None, use_errno=True).adjtimex(ctypes.create_string_buffer(TIMEX_SIZE))  # zeros: only asks
    except (OSError, AttributeError):
        return None
    return None if state < 0 else state != TIME_ERROR


def probe_versions() -> list[Finding]:
    """Return one finding for Python and all libraries that can be imported, and one for each that can't."""
    versions = {name: _version(name, distribution) for name, distribution, _ in LIBRARIES}
    good = [f"{name} {version}".strip() for name, version in versions.items() if version is not None]
    bad = [(name, remedy) for name, _, remedy in LIBRARIES if versions[name] is None]
    bad += [(name, install(name)) for name in MESSAGES if not find_spec(name)]
    return [Finding(OK, "versions", ", ".join(["Python " + ".".join(map(str, sys.version_info[:3])), *good])),
            *(Finding(BAD, "versions", f"{name} can't be imported", remedy) for name, remedy in bad)]


def _version(name, distribution):
    try:
        module = importlib.import_module(name)
    except Exception:  # a library can fail in any way; that it does is the finding
        return None
    try:
        return importlib.metadata.version(distribution) if distribution else ""
    except importlib.metadata.PackageNotFoundError:
        return str(getattr(module, "__version__", ""))


def probe_packages() -> list[Finding]:
    """Look for what not every car needs: the libraries of the tools for recordings."""
    missing = [distribution for name, distribution in TOOLS.items() if not find_spec(name)]
    verb = "is" if len(missing) == 1 else "are"
    return first(
        "packages",
        (not missing, OK, "the tools for recordings have theirs"),
        (os.path.exists(os.path.expanduser(TOOLS_ENVIRONMENT)), OK,
         f"the tools for recordings are in {TOOLS_ENVIRONMENT}"),
        (True, WARN,
         f"{', '.join(missing)} {verb} missing for bag_report, check_map and the calibration; driving needs none of it",
         f"rosdep install, or on Debian a virtual environment: {INSTALL_TOOLS}"))


def probe_driver(folder: str = "/sys/bus/usb/devices") -> list[Finding]:
    """Look for Xbox gamepads on USB, and others that are like them, for which this computer has no driver.

    Args:
        folder: where the kernel lists USB devices: Linux, Documentation/ABI/testing/sysfs-bus-usb.
    """
    found = []
    for interface in sorted(glob.glob(f"{folder}/*:1.0")):
        kind = tuple(_read_word(interface, f"bInterface{name}") for name in ("Class", "SubClass", "Protocol"))
        if kind in XBOX_INTERFACES and not os.path.exists(f"{interface}/driver"):
            device = interface.partition(":")[0]
            numbers = f"{_read_word(device, 'idVendor')}:{_read_word(device, 'idProduct')}"
            name = _read_word(device, "product") or "a gamepad"
            found.append(Finding(WARN, "gamepad", f"{name} ({numbers}) is plugged in, but no driver has it: no xpad",
                                 NO_XPAD_REMEDY))
    return found


def _read_word(folder, name):
    """Return what a file of sysfs has; empty: there is none."""
    try:
        with open(os.path.join(folder, name), encoding="utf-8", errors="replace") as file:
            return file.read().strip()
    except OSError:
        return ""


# --- the network ---

def probe_network(uri: str, ask_master: Callable[[], str]) -> tuple[list[Finding], bool]:
    """Return the findings about the master and this computer's address, and whether the master answers.

    Args:
        uri: ROS_MASTER_URI; empty when it isn't set.
        ask_master: returns why the master doesn't answer; empty when it does.
    """
    host, port = host_and_port(uri) or ("", DEFAULT_PORT)
    if not host:
        return first("master",
                     (not uri, BAD, "ROS_MASTER_URI is not set: no ROS program can run",
                      "Source the workspace: source devel/setup.bash"),
                     (True, BAD, f"ROS_MASTER_URI is {uri}, which is no master's address",
                      f"export ROS_MASTER_URI=http://localhost:{DEFAULT_PORT}")), False
    is_here = leads_here(host)
    trouble = "" if is_here is None else ask_master()
    listens_on = listeners(port) if is_here else []
    exposed = [address for address in listens_on if not address.is_loopback]
    where = "every interface" if any(address.is_unspecified for address in exposed) else ", ".join(map(str, exposed))
    found = first(
        "master",
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
    return found + _check_address(is_here is not False), is_here is not None and not trouble


def _check_address(master_is_here):
    """Return whether other nodes can reach what is started here."""
    both = [variable for variable in ("ROS_HOSTNAME", "ROS_IP") if os.environ.get(variable)]
    source, name = (both[0], os.environ[both[0]]) if both else ("this host's name", socket.gethostname())  # as ROS does
    is_here, addresses = leads_here(name), _addresses(name)
    is_loopback = all(address == "::1" or address.startswith("127.") for address in addresses)
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
         f"ROS_HOSTNAME ({name}) and ROS_IP ({os.environ.get('ROS_IP')}) are both set; the first one counts",
         "unset ROS_IP, or the other one"),
        (is_loopback, OK, f"{source}, {name}: reached from this computer only"),
        (True, OK, f"{source}, {name}"))


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
    with suppress(OSError), socket.socket(family, socket.SOCK_STREAM) as probe:
        probe.bind((address, 0))
        return True
    return False


def host_and_port(uri: str) -> tuple[str, int] | None:
    """Return host and port of a master's URI; ``None`` when it's none."""
    with suppress(ValueError):
        parts = urlsplit(uri)
        if parts.scheme == "http" and parts.hostname:
            return parts.hostname, parts.port or DEFAULT_PORT
    return None


def listeners(port: int) -> list[Any]:
    """Return the addresses that something listens on at a TCP port, by the kernel's tables."""
    found = set()
    for path in ("/proc/net/tcp", "/proc/net/tcp6"):
        with suppress(OSError), open(path, encoding="ascii") as file:
            for fields in map(str.split, list(file)[1:]):
                address, _, number = fields[1].rpartition(":")
                if fields[3] == LISTENING and int(number, 16) == port:
                    found.add(_address(address))
    return sorted(found, key=str)


def _address(hexadecimal):
    """Return an address of the kernel's table: groups of four bytes, the lowest first on a little-endian computer."""
    data = bytes.fromhex(hexadecimal)
    address = ipaddress.ip_address(b"".join(data[start:start + 4][::-1] for start in range(0, len(data), 4)))
    return getattr(address, "ipv4_mapped", None) or address
