#!/usr/bin/env python3
"""keyboard_drive on terminals of its own: it drives the virtual car, and what lets go of the keys stops the car."""
from __future__ import annotations

import os
import shutil
import signal
import struct
import tempfile
import threading
import time
import unittest

import rospy
import rostest
from car_interface.msg import SteeringState
from nav_msgs.msg import Odometry
from sensor_msgs.msg import Joy
from std_msgs.msg import Bool

from terminal import Terminal
from waiting import Sender, Topic, delete_param, eventually, executable, rate_hz, retried, set_params, start

STEER, THROTTLE, MANUAL, AUTONOMOUS = 0, 4, 4, 5  # as config/teleop_logi.yaml has them
HOLD_S = 0.7
REPEAT_DELAY_S, REPEAT_S = 0.5, 0.033  # of a key on a desktop
READY = "To drive: "
EVENT = struct.Struct("@llHHi")  # struct input_event
CODE_M = 50
# The ioctl by which a keyboard is known fails on a named pipe: here it says that each of them is one.
EVERY_PIPE_IS_A_KEYBOARD = """
import fcntl, stat, os
real = fcntl.ioctl
def ioctl(fd, request, *arguments):
    if request == 0x80604521 and stat.S_ISFIFO(os.fstat(fd).st_mode):
        return bytes([255] * 96)
    return real(fd, request, *arguments)
fcntl.ioctl = ioctl
"""


class Hand:
    """Holds one key of a terminal, which repeats as on a desktop."""

    def __init__(self, terminal, key):
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._run, args=(terminal, key), daemon=True)
        self._thread.start()

    def _run(self, terminal, key):
        terminal.type(key)
        pause_s = REPEAT_DELAY_S
        while not self._ending.wait(pause_s):
            terminal.type(key)
            pause_s = REPEAT_S

    def let_go(self):
        self._ending.set()
        self._thread.join()


class KeyboardTest(unittest.TestCase):
    def start(self, *arguments, env=None):
        terminal = Terminal(executable("keyboard_drive"), *arguments, env=env)
        self.addCleanup(terminal.clean_up)
        return terminal

    def hold(self, terminal, key):
        hand = Hand(terminal, key)
        self.addCleanup(hand.let_go)
        return hand

    def start_elsewhere(self, place, device="virtual", arguments=(), **params):
        """One with parameters of its own; its terminal and what it publishes."""
        set_params(self, f"/{place}/pca9685", {"device": device})
        set_params(self, f"/{place}/teleop_logi", params)
        joy = Topic(f"/{place}/joy", Joy)
        self.addCleanup(joy.close)
        terminal = self.start(f"__ns:=/{place}", *arguments)
        terminal.wait_for_line(READY)
        joy.connected()
        return terminal, joy

    def wait_for_button(self, joy, held, button=MANUAL):
        return joy.wait_for(lambda message: message.buttons[button] == held, joy.mark())

    def refusal(self, *arguments):
        """The one line of a node that ends at once."""
        terminal = self.start(*arguments)
        self.assertEqual(terminal.wait_for_exit(), 1)
        lines = [line for line in terminal.lines.since() if line]
        self.assertEqual(len(lines), 1, lines)
        return lines[0]


class VirtualCar(KeyboardTest):
    def setUp(self):
        self.human = Topic("/teleop_logi/human_in_loop", Bool).connected()
        self.truth = Topic("/car_sim/truth", Odometry).connected()
        self.states = Topic("/turn_arb/state", SteeringState).connected()
        for topic in (self.human, self.truth, self.states):
            self.addCleanup(topic.close)

    def wait_for_human(self, present):
        return self.human.wait_for(lambda message: message.data is present, self.human.mark())

    def test_car_is_driven_and_let_go_of(self):
        terminal = self.start()
        for line in ("M +deadman: you drive", "W A S D .*faster, left, slower, right", "space +let go of everything",
                     READY):
            terminal.wait_for_line(line)
        terminal.wait_for_line("^NO_HUMAN: human_in_loop is false: no deadman is held")
        deadman = self.hold(terminal, b"m")
        self.wait_for_human(True)
        terminal.wait_for_line("^TELEOP: tele_steer_req")
        deadman.let_go()
        faster = self.hold(terminal, b"w")
        self.truth.wait_for(lambda truth: truth.twist.twist.linear.x > 0.5, self.truth.mark())
        faster.let_go()
        left = self.hold(terminal, b"\x1b[D")
        self.states.wait_for(lambda state: state.source == SteeringState.TELEOP and state.duty == 3800,
                             self.states.mark())
        self.truth.wait_for(lambda truth: truth.twist.twist.angular.z > 0.3, self.truth.mark())
        left.let_go()
        let_go_s = time.monotonic()
        self.assertLess(self.wait_for_human(False).at_s - let_go_s, HOLD_S + 0.3)
        terminal.wait_for_line("^NO_HUMAN: human_in_loop is false: no deadman is held", terminal.lines.mark() - 1)
        terminal.type(b"q")
        self.assertEqual(terminal.wait_for_exit(), 0)

    def test_space_stops_at_once(self):
        terminal = self.start()
        terminal.wait_for_line("no deadman is held")  # a key that is held before teleop_logi hears of it doesn't count

        def attempt():
            hand = self.hold(terminal, b"m")
            self.wait_for_human(True)
            hand.let_go()
            terminal.type(b"m")
            pressed_s = time.monotonic()
            terminal.type(b" ")
            self.assertLess(self.wait_for_human(False).at_s - pressed_s, 0.3)
        retried(attempt)

    def test_second_publisher_of_joy_is_refused_by_name(self):
        gamepad = Sender("/joy", Joy)
        self.addCleanup(gamepad.close)
        line = self.refusal()
        self.assertIn(f"{rospy.get_name()} publishes /joy already. End it first: rosnode kill {rospy.get_name()}", line)


class Elsewhere(KeyboardTest):
    def test_joy_comes_at_50_hz_with_the_axes_and_buttons_of_teleop_logi(self):
        terminal, joy = self.start_elsewhere("other", steer_axis=2, throttle_axis=9, manual_button=12,
                                             autonomous_button=1, steer_scale=-1.0)
        retried(lambda: self.assertAlmostEqual(rate_hz(joy, over_s=1.0), 50, delta=3))
        terminal.type(b"ma")
        left = joy.wait_for(lambda message: message.axes[2] == -1.0).what
        self.assertEqual((len(left.axes), len(left.buttons)), (10, 13))
        self.assertEqual([index for index, held in enumerate(left.buttons) if held], [12])
        self.wait_for_button(joy, 0, button=12)
        terminal.type(b"pw")
        forward = joy.wait_for(lambda message: message.axes[9] == 1.0, joy.mark()).what
        self.assertEqual([index for index, held in enumerate(forward.buttons) if held], [1])

    def test_key_counts_for_0_7_s(self):
        terminal, joy = self.start_elsewhere("short")

        def attempt():
            self.wait_for_button(joy, 0)
            mark = joy.mark()
            terminal.type(b"m")
            held = joy.wait_for(lambda message: message.buttons[MANUAL], mark)
            released = joy.wait_for(lambda message: not message.buttons[MANUAL], joy.mark())
            self.assertAlmostEqual(released.at_s - held.at_s, HOLD_S, delta=0.1)
        retried(attempt)

    def test_terminal_is_restored_however_it_ends(self):
        for ending in ("q", "ctrl-c", "SIGTERM", "SIGHUP", "a fault"):
            with self.subTest(ending):
                terminal, _ = self.start_elsewhere("restored")
                self.assertNotEqual(terminal.settings(), terminal.settings_before)
                if ending == "a fault":
                    rospy.set_param("/restored/pca9685/device", "/dev/i2c-1")
                elif ending.startswith("SIG"):
                    os.kill(terminal.pid, getattr(signal, ending))
                else:
                    terminal.type({"q": b"q", "ctrl-c": b"\x03"}[ending])
                eventually(lambda terminal=terminal: terminal.settings() == terminal.settings_before, "the settings")
                self.assertEqual(terminal.wait_for_exit(), int(ending == "a fault"))
                self.assertNotIn("Traceback", "\n".join(terminal.lines.since()))

    def test_car_that_becomes_real_ends_it(self):
        terminal, joy = self.start_elsewhere("changing")
        self.hold(terminal, b"m")
        self.wait_for_button(joy, 1)
        mark = joy.mark()
        rospy.set_param("/changing/pca9685/device", "/dev/i2c-1")
        self.assertEqual(terminal.wait_for_exit(), 1)
        terminal.wait_for_line("pca9685's device was virtual when this node started and is /dev/i2c-1 now")
        eventually(lambda: joy.since(mark)[-1].buttons[MANUAL] == 0, "the release")

    def test_background_lets_go_and_foreground_goes_on(self):
        set_params(self, "/job/pca9685", {"device": "virtual"})
        joy = Topic("/job/joy", Joy)
        self.addCleanup(joy.close)
        shell = Terminal("bash", "--norc", "--noprofile", "-i")
        self.addCleanup(shell.clean_up)
        shell.type(f"{executable('keyboard_drive')} __ns:=/job\n".encode())
        shell.wait_for_line(READY)
        joy.connected()
        hand = self.hold(shell, b"m")
        self.wait_for_button(joy, 1)
        shell.type(b"\x1a")
        shell.wait_for_line("Stopped")
        hand.let_go()
        mark = joy.mark()
        shell.type(b"\x15bg\n")  # Ctrl-U: what the hand has typed into the shell
        messages = joy.wait_for_count(30, mark)
        self.assertEqual({message.buttons[MANUAL] for message in messages[3:]}, {0})
        mark = joy.mark()
        shell.type(b"mmm\x15")
        self.assertEqual({message.buttons[MANUAL] for message in joy.wait_for_count(30, mark)}, {0})
        shell.type(b"fg\n")
        shell.wait_for_line("keyboard_drive __ns", shell.lines.mark() - 1)
        self.hold(shell, b"m")
        self.wait_for_button(joy, 1)

    def test_without_a_terminal_it_is_refused(self):
        set_params(self, "/pipe/pca9685", {"device": "virtual"})
        process = start(self, executable("keyboard_drive"), "__ns:=/pipe")
        self.assertEqual(process.wait_for_exit(), 1)
        (line,) = process.stderr.since()
        self.assertIn("no terminal to read keys from: start it by rosrun in a terminal of its own, not by roslaunch "
                      "and not in the background", line)

    def test_real_car_without_a_keyboard_s_events_is_refused(self):
        set_params(self, "/real/pca9685", {"device": "/dev/i2c-1"})
        line = self.refusal("__ns:=/real", "_input_devices:=none")
        self.addCleanup(delete_param, "/real/keyboard_drive")
        self.assertIn("/real/pca9685/device is /dev/i2c-1, a real servo board, and no keyboard can be read (none): a "
                      "terminal doesn't say when a key is released. Drive by gamepad; or, with a keyboard on this "
                      "computer: rosrun car_interface setup_hardware", line)

    def test_without_a_car_it_is_refused_with_what_to_type(self):
        self.assertIn("there is no /empty/pca9685/device: no car, or it is in another namespace (ROS_NAMESPACE). Start "
                      "the virtual car first: roslaunch car_interface demo.launch drive:=false",
                      self.refusal("__ns:=/empty", "_input_devices:=none"))
        delete_param("/empty/keyboard_drive")


class RealCarWithAKeyboard(KeyboardTest):
    """The kernel's events come from a named pipe."""

    def setUp(self):
        folder = tempfile.mkdtemp()
        self.addCleanup(shutil.rmtree, folder)
        with open(os.path.join(folder, "sitecustomize.py"), "w", encoding="ascii") as file:
            file.write(EVERY_PIPE_IS_A_KEYBOARD)
        pipe = os.path.join(folder, "event0")
        os.mkfifo(pipe)
        reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
        self.kernel = os.open(pipe, os.O_WRONLY)
        self.addCleanup(lambda: self.kernel is not None and os.close(self.kernel))
        os.set_blocking(reader, False)
        set_params(self, "/car8/pca9685", {"device": "/dev/i2c-1"})
        self.joy = Topic("/car8/joy", Joy)
        self.addCleanup(self.joy.close)
        self.addCleanup(delete_param, "/car8/keyboard_drive")
        self.terminal = self.start("__ns:=/car8", f"_input_devices:={folder}/event*",
                                   env={"PYTHONPATH": f"{folder}:{os.environ['PYTHONPATH']}"})
        self.terminal.wait_for_line("To drive: hold M")
        os.close(reader)
        self.joy.connected()

    def key(self, value):
        os.write(self.kernel, EVENT.pack(0, 0, 1, CODE_M, value) + EVENT.pack(0, 0, 0, 0, 0))

    def hold_deadman(self):
        self.key(1)
        self.terminal.type(b"m")
        self.wait_for_button(self.joy, 1)

    def test_key_counts_until_its_release(self):
        self.hold_deadman()
        mark = self.joy.mark()
        messages = self.joy.wait_for_count(75, mark)  # 1.5 s
        self.assertEqual({message.buttons[MANUAL] for message in messages}, {1})

        def attempt():
            released_s = time.monotonic()
            self.key(0)
            self.assertLess(self.wait_for_button(self.joy, 0).at_s - released_s, 0.15)
        retried(attempt)

    def test_key_that_another_program_gets_does_not_count(self):
        self.key(1)
        mark = self.joy.mark()
        self.assertEqual({message.buttons[MANUAL] for message in self.joy.wait_for_count(30, mark)}, {0})

    def test_key_of_another_computer_s_keyboard_does_not_count_and_it_says_why(self):
        self.terminal.type(b"m")
        self.terminal.wait_for_line("a key was typed here, but not on a keyboard of this computer: its release can't "
                                    "be seen, so it doesn't count")
        mark = self.joy.mark()
        self.assertEqual({message.buttons[MANUAL] for message in self.joy.wait_for_count(30, mark)}, {0})

    def test_keyboard_that_is_unplugged_lets_go(self):
        self.hold_deadman()
        os.close(self.kernel)
        self.kernel = None
        self.wait_for_button(self.joy, 0)


if __name__ == "__main__":
    rospy.init_node("keyboard_drive_test")
    rostest.rosrun("car_interface", "keyboard_drive_test", "__main__")
