"""What catkin, rosrun, roslaunch and rosdep will find, as far as it can be checked without ROS.

Each argument of a launch file says what it is, and none is required that has a default.
"""
from __future__ import annotations

import importlib.util
import os
import re
import sys
import sysconfig
from pathlib import Path
from xml.etree import ElementTree

import pytest
from mutate import imports

from car_interface.common.fixed_parameters import FIXED, PARTS

ROOT = Path(__file__).resolve().parents[2]
CMAKE = (ROOT / "CMakeLists.txt").read_text(encoding="utf-8")
SCRIPTS = sorted((ROOT / "scripts").iterdir())
DEMO = ROOT / "demo"
LAUNCH_FILES = sorted((ROOT / "launch").glob("*.launch"))
# Scripts that are run by hand and end by themselves; those for recordings and tables need no ROS.
OFFLINE = {"bag_report", "calibrate_esc", "calibrate_steering", "calibrate_value_map", "check_map", "drives"}
# Started by hand.
TOOLS = {"calibration_drive", "doctor", "first_check", "keyboard_drive", "map_gamepad", "setup_hardware",
         "wait_for_name"} | OFFLINE
NODES = [script for script in SCRIPTS if script.name not in OFFLINE]
NODE_TESTS = sorted((ROOT / "test" / "process").glob("*.test"))
# The rosdep keys of libraries that are not called like their key.
KEYS = {name: f"python3-{name}" for name in ("evdev", "hypothesis", "jinja2", "matplotlib", "numpy", "pytest",
                                            "qrcode", "rospkg", "scipy", "serial", "setuptools", "smbus2", "tornado",
                                            "tqdm", "yaml")}
KEYS["PIL"] = "python3-pil"
KEYS["rosbags"] = "python3-rosbags-pip"
EXTRAS = {"distributed"}  # of setup.py, which ROS doesn't install


def name_of(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


def root_of(path: Path) -> ElementTree.Element:
    return ElementTree.parse(str(path)).getroot()


def dependencies(*kinds: str) -> set[tuple[str, str]]:
    """Returns key and condition of each dependency of the given kinds in package.xml."""
    package = root_of(ROOT / "package.xml")
    return {((tag.text or "").strip(), tag.get("condition", "")) for tag in package if tag.tag in kinds}


def is_standard(name: str) -> bool:
    """Says whether a module belongs to Python itself."""
    spec = importlib.util.find_spec(name)
    if spec is None:
        return False
    origin = spec.origin or ""
    inside = origin.startswith(sysconfig.get_paths()["stdlib"]) and not re.search("(site|dist)-packages", origin)
    return inside or origin == "frozen" or name in sys.builtin_module_names


def keys_of_imports(paths: list[Path]) -> set[str]:
    """Returns the rosdep keys of the libraries that Python files import from outside the package."""
    found = {name.split(".")[0] for path in paths for name in imports(path)}  # "" of a relative one
    ours = {"", "car_interface", *(path.stem for path in [*paths, *DEMO.glob("*.py")]),
            *(path.parent.name for path in paths)}
    return {KEYS.get(name, name) for name in found - ours if not is_standard(name)}


def listed_in_cmake(command: str) -> list[str]:
    """Returns the file names that a CMake command lists."""
    (body,) = re.findall(r"\b" + command + r"\(([^)]*)\)", CMAKE)
    return re.findall(r"[\w/]+\.(?:msg|srv)\b|(?:scripts|demo)/\w+", body)


def module_of(script: Path) -> str:
    """Returns the module below car_interface whose main() a script calls."""
    return {"doctor": "tools.doctor.cli", "map_gamepad": "tools.host_setup.map_gamepad",
            "setup_hardware": "tools.host_setup.cli",
            "wait_for_name": "ros.wait_for_name"}.get(script.name, f"nodes.{script.name}")


@pytest.mark.parametrize("script", SCRIPTS, ids=name_of)
def test_script_is_executable_shadows_no_library_and_only_calls_its_command_or_node(script):
    assert os.access(str(script), os.X_OK)
    assert "." not in script.name, "an extension could make it shadow a library"
    expected = (f'from car_interface.ros.start import start\n\nstart("{module_of(script)}")\n' if script in NODES else
                'import sys\n\nfrom car_interface.tools.cli.main import main\n\nif __name__ == "__main__":  # '
                f'a process that it starts imports it\n    sys.exit(main("{script.name}"))\n')
    assert script.read_text(encoding="utf-8") == f"#!/usr/bin/env python3\n{expected}"
    if script in NODES:
        path = ROOT / "src/car_interface" / module_of(script).replace(".", "/")
        path = path / "node.py" if path.is_dir() else path.with_suffix(".py")
        assert "\ndef main(" in path.read_text(encoding="utf-8")


def test_cmake_lists_every_script_message_service_and_cfg_file_which_can_be_run():
    assert listed_in_cmake("catkin_install_python") == [*map(name_of, SCRIPTS), "demo/demo_drive"]
    assert listed_in_cmake("add_message_files") == sorted(path.name for path in (ROOT / "msg").iterdir())
    assert listed_in_cmake("add_service_files") == sorted(path.name for path in (ROOT / "srv").iterdir())
    listed = re.findall(r"cfg/\w+\.cfg", CMAKE)
    assert listed == sorted(name_of(path) for path in (ROOT / "cfg").iterdir())
    assert [name for name in listed if not os.access(str(ROOT / name), os.X_OK)] == []


def test_cmake_installs_everything_that_a_user_needs():
    installed = set(" ".join(re.findall(r"\binstall\((?:DIRECTORY|FILES) ([\w. ]+?) DESTINATION", CMAKE)).split())
    assert installed == {"config", "docs", "launch", "udev", "LICENSE", "README.md"}
    assert [name for name in installed if not (ROOT / name).exists()] == []
    modules = " ".join(name_of(path) for path in sorted(DEMO.glob("*.py")))
    assert f"install(FILES {modules} DESTINATION ${{CATKIN_PACKAGE_BIN_DESTINATION}})" in CMAKE


def test_setup_finds_every_folder_of_modules_and_none_hides_the_generated_messages():
    folders = {path.parent for path in (ROOT / "src").rglob("*.py")}
    assert [folder for folder in folders if not (folder / "__init__.py").exists()] == []
    assert not (ROOT / "src/car_interface/msg").exists() and not (ROOT / "src/car_interface/srv").exists()


@pytest.mark.parametrize("paths, kind", [
    ([*(ROOT / "src").rglob("*.py"), *SCRIPTS, *DEMO.glob("*.py"), ROOT / "setup.py"], "buildtool_depend"),
    (list((ROOT / "test").rglob("*.py")), "test_depend"),
], ids=["code", "tests"])
def test_package_declares_what_is_imported(paths, kind):
    assert keys_of_imports(paths) - {key for key, _ in dependencies("exec_depend", kind)} - EXTRAS == set()


@pytest.mark.parametrize("path", LAUNCH_FILES + NODE_TESTS, ids=name_of)
def test_launch_file_starts_and_names_only_what_exists(path):
    launch = root_of(path)
    declared = {key for key, _ in dependencies("exec_depend")}
    for node in launch.iter("node"):
        if node.get("pkg") == "car_interface":
            assert any(os.access(str(ROOT / folder / node.get("type")), os.X_OK) for folder in ("scripts", "demo"))
        else:
            assert node.get("pkg") in declared
    for test in launch.iter("test"):
        assert test.get("pkg") == "car_interface"
        assert os.access(str(path.parent / test.get("type")), os.X_OK)
    named = re.findall(r"\$\(find car_interface\)/([\w./-]+)", path.read_text(encoding="utf-8"))
    assert [name for name in named if not (ROOT / name).exists()] == []


def test_every_node_has_a_launch_file():
    started = {node.get("type") for path in LAUNCH_FILES for node in root_of(path).iter("node")}
    assert set(FIXED) <= started
    assert [script.name for script in SCRIPTS if script.name not in started | TOOLS] == []


def test_every_node_test_is_run_by_a_test_file():
    run = {test.get("type") for path in NODE_TESTS for test in root_of(path).iter("test")}
    assert {path.name for path in (ROOT / "test/process").glob("*_test.py")} == run


# --- arguments of launch files ---

ARGUMENTS = [(path.name, arg) for path in LAUNCH_FILES for arg in root_of(path).findall("arg")
             if not arg.get("name").endswith("_is_refused")]


@pytest.mark.parametrize("file, arg", ARGUMENTS, ids=[f"{file}:{arg.get('name')}" for file, arg in ARGUMENTS])
def test_argument_has_a_short_doc_and_a_default(file, arg):
    doc, default = arg.get("doc", ""), arg.get("default")
    assert 0 < len(doc) <= 100 and doc == doc.strip() and not doc.endswith(".")
    # `roslaunch --ros-args` lists an argument as required whose default is empty, or becomes so when evaluated.
    assert default and not default.startswith("$(eval")


@pytest.mark.parametrize("path", LAUNCH_FILES, ids=name_of)
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


DEVICE_NODES = [(path.name, node) for path in LAUNCH_FILES for node in root_of(path).iter("node")
                if node.get("type") in FIXED]


@pytest.mark.parametrize("file, node", DEVICE_NODES, ids=[f"{file}:{node.get('type')}" for file, node in DEVICE_NODES])
def test_node_gets_its_devices_as_arguments_as_well_as_by_parameters(file, node):
    kind, text = node.get("type"), node.get("args")
    given = re.findall(r"--([\w-]+) '([^']+)'", text)  # quoted: a path may have a space
    assert " ".join(text.split()) == " ".join(f"--{name} '{value}'" for name, value in given)
    names = {name for each in PARTS.get(kind, (kind,)) for name in FIXED[each]}
    assert {name.replace("-", "_") for name, _ in given} == names
    values = {param.get("name"): param.get("value") for param in root_of(ROOT / "launch" / file).iter("param")}
    assert {name.replace("-", "_"): value for name, value in given} == {name: values[name] for name in names}
