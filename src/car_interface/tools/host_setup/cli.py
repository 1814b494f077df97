"""rosrun car_interface setup_hardware: once on each computer, to give its user access to the car's hardware.

It installs the udev rules and adds the user to the groups dialout, i2c and input. Each step is a command that it shows,
and runs by sudo; nothing else of this package needs root. What is done already is left alone; what fails keeps nothing
else from being done, and makes the exit code 1.

Options:
    --dry-run: only show the commands.
    --user: whom to give access; by default who runs this, also by sudo.
    --autostart config:=FOLDER …: have systemd start car.launch with these arguments at each boot; nothing else is done.
    --remove: undo that.
"""
from __future__ import annotations

import argparse
import filecmp
import os
import pwd
import shlex
import shutil
import subprocess
import sys
import tempfile
from typing import Mapping, NamedTuple, Sequence
from xml.etree import ElementTree

from car_interface.common.devices import GROUPS, STABLE_PORT, UNKNOWN, Header, existing_groups, groups_of, read_header
from car_interface.common.errors import CarInterfaceError
from car_interface.common.package_files import package_file

RULES_NAME = "70-car-interface.rules"
RULES_FOLDER = "/etc/udev/rules.d"
ROOT = "root"
# A user's PATH often lacks these, where the commands are.
SYSTEM_PATH = "/usr/sbin:/sbin:/usr/bin:/bin"
UNIT = "car_interface.service"
UNIT_PATH = f"/etc/systemd/system/{UNIT}"
# A workspace's own script, which runs a command in the workspace's environment; catkin generates it.
ENVIRONMENT_SCRIPT = "env.sh"
NETWORK = ("ROS_MASTER_URI", "ROS_IP", "ROS_HOSTNAME")  # what the unit keeps of the terminal's environment
# roslaunch waits 15 s for its nodes, then 2 s for those that it ends by SIGTERM; pca9685's guard acts within 10 s.
STOP_S = 30
EXAMPLE = "setup_hardware --autostart config:=$HOME/my_car port:=/dev/teensy_sensor_hub throttle:=true"


class Computer(NamedTuple):
    """How the computer is now."""

    user: str  # whom to give access; root needs none
    groups: frozenset  # all groups that there are
    joined: frozenset  # those that /etc/group puts the user in
    has_udev: bool  # whether udevadm is there; containers have none
    rules_are_new: bool  # whether the installed rules are the package's
    header: Header = UNKNOWN  # of this computer
    has_bus: bool = True  # whether the header's I²C bus is there


class SetupStep(NamedTuple):
    """One thing to do."""

    what: str  # a description
    command: tuple  # what does it, as root
    may_fail: bool = False  # whether what it does comes about without it, too
    otherwise: str = ""  # what to print when it failed
    remark: str = ""  # what the user has to know at the end, once it is done


def plan(computer: Computer, rules: str) -> list[SetupStep]:
    """Return the steps that are left to do, in order; ``rules`` is the path of the package's udev rules."""
    missing = [group for group in GROUPS if group not in computer.joined]
    lacks_rules = computer.has_udev and not computer.rules_are_new
    return [step for is_left, step in (
        *((group not in computer.groups, SetupStep(f"make the group {group}", ("groupadd", "--system", group)))
          for group in GROUPS),
        (missing and computer.user != ROOT, SetupStep(
            f"add {computer.user} to {', '.join(missing)}",
            ("usermod", "--append", "--groups", ",".join(missing), computer.user),
            otherwise=f"a user who isn't in /etc/passwd joins each group by: sudo gpasswd --add {computer.user} GROUP",
            remark=f"Groups count from the next log-in: {computer.user} must log out and in again, everywhere.")),
        # After the groups: udev looks their names up when it reads the rules.
        (lacks_rules, SetupStep(
            f"install {RULES_FOLDER}/{RULES_NAME}",
            ("install", "-D", "--mode=644", rules, f"{RULES_FOLDER}/{RULES_NAME}"),
            remark=f"The Teensy is now also {STABLE_PORT}. If ModemManager had it open, plug it in anew.")),
        (lacks_rules, SetupStep(
            "have udev read it", ("udevadm", "control", "--reload-rules"), True, "udev reads it at the next boot")),
        (lacks_rules, SetupStep(
            "have udev apply it to what is plugged in",
            ("udevadm", "trigger", "--subsystem-match=tty", "--subsystem-match=i2c-dev"), True,
            "plug the Teensy out and in again, or start the computer anew"))) if is_left]


def remarks(computer: Computer) -> list[str]:
    """Return what the user has to know of the computer: also what the pins of its header are, and what they need."""
    header = computer.header
    missing = "" if computer.has_bus else f", which is missing. {header.bus_remedy}"
    note = f": {header.ports[header.port]}" if header.port in header.ports else ""
    return [line for holds, line in (
        (computer.user == ROOT, "root needs no groups. For the user who will drive: setup_hardware --user NAME"),
        (not computer.has_udev,
         ("There is no udevadm here, as in a container: the udev rule was left out. Run this on the computer itself, "
          "too; it makes the devices that a container is given.")),
        (header.computer, f"This is a {header.computer}: pins 3 and 5 are {header.bus_paths[0]}{missing}"),
        (header.computer, (f"A Teensy on pins 8 and 10 is on {header.port}{note}. If a log-in console has that: "
                           f"{header.console_remedy}"))) if holds]


def read_computer(user: str, rules: str) -> Computer:
    """Read how this computer is now."""
    installed = os.path.join(RULES_FOLDER, RULES_NAME)
    return Computer(
        user=user, groups=existing_groups(), joined=groups_of(user, pwd.getpwnam(user).pw_gid),
        has_udev=shutil.which("udevadm", path=SYSTEM_PATH) is not None,
        rules_are_new=os.path.exists(installed) and filecmp.cmp(rules, installed, shallow=False),
        header=read_header(), has_bus=os.path.exists(read_header().bus_paths[0]))


def run_step(step: SetupStep, is_dry: bool) -> bool:
    """Print a step, run its command as root unless ``is_dry``, and return whether that worked."""
    command = [*(["sudo"] if os.geteuid() else []), *step.command]
    print(f"{'would ' if is_dry else ''}{step.what}:\n    {shlex.join(command)}", flush=True)
    if is_dry:
        return True
    try:
        code = subprocess.run(command, check=False, env={**os.environ, "PATH": SYSTEM_PATH}).returncode
    except OSError as error:
        print(f"    it can't be run: {error.strerror}")
        code = 1
    if code:
        print("    that didn't work" + (f"; {step.otherwise}" if step.otherwise else ""))
    return code == 0


def unit_text(user: str, arguments: Sequence[str], environment: Mapping[str, str], launch_file: str) -> str:
    """Return the unit that starts the car. It waits for no device, as the nodes do that themselves.

    Args:
        user: who drives.
        arguments: NAME:=VALUE for car.launch; the folder becomes absolute.
        environment: of a terminal in which the workspace was sourced.
        launch_file: the path of car.launch.

    Raises:
        CarInterfaceError: an argument is none of car.launch's, or calibration_drive; the folder is missing, or no
            workspace was sourced.
    """
    values = dict(argument.split(":=", 1) for argument in arguments)
    known = [each.get("name") for each in ElementTree.parse(launch_file).getroot().findall("arg")]
    unknown = [name for name in values if name not in known]
    if unknown:
        raise CarInterfaceError(f"car.launch has no argument {unknown[0]}; accepted: {', '.join(known)}")
    if values.get("calibration_drive", "false") != "false":
        raise CarInterfaceError("calibration_drive is for a drive that somebody watches, and not for each boot: "
                                "no brake is certain with it")
    if not os.path.isdir(values.get("config", "")):
        raise CarInterfaceError(f"config:= must be the folder with your car's files, as in: {EXAMPLE}")
    values["config"] = os.path.abspath(values["config"])
    scripts = [os.path.join(prefix, ENVIRONMENT_SCRIPT)
               for prefix in environment.get("CMAKE_PREFIX_PATH", "").split(os.pathsep)]
    script = next((path for path in scripts if os.access(path, os.X_OK)), None)
    if script is None:
        raise CarInterfaceError("no catkin workspace was sourced in this terminal: source devel/setup.bash of yours")
    command = " ".join(map(_quoted, (script, "roslaunch", "car_interface", "car.launch",
                                     *(f"{name}:={value}" for name, value in values.items()))))
    network = "".join(f"Environment={_quoted(f'{name}={environment[name]}', is_command=False)}\n"
                      for name in NETWORK if environment.get(name))
    return f"""\
# Written by `rosrun car_interface setup_hardware --autostart`; `--remove` takes it away.
[Unit]
Description=Nodes of the car (car_interface)
After=network.target
StartLimitIntervalSec=0

[Service]
User={user}
WorkingDirectory=~
Environment=PYTHONUNBUFFERED=1
{network}ExecStart={command}
Restart=always
RestartSec=2
# roslaunch ends its nodes, and they switch the servo board off.
KillMode=mixed
KillSignal=SIGINT
TimeoutStopSec={STOP_S}

[Install]
WantedBy=multi-user.target
"""


def _quoted(text, is_command=True):
    """Return a word as systemd reads it: systemd.syntax(7), systemd.service(5)."""
    escapes = str.maketrans({"\\": "\\\\", '"': '\\"', "%": "%%", **({"$": "$$"} if is_command else {})})
    return f'"{text.translate(escapes)}"'


# What undoes --autostart, and stops what it started.
REMOVAL = (SetupStep("stop it, and start it no more", ("systemctl", "disable", "--now", UNIT)),
           SetupStep(f"remove {UNIT_PATH}", ("rm", UNIT_PATH)),
           SetupStep("have systemd forget it", ("systemctl", "daemon-reload")))
AUTOSTART_REMARK = f"""\
The car starts at the next boot; now: sudo systemctl restart {UNIT}
What it says: journalctl --follow --unit {UNIT}
It doesn't drive by itself: a deadman counts once it was seen released, and then while it is held."""


def main():
    """Run the set-up."""
    parser = argparse.ArgumentParser(prog="setup_hardware",
                                     description="Gives a user access to the car's serial port, I2C bus and gamepad.")
    parser.add_argument("--dry-run", action="store_true", help="only show what would be done")
    parser.add_argument("--user", help="whom to give access, if not you")
    parser.add_argument("--autostart", action="store_true",
                        help="have systemd start car.launch at each boot, with the NAME:=VALUE given here")
    parser.add_argument("--remove", action="store_true", help="undo --autostart")
    options = parser.parse_args([argument for argument in sys.argv[1:] if ":=" not in argument])
    options.user = options.user or os.environ.get("SUDO_USER") or pwd.getpwuid(os.getuid()).pw_name
    try:
        pwd.getpwnam(options.user)
        if options.autostart or options.remove:
            _set_autostart(options)
            return
        rules = str(package_file(f"udev/{RULES_NAME}"))
        computer = read_computer(options.user, rules)
    except CarInterfaceError as error:
        sys.exit(str(error))
    except KeyError:
        sys.exit(f"there is no user {options.user}")
    steps = plan(computer, rules)
    if not steps:
        print("Nothing to do: it's all there.")
    _run(steps, options.dry_run, remarks(computer))


def _set_autostart(options):
    if shutil.which("systemctl", path=SYSTEM_PATH) is None:
        raise CarInterfaceError("there is no systemctl here, as in a container: nothing could start the car at boot")
    if options.remove:
        if os.path.exists(UNIT_PATH):
            _run(REMOVAL, options.dry_run)
        else:
            print(f"Nothing to do: there is no {UNIT_PATH}.")
        return
    # What roslaunch adds to the arguments begins with __.
    arguments = [argument for argument in sys.argv[1:] if ":=" in argument and not argument.startswith("__")]
    text = unit_text(options.user, arguments, os.environ, str(package_file("launch/car.launch")))
    print(text)
    with tempfile.NamedTemporaryFile("w", prefix=UNIT, encoding="utf-8") as file:
        file.write(text)
        file.flush()
        _run([SetupStep(f"install {UNIT_PATH}", ("install", "--mode=644", file.name, UNIT_PATH)),
              SetupStep("have systemd read it", ("systemctl", "daemon-reload")),
              SetupStep("have it start at each boot", ("systemctl", "enable", UNIT),
                        remark=AUTOSTART_REMARK)], options.dry_run)


def _run(steps, is_dry, remarks=()):
    """Run the steps, and print what is to be known of those that were done, and the remarks; exit with what failed."""
    done = [step for step in steps if run_step(step, is_dry)]
    failed = [step.what for step in steps if step not in done and not step.may_fail]
    for remark in (*(step.remark for step in done if step.remark), *remarks):
        print(remark)
    if failed:
        sys.exit(f"Not done: {'; '.join(failed)}. Running this again does what is left.")
