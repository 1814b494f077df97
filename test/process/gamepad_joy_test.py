#!/usr/bin/env python3
"""gamepad_joy, launched as an owner on Debian does, with a pseudo-terminal that writes a gamepad's events."""
from __future__ import annotations

import os
import shutil
import struct
import tempfile
import tty
import unittest

import rospy
import rostest
from car_interface.msg import TeleopState
from diagnostic_msgs.msg import DiagnosticArray
from sensor_msgs.msg import Joy
from std_msgs.msg import Bool

from car_interface.common import causes
from waiting import Topic, rate_hz, start, start_node

BUTTON, AXIS, INIT = 1, 2, 0x80  # linux/joystick.h
LB = 4  # as config/teleop_logi.yaml has it


class Pad:
    """A gamepad: a pseudo-terminal behind a link, as /dev/input/js0 appears and vanishes."""

    def __init__(self, path):
        self._path = path
        self._near, self._far = os.openpty()
        tty.setraw(self._far)
        os.symlink(os.ttyname(self._far), path)
        for number in range(8):
            self.send(0, AXIS | INIT, number)
        for number in range(11):
            self.send(0, BUTTON | INIT, number)

    def send(self, value, kind, number):
        os.write(self._near, struct.pack("=IhBB", 1234, value, kind, number))

    def unplug(self):
        os.unlink(self._path)
        os.close(self._far)
        os.close(self._near)


class GamepadJoyTest(unittest.TestCase):
    def setUp(self):
        folder = tempfile.mkdtemp(prefix="gamepad_joy_test")
        self.addCleanup(shutil.rmtree, folder)
        self.path = os.path.join(folder, "js0")

    def node(self, ns, *parameters):
        """The node, and its messages."""
        process = start_node(self, "gamepad_joy", f"__ns:={ns}", f"_dev:={self.path}", *parameters)
        joys = Topic(f"/{ns}/joy", Joy)
        self.addCleanup(joys.close)
        return process, joys

    def test_launched_with_teleop_logi_a_deadman_counts_until_it_is_released_or_the_gamepad_is_unplugged(self):
        pad = Pad(self.path)
        human = Topic("/debian/teleop_logi/human_in_loop", Bool)
        states = Topic("/debian/teleop_logi/state", TeleopState)
        launch = start(self, "roslaunch", "car_interface", "teleop_logi.launch", "ns:=debian", "gamepad:=true",
                       "joy_driver:=gamepad_joy", f"joy_device:={self.path}")
        self.addCleanup(launch.end)
        human.wait_for(lambda message: not message.data, within_s=30)
        # A deadman that is held when teleop_logi first hears the gamepad doesn't count.
        states.wait_for(lambda message: message.cause == causes.NO_DEADMAN)
        joys = Topic("/debian/joy", Joy).connected()
        at_rest = joys.wait_for(lambda message: True).what
        self.assertEqual((list(at_rest.axes), list(at_rest.buttons)), ([0.0] * 8, [0] * 11))
        pad.send(1, BUTTON, LB)
        human.wait_for(lambda message: message.data)
        pad.send(0, BUTTON, LB)
        human.wait_for(lambda message: not message.data, human.mark())
        pad.send(1, BUTTON, LB)
        human.wait_for(lambda message: message.data, human.mark())
        mark = human.mark()
        pad.unplug()
        human.wait_for(lambda message: not message.data, mark, within_s=5)
        pad = Pad(self.path)  # plugged in again with the button held: it must be released first
        mark = joys.mark()
        pad.send(1, BUTTON | INIT, LB)
        joys.wait_for(lambda message: message.buttons[LB] == 1, mark)
        states.wait_for(lambda message: message.joy_age < 0.1, states.mark())
        mark = human.mark()
        self.assertFalse(any(message.data for message in human.wait_for_count(25, mark)))
        pad.send(0, BUTTON, LB)
        pad.send(1, BUTTON, LB)
        human.wait_for(lambda message: message.data, mark)

    def test_axes_are_published_together_and_the_state_at_the_asked_rate(self):
        pad = Pad(self.path)
        _, joys = self.node("rate", "_coalesce_interval:=0.05", "_autorepeat_rate:=40", "_deadzone:=0.1")
        joys.wait_for(lambda message: len(message.axes) == 8 and len(message.buttons) == 11)
        mark = joys.mark()
        pad.send(-32767, AXIS, 0)
        pad.send(16384, AXIS, 4)
        changed = joys.wait_for(lambda message: any(message.axes), mark).what
        self.assertEqual(changed.axes[0], 1.0)
        self.assertAlmostEqual(changed.axes[4], -0.444, places=3)  # (0.5 − 0.1) / 0.9, forward positive
        self.assertEqual(changed.header.frame_id, self.path)
        self.assertAlmostEqual(rate_hz(joys, 1.0), 40.0, delta=8.0)

    def test_nothing_is_published_while_there_is_no_gamepad_and_the_log_and_diagnostics_say_what_to_do(self):
        diagnostics = Topic("/diagnostics", DiagnosticArray)
        process, joys = self.node("missing")
        line = process.wait_for_line("there is no such device")
        text = (f"{self.path}: there is no such device. Plug in the gamepad or its receiver, then ls /dev/input/js*; "
                "another one: joy_device:=/dev/input/js1. None at all: sudo modprobe joydev")
        self.assertIn(text, line)
        status = diagnostics.wait_for(
            lambda array: any(status.name == "missing/gamepad_joy: gamepad device" for status in array.status)).what
        self.assertEqual([(each.level, each.message) for each in status.status], [(2, text)])
        self.assertEqual(joys.since(), [])
        pad = Pad(self.path)
        joys.wait_for(lambda message: len(message.buttons) == 11)
        process.wait_for_info(f"gamepad on {self.path}")
        pad.unplug()
        process.wait_for_line("the gamepad is gone|there is no such device|Input/output error")
        mark = joys.mark()
        diagnostics.wait_for(lambda array: any(status.level == 2 for status in array.status), diagnostics.mark())
        self.assertEqual(joys.since(mark), [])
        self.assertTrue(process.runs())

    def test_device_that_is_no_joystick_is_refused(self):
        self.path = "/dev/zero"  # its bytes would be events
        process, joys = self.node("wrong")
        self.assertIn("/dev/zero: it is no joystick. A gamepad is /dev/input/js0 or the like, not .../event*: "
                      "ls /dev/input/js*", process.wait_for_line("no joystick"))
        self.assertEqual(joys.since(), [])

    def test_bad_parameter_ends_it_with_one_line(self):
        process, _ = self.node("bad", "_deadzone:=1.5")
        self.assertEqual(process.wait_for_exit(), 1)
        self.assertIn("deadzone is 1.5; accepted: a number from 0 to 0.9", process.wait_for_line("deadzone"))


if __name__ == "__main__":
    rospy.init_node("gamepad_joy_test")
    rostest.rosrun("car_interface", "gamepad_joy_test", "__main__")
