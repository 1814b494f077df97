"""Each argument of a launch file says what it is, and none is required that has a default."""
from __future__ import annotations

import re
from pathlib import Path
from xml.etree import ElementTree

import pytest

from car_interface.common.fixed_parameters import FIXED, PARTS

ROOT = Path(__file__).resolve().parents[2]
LAUNCH_FILES = sorted((ROOT / "launch").glob("*.launch"))


def root_of(path: Path):
    return ElementTree.parse(str(path)).getroot()


ARGUMENTS = [(path.name, arg) for path in LAUNCH_FILES for arg in root_of(path).findall("arg")
             if not arg.get("name").endswith("_is_refused")]


@pytest.mark.parametrize("file, arg", ARGUMENTS, ids=[f"{file}:{arg.get('name')}" for file, arg in ARGUMENTS])
def test_argument_has_a_short_doc_and_a_default(file, arg):
    doc, default = arg.get("doc", ""), arg.get("default")
    assert 0 < len(doc) <= 100 and doc == doc.strip() and not doc.endswith(".")
    # `roslaunch --ros-args` lists an argument as required whose default is empty, or becomes so when evaluated.
    assert default and not default.startswith("$(eval")


@pytest.mark.parametrize("path", LAUNCH_FILES, ids=lambda path: path.name)
def test_included_file_declares_the_arguments_that_it_is_given(path):
    for include in root_of(path).iter("include"):
        (name,) = re.findall(r"\$\(find car_interface\)/launch/([\w.]+)$", include.get("file"))
        declared = {arg.get("name") for file, arg in ARGUMENTS if file == name}
        assert {arg.get("name") for arg in include.findall("arg")} <= declared


def test_an_argument_of_one_name_has_the_same_default_in_every_file():
    # A simulated car may have no files, the demo's port is the virtual Teensy's, car.launch expects a gamepad, and
    # planner_interface.launch a planner.
    differ = {"config", "port", "gamepad", "planner"}
    defaults = {}
    for _, arg in ARGUMENTS:
        if arg.get("name") not in differ:
            defaults.setdefault(arg.get("name"), set()).add(arg.get("default"))
    assert {name: found for name, found in defaults.items() if len(found) > 1} == {}


NODES = [(path.name, node) for path in LAUNCH_FILES for node in root_of(path).iter("node")
         if node.get("type") in FIXED]


@pytest.mark.parametrize("file, node", NODES, ids=[f"{file}:{node.get('type')}" for file, node in NODES])
def test_node_gets_its_devices_as_arguments_as_well_as_by_parameters(file, node):
    kind, text = node.get("type"), node.get("args")
    given = re.findall(r"--([\w-]+) '([^']+)'", text)  # quoted: a path may have a space
    assert " ".join(text.split()) == " ".join(f"--{name} '{value}'" for name, value in given)
    names = {name for each in PARTS.get(kind, (kind,)) for name in FIXED[each]}
    assert {name.replace("-", "_") for name, _ in given} == names
    values = {param.get("name"): param.get("value") for param in root_of(ROOT / "launch" / file).iter("param")}
    assert {name.replace("-", "_"): value for name, value in given} == {name: values[name] for name in names}


def test_each_node_that_opens_a_device_is_started_so():
    assert {node.get("type") for _, node in NODES} == set(FIXED)
