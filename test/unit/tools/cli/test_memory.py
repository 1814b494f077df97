"""The commands with little memory: each works, or ends with one line. Numpy's OpenBLAS would wait for ever."""
import os
import resource
import subprocess
import sys
from pathlib import Path

import pytest

from written_recordings import drive, write_ros1

ROOT = Path(__file__).resolve().parents[4]
MIB = 1 << 20


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    path = tmp_path_factory.mktemp("drives") / "drive.bag"
    write_ros1(path, drive(8.0))
    return path


def arguments(name, bag, folder):
    return {"bag_report": [bag, "-o", folder / "page.html"],
            "drives": [bag.parent, "-o", folder / "drives.html", "--fresh"],
            "check_map": [ROOT / "config" / "value_map.csv", "-o", folder / "map.png"],
            "calibrate_esc": [bag, "-o", folder / "esc.yaml"],
            "calibrate_steering": [bag, "-o", folder / "steering.yaml"],
            "calibrate_value_map": [bag, "-o", folder / "map.csv"]}[name]


def run(mib, name, bag, folder):
    def limit():
        resource.setrlimit(resource.RLIMIT_AS, (mib * MIB, mib * MIB))
    return subprocess.run(
        [sys.executable, "-B", str(ROOT / "scripts" / name), *map(str, arguments(name, bag, folder))],
        capture_output=True, text=True, check=False, timeout=120, preexec_fn=limit,
        env={**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT / "src"), *filter(None, sys.path)])})


@pytest.mark.once
def test_a_limit_that_is_high_enough_changes_nothing(bag, tmp_path):
    """400 MB are, with Debian 12's libraries; others take more."""
    done = run(1000, "check_map", bag, tmp_path)
    assert (done.returncode, done.stderr) == (0, "") and os.listdir(tmp_path)


LIMITS_MIB = {"bag_report": (40,), "check_map": (160,), "calibrate_value_map": (100,)}
if os.environ.get("CAR_INTERFACE_ALL"):
    LIMITS_MIB = dict.fromkeys(("bag_report", "drives", "check_map", "calibrate_esc", "calibrate_steering",
                                "calibrate_value_map"), (40, 70, 100, 130, 160, 200, 240, 400))


@pytest.mark.once
@pytest.mark.parametrize("name, mib", [(name, mib) for name, limits in LIMITS_MIB.items() for mib in limits])
def test_less_is_enough_or_ends_with_one_line(name, mib, bag, tmp_path):
    done = run(mib, name, bag, tmp_path)
    if done.returncode:
        assert done.returncode == 1 and done.stderr.count("\n") == 1 and done.stderr.startswith(f"{name}: ")
    else:
        assert done.stderr == ""
    if mib < 100 and name != "check_map":
        assert done.stderr == (f"{name}: out of memory: its limit of address space is {mib} MB; raise that in the "
                               "shell that starts it (ulimit -v unlimited)\n")
