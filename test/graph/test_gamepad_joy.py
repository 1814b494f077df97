"""gamepad_joy and teleop_logi, with a named pipe that carries a gamepad's events."""
from __future__ import annotations

import os
import struct

import pytest
from sensor_msgs.msg import Joy

from car import Car
from car_interface.common import causes
from car_interface.nodes.gamepad_joy import GamepadJoy
from graph import NS_PER_S

BUTTON, AXIS, INIT = 1, 2, 0x80  # linux/joystick.h
LB = 4  # as config/teleop_logi.yaml has it


class Pad:
    """gamepad_joy, and its gamepad, which can be plugged in and out."""

    def __init__(self, tmp_path, **parameters):
        self.car, self.path, self._fd = Car(), str(tmp_path / "js0"), None
        self.graph = self.car.graph
        self.graph.record("/joy")
        self.parameters = {"dev": self.path, **parameters}

    def start(self):
        self.node = self.graph.add(GamepadJoy, "gamepad_joy", self.parameters)
        self.graph.run(0.1)
        return self

    def plug_in(self, *held):
        os.mkfifo(self.path)
        reader = os.open(self.path, os.O_RDONLY | os.O_NONBLOCK)
        self._fd = os.open(self.path, os.O_WRONLY)
        self.send(*((0, AXIS | INIT, number) for number in range(8)),
                  *((int(number in held), BUTTON | INIT, number) for number in range(11)), run_s=0.6)
        os.close(reader)
        return self

    def send(self, *events, run_s=0.03):
        os.write(self._fd, b"".join(struct.pack("=IhBB", 1234, *event) for event in events))
        self._wake()
        self.graph.run(run_s)

    def unplug(self):
        os.unlink(self.path)
        os.close(self._fd)
        self._wake()

    def _wake(self):
        if hasattr(self, "node") and self.node.node._device is not None:
            self.graph.readable(self.node.node._device.fileno())

    @property
    def joy(self) -> Joy:
        return self.graph.newest("/joy")

    def device(self):
        """Run for 1.2 s; return level and text of the device's report."""
        self.graph.run(1.2)
        report = self.graph.report("gamepad_joy: gamepad device")
        return report.level, report.message


def test_deadman_counts_until_it_is_released_or_the_gamepad_is_unplugged(tmp_path):
    pad = Pad(tmp_path).plug_in().start()
    pad.graph.record("/teleop_logi/human_in_loop")
    pad.car.teleop()
    pad.graph.run(1.0)
    assert (list(pad.joy.axes), list(pad.joy.buttons)) == ([0.0] * 8, [0] * 11)
    assert pad.graph.newest("/teleop_logi/state").cause == causes.NO_DEADMAN

    def human():
        return pad.graph.newest("/teleop_logi/human_in_loop").data
    for pressed in (1, 0, 1):
        pad.send((pressed, BUTTON, LB))
        assert human() == bool(pressed)
    at_ns = pad.graph.now_ns
    pad.unplug()
    gone_ns = pad.graph.run_until(lambda: not human())
    assert gone_ns - at_ns <= NS_PER_S // 4 + 1
    pad.plug_in(LB)  # with the button held: it must be released first
    assert pad.joy.buttons[LB] == 1
    pad.graph.run(1.0)
    assert pad.graph.newest("/teleop_logi/state").joy_age < 0.1 and not human()
    pad.send((0, BUTTON, LB))
    pad.send((1, BUTTON, LB))
    assert human()


def test_axes_are_published_together_buttons_at_once_and_the_state_at_the_asked_rate(tmp_path):
    pad = Pad(tmp_path, coalesce_interval=0.05, autorepeat_rate=5, deadzone=0.1).plug_in().start()
    pad.graph.run(1.07)
    at_ns = pad.graph.now_ns
    pad.send((-32767, AXIS, 0), run_s=0.03)
    pad.send((16384, AXIS, 4), run_s=0.1)
    (record,) = [record for record in pad.graph.recorded["/joy"] if any(record.message.axes)]
    assert record.at_ns - at_ns == 50_000_000
    axes = record.message.axes
    assert (axes[0], axes[4]) == (1.0, pytest.approx(-0.444, abs=1e-3))  # (0.5 − 0.1) / 0.9
    assert (record.message.header.frame_id, record.message.header.stamp.to_nsec()) == (
        pad.path, record.at_ns + pad.graph.ros_ahead_ns)
    at_ns = pad.graph.now_ns
    pad.send((1, BUTTON, LB))
    assert pad.graph.recorded["/joy"][-1].at_ns == at_ns and pad.joy.buttons[LB]
    pad.graph.run(2.0)
    times_ns = [each.at_ns for each in pad.graph.recorded["/joy"] if each.at_ns >= at_ns]
    assert {after - before for before, after in zip(times_ns, times_ns[1:])} == {NS_PER_S // 5}


def test_nothing_is_published_while_there_is_no_gamepad_and_the_log_and_diagnostics_say_what_to_do(tmp_path):
    pad = Pad(tmp_path).start()
    text = (f"{pad.path}: there is no such device. Plug in the gamepad or its receiver, then ls /dev/input/js*; "
            "another one: joy_device:=/dev/input/js1. None at all: sudo modprobe joydev")
    assert pad.device() == (2, text)
    (line,) = pad.graph.lines("/gamepad_joy", level=30)
    assert line.startswith(text) and pad.graph.recorded["/joy"] == []
    pad.plug_in()
    assert f"gamepad on {pad.path}: no gamepad, but a program that writes its events" in pad.graph.lines("/gamepad_joy")
    assert pad.device() == (0, "no gamepad, but a program that writes its events: 8 axes, 11 buttons")
    pad.unplug()
    pad.graph.run(0.1)
    at_ns = pad.graph.now_ns
    level, text = pad.device()
    assert (level, pad.graph.messages("/joy", at_ns), pad.node.is_alive) == (2, [], True)
    assert "the gamepad is gone" in " ".join(pad.graph.lines("/gamepad_joy", level=30))


def test_device_that_is_no_joystick_is_refused(tmp_path):
    pad = Pad(tmp_path, dev="/dev/zero").start()  # its bytes would be events
    assert pad.device() == (2, ("/dev/zero: it is no joystick. A gamepad is /dev/input/js0 or the like, not .../event*"
                                ": ls /dev/input/js*"))
    assert pad.graph.recorded["/joy"] == []
