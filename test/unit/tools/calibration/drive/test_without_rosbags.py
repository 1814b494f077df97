"""A car's own computer may have no rosbags, as Debian has no package of it: the drive needs none."""
import subprocess
import sys
from pathlib import Path

SRC = Path(__file__).resolve().parents[5] / "src"


def test_drive_and_its_conclusion_are_imported_without_rosbags():
    code = ("import sys; sys.modules['rosbags'] = None; "
            "import car_interface.tools.calibration.drive.calibration_drive, "
            "car_interface.tools.calibration.drive.conclusion, "
            "car_interface.tools.calibration.drive.stick_guide")
    path = [str(SRC), *filter(None, sys.path)]
    done = subprocess.run([sys.executable, "-B", "-c", code], env={"PYTHONPATH": ":".join(path)}, capture_output=True,
                          text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
