"""What the drive takes from the car's nodes, and that it takes no rosbags."""
import subprocess
import sys
from pathlib import Path

import pytest

from car_interface.common.errors import CarInterfaceError, ConfigError
from car_interface.common.package_files import package_file
from car_interface.common.vehicle_geometry import SONARS
from car_interface.common.yaml_file import load_yaml
from car_interface.tools.calibration.drive.config import (
    CalibrationDriveConfig,
    drive_config,
    parse,
)

THROTTLE = {**load_yaml(str(package_file("config/throttle.yaml"))),
            "sonar_hub": load_yaml(str(package_file("config/sonars.yaml")))}


def test_sonars_are_those_of_throttle_arb_also_where_it_does_not_stop_for_them_and_without_it_is_refused():
    assert THROTTLE["obstacle_stop"] is False
    obstacle = {"sonars": {"rear_left": "absent"}, "front": 0.5}
    made = drive_config(parse([]), {**THROTTLE, "obstacle": obstacle}).obstacles
    assert set(made.mounts) == set(SONARS) - {"rear_left"}
    assert made.outline.front_m == 0.5
    with pytest.raises(CarInterfaceError, match=r"of throttle_arb's parameters sonar_hub/sonars/front_right is "
                                                r"missing.*launch the car by its launch files, or .* --no-sonars"):
        drive_config(parse([]), {"servo": THROTTLE["servo"]})


def test_options_are_read_and_those_of_the_drive_are_its_settings():
    made = parse([])
    assert (made.output, made.base, made.yes, made.stick, made.no_sonars) == (None, None, False, False, False)
    assert drive_config(parse(["--no-sonars"]), {}) == drive_config(parse(["--stick"]), {}) == CalibrationDriveConfig()
    made = parse(["-o", "a.yaml", "--base", "b.yaml", "--yes", "--stick", "--no-sonars", "--radius", "4", "--speed",
                  "1", "--tight-speed", "0.8", "--max-time", "60", "--braking", "0.5"])
    assert (made.output, made.base, made.yes, made.stick, made.no_sonars) == ("a.yaml", "b.yaml", True, True, True)
    assert drive_config(made, {}) == CalibrationDriveConfig(4.0, 1.0, 0.8, 60.0, 0.5)


@pytest.mark.parametrize("option, value, accepted", [
    ("radius", "1", "2.5 to 100"), ("speed", "0", "0.4 to 3"), ("tight-speed", "5", "0.4 to 3"),
    ("max-time", "0", "30 to 3600"), ("braking", "0", "0.1 to 10"), ("radius", "nan", "2.5 to 100"),
])
def test_an_impossible_number_is_refused_by_its_name(option, value, accepted):
    with pytest.raises(ConfigError, match=rf"^{option.replace('-', '_')} is .*; accepted: a number from {accepted}$"):
        drive_config(parse([f"--{option}", value]), {})


def test_drive_and_its_conclusion_are_imported_without_rosbags():
    """A car's own computer may have none, as Debian has no package of it."""
    code = ("import sys; sys.modules['rosbags'] = None; "
            "import car_interface.tools.calibration.drive.calibration_drive, "
            "car_interface.tools.calibration.drive.conclusion")
    path = [str(Path(__file__).resolve().parents[5] / "src"), *filter(None, sys.path)]
    done = subprocess.run([sys.executable, "-B", "-c", code], env={"PYTHONPATH": ":".join(path)}, capture_output=True,
                          text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
