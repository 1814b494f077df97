#!/usr/bin/env python3
"""calibrate_esc as it is typed, on recordings of a person who follows docs/calibrate.md: what it prints and writes."""
from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tempfile
import unittest

import rospkg
import rostest
import yaml

ROOT = os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(__file__))))
DRIVE = os.path.join(ROOT, "test", "accuracy", "esc_calibration.py")
SEED = "1"  # an ESC that brakes, then reverses, and forgets after some seconds
EXPECTED = r"""ESC by esc\.bag: \d+ s
  esc/profile: brake_then_reverse \(was unverified\): \d+ brakes held the car, \d second pulls drove it backward
  servo/neutral: 49\d\d \(was 4915\): the car set off at 5\d{3} \(3 times\) and 4\d{3} \(3 times\)
  esc/dead_band_forward: 0\.1\d+ \(was 0\.08\): from there to where the car sets off
  esc/dead_band_reverse: 0\.1\d+ \(was 0\.08\): from there to where the car sets off
  esc/dwell: 0\.\d+ s \(was 0\.5 s\): 0\.\d+ s of neutral were enough, 0\.\d+ s were not
  esc/reverse_after_neutral: \d\.\d+ s \(was 0\.0 s\): after \d\.\d s in neutral the first pull was reverse, .*
  esc/drag_deceleration: \d\.\d+ m/s² \(was 0\.3 m/s²\): .* m/s² in neutral: the ESC has a drag brake
written: my_car/throttle\.yaml; the old one is .*/my_car/throttle\.yaml\.bak-\d{8}-\d{6}
"""
REFUSED = (
    "calibrate_esc: nothing is written: the drive doesn't show all of it. Drive this, and give that recording as well, "
    "or keep the old numbers there by --force: esc/reverse_after_neutral: full stick for a good second, center it, and "
    "after 8 s pull back all the way for two seconds; twice; esc/drag_deceleration: full stick for a good second, then "
    "center it until the car stands; three times\n")


class CalibrateEsc(unittest.TestCase):
    def setUp(self):
        self.folder = tempfile.mkdtemp(prefix="calibrate_esc")
        self.addCleanup(shutil.rmtree, self.folder)
        shutil.copytree(os.path.join(rospkg.RosPack().get_path("car_interface"), "config"),
                        os.path.join(self.folder, "my_car"))

    def drive(self, *options):
        path = os.pathsep.join([os.path.join(ROOT, "test"), os.environ.get("PYTHONPATH", "")])
        subprocess.run([sys.executable, DRIVE, "--bag", SEED, os.path.join(self.folder, "esc.bag"), *options],
                       check=True, env={**os.environ, "PYTHONPATH": path}, stdout=subprocess.DEVNULL)

    def typed(self):
        """As the page has it."""
        command = "rosrun car_interface calibrate_esc esc.bag -o my_car/throttle.yaml --base my_car/throttle.yaml"
        return subprocess.run(command.split(), cwd=self.folder, capture_output=True, check=False, encoding="utf-8",
                              env={**os.environ, "PYTHONIOENCODING": "utf-8"})

    def test_drive_of_the_page_is_written_and_says_what_was_seen(self):
        self.drive()
        done = self.typed()
        self.assertEqual((done.returncode, done.stderr), (0, ""))
        self.assertRegex(done.stdout, re.compile(rf"\A{EXPECTED}\Z"))
        with open(os.path.join(self.folder, "my_car", "throttle.yaml"), encoding="utf-8") as file:
            written = yaml.safe_load(file)
        self.assertEqual((written["esc"]["profile"], written["esc"]["profile_measured"]), ("brake_then_reverse", True))

    def test_drive_that_lacks_a_step_is_refused_and_nothing_is_written(self):
        self.drive("--without", "wait and pull")
        done = self.typed()
        self.assertEqual((done.returncode, done.stderr), (1, REFUSED))
        self.assertIn("  esc/reverse_after_neutral: not shown by the drive, stays 0.0 s\n", done.stdout)
        self.assertEqual([name for name in os.listdir(os.path.join(self.folder, "my_car")) if "bak" in name], [])


if __name__ == "__main__":
    rostest.rosrun("car_interface", "calibrate_esc_test", CalibrateEsc)
