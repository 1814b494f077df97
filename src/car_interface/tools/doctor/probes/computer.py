"""What the doctor finds out about this computer: groups, clock, versions, network. Nothing is changed."""
from __future__ import annotations

import ctypes
import glob
import grp
import importlib
import importlib.metadata
import importlib.util
import os
import socket
import sys
import time
from typing import Callable

from car_interface.common.device_access import read_membership
from car_interface.teensy.link.console import is_consoles
from car_interface.tools.doctor.checks.computer import (
    ClockReading,
    Library,
    Need,
    check_clock,
    check_groups,
    check_joy,
    check_tools,
    check_versions,
)
from car_interface.tools.doctor.checks.findings import BAD, WARN
from car_interface.tools.doctor.checks.network import (
    LocalAddress,
    MasterAddress,
    check_local_address,
    check_master,
    host_and_port,
    listeners,
    local_name,
)

TIME_ERROR = 5  # what adjtimex returns while the clock is not synchronised: adjtimex(2)
TIMEX_SIZE = 512  # more than struct timex on any computer

# What nodes import: how it's distributed, and what installs it.
LIBRARIES = (
    ("rospy", "rospy", "Source the workspace; or sudo apt install ros-noetic-rospy (Debian: python3-rospy)"),
    ("car_interface.msg", "", "Build the workspace and source it: catkin_make && source devel/setup.bash"),
    ("diagnostic_updater", "diagnostic_updater",
     "sudo apt install ros-noetic-diagnostic-updater (Debian: python3-diagnostic-updater)"),
    ("dynamic_reconfigure", "dynamic_reconfigure",
     "sudo apt install ros-noetic-dynamic-reconfigure (Debian: python3-dynamic-reconfigure)"),
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


def probe_groups(port: str, bus: str, virtual_port: bool, virtual_bus: bool):
    """Return whether this process is in the groups of the devices that the car uses."""
    needs = []
    if not virtual_port:
        needs.append(Need(group_of(port, "dialout"), "the Teensy's port", BAD))
    if not virtual_bus:
        needs.append(Need(group_of(bus, "i2c"), "the servo board's bus", BAD))
    if any(not os.access(path, os.R_OK) for path in glob.glob("/dev/input/js*")):
        needs.append(Need("input", "the gamepad", WARN))
    return check_groups(read_membership(), list(dict.fromkeys(needs)))


def group_of(path: str, usual: str) -> str:
    """Return a device's group; the usual one when it's absent, a console's, or root's, as before a udev rule was
    installed.
    """
    try:
        gid = os.stat(path).st_gid
        return grp.getgrgid(gid).gr_name if gid and not is_consoles(path) else usual
    except (OSError, KeyError):
        return usual


def probe_clock(uses_sim_time: bool):
    """Return whether the wall clock is set, and what nodes take for the time."""
    return check_clock(ClockReading(year=time.gmtime().tm_year, synchronised=_is_synchronised(),
                                    uses_sim_time=uses_sim_time))


def _is_synchronised():
    """Return whether the clock is, as the kernel has it; ``None`` where it isn't known."""
    try:
        state = ctypes.CDLL(None, use_errno=True).adjtimex(ctypes.create_string_buffer(TIMEX_SIZE))  # zeros: only asks
    except (OSError, AttributeError):
        return None
    return None if state < 0 else state != TIME_ERROR


def probe_versions():
    """Python and what nodes import."""
    return check_versions(".".join(map(str, sys.version_info[:3])),
                          [Library(name, _version(name, distribution), remedy)
                           for name, distribution, remedy in LIBRARIES] + _missing_messages())


def _missing_messages():
    return [Library(name, None, f"sudo apt install ros-noetic-{name.replace('_', '-')} (Debian: "
                                f"python3-{name.replace('_', '-')})") for name in MESSAGES if not _is_installed(name)]


def _is_installed(name):
    try:
        return importlib.util.find_spec(name) is not None
    except (ImportError, ValueError):
        return False


def probe_packages(joy_is_published: bool, is_virtual: bool):
    """Look for what not every car needs: the ROS package joy, and the libraries of the tools for recordings."""
    environment = TOOLS_ENVIRONMENT if os.path.exists(os.path.expanduser(TOOLS_ENVIRONMENT)) else ""
    missing = [distribution for name, distribution in TOOLS.items() if not _is_installed(name)]
    found = check_tools(missing, environment)
    if not is_virtual:
        found += check_joy(_has_ros_package("joy"), joy_is_published, os.environ.get("ROS_DISTRO", ""))
    return found


def _has_ros_package(name):
    import rospkg  # it comes with ROS, which may be what is missing
    try:
        rospkg.RosPack().get_path(name)
    except rospkg.ResourceNotFound:
        return False
    return True


def _version(name, distribution):
    try:
        module = importlib.import_module(name)
    except Exception:  # a library can fail in any way; that it does is the finding
        return None
    try:
        return importlib.metadata.version(distribution) if distribution else ""
    except importlib.metadata.PackageNotFoundError:
        return str(getattr(module, "__version__", ""))


def probe_network(uri: str, ask_master: Callable[[], str]):
    """Return the master and this computer's own address.

    Args:
        uri: ROS_MASTER_URI.
        ask_master: returns why the master doesn't answer; empty when it does.

    Returns:
        The findings about the master and about the address, and whether the master answers.
    """
    place = host_and_port(uri) if uri else None
    if place is None:
        return check_master(MasterAddress(uri)), [], False
    here = leads_here(place[0])
    trouble = ask_master() if here is not None else "its host can't be found"
    master = MasterAddress(uri, trouble, here, listeners(_tcp_tables(), place[1]) if here else ())
    name = local_name(os.environ, socket.gethostname())
    is_here = leads_here(name)
    own = LocalAddress(name, is_here is not None, bool(is_here), _is_loopback(name))
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


def _is_loopback(host):
    addresses = _addresses(host)
    return bool(addresses) and all(address == "::1" or address.startswith("127.") for address in addresses)


def _tcp_tables():
    for path in ("/proc/net/tcp", "/proc/net/tcp6"):
        try:
            with open(path, encoding="ascii") as file:
                yield file.read()
        except OSError:
            continue
