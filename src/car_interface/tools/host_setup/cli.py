"""rosrun car_interface setup_hardware: once on each computer, to give its user access to the car's hardware.

It installs the udev rules and adds the user to the groups dialout, i2c and input. Each step is a command that it shows,
and runs by sudo; nothing else of this package needs root. What is done already is left alone; what fails keeps nothing
else from being done, and makes the exit code 1.

Options:
    --dry-run: only show the commands.
    --user: whom to give access; by default who runs this, also by sudo.
"""
from __future__ import annotations

import argparse
import filecmp
import grp
import os
import pwd
import shlex
import shutil
import subprocess
import sys

from car_interface.common.errors import CarInterfaceError
from car_interface.common.package_files import package_file
from car_interface.tools.host_setup.plan import RULES_FOLDER, RULES_NAME, Computer, Step, plan, remarks

# A user's PATH often lacks these, where the commands are.
SYSTEM_PATH = "/usr/sbin:/sbin:/usr/bin:/bin"


def read_computer(user: str, rules: str) -> Computer:
    """Read how this computer is now."""
    groups = grp.getgrall()
    primary = pwd.getpwnam(user).pw_gid
    return Computer(
        user=user, groups=frozenset(group.gr_name for group in groups),
        joined=frozenset(group.gr_name for group in groups if user in group.gr_mem or group.gr_gid == primary),
        has_udev=shutil.which("udevadm", path=SYSTEM_PATH) is not None, rules_are_new=_same(rules))


def _same(rules):
    installed = os.path.join(RULES_FOLDER, RULES_NAME)
    return os.path.exists(installed) and filecmp.cmp(rules, installed, shallow=False)


def show_step(step: Step) -> bool:
    """Print what a step would do; True, as if that worked."""
    print(f"would {step.what}:\n    {shlex.join(as_root(step.command))}")
    return True


def run_step(step: Step) -> bool:
    """Run a step's command as root; whether that worked."""
    command = as_root(step.command)
    print(f"{step.what}:\n    {shlex.join(command)}", flush=True)
    try:
        code = subprocess.run(command, check=False, env={**os.environ, "PATH": SYSTEM_PATH}).returncode
    except OSError as error:
        print(f"    it can't be run: {error.strerror}")
        code = 1
    if code:
        print("    that didn't work" + (f"; {step.otherwise}" if step.otherwise else ""))
    return code == 0


def as_root(command) -> list[str]:
    """The command, by sudo unless this is root."""
    return list(command) if os.geteuid() == 0 else ["sudo", *command]


def main():
    """Run the set-up."""
    parser = argparse.ArgumentParser(prog="setup_hardware",
                                     description="Gives a user access to the car's serial port, I2C bus and gamepad.")
    parser.add_argument("--dry-run", action="store_true", help="only show what would be done")
    parser.add_argument("--user", help="whom to give access, if not you")
    options = parser.parse_args([argument for argument in sys.argv[1:] if ":=" not in argument])
    user = options.user or os.environ.get("SUDO_USER") or pwd.getpwuid(os.getuid()).pw_name
    try:
        rules = str(package_file(f"udev/{RULES_NAME}"))
        computer = read_computer(user, rules)
    except CarInterfaceError as error:
        sys.exit(str(error))
    except KeyError:
        sys.exit(f"there is no user {user}")
    steps = plan(computer, rules)
    done = [step for step in steps if (show_step if options.dry_run else run_step)(step)]
    if not steps:
        print("Nothing to do: it's all there.")
    for remark in remarks(computer, done):
        print(remark)
    failed = [step.what for step in steps if step not in done and not step.may_fail]
    if failed:
        sys.exit(f"Not done: {'; '.join(failed)}. Running this again does what is left.")
