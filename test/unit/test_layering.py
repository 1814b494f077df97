"""The walls of the house: what imports what. Downwards only: scripts, nodes, sim, the parts, the foundation."""
from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

SRC = Path(__file__).resolve().parents[2] / "src"
PACKAGE = SRC / "car_interface"
FOUNDATION = {"errors", "freshness", "interpolation", "params", "processes", "servo", "tuning", "whole_file"}
# A room is a folder, or the modules named here, or else a single module.
ROOM_OF = {**dict.fromkeys(("value_map", "value_map_bulk", "conversion", "throttle"), "acceleration"),
           "steering_params": "steering"}
# Between parts there is nothing but this: what drives the ESC reads who steers out of turn_arb's state, and it asks for
# permission by the same rules as the steering; the gamepad says in the same words that it has just started.
BETWEEN_PARTS = {("acceleration", "steering"), ("acceleration", "permission"), ("steering", "permission"),
                 ("gamepad", "permission")}
# Devices and ROS are for nodes; numpy is imported where whole arrays are worked on, never with a module, but by
# calibration, which is nothing but arrays.
LINK = "teensy/link.py"
FOR_ARRAYS = ("value_map_bulk.py",)
HEAVY = ("rospy", "serial", "smbus2", "rosbags", "numpy")
ONLY_IN = {"rospy": ("nodes/",), "rosbags": ("bags/",), "matplotlib": ("bags/",), "tqdm": ("bags/",),
           "scipy": ("calibration/",), "serial": ("teensy/link.py",),
           "dynamic_reconfigure": ("nodes/live.py",),
           "smbus2": ("nodes/pca9685.py", "nodes/doctor_devices.py")}


def modules() -> list[Path]:
    return sorted(PACKAGE.rglob("*.py"))


def pure_modules() -> list[str]:
    names = []
    for path in modules():
        inside = path.relative_to(PACKAGE)
        folder, file = inside.parts[0], inside.as_posix()
        if folder not in ("nodes", "bags", "calibration") and file not in (LINK, *FOR_ARRAYS):
            names.append(".".join(path.relative_to(SRC).with_suffix("").parts).replace(".__init__", ""))
    return names


def imports(path: Path) -> set[str]:
    """Returns the full names of the modules that a file imports, anywhere in it."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path} imports relatively: that hides which room it looks into"
            found.update(f"{node.module}.{alias.name}" for alias in node.names)
    return found


def room(name: str) -> str:
    """Returns the room of a module given as its path below the package, or as its full name."""
    first = name.replace("car_interface.", "", 1).replace("/", ".").split(".")[0]
    return ROOM_OF.get(first, "foundation" if first in FOUNDATION else first)


def allowed(importer: str, imported: str) -> bool:
    """Says whether a module of one room may import one of another."""
    if importer == imported or imported == "foundation" or importer == "nodes":
        return True
    if importer == "sim":
        # A simulated Teensy that shares code with the host that it tests would prove nothing; nor would a chip.
        return imported not in ("nodes", "teensy", "pca9685")
    if importer == "bags":
        return imported not in ("nodes", "sim", "doctor")
    if importer == "doctor":
        # It examines the parts' devices by what the parts know of them.
        return imported not in ("nodes", "sim")
    return (importer, imported) in BETWEEN_PARTS


@pytest.mark.parametrize("name", pure_modules())
def test_pure_module_imported_alone_pulls_in_no_device_no_ros_and_no_numpy(name):
    code = f"import sys, {name}; print(*sorted(set(sys.modules) & set({HEAVY!r})))"
    # -S: what site packages import by themselves is not the module's doing.
    done = subprocess.run(
        [sys.executable, "-S", "-B", "-c", code],
        env={"PYTHONPATH": str(SRC)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stderr, done.stdout.strip()) == (0, "", "")


@pytest.mark.parametrize("path", modules(), ids=lambda path: path.relative_to(PACKAGE).as_posix())
def test_module_imports_downwards_only(path):
    importer = room(path.relative_to(PACKAGE).with_suffix("").as_posix())
    ours = {name for name in imports(path) if name.startswith("car_interface.")}
    generated = {name for name in ours if name.split(".")[1] in ("msg", "srv")}
    assert not generated or importer == "nodes"
    assert [name for name in sorted(ours - generated) if not allowed(importer, room(name))] == []


@pytest.mark.parametrize("path", modules(), ids=lambda path: path.relative_to(PACKAGE).as_posix())
def test_ros_and_devices_are_imported_only_where_they_belong(path):
    inside = path.relative_to(PACKAGE).as_posix()
    libraries = {name.split(".")[0] for name in imports(path)}
    assert [name for name in ONLY_IN if name in libraries and not inside.startswith(ONLY_IN[name])] == []


def test_the_walls_are_looked_at():
    assert allowed("nodes", "sim") and allowed("sim", "steering") and allowed("teensy", "foundation")
    assert not allowed("teensy", "pca9685") and not allowed("steering", "acceleration") and not allowed("sim", "teensy")
    assert allowed("nodes", "doctor") and allowed("doctor", "teensy") and not allowed("doctor", "nodes")
    assert not allowed("teensy", "doctor") and not allowed("foundation", "steering") and not allowed("pca9685", "nodes")
    assert allowed("bags", "calibration") and not allowed("calibration", "bags") and not allowed("calibration", "sim")
    assert "car_interface.steering" in pure_modules() and "car_interface.teensy.link" not in pure_modules()
