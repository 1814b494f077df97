"""The steps that give a user access to the car's hardware, once on each computer; ``cli`` runs them.

A step that is done already is no step: planning again after everything was done plans nothing. One that fails keeps
none of the others from being done.
"""
from __future__ import annotations

from typing import NamedTuple, Sequence

RULES_NAME = "70-car-interface.rules"
RULES_FOLDER = "/etc/udev/rules.d"
GROUPS = ("dialout", "i2c", "input")  # the Teensy's port, the servo board's bus, the gamepad
ROOT = "root"


class Computer(NamedTuple):
    """How the computer is now.

    Attributes:
        user: whom to give access; root needs none.
        groups: all groups that there are.
        joined: those that /etc/group puts the user in.
        has_udev: whether ``udevadm`` is there; containers have none.
        rules_are_new: whether the installed rules are the package's.
    """

    user: str
    groups: frozenset
    joined: frozenset
    has_udev: bool
    rules_are_new: bool


class Step(NamedTuple):
    """One thing to do.

    Attributes:
        what: a description.
        command: what does it, as root.
        may_fail: whether what it does comes about without it, too.
        otherwise: what to print when it failed.
    """

    what: str
    command: tuple
    may_fail: bool = False
    otherwise: str = ""


def plan(computer: Computer, rules: str) -> list[Step]:
    """The steps that are left to do, in order.

    Args:
        computer: how it is now.
        rules: the path of the package's udev rules.
    """
    steps = [Step(f"make the group {group}", ("groupadd", "--system", group))
             for group in GROUPS if group not in computer.groups]
    missing = [group for group in GROUPS if group not in computer.joined]
    if missing and computer.user != ROOT:
        steps.append(Step(f"add {computer.user} to {', '.join(missing)}",
                          ("usermod", "--append", "--groups", ",".join(missing), computer.user),
                          otherwise="a user who isn't in /etc/passwd joins each group by: sudo gpasswd --add "
                                    f"{computer.user} GROUP"))
    if computer.has_udev and not computer.rules_are_new:
        # After the groups: udev looks their names up when it reads the rules.
        steps += [
            Step(f"install {RULES_FOLDER}/{RULES_NAME}",
                 ("install", "-D", "--mode=644", rules, f"{RULES_FOLDER}/{RULES_NAME}")),
            Step("have udev read it", ("udevadm", "control", "--reload-rules"), True, "udev reads it at the next boot"),
            Step("have udev apply it to what is plugged in",
                 ("udevadm", "trigger", "--subsystem-match=tty", "--subsystem-match=i2c-dev"), True,
                 "plug the Teensy out and in again, or start the computer anew"),
        ]
    return steps


def remarks(computer: Computer, steps: Sequence[Step]) -> list[str]:
    """What the user has to know at the end.

    Args:
        computer: how it was before.
        steps: what was done.
    """
    done = [step.command[0] for step in steps]
    lines = []
    if computer.user == ROOT:
        lines.append("root needs no groups. For the user who will drive: setup_hardware --user NAME")
    if "usermod" in done:
        lines.append(f"Groups count from the next log-in: {computer.user} must log out and in again, everywhere.")
    if not computer.has_udev:
        lines.append("There is no udevadm here, as in a container: the udev rule was left out. Run this on the "
                     "computer itself, too; it makes the devices that a container is given.")
    elif "install" in done:
        lines.append("The Teensy is now also /dev/teensy_sensor_hub. If ModemManager had it open, plug it in anew.")
    return lines
