"""The keyboard_drive node: drives by the keys of a terminal, as a gamepad does.

It is started by hand, in a terminal of its own, and prints its keys. It publishes what a gamepad's driver would, for
the axes and buttons that teleop_logi is set to; deadman, re-arming and e-stop are as with a gamepad. While it is not in
the terminal's foreground nothing is held.

A terminal doesn't say when a key is released. Where this computer's keyboards can be read (/dev/input/event*, the group
input) they say it, and any car can be driven. Otherwise a key counts for 0.7 s after it was last seen, and only a
virtual car is driven (pca9685's ~device is ``virtual``).

Publishes, at 50 Hz:
    joy (sensor_msgs/Joy).
Subscribes, for its screen; without a terminal to draw on it prints who steers and why when that changes:
    turn_arb/state (SteeringState), throttle_arb/state (ThrottleState), sonar/… (Range).
    car_sim/collisions (std_msgs/Int32): of a virtual car.
"""
from __future__ import annotations

import glob
import math
import re
import select
import textwrap
from contextlib import suppress
from typing import Any, Callable, Mapping

import rospy
from evdev import InputDevice, ecodes
from sensor_msgs.msg import Joy, Range
from std_msgs.msg import Int32

from car_interface.common import causes
from car_interface.common.declared import read, read_all
from car_interface.common.errors import CarInterfaceError
from car_interface.common.params import Params
from car_interface.common.rate_timer import RateTimer
from car_interface.common.sources import source_name
from car_interface.common.units import NS_PER_S
from car_interface.common.vehicle_geometry import SONARS
from car_interface.msg import SteeringState, ThrottleState
from car_interface.nodes.terminal import Keys, LiveText
from car_interface.ros.runtime import run
from car_interface.ros.topics import advertise, listen
from car_interface.teleop.keyboard import QUIT, Controls, Keyboard, KeyboardConfig, KeyReader, help_text
from car_interface.teleop.mappings import KEYBOARD_FRAME

RATE_HZ, TICKS_PER_SCREEN = 50, 10
STATE_TIMEOUT_S, RANGE_TIMEOUT_S = 1.0, 1.5
FREE_MPS = 0.15  # a car that is faster has left the wall that it hit
AXES, BUTTONS = 8, 11  # at least: as many as the shipped gamepad has
VIRTUAL, NO_DEVICES = "virtual", "none"
WATCH_NS = NS_PER_S  # how often pca9685's device is looked at
HELD_UP_NS = NS_PER_S // 4  # after such a pause, Ctrl-Z for one, keys must be pressed anew
NUMBER = re.compile(r"[-+]?\d[\d.]*")
RELEASED, PRESSED = 0, 1  # values of EV_KEY; 2 is a repeat
# Whatever has these is a keyboard, not a power button or a mouse.
LETTERS_AND_SPACE = {*range(ecodes.KEY_Q, ecodes.KEY_P + 1), ecodes.KEY_SPACE}
NEAR_M = 1.0
BACK_OUT = "you hit a wall. To back out: hold S; then M alone for a second; then S again"
UNLOCK = "the e-stop is on. To end it: rostopic pub -r 10 /e_stop std_msgs/Bool false"
REVERSE = "it stands. To reverse: hold M alone for a second, then S again"
ADVICE = {**dict.fromkeys(causes.LOCKS, UNLOCK), causes.HUMAN_ABSENT: "hold M to drive, P to let the planner drive",
          causes.NOT_REARMED: "let go of all keys, then hold M or P again"}
NO_REVERSE = frozenset({causes.AT_STANDSTILL, causes.HOLDING})


class Keyboards:
    """The keyboards that this process may read: presses and releases, whichever program the keys are meant for.

    Args:
        pattern: of the paths of input devices.
    """

    def __init__(self, pattern: str, open_device: Callable = InputDevice):
        self._devices = []
        for path in sorted(glob.glob(pattern)):
            with suppress(OSError):  # it may not be read
                device = open_device(path)
                if LETTERS_AND_SPACE.issubset(device.capabilities().get(ecodes.EV_KEY, ())):
                    self._devices.append(device)
                else:
                    device.close()

    def __len__(self) -> int:
        return len(self._devices)

    def read(self) -> list[tuple[int, bool]] | None:
        """Return each (code, is pressed) since the last call; ``None`` = some were lost or a keyboard was unplugged."""
        events, was_lost = [], False
        for device in list(self._devices):
            try:
                # Before version 1.4, which Ubuntu 20.04 lacks, evdev loses memory with each read that finds nothing.
                while select.select([device.fd], [], [], 0)[0]:
                    news = list(device.read())
                    if not news:
                        raise OSError("it was unplugged")
                    events += news
            except BlockingIOError:
                continue
            except OSError:
                device.close()
                self._devices.remove(device)
                was_lost = True
        if was_lost or any(event.type == ecodes.EV_SYN and event.code == ecodes.SYN_DROPPED for event in events):
            return None
        return [(event.code, event.value == PRESSED) for event in events
                if event.type == ecodes.EV_KEY and event.value in (RELEASED, PRESSED)]

    def close(self) -> None:
        for device in self._devices:
            device.close()
        self._devices.clear()


class KeyboardDrive:
    """Reads the keys and publishes joy.

    Args:
        keys: of the terminal; ``None`` = of the one that the node runs in.
        make_keyboards: called with a pattern of paths, as ``Keyboards``.
        text: draws on the terminal; ``None`` = on this process's.
    """

    def __init__(self, params, inbox, keys=None, make_keyboards=Keyboards, text=None):
        teleop_logi = Params(inbox.graph.parameter("teleop_logi", {}))
        self._config = read_all(params, KeyboardConfig, default=read(teleop_logi, KeyboardConfig))
        self._inbox, self._clocks = inbox, inbox.clocks
        self._device = inbox.graph.parameter("pca9685/device", None)
        devices = self._config.input_devices
        self._keyboards = make_keyboards("" if devices == NO_DEVICES else devices)
        _check_can_drive(inbox, devices, self._device, len(self._keyboards) > 0)
        now_ns = self._clocks.now_ns()
        self._timer = RateTimer(RATE_HZ, now_ns)
        self._stepped_ns = now_ns
        self._reader = KeyReader()
        self._keyboard = Keyboard(counts_without_release=self._device == VIRTUAL)
        self._was_warned = False
        self._joy = advertise("joy", Joy, inbox)
        self._text = text or LiveText()
        self._shown = self._seen = ""  # who steers, and why: as it was printed, and as it was at the last look
        self._steering = listen("turn_arb/state", SteeringState, inbox, STATE_TIMEOUT_S)
        self._throttle = listen("throttle_arb/state", ThrottleState, inbox, STATE_TIMEOUT_S)
        self._ranges = {name: listen(f"sonar/{name}", Range, inbox, RANGE_TIMEOUT_S) for name in SONARS}
        self._collisions = listen("car_sim/collisions", Int32, inbox, 0)
        self._hits, self._is_blocked, self._has_stood = 0, False, False
        self._keys = keys or Keys()
        if not self._keys.start():
            raise CarInterfaceError("no terminal to read keys from: start it by rosrun in a terminal of its own, not "
                                    "by roslaunch and not in the background")
        self._text.say(help_text(len(self._keyboards) > 0))
        self._watch_ns = now_ns + WATCH_NS  # when the device is looked at; inf: it is just being looked at

    def step(self, now_ns):
        """Read the keys; publish when it is time."""
        self._inbox.dispatch()
        if now_ns >= self._watch_ns:
            self._watch_ns = math.inf
            self._inbox.work(self._look_at_device, self._on_device)
        if self._timer.is_due(now_ns):
            self._read_keys(now_ns)
            self._publish(self._keyboard.controls(now_ns))
            if self._timer.ticks % TICKS_PER_SCREEN == 0:
                self._show(now_ns)
        return self._timer.due_ns

    def shut_down(self):
        self._keys.restore()
        self._keyboards.close()
        self._publish(Controls())

    def _read_keys(self, now_ns):
        typed = self._keys.read()  # before the keyboards: whatever was typed by now was pressed before
        events = self._keyboards.read()
        was_held_up = now_ns - self._stepped_ns > HELD_UP_NS
        self._stepped_ns = now_ns
        if typed is None or events is None or was_held_up:
            self._keyboard.release_all()
            if self._keys.is_closed():
                raise CarInterfaceError("its terminal was closed")
            return
        for code, is_pressed in events:
            (self._keyboard.press if is_pressed else self._keyboard.release)(code, now_ns)
        for key in self._reader.feed(typed):
            if key == QUIT:
                self._inbox.end()
            elif not self._keyboard.type(key, now_ns) and not self._was_warned:
                self._was_warned = True
                rospy.logwarn("a key was typed here, but not on a keyboard of this computer: its release can't be "
                              "seen, so it doesn't count. Use a keyboard of the computer that this runs on, or a "
                              "gamepad")

    def _publish(self, controls):
        config = self._config
        axes = {config.steer_axis: math.copysign(1.0, config.steer_scale) * controls.steering,
                config.throttle_axis: math.copysign(1.0, config.throttle_scale) * controls.throttle}
        buttons = ((config.manual_button, controls.manual), (config.autonomous_button, controls.autonomous),
                   (config.faster_button, controls.scale == 1), (config.slower_button, controls.scale == -1))
        held = {button for button, is_held in buttons if is_held}
        message = Joy(axes=[axes.get(index, 0.0) for index in range(max(AXES, *(axis + 1 for axis in axes)))],
                      buttons=[int(index in held) for index in range(max(BUTTONS, *(each + 1 for each, _ in buttons)))])
        message.header.stamp, message.header.frame_id = self._clocks.ros_now(), KEYBOARD_FRAME
        self._joy.publish(message)

    def _show(self, now_ns):
        """Draw the screen; without one print who steers, once it stays so: the reason comes a moment after it."""
        steering, throttle = self._steering.fresh(now_ns), self._throttle.fresh(now_ns)
        if self._text.is_live:
            self._notice_wall(throttle)
            ranges_m = {name: each.value.range for name, each in self._ranges.items() if not each.is_stale(now_ns)}
            self._text.show(screen_lines(steering, throttle, ranges_m, self._is_blocked, self._text.width))
        elif steering is not None:
            text = f"{source_name(steering.source)}: {steering.reason}"
            kind = NUMBER.sub("", text)
            if kind == self._seen != self._shown:
                self._shown = kind
                print(text, flush=True)
            self._seen = kind

    def _notice_wall(self, throttle):
        """Notice that the virtual car ran into something, and that it has left it."""
        before, self._hits = self._hits, self._collisions.value.data if self._collisions.was_received else 0
        if self._hits > before:
            self._is_blocked, self._has_stood = True, False
        # For a while after it hit something, too: the wheels' speed falls late.
        moves = throttle is not None and abs(throttle.speed) > FREE_MPS
        self._is_blocked = self._is_blocked and not (moves and self._has_stood)
        self._has_stood = self._has_stood or not moves

    def _look_at_device(self):
        try:
            return self._inbox.graph.parameter("pca9685/device", self._device)
        except Exception:  # the master is gone: no node can start either
            return self._device

    def _on_device(self, device, now_ns):
        """Notice when a virtual car was replaced by a real one on the same master."""
        self._watch_ns = now_ns + WATCH_NS
        if device != self._device:
            raise CarInterfaceError(f"pca9685's device was {self._device} when this node started and is {device} now: "
                                    "start it again")


def _check_can_drive(inbox, devices, device, has_keyboard):
    """Refuse to be a second one, each of which would undo what the other holds, and a car whose keys end unseen.

    Raises:
        CarInterfaceError: with the remedy.
    """
    graph, joy, name = inbox.graph, inbox.resolve_name("joy"), inbox.resolve_name("pca9685/device")
    others = [node for node in graph.publishers(joy) if node != graph.process_name()]
    if others:
        raise CarInterfaceError(f"{others[0]} publishes {joy} already. End it first: rosnode kill {others[0]}; or "
                                "rosnode cleanup, if it is dead. A demo has no drive of its own by drive:=false")
    if has_keyboard or device == VIRTUAL:
        return
    if device is None:
        raise CarInterfaceError(f"there is no {name}: no car, or it is in another namespace (ROS_NAMESPACE). Start the "
                                "virtual car first: roslaunch car_interface demo.launch drive:=false")
    raise CarInterfaceError(f"{name} is {device}, a real servo board, and no keyboard can be read ({devices}): a "
                            "terminal doesn't say when a key is released. Drive by gamepad; or, with a keyboard on "
                            "this computer: rosrun car_interface setup_hardware")


def screen_lines(steering: Any, throttle: Any, ranges_m: Mapping[str, float], is_blocked: bool,
                 columns: int) -> list[str]:
    """Return how the car drives, who drives it and why, what is near, and what to do next.

    Args:
        steering, throttle: the arbiters' newest states; ``None`` = silent.
        ranges_m: the newest of each sonar, by its name.
        is_blocked: the virtual car stands at what it ran into.
        columns: of the terminal.
    """
    lines = []
    if throttle is not None:
        speed = "unknown" if math.isnan(throttle.speed) else f"{throttle.speed:.2f} m/s"
        cut = f", cut: {throttle.limit_reason}" if throttle.limit in causes.THROTTLE_CUTS else ""
        lines.append(f"speed {speed}   throttle {throttle.granted:.2f} of {throttle.asked:.2f} asked{cut}   "
                     f"scale {throttle.human_scale:.1f}   mode {throttle.mode or 'none'}")
        lines.append(f"drives: {source_name(throttle.source)}, {throttle.reason}")
        if throttle.esc_reason:
            lines.append(f"ESC:    {throttle.esc}, {throttle.esc_reason}")
    if steering is not None:
        lines.append(f"steers: {source_name(steering.source)}, {steering.reason}")
    near = sorted((range_m, name) for name, range_m in ranges_m.items() if range_m < NEAR_M)
    lines += ["near:   " + (", ".join(f"{name.replace('_', ' ')} {max(0.0, range_m):.2f} m" for range_m, name in near)
                            or f"nothing within {NEAR_M:g} m"),
              f"--> {_advice(steering, throttle, is_blocked)}"]
    return [part for line in lines for part in textwrap.wrap(line, max(20, columns - 1), subsequent_indent="        ")]


def _advice(steering, throttle, is_blocked):
    for state in (steering, throttle):
        if state is not None and state.cause in ADVICE:
            return ADVICE[state.cause]
    if steering is None or throttle is None:
        return "the car is silent: does it run?"
    return next(advice for holds, advice in (
        (is_blocked, BACK_OUT), (throttle.mode == causes.AUTONOMOUS, "let go of P to stop"),
        (throttle.asked < 0 and throttle.esc_cause in NO_REVERSE, REVERSE), (True, "let go of M to stop")) if holds)


def main():
    run("keyboard_drive", KeyboardDrive)
