"""The unit that starts the car with the computer: what it runs, and that systemd takes it."""
import os
import pwd
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from car_interface.common.errors import CarInterfaceError
from car_interface.tools.host_setup import cli
from car_interface.tools.host_setup.cli import UNIT, UNIT_PATH, unit_text

CAR_LAUNCH = str(Path(__file__).resolve().parents[4] / "launch/car.launch")
# What catkin generates, as far as it matters here: it sources the workspace, and becomes the command.
ENV_SH = """#!/usr/bin/env sh
. "$(dirname "$0")/setup.sh"
exec "$@"
"""
USER = pwd.getpwuid(os.getuid()).pw_name


@pytest.fixture
def workspace(tmp_path):
    """A workspace, whose roslaunch prints what it is given; and a folder with a car's files."""
    for folder in ("my devel", "bin", "my 50% $car"):
        (tmp_path / folder).mkdir()
    programs = {"my devel/env.sh": ENV_SH, "my devel/setup.sh": f"PATH='{tmp_path}/bin':$PATH\n",
                "bin/roslaunch": "#!/bin/sh\nprintf '%s|' \"$@\"\n"}
    for name, text in programs.items():
        (tmp_path / name).write_text(text, encoding="ascii")
        (tmp_path / name).chmod(0o755)
    return tmp_path


def unit_of(folder, *arguments, **environment):
    return unit_text(USER, arguments, {"CMAKE_PREFIX_PATH": f"{folder}/my devel:/opt/ros/noetic", **environment},
                     CAR_LAUNCH)


def lines_of(text, name):
    return [line.partition("=")[2] for line in text.splitlines() if line.startswith(f"{name}=")]


def words_of(line):
    """The words of a command line of systemd; in double quotes it has the rules of a shell, and two characters more."""
    return [word.replace("%%", "%").replace("$$", "$") for word in shlex.split(line)]


def test_unit_launches_the_car_in_its_workspace_with_the_user_s_folder_and_devices(workspace, monkeypatch):
    monkeypatch.chdir(workspace)
    text = unit_of(workspace, "config:=my 50% $car", "port:=/dev/teensy_sensor_hub", "throttle:=true")
    (command,) = lines_of(text, "ExecStart")
    assert words_of(command)[0] == f"{workspace}/my devel/env.sh"
    shown = subprocess.run(words_of(command), capture_output=True, text=True, check=True).stdout
    assert shown == (f"car_interface|car.launch|config:={workspace}/my 50% $car|port:=/dev/teensy_sensor_hub|"
                     "throttle:=true|")
    assert lines_of(text, "User") == [USER]


def test_unit_starts_at_boot_again_and_again_with_the_network_of_the_terminal_and_ends_as_by_ctrl_c(workspace):
    text = unit_of(workspace, f"config:={workspace}/bin", ROS_IP="127.0.0.1", ROS_HOSTNAME="", SECRET="x")
    for line in ("WantedBy=multi-user.target", "Restart=always", "StartLimitIntervalSec=0", "KillSignal=SIGINT",
                 "KillMode=mixed", f"User={USER}"):
        assert line in text.splitlines()
    assert lines_of(text, "Environment") == ["PYTHONUNBUFFERED=1", '"ROS_IP=127.0.0.1"']


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="no systemd here")
def test_systemd_takes_the_unit_also_with_spaces_and_its_own_signs_in_the_paths(workspace):
    unit = workspace / UNIT
    text = unit_of(workspace, f"config:={workspace}/my 50% $car", ROS_MASTER_URI="http://car:11311")
    unit.write_text(text, encoding="utf-8")
    verify = ["systemd-analyze", "verify", "--man=no", str(unit)]
    done = subprocess.run(verify, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    unit.write_text(text.replace(f"{workspace}/my devel/env.sh", "/nowhere/env.sh"), encoding="utf-8")
    done = subprocess.run(verify, capture_output=True, text=True, check=False)
    assert done.returncode != 0 and "/nowhere/env.sh" in done.stderr, "it does look at the command"


@pytest.mark.parametrize("arguments, environment, message", [
    ([], {}, "config:= must be the folder with your car's files, as in: setup_hardware --autostart config:="),
    (["config:=/nowhere/at/all"], {}, "config:= must be the folder"),
    (["config:=.", "trottle:=true"], {}, "car.launch has no argument trottle; accepted: ns, port, "),
    (["config:=.", "calibration_drive:=true"], {}, "calibration_drive is for a drive that somebody watches"),
    (["config:=."], {"CMAKE_PREFIX_PATH": "/opt/ros/absent"}, "no catkin workspace was sourced in this terminal"),
], ids=["no_folder", "absent_folder", "misspelt", "calibration_drive", "not_sourced"])
def test_what_could_not_start_is_refused_at_once(workspace, arguments, environment, message):
    with pytest.raises(CarInterfaceError, match=f"^{message}"):
        unit_of(workspace, *arguments, **environment)


# --- the command ---

@pytest.fixture
def run(monkeypatch, capsys, workspace):
    """Runs setup_hardware; the commands that it ran, and what it printed."""
    def run(*arguments, has_systemd=True, is_installed=True):
        ran = []

        def execute(command, **_):
            ran.append(" ".join(command))
            return subprocess.CompletedProcess(command, 0)
        monkeypatch.setattr(subprocess, "run", execute)
        monkeypatch.setattr(cli.os, "geteuid", lambda: 0)
        monkeypatch.setattr(cli.shutil, "which", lambda name, path: "/bin/systemctl" if has_systemd else None)
        monkeypatch.setattr(cli.os.path, "exists", lambda path: is_installed)
        monkeypatch.setattr(cli, "package_file", lambda name: CAR_LAUNCH)
        monkeypatch.setenv("CMAKE_PREFIX_PATH", f"{workspace}/my devel")
        monkeypatch.setattr(sys, "argv", ["setup_hardware", "--user", USER, *arguments])
        last_words = ""
        try:
            cli.main()
        except SystemExit as end:
            last_words = end.code
        return ran, capsys.readouterr().out + last_words
    return run


def test_autostart_installs_the_unit_and_touches_neither_groups_nor_rules(run, workspace):
    ran, said = run("--autostart", f"config:={workspace}/bin")
    assert ran[0].startswith("install --mode=644 ") and ran[0].endswith(UNIT_PATH)
    assert ran[1:] == ["systemctl daemon-reload", f"systemctl enable {UNIT}"]
    assert f'"config:={workspace}/bin"' in said and f"journalctl --follow --unit {UNIT}" in said
    assert "a deadman counts once it was seen released" in said


def test_remove_stops_and_removes_the_unit_where_there_is_one(run):
    ran, _ = run("--remove")
    assert ran == [f"systemctl disable --now {UNIT}", f"rm {UNIT_PATH}", "systemctl daemon-reload"]
    ran, said = run("--remove", is_installed=False)
    assert ran == [] and "Nothing to do" in said


def test_dry_run_shows_the_unit_and_runs_nothing_nor_does_a_computer_without_systemd(run, workspace):
    ran, said = run("--autostart", "--dry-run", f"config:={workspace}/bin")
    assert ran == [] and "WantedBy=multi-user.target" in said and f"would install {UNIT_PATH}" in said
    ran, said = run("--autostart", "config:=.", has_systemd=False)
    assert ran == [] and said.startswith("there is no systemctl here, as in a container")
