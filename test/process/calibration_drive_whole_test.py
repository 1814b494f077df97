#!/usr/bin/env python3
"""Whole drives of the virtual car, which write a table: by the autonomous deadman, and by the stick."""
from __future__ import annotations

import os
import random
import shutil

import rospy
import rostest

from calibration_person import DriveTest, StickPerson, shown
from waiting import PACKAGE, NodeProcess, eventually, executable, skip

WHOLE_S = 900


class WholeDrive(DriveTest):
    def setUp(self):
        if not os.environ.get("CAR_INTERFACE_ALL"):
            skip(self, "a drive of some minutes: ./dev test --all")
        super().setUp()
        shutil.copy(os.path.join(PACKAGE, "config", "turn_arb.yaml"), self.table)
        with open(self.table, encoding="utf-8") as file:
            self.old_text = file.read()
        self.drive_to(0.0, 0.0)  # as the person is told to: with enough floor around it

    def drive(self, is_over):
        """Hold the deadman until it is over."""
        def step():
            self.hold_anew()
            return is_over()
        eventually(step, lambda: f"the end; {self.newest()}", WHOLE_S)
        self.press(None)

    def check_old(self, lines, path):
        """The table that was there is kept beside the one that was written to a path."""
        written = next(line for line in lines if line.startswith(f"written: {path}"))
        backup = written.partition("; the old one is ")[2]
        with open(backup, encoding="utf-8") as file:
            self.assertEqual(file.read(), self.old_text)

    def check_recording(self, lines):
        """The recording makes a table by calibrate_steering, too."""
        bag = next(line.partition(": ")[2] for line in lines if line.startswith("recording: "))
        made = os.path.join(self.folder, "made.yaml")
        process = NodeProcess(executable("calibrate_steering"), bag, "-o", made, "--base", self.table)
        self.addCleanup(process.clean_up)
        self.assertEqual(process.wait_for_exit(), 0, process.stderr.since())
        self.check_table(made)


class Autonomous(WholeDrive):
    def test_table_is_replaced_after_a_question_and_the_car_turns_as_it_says(self):
        terminal = self.begin()
        self.drive(lambda: any(shown(line).startswith("Replace ") for line in terminal.lines.since()))
        terminal.type(b"y")
        lines = self.ended(terminal, 0)
        self.check_old(lines, self.table)
        self.check_table(self.table)
        self.check_recording(lines)
        self.assertTrue([line for line in lines if line.startswith("the servo board centers the steering by")], lines)

    def test_without_a_terminal_the_table_is_written_beside_the_old_one(self):
        process = NodeProcess(executable("calibration_drive"), "-o", self.table)
        self.addCleanup(process.clean_up)
        process.wait_for_info("waiting: no deadman is held; hold the autonomous deadman and it begins")
        self.drive(lambda: not process.runs())
        self.assertEqual(process.wait_for_exit(), 0, process.stderr.since())
        beside = os.path.join(self.folder, "turn_arb.new.yaml")
        self.assertIn(f"{self.table} is as it was. To take the new one: mv {beside} {self.table}",
                      process.stdout.since())
        with open(self.table, encoding="utf-8") as file:
            self.assertEqual(file.read(), self.old_text)
        self.check_table(beside)


class ByTheStick(WholeDrive):
    """After the others: it ends near a wall now and then."""

    def test_person_with_the_stick_gets_a_table_and_no_question_with_yes(self):
        terminal = self.start("-o", self.table, "--stick", "--yes")
        self.wait_for_line(terminal, "^no deadman is held; hold the manual deadman")
        person = StickPerson(self, random.Random(1))

        def is_over():
            person.step()
            lines = [shown(line) for line in terminal.lines.since()[-30:]]
            if any(line.startswith("nothing is missing; ") for line in lines):
                terminal.type(b"f")
            return any("You can let go. Calibrating" in line for line in lines)
        eventually(is_over, lambda: f"the end; {self.newest()}", WHOLE_S)
        self.press(None)
        lines = self.ended(terminal, 0)
        self.check_old(lines, self.table)
        self.check_table(self.table, 0.15)  # ended as soon as the tool refuses nothing any more
        self.assertEqual((self.requests.since(), self.speeds.since()), ([], []))


if __name__ == "__main__":
    rospy.init_node("calibration_drive_whole_test")
    rostest.rosrun("car_interface", "calibration_drive_whole_test", "__main__")
