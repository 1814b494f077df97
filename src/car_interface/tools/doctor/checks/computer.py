"""The computer itself: whom its devices are open to, what its clock says, which versions it runs."""
from __future__ import annotations

from typing import Iterable, NamedTuple, Sequence

from car_interface.common.device_access import SETUP_REMEDY, Membership
from car_interface.tools.doctor.checks.findings import BAD, OK, WARN, Finding

# --- groups ---


class Need(NamedTuple):
    """A group that opens a device."""

    group: str  # its name
    purpose: str  # what it's for
    level: int  # how bad it is to be outside


def check_groups(who: Membership, needs: Sequence[Need]) -> list[Finding]:
    """Return one finding for all groups that are as they should be, and one for each that isn't."""
    if who.is_root:
        return [Finding(OK, "groups", "this is root, which needs none; the nodes don't need root")]
    if not needs:
        return [Finding(OK, "groups", "none needed: the devices are virtual")]
    missing = [need for need in needs if need.group not in who.of_process]
    inside = [need.group for need in needs if need not in missing]
    found = [Finding(OK, "groups", f"{who.user} is in {', '.join(inside)}")] if inside else []
    return found + [_outside(who, need) for need in missing]


def _outside(who, need):
    if need.group in who.of_user:
        return Finding(need.level, "groups", f"{who.user} joined {need.group} ({need.purpose}) after this log-in",
                       f"Log in anew; for this terminal alone: newgrp {need.group}")
    if need.group not in who.existing:
        return Finding(need.level, "groups", f"there is no group {need.group} ({need.purpose})", SETUP_REMEDY)
    return Finding(need.level, "groups", f"{who.user} is not in {need.group} ({need.purpose})", SETUP_REMEDY)


# --- clock ---

PLAUSIBLE_YEARS = range(2024, 2100)


class ClockReading(NamedTuple):
    """What the clocks say."""

    year: int  # of the wall clock
    synchronised: bool | None  # whether the kernel knows it to be set by NTP or the like; None = it doesn't say
    uses_sim_time: bool  # the parameter /use_sim_time


def check_clock(clock: ClockReading) -> list[Finding]:
    """Return the clock's findings; the driving itself goes by the monotonic clock and minds none of them."""
    found = []
    if clock.year not in PLAUSIBLE_YEARS:
        found.append(Finding(BAD, "clock", f"it's the year {clock.year}: stamps and bags will be wrong",
                             "Connect to a network, or set it: sudo date -s 'YYYY-MM-DD hh:mm'"))
    elif clock.synchronised is False:
        found.append(Finding(WARN, "clock", "not synchronised: stamps of two computers, and the dates of bags, may be "
                                            "off; driving doesn't depend on it",
                             "sudo timedatectl set-ntp true, and a network; see timedatectl"))
    if clock.uses_sim_time:
        found.append(Finding(WARN, "clock", "/use_sim_time is true: stamps stand still unless something publishes "
                                            "/clock", "On a car: rosparam delete /use_sim_time, and start again"))
    if not found:
        found.append(Finding(OK, "clock", "synchronised" if clock.synchronised else
                             "the kernel doesn't say whether it's synchronised"))
    return found


# --- versions ---

class Library(NamedTuple):
    """A library that nodes import."""

    name: str  # as it's imported
    version: str | None  # as a text; None when it can't be imported, empty when it isn't known
    remedy: str  # what installs it


def check_versions(python: str, libraries: Iterable[Library]) -> list[Finding]:
    """Return one finding for Python and all libraries that are there, and one for each that isn't."""
    found, good = [], [f"Python {python}"]
    for library in libraries:
        if library.version is None:
            found.append(Finding(BAD, "versions", f"{library.name} can't be imported", library.remedy))
        else:
            good.append(f"{library.name} {library.version}".strip())
    return [Finding(OK, "versions", ", ".join(good)), *found]


# --- packages that a part of the work needs ---

INSTALL_TOOLS = "docs/recordings.md, Install the tools"


def check_tools(missing: Sequence[str], environment: str) -> list[Finding]:
    """Check whether the commands for recordings can run.

    Args:
        missing: the libraries that this Python lacks.
        environment: the command of a virtual environment that has them; empty = there is none.
    """
    if not missing:
        return [Finding(OK, "packages", "the tools for recordings have theirs")]
    if environment:
        return [Finding(OK, "packages", f"the tools for recordings are in {environment}")]
    return [Finding(WARN, "packages", f"{', '.join(missing)} {'is' if len(missing) == 1 else 'are'} missing for "
                                      f"bag_report, check_map and the calibration; driving needs none of it",
                    f"rosdep install, or on Debian a virtual environment: {INSTALL_TOOLS}")]


def check_joy(is_installed: bool, is_published: bool, distribution: str) -> list[Finding]:
    """Check whether a gamepad's messages can come.

    Args:
        is_installed: the ROS package joy, whose joy_node reads the gamepad.
        is_published: somebody publishes the car's joy topic.
        distribution: ROS_DISTRO.
    """
    if is_installed:
        return [Finding(OK, "packages", "joy, for the gamepad, is installed")]
    if is_published:
        return [Finding(OK, "packages", "joy isn't installed here, but somebody publishes the gamepad's messages")]
    if distribution != "noetic":
        return [Finding(OK, "packages", "joy isn't installed: gamepad_joy of this package reads the gamepad")]
    return [Finding(WARN, "packages", "the ROS package joy, whose joy_node reads the gamepad, is missing, and nobody "
                                      "publishes joy",
                    "sudo apt install ros-noetic-joy, or start car.launch with joy_driver:=gamepad_joy")]
