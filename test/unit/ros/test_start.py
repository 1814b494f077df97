"""Every script answers --help without a ROS master; a node's doesn't need rospy."""
from __future__ import annotations

import importlib.util
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
SCRIPTS = sorted((ROOT / "scripts").iterdir())
NODES = [script for script in SCRIPTS if '"nodes.' in script.read_text(encoding="utf-8")]
COMMANDS = [script for script in SCRIPTS if script not in NODES]
WITH_OPTIONS = ("calibration_drive",)  # their usage lists them
# ROS's own, which an interpreter for unit tests may lack.
LIBRARIES = {"setup_hardware": "rospkg", "wait_for_name": "rosgraph"}


def run(script, *arguments, flags=(), path=""):
    done = subprocess.run([sys.executable, "-B", *flags, str(script), *arguments], capture_output=True, text=True,
                          check=False, timeout=60, env={"PYTHONPATH": f"{ROOT / 'src'}:{path}", "COLUMNS": "100"})
    assert (done.returncode, done.stderr) == (0, "")
    return done.stdout


def test_there_is_a_script_for_every_node():
    modules = {path.stem for path in (ROOT / "src" / "car_interface" / "nodes").glob("[a-z]*.py")}
    assert modules == {script.name for script in NODES}


@pytest.mark.parametrize("flag", ["-h", "--help"])
@pytest.mark.parametrize("script", NODES, ids=lambda script: script.name)
def test_node_prints_its_usage(script, flag):
    # -S: without site packages there is no rospy.
    usage = run(script, flag, "__name:=other", flags=["-S"])
    assert usage.startswith(f"usage: rosrun car_interface {script.name} ")
    assert script.name in usage.split("\n\n")[1] and "docs/nodes.md" in usage
    assert len(usage.splitlines()) < 12 or script.name in WITH_OPTIONS


@pytest.mark.parametrize("script", COMMANDS, ids=lambda script: script.name)
def test_command_prints_its_usage(script):
    if script.name in LIBRARIES and importlib.util.find_spec(LIBRARIES[script.name]) is None:
        pytest.skip(f"needs {LIBRARIES[script.name]}")
    assert run(script, "--help", path=":".join(sys.path)).startswith(f"usage: {script.name} ")
