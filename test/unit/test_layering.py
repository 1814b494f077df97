"""Which folder imports which: downwards only, from scripts over nodes, ros and the parts to common."""
from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from mutate import imports

SRC = Path(__file__).resolve().parents[2] / "src"
PACKAGE = SRC / "car_interface"
SENSING = ("common", "teensy/link", "teensy/sensing")
PARTS = (*SENSING, "interlock", "steering", "throttle", "planner", "teleop", "pca9685")
# What each folder may import beside itself. A simulated device that shared code with what it tests would prove nothing.
MAY_IMPORT = {
    "common": (),
    "interlock": ("common",),
    "steering": ("common", "interlock"),
    "throttle": ("common", "interlock", "steering"),  # the ESC is driven while turn_arb's state says who steers
    "planner": ("common",),
    "teleop": ("common", "interlock"),
    "pca9685": ("common",),
    "teensy/link": ("common",),
    "teensy/sensing": SENSING,
    "sim": ("common",),
    "ros": (*PARTS, "sim"),
    # One node calibrates while it drives; and it writes what calibrate_steering would.
    "nodes": (*PARTS, "sim", "ros", "calibration", "calibration/drive", "calibration/steering"),
    "recordings": PARTS,
    "report": (*PARTS, "recordings"),
    "calibration": ("common",),
    "calibration/drive": (*PARTS, "recordings", "calibration", "calibration/steering"),
    "calibration/esc": (*PARTS, "recordings", "calibration"),
    "calibration/steering": (*PARTS, "recordings", "calibration"),
    "calibration/value_map": (*PARTS, "recordings", "calibration"),
    "cli": (*PARTS, "recordings", "report", "calibration", "calibration/esc", "calibration/steering",
            "calibration/value_map"),
    "doctor/checks": PARTS,
    "doctor/probes": (*PARTS, "ros", "doctor/checks"),
    "doctor": (*PARTS, "doctor/checks", "doctor/probes"),
    "host_setup": ("common",),
}
ROS = ("nodes/", "ros/", "doctor/probes/")
# Libraries, and the only places that import them.
ONLY_IN = {
    "rospy": ROS,
    "rosbags": ("recordings/",),
    "matplotlib": ("report/",),
    "tqdm": ("recordings/", "cli/"),
    "scipy": ("calibration/",),
    "serial": ("teensy/link/port.py",),
    "dynamic_reconfigure": ("ros/reconfigure.py",),
    "smbus2": ("nodes/pca9685.py", "doctor/probes/devices.py"),
}
# Imported alone, a module outside of these pulls in none of the heavy ones.
NOT_PURE = (*ROS, "doctor/cli.py", "host_setup/cli.py", "recordings/", "report/", "cli/", "calibration/",
            "teensy/link/port.py")
MODULES = sorted(PACKAGE.rglob("*.py"))
HEAVY = ("rospy", "serial", "smbus2", "rosbags", "numpy")


def inside(path: Path) -> str:
    return path.relative_to(PACKAGE).as_posix()


def dotted(path: Path) -> str:
    return ".".join(path.relative_to(SRC).with_suffix("").parts).replace(".__init__", "")


def folder(name: str) -> str:
    """Returns the folder, as MAY_IMPORT names it, of a module or of something in a module."""
    parts = name.split(".")[1:]
    return max((known for known in MAY_IMPORT if parts[:known.count("/") + 1] == known.split("/")), key=len, default="")


# Each module in a child of its own, which has imported nothing else.
IMPORT_EACH = f"""
import importlib, os, sys
for name in sys.argv[1:]:
    if not os.fork():
        importlib.import_module(name)
        heavy = sorted(set(sys.modules) & set({HEAVY!r}))
        if heavy:
            print(name, *heavy, flush=True)
        os._exit(0)
    if os.wait()[1]:
        print(name, "can't be imported", flush=True)
"""


def test_pure_module_imported_alone_pulls_in_no_device_no_ros_and_no_numpy():
    pure = [dotted(path) for path in MODULES if not inside(path).startswith(NOT_PURE)]
    # -S: what site packages import by themselves is not the module's doing.
    done = subprocess.run([sys.executable, "-S", "-B", "-c", IMPORT_EACH, *pure],
                          env={"PYTHONPATH": str(SRC)}, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr, done.stdout) == (0, "", "") and len(pure) > 100


@pytest.mark.parametrize("path", MODULES, ids=inside)
def test_module_imports_downwards_only_and_ros_and_devices_only_where_they_belong(path):
    names = imports(path)
    assert [name for name in names if name.startswith(".")] == [], "relative: that hides which folder it looks into"
    ours = {name for name in names if name.startswith("car_interface.")}
    generated = {name for name in ours if name.split(".")[1] in ("msg", "srv", "cfg")}
    assert not generated or inside(path).startswith(ROS)
    importer = folder(dotted(path))
    allowed = (importer, *MAY_IMPORT.get(importer, ()))
    assert [name for name in sorted(ours - generated) if folder(name) not in allowed] == []
    libraries = {name.split(".")[0] for name in names}
    assert [name for name in ONLY_IN if name in libraries and not inside(path).startswith(ONLY_IN[name])] == []


def test_every_folder_is_in_the_table_and_the_package_has_no_loose_modules():
    folders = {inside(path.parent) for path in MODULES} - {"."}
    assert folders - {"teensy"} <= set(MAY_IMPORT)
    (only,) = PACKAGE.glob("*.py")
    assert only.name == "__init__.py" and imports(only) == set()
