"""Every script answers --help without a ROS master; a node's doesn't need rospy."""
import importlib.util
import re
import runpy
import subprocess
import sys
from pathlib import Path

import pytest

from car_interface.common.declared import rows
from car_interface.ros.start import config_class

ROOT = Path(__file__).resolve().parents[3]
SCRIPTS = sorted((ROOT / "scripts").iterdir())
NODES = [script for script in SCRIPTS if '"nodes.' in script.read_text(encoding="utf-8")]
COMMANDS = [script for script in SCRIPTS if script not in NODES]
WITH_OPTIONS = ("calibration_drive",)  # their usage lists them
# Those that an interpreter for unit tests may lack.
LIBRARIES = {"map_gamepad": "evdev", "setup_hardware": "rospkg", "wait_for_name": "rosgraph"}


def test_there_is_a_script_for_every_node():
    nodes = ROOT / "src" / "car_interface" / "nodes"
    modules = {path.stem for path in nodes.glob("[a-z]*.py")} | {path.parent.name for path in nodes.glob("*/node.py")}
    modules -= {"bag_recording", "command_node", "terminal"}  # what two of them share
    assert modules == {script.name for script in NODES}


@pytest.mark.parametrize("script", NODES, ids=lambda script: script.name)
def test_node_prints_its_usage(script):
    # -S: without site packages there is no rospy.
    done = subprocess.run([sys.executable, "-B", "-S", str(script), "--help", "__name:=other"], capture_output=True,
                          text=True, check=False, timeout=60, env={"PYTHONPATH": str(ROOT / "src"), "COLUMNS": "100"})
    assert (done.returncode, done.stderr) == (0, "")
    usage = done.stdout
    assert usage.startswith(f"usage: rosrun car_interface {script.name} ")
    assert script.name in usage.split("\n\n")[1] and "docs/nodes.md" in usage
    config = config_class(script.name)
    names = {row.name.replace("`", "") for row in rows(config)} if config else set()
    assert names <= set(re.findall(r"^  (\S.*?) \(", usage, re.M))
    assert len(usage.splitlines()) < 12 + 2 * len(names) or script.name in WITH_OPTIONS


@pytest.mark.parametrize("node, goes_without", [("phone_drive", True), ("planner_interface", True),
                                                ("calibration_drive", False), ("first_check", False)])
def test_node_without_arrays_goes_without_numpy_which_genpy_imports_where_it_can(node, goes_without):
    code = ("import importlib.util, sys, types\n"
            "from car_interface.ros.start import full_name, start\n"
            f"name = full_name('nodes.{node}')\n"
            "module = types.ModuleType(name)\n"
            "module.__spec__ = importlib.util.find_spec(name)\n"
            "sys.modules[name] = module\n"
            "module.main = lambda: print('numpy' in sys.modules and sys.modules['numpy'] is None)\n"
            f"start('nodes.{node}')")
    done = subprocess.run([sys.executable, "-B", "-S", "-c", code], capture_output=True, text=True, check=False,
                          timeout=60, env={"PYTHONPATH": str(ROOT / "src")})
    assert (done.stdout, done.stderr) == (f"{goes_without}\n", "")


@pytest.mark.parametrize("script", COMMANDS, ids=lambda script: script.name)
def test_command_prints_its_usage(script, monkeypatch, capsys):
    if script.name in LIBRARIES and importlib.util.find_spec(LIBRARIES[script.name]) is None:
        pytest.skip(f"needs {LIBRARIES[script.name]}")
    monkeypatch.setattr(sys, "argv", [str(script), "--help"])
    try:
        runpy.run_path(str(script), run_name="__main__")
    except SystemExit as end:
        assert end.code == 0
    shown = capsys.readouterr()
    assert shown.err == "" and shown.out.startswith(f"usage: {script.name} ")
