#!/usr/bin/env python3
"""A short soak: random faults while the car drives; nothing moves that must not, and everything recovers."""
from __future__ import annotations

import os
import sys
import unittest

import rospy
import rostest

from waiting import start

MINUTES = 10 if os.environ.get("CAR_INTERFACE_ALL") else 1
SOAK = os.path.join(os.path.dirname(os.path.dirname(os.path.abspath(__file__))), "soak.py")


class Soak(unittest.TestCase):
    def test_nothing_moves_that_must_not_and_everything_recovers(self):
        process = start(self, sys.executable, SOAK, "--minutes", str(MINUTES))
        code = process.wait_for_exit(60 * MINUTES + 180)
        report = "\n".join(process.stdout.since() + process.stderr.since())
        print(report, flush=True)
        self.assertEqual(code, 0, report)
        self.assertRegex(report, r"not recovered 0, unsafe moments 0, leaks 0")
        self.assertNotIn("Traceback", report)


if __name__ == "__main__":
    rospy.init_node("soak_test")
    rostest.rosrun("car_interface", "soak_test", "__main__")
