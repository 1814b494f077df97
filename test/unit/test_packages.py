"""test/packages.py: which packages a system needs by package.xml."""
from __future__ import annotations

import importlib
import sys
from pathlib import Path

import pytest

sys.path.append(str(Path(__file__).resolve().parents[1]))
packages = importlib.import_module("packages")
ROSBAGS = "rosbags>=0.9.23,<=0.11.9"


def test_condition_of_another_kind_is_refused():
    with pytest.raises(ValueError, match=r"not understood: \$ROS_VERSION == 1"):
        packages.holds("$ROS_VERSION == 1", "debian")


def test_package_without_a_distribution_s_comes_from_pip_and_only_from_there():
    assert packages.packages("debian", "pip") == [ROSBAGS]
    assert packages.packages("noetic", "pip") == [ROSBAGS, "smbus2"]
    assert [name for name in packages.packages("noetic", "apt") if "smbus2" in name or "rosbags" in name] == []


def test_list_has_what_commands_and_tests_call_and_no_rviz():
    found = packages.packages("debian", "apt")
    assert {"catkin", "rosbash", "rosout", "python3-pytest-xdist", "python3-smbus2", "libfaketime"} <= set(found)
    assert not any("rviz" in name for name in found)


def test_other_python_gets_every_python_package():
    found = packages.packages("debian", "python3.8")
    assert {"numpy", "pyserial", "pytest", "pytest-xdist", "PyYAML", ROSBAGS, "rospkg", "smbus2"} <= set(found)
    assert "venv" not in found
