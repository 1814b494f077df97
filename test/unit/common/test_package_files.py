"""Where the package's own files are, in a checkout and where it is installed."""
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from car_interface.common.errors import CarInterfaceError
from car_interface.common.package_files import is_package_file, package_file

ROOT = Path(__file__).resolve().parents[3]
TABLE = ROOT / "config" / "turn_arb.yaml"


def test_files_of_the_package_are_found_in_the_checkout():
    assert package_file("msg") == ROOT / "msg" and package_file("config/turn_arb.yaml") == TABLE
    with pytest.raises(CarInterfaceError, match="no_such_file of car_interface is missing"):
        package_file("no_such_file")


@pytest.mark.parametrize("modules", ["lib/python3/dist-packages", "lib/python3.11/site-packages", "."],
                         ids=["catkin_install", "venv", "pip_target"])
def test_files_of_the_package_are_found_where_it_is_installed(modules, tmp_path):
    for name in ("__init__.py", "common/__init__.py", "common/errors.py", "common/package_files.py"):
        target = tmp_path / modules / "car_interface" / name
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(str(ROOT / "src/car_interface" / name), str(target))
    shutil.copytree(str(ROOT / "msg"), str(tmp_path / "share/car_interface/msg"))
    code = "from car_interface.common.package_files import package_file; print(package_file('msg'))"
    done = subprocess.run([sys.executable, "-B", "-c", code], env={"PYTHONPATH": str(tmp_path / modules)},
                          capture_output=True, text=True, check=False)
    assert (done.stdout.strip(), done.stderr) == (str(tmp_path.resolve() / "share/car_interface/msg"), "")


def test_file_of_the_package_is_one_by_any_way_to_it(tmp_path):
    (tmp_path / "link").symlink_to(ROOT)
    assert is_package_file(str(TABLE)) and is_package_file(str(tmp_path / "link/config/../config/turn_arb.yaml"))
    assert is_package_file(str(ROOT / "config" / "none_yet.yaml"))
    assert not is_package_file(str(tmp_path / "config/turn_arb.yaml")) and not is_package_file(str(ROOT / "config_2/a"))
