"""Runs a command while the car without hardware is up, on a ROS master of its own.

    python3 test/on_virtual_car.py LOG_FOLDER [ARGUMENT:=VALUE...] [--report BAG_FOLDER] -- COMMAND...

The arguments are demo.launch's. With --report a page is made of the bag that the command has recorded there, and what
to do next is printed. The exit code is the command's, or 1 when the car did not start or ended before it.
"""
from __future__ import annotations

import os
import shlex
import shutil
import subprocess
import sys
import time
from pathlib import Path

from processes import adopt_descendants, answers, end_descendants, end_of_log, free_port, interrupt, start, wait_until

START_S = 30.0
NEXT_STEPS = """
Next, type
  xdg-open {page}
                                   to see who drove when, and why the car stopped
  {env}; roslaunch car_interface demo.launch drive:=false
                                   and in a second terminal, to drive by hand, with the keys that it shows,
  {env}; rosrun car_interface keyboard_drive
  cp -r {config} ~/practice_car
  {env}; roslaunch car_interface practice.launch config:=$HOME/practice_car
                                   and go on in {checkout}/docs/calibrate.md, Practise without a car:
                                   the car calibrates its own steering"""
# An interrupted roslaunch ends its nodes in order, then the master. While it starts it may swallow the signal.
LAUNCH = ("roslaunch", "--sigint-timeout=4", "--sigterm-timeout=2", "car_interface", "demo.launch", "drive:=false")


def run(log: Path, arguments: list[str], command: list[str]) -> int:
    """Launch the car, run the command, end both."""
    port, processes = free_port(), []
    os.environ.update(ROS_LOG_DIR=str(log.parent), ROS_MASTER_URI=f"http://127.0.0.1:{port}")
    try:
        with open(str(log), "wb") as file:
            car = start(*LAUNCH, "-p", str(port), *arguments, stdin=subprocess.DEVNULL, stdout=file, stderr=file)
        processes += [(car, 4.0), (car, 8.0)]
        wait_until(lambda: answers(port) or car.poll() is not None, START_S)
        if not answers(port):
            return fail("roslaunch did not start", log)
        drive = start(*command)
        processes.append((drive, 5.0))
        code = drive.wait()
        if car.poll() is not None:
            return fail("roslaunch ended before the drive did", log)
        if code:
            print(f"The nodes' logs: {log.parent}", file=sys.stderr)
        return code if code >= 0 else 128 - code
    finally:
        for process, within_s in reversed(processes):  # the drive first: it closes its bag while the master lives
            interrupt(process, within_s)
        end_descendants()


def fail(reason: str, log: Path) -> int:
    """Show the end of roslaunch's log; return the exit code."""
    print(end_of_log(log, 40), f"./dev: {reason}", sep="\n", file=sys.stderr)
    return 1


def report(folder: Path, since_s: float) -> None:
    """Make a page of the newest bag, also of a drive that failed."""
    bags = [path for path in folder.glob("*.bag") if path.stat().st_mtime >= since_s]
    for bag in sorted(bags, key=lambda path: path.stat().st_mtime)[-1:]:
        page = str(bag.with_suffix(".html"))
        subprocess.run(["rosrun", "car_interface", "bag_report", str(bag), "-o", page], stdout=subprocess.DEVNULL,
                       check=True)
        print(f"  {'report':<32} {page}")
        checkout = Path(__file__).resolve().parents[1]
        env = f'eval "$({shlex.quote(str(checkout / "dev"))} env)"'
        print(NEXT_STEPS.format(page=shlex.quote(page), env=env, checkout=checkout,
                                config=shlex.quote(str(checkout / "config"))))


if __name__ == "__main__":
    split = sys.argv.index("--")
    arguments, begun_s = sys.argv[2:split], time.time()
    adopt_descendants()
    log = Path(sys.argv[1])
    shutil.rmtree(str(log), ignore_errors=True)
    log.mkdir(parents=True)
    code = run(log / "roslaunch.log", [each for each in arguments if ":=" in each], sys.argv[split + 1:])
    if "--report" in arguments:
        report(Path(arguments[arguments.index("--report") + 1]), begun_s)
    sys.exit(code)
