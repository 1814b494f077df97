"""Starts the car with the computer: writes a systemd unit that launches car.launch, and what takes it away again."""
from __future__ import annotations

import os
from typing import Mapping, NamedTuple, Sequence
from xml.etree import ElementTree

from car_interface.common.errors import CarInterfaceError

UNIT = "car_interface.service"
UNIT_PATH = f"/etc/systemd/system/{UNIT}"
# A workspace's own script, which runs a command in the workspace's environment; catkin generates it.
ENVIRONMENT_SCRIPT = "env.sh"
NETWORK = ("ROS_MASTER_URI", "ROS_IP", "ROS_HOSTNAME")  # what the unit keeps of the terminal's environment
# roslaunch waits 15 s for its nodes, then 2 s for those that it ends by SIGTERM; pca9685's guard acts within 10 s.
STOP_S = 30
EXAMPLE = "setup_hardware --autostart config:=$HOME/my_car port:=/dev/teensy_sensor_hub throttle:=true"


class Launch(NamedTuple):
    """What the unit starts."""

    user: str
    script: str  # ENVIRONMENT_SCRIPT, by its whole path
    arguments: Sequence[str]  # of car.launch
    network: Mapping[str, str]  # those of NETWORK that are set


def read_launch(user: str, arguments: Sequence[str], environment: Mapping[str, str], launch_file: str) -> Launch:
    """Read what to start.

    Args:
        arguments: NAME:=VALUE; the folder becomes absolute.
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
    return Launch(user, script, [f"{name}:={value}" for name, value in values.items()],
                  {name: environment[name] for name in NETWORK if environment.get(name)})


def unit_text(launch: Launch) -> str:
    """Return the unit. It waits for no device, as the nodes do that themselves."""
    command = " ".join(map(_quoted, (launch.script, "roslaunch", "car_interface", "car.launch", *launch.arguments)))
    network = "".join(f"Environment={_quoted(f'{name}={value}', is_command=False)}\n"
                      for name, value in launch.network.items())
    return f"""\
# Written by `rosrun car_interface setup_hardware --autostart`; `--remove` takes it away.
[Unit]
Description=Nodes of the car (car_interface)
After=network.target
StartLimitIntervalSec=0

[Service]
User={launch.user}
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
    for plain, escaped in (("\\", "\\\\"), ('"', '\\"'), ("%", "%%"), *((("$", "$$"),) if is_command else ())):
        text = text.replace(plain, escaped)
    return f'"{text}"'
