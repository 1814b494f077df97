"""Which folder imports which: downwards only, from scripts over nodes, ros and the parts to common."""
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from mutate import imports

SRC = Path(__file__).resolve().parents[2] / "src"
PACKAGE = SRC / "car_interface"
SENSING = ("common", "teensy/link", "teensy/sensing")
PARTS = (*SENSING, "interlock", "steering", "throttle", "planner", "teleop", "pca9685")
FITS = ("tools/recordings", "tools/calibration")
# What each folder may import beside itself. A simulated device that shared code with what it tests would prove nothing.
MAY_IMPORT = {
    "common": (),
    "interlock": ("common",),
    "steering": ("common", "interlock"),
    "planner": ("common",),
    "throttle": ("common", "interlock", "planner"),  # the speed control takes a planner's request
    "teleop": ("common",),
    "pca9685": ("common",),
    "teensy/link": ("common",),
    "teensy/sensing": SENSING,
    "sim": ("common",),
    "ros": (*PARTS, "sim"),
    # One node calibrates while it drives, and one checks a new car.
    "nodes": (*PARTS, "sim", "ros", "tools/calibration/drive", "tools/first_check"),
    "tools/recordings": PARTS,
    "tools/report": (*PARTS, "tools/recordings"),
    "tools/calibration": ("common", "tools/recordings"),
    "tools/calibration/drive": (*PARTS, *FITS, "tools/calibration/steering"),
    "tools/calibration/esc": (*PARTS, *FITS),
    "tools/calibration/steering": (*PARTS, *FITS),
    "tools/calibration/value_map": (*PARTS, *FITS),
    "tools/cli": (*PARTS, *FITS, "tools/report", "tools/calibration/esc", "tools/calibration/steering",
                  "tools/calibration/value_map"),
    "tools/doctor": (*PARTS, "ros"),
    "tools/first_check": (*PARTS, "tools/report"),
    "tools/host_setup": ("common", "teleop"),
}
ROS = ("nodes/", "ros/", "tools/doctor/topics.py")
# Libraries, and the only places that import them.
ONLY_IN = {
    "rospy": ROS,
    "rosbag": ("nodes/black_box.py",),
    "rosbags": ("tools/recordings/",),
    "evdev": ("nodes/keyboard_drive.py", "teleop/gamepad_device.py"),
    "jinja2": ("tools/report/html.py",),
    "matplotlib": ("tools/report/",),
    "tqdm": ("tools/recordings/", "tools/cli/"),
    "scipy": ("tools/calibration/",),
    "serial": ("teensy/link/port.py",),
    "dynamic_reconfigure": ("ros/reconfigure.py",),
    "tornado": ("nodes/phone_drive/server.py",),
    "smbus2": ("nodes/pca9685/node.py", "tools/doctor/devices.py"),
}
# Imported alone, a module outside of these pulls in none of the heavy ones.
NOT_PURE = (*ROS, "teensy/link/port.py", "teleop/gamepad_device.py", "tools/doctor/cli.py", "tools/host_setup/",
            "tools/recordings/", "tools/report/", "tools/cli/", "tools/calibration/")
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


# Each module in a child of its own, which has imported nothing else, but for what most need of the standard library.
IMPORT_EACH = f"""
import argparse, ctypes, dataclasses, importlib, inspect, json, logging, os, random, shutil, sys, tempfile, typing
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
    kept = {name: os.environ[name] for name in ("PYTHONPYCACHEPREFIX",) if name in os.environ}
    done = subprocess.run([sys.executable, "-S", "-B", "-c", IMPORT_EACH, *pure],
                          env={"PYTHONPATH": str(SRC), **kept}, capture_output=True, text=True, check=False)
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
    folders = {re.sub("^nodes/.*", "nodes", inside(path.parent)) for path in MODULES} - {"."}
    assert folders - {"teensy", "tools"} <= set(MAY_IMPORT)
    (only,) = PACKAGE.glob("*.py")
    assert only.name == "__init__.py" and imports(only) == set()
