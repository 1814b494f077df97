"""The computer itself: whom its devices are open to, what its clock says, which versions it runs."""
from __future__ import annotations

from typing import Iterable, NamedTuple, Sequence

from car_interface.common.device_access import SETUP_REMEDY, Membership
from car_interface.doctor.checks.findings import BAD, OK, WARN, Finding

# --- groups ---


class Need(NamedTuple):
    """A group that opens a device.

    Attributes:
        group: its name.
        purpose: what it's for.
        level: how bad it is to be outside.
    """

    group: str
    purpose: str
    level: int


def check_groups(who: Membership, needs: Sequence[Need]) -> list[Finding]:
    """One finding for all groups that are as they should be, and one for each that isn't."""
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
MAX_DRIFT_S = 0.05  # between wall clock and monotonic clock while the doctor looks; NTP slews 0.5 ms a second


class ClockReading(NamedTuple):
    """What the clocks say.

    Attributes:
        year: of the wall clock.
        synchronised: whether the kernel knows it to be set by NTP or the like; ``None`` = it doesn't say.
        wall_s: how far the wall clock went while the doctor looked.
        monotonic_s: how far the monotonic clock went meanwhile.
        uses_sim_time: the parameter /use_sim_time.
    """

    year: int
    synchronised: bool | None
    wall_s: float
    monotonic_s: float
    uses_sim_time: bool


def check_clock(clock: ClockReading) -> list[Finding]:
    """The clock's findings; the driving itself goes by the monotonic clock and minds none of them."""
    found = []
    if clock.year not in PLAUSIBLE_YEARS:
        found.append(Finding(BAD, "clock", f"it's the year {clock.year}: stamps and bags will be wrong",
                             "Connect to a network, or set it: sudo date -s 'YYYY-MM-DD hh:mm'"))
    elif clock.synchronised is False:
        found.append(Finding(WARN, "clock", "not synchronised: stamps of two computers, and the dates of bags, may be "
                                            "off; driving doesn't depend on it",
                             "sudo timedatectl set-ntp true, and a network; see timedatectl"))
    jumped_s = clock.wall_s - clock.monotonic_s
    if abs(jumped_s) > MAX_DRIFT_S:
        found.append(Finding(WARN, "clock", f"it jumped by {jumped_s:+.2f} s while the doctor looked: two programs may "
                                            "be setting it", "See who sets it: timedatectl. One program is enough"))
    if clock.uses_sim_time:
        found.append(Finding(WARN, "clock", "/use_sim_time is true: stamps stand still unless something publishes "
                                            "/clock", "On a car: rosparam delete /use_sim_time, and start again"))
    if not found:
        how = "synchronised" if clock.synchronised else "the kernel doesn't say whether it's synchronised"
        found.append(Finding(OK, "clock", f"{how}, and goes as the monotonic clock does"))
    return found


# --- versions ---

OLDEST_PYTHON = (3, 8)


class Library(NamedTuple):
    """A library that nodes import.

    Attributes:
        name: as it's imported.
        version: as a text; ``None`` when it can't be imported, empty when it doesn't tell.
        oldest: the oldest version that will do, as numbers; empty = any.
        remedy: what installs it.
    """

    name: str
    version: str | None
    oldest: tuple
    remedy: str


def check_versions(python: Sequence[int], libraries: Iterable[Library]) -> list[Finding]:
    """One finding for Python and all libraries that will do, and one for each that won't."""
    found, good = [], []
    if tuple(python[:2]) < OLDEST_PYTHON:
        found.append(Finding(BAD, "versions", f"this is Python {_dotted(python)}",
                             f"Run it with Python {_dotted(OLDEST_PYTHON)} or newer"))
    else:
        good.append(f"Python {_dotted(python)}")
    for library in libraries:
        if library.version is None:
            found.append(Finding(BAD, "versions", f"{library.name} can't be imported", library.remedy))
        elif library.version and _numbers(library.version) < library.oldest:
            found.append(Finding(BAD, "versions", f"{library.name} is {library.version}; it takes "
                                                  f"{_dotted(library.oldest)} or newer", library.remedy))
        else:
            good.append(f"{library.name} {library.version}".strip())
    return ([Finding(OK, "versions", ", ".join(good))] if good else []) + found


def _numbers(version):
    """The leading numbers of a version: (3, 5) of ``3.5b1``."""
    numbers = []
    for part in version.split("."):
        digits = part[:len(part) - len(part.lstrip("0123456789"))]
        if not digits:
            break
        numbers.append(int(digits))
    return tuple(numbers)


def _dotted(numbers):
    return ".".join(map(str, numbers[:3]))
