"""Examines the computer itself: whom its devices are open to, what its clock says, and what is installed."""
from __future__ import annotations

import ctypes
import grp
import importlib
import importlib.metadata
import importlib.util
import os
import stat
import sys
import time
from typing import Sequence

from car_interface.common.device_access import SETUP_REMEDY, Membership, read_membership
from car_interface.common.header import read_header
from car_interface.pca9685.config import AUTO
from car_interface.teensy.link.console import is_consoles
from car_interface.teleop.input_devices import find_pads
from car_interface.tools.doctor.findings import BAD, OK, WARN, Finding, first

PLAUSIBLE_YEARS = range(2024, 2100)
TIME_ERROR = 5  # what adjtimex returns while the clock is not synchronised: adjtimex(2)
TIMEX_SIZE = 512  # more than struct timex on any computer


def install(name: str) -> str:
    """Return the command that installs a ROS package, in the distribution that this terminal has sourced."""
    distribution = os.environ.get("ROS_DISTRO", "Debian")  # as Debian's own packages call it
    prefix = "python3" if distribution == "Debian" else f"ros-{distribution}"
    return f"sudo apt install {prefix}-{name.replace('_', '-')}"


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
    """Check whether this process is in the groups of the devices that the car uses."""
    needs = []
    # Of a device that is missing, that is the first thing to be told as bad.
    if not virtual_port:
        needs.append((group_of(port, "dialout"), "the Teensy's port", BAD if os.path.exists(port) else WARN))
    if not virtual_bus:
        path = read_header().bus_paths[0] if bus == AUTO else bus
        needs.append((group_of(path, "i2c"), "the servo board's bus", BAD if os.path.exists(path) else WARN))
    if any(not os.access(pad.path, os.R_OK) for pad in find_pads()):
        needs.append(("input", "the gamepad", WARN))
    return check_groups(read_membership(), list(dict.fromkeys(needs)))


def check_groups(who: Membership, needs: Sequence[tuple[str, str, int]]) -> list[Finding]:
    """Return one finding for all groups that are as they should be, and one for each that isn't.

    Args:
        needs: groups that open a device: name, what it's for, and how bad it is to be outside.
    """
    if who.is_root:
        return [Finding(OK, "groups", "this is root, which needs none; the nodes don't need root")]
    if not needs:
        return [Finding(OK, "groups", "none needed: the devices are virtual")]
    inside = [group for group, _, _ in needs if group in who.of_process]
    found = [Finding(OK, "groups", f"{who.user} is in {', '.join(inside)}")] if inside else []
    for group, purpose, level in needs:
        if group not in inside:
            found += first("groups",
                           (group in who.of_user, level, f"{who.user} joined {group} ({purpose}) after this log-in",
                            f"Log in anew; for this terminal alone: newgrp {group}"),
                           (group not in who.existing, level, f"there is no group {group} ({purpose})", SETUP_REMEDY),
                           (True, level, f"{who.user} is not in {group} ({purpose})", SETUP_REMEDY))
    return found


def group_of(path: str, usual: str) -> str:
    """Return a device's group; the usual one when it's absent, a console's, or root's (without a udev rule)."""
    try:
        gid = os.stat(path).st_gid
        return grp.getgrgid(gid).gr_name if gid and not is_consoles(path) else usual
    except (OSError, KeyError):
        return usual


def is_character_device(path: str) -> bool:
    """Return whether there is a character device at a path, as each port and bus is one."""
    try:
        return stat.S_ISCHR(os.stat(path).st_mode)
    except OSError:
        return False


def probe_clock(uses_sim_time: bool) -> list[Finding]:
    """Check the wall clock and ROS time; the driving itself goes by the monotonic clock and minds neither."""
    found, year, synchronised = [], time.gmtime().tm_year, _is_synchronised()
    if year not in PLAUSIBLE_YEARS:
        found.append(Finding(BAD, "clock", f"it's the year {year}: stamps and bags will be wrong",
                             "Connect to a network, or set it: sudo date -s 'YYYY-MM-DD hh:mm'"))
    elif synchronised is False:
        found.append(Finding(WARN, "clock", "not synchronised: stamps of two computers, and the dates of bags, may be "
                                            "off; driving doesn't depend on it",
                             "sudo timedatectl set-ntp true, and a network; see timedatectl"))
    if uses_sim_time:
        found.append(Finding(WARN, "clock", "/use_sim_time is true: stamps stand still unless something publishes "
                                            "/clock", "On a car: rosparam delete /use_sim_time, and start again"))
    if not found:
        found.append(Finding(OK, "clock", "synchronised" if synchronised else
                             "the kernel doesn't say whether it's synchronised"))
    return found


def _is_synchronised():
    """Return whether the clock is, as the kernel has it; ``None`` where it isn't known."""
    try:
        state = ctypes.CDLL(None, use_errno=True).adjtimex(ctypes.create_string_buffer(TIMEX_SIZE))  # zeros: only asks
    except (OSError, AttributeError):
        return None
    return None if state < 0 else state != TIME_ERROR


def probe_versions() -> list[Finding]:
    """Return one finding for Python and all libraries that can be imported, and one for each that can't."""
    found, good = [], ["Python " + ".".join(map(str, sys.version_info[:3]))]
    for name, distribution, remedy in LIBRARIES:
        version = _version(name, distribution)
        if version is None:
            found.append(Finding(BAD, "versions", f"{name} can't be imported", remedy))
        else:
            good.append(f"{name} {version}".strip())
    for name in MESSAGES:
        if not _is_installed(name):
            found.append(Finding(BAD, "versions", f"{name} can't be imported", install(name)))
    return [Finding(OK, "versions", ", ".join(good)), *found]


def _version(name, distribution):
    try:
        module = importlib.import_module(name)
    except Exception:  # a library can fail in any way; that it does is the finding
        return None
    try:
        return importlib.metadata.version(distribution) if distribution else ""
    except importlib.metadata.PackageNotFoundError:
        return str(getattr(module, "__version__", ""))


def _is_installed(name):
    try:
        return importlib.util.find_spec(name) is not None
    except (ImportError, ValueError):
        return False


def probe_packages() -> list[Finding]:
    """Look for what not every car needs: the libraries of the tools for recordings."""
    environment = TOOLS_ENVIRONMENT if os.path.exists(os.path.expanduser(TOOLS_ENVIRONMENT)) else ""
    missing = [distribution for name, distribution in TOOLS.items() if not _is_installed(name)]
    return check_tools(missing, environment)


def check_tools(missing: Sequence[str], environment: str) -> list[Finding]:
    """Check whether the commands for recordings can run.

    Args:
        missing: the libraries that this Python lacks.
        environment: the command of a virtual environment that has them; empty = there is none.
    """
    verb = "is" if len(missing) == 1 else "are"
    return first(
        "packages",
        (not missing, OK, "the tools for recordings have theirs"),
        (environment, OK, f"the tools for recordings are in {environment}"),
        (True, WARN,
         f"{', '.join(missing)} {verb} missing for bag_report, check_map and the calibration; driving needs none of it",
         f"rosdep install, or on Debian a virtual environment: {INSTALL_TOOLS}"))
