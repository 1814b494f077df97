"""The first_check program: asks a person about a car on a box, one question at a time, and writes what it learned.

It is started by hand, in a terminal of its own, beside a launched car. It steers by a planner's topic, while the
autonomous deadman is held. It gives no throttle: that is the person's stick. Deadman, e-stop, arming and timeouts hold
as for any planner. It writes nothing before it was told to, at the end.

Publishes:
    av_steer_req (std_msgs/Float32): −1 right .. +1 left, at 20 Hz, in the questions on the steering, while the
        autonomous deadman is held.
Subscribes:
    teleop_logi/human_in_loop (std_msgs/Bool), teleop_logi/mode (std_msgs/String), teleop_logi/tele_steer_req,
        teleop_logi/tele_throt_req (std_msgs/Float32), teleop_logi/state (TeleopState), joy (sensor_msgs/Joy).
    turn_arb/state (SteeringState), throttle_arb/state (ThrottleState), servo/output (std_msgs/Int32MultiArray).
    teensy_sensor_hub/link (LinkStatus), teensy_wheel (Wheel), odom (nav_msgs/Odometry), sonar/front_right …
        sonar/rear_left (sensor_msgs/Range).
Calls:
    throttle_arb/servo/set_parameters: in the question on the ESC's neutral, while + or − is typed.
Parameters: none of its own; it reads those of the car's nodes.
"""
from __future__ import annotations

import os
import signal
import textwrap
from functools import partial
from operator import attrgetter
from typing import Any, Callable, Mapping

import rospy
from nav_msgs.msg import Odometry
from sensor_msgs.msg import Joy, Range
from std_msgs.msg import Bool, Float32, Int32MultiArray, String

from car_interface.common.causes import AUTONOMOUS, MANUAL
from car_interface.common.declared import read
from car_interface.common.devices import command_line
from car_interface.common.errors import CarInterfaceError, ConfigError, EndedEarly
from car_interface.common.params import Params
from car_interface.common.rate_timer import RateTimer
from car_interface.common.units import CHANNELS, NS_PER_S
from car_interface.common.vehicle_geometry import PULSES_PER_REVOLUTION, SONARS
from car_interface.msg import LinkStatus, SteeringState, TeleopState, ThrottleState, Wheel
from car_interface.nodes.terminal import Keys, LiveText
from car_interface.ros.clocks import SYSTEM
from car_interface.ros.reconfigure import request_values
from car_interface.ros.runtime import run
from car_interface.ros.topics import advertise, sender_of, subscribe
from car_interface.ros.xmlrpc_calls import call
from car_interface.steering.config import calibration_of
from car_interface.teleop.gamepad import GamepadConfig
from car_interface.teleop.mappings import KEYBOARD_FRAME, Entries, button_label, config_for, load_entries, model_of
from car_interface.throttle.calibration import ThrottleCalibration
from car_interface.throttle.config import load_throttle
from car_interface.tools.first_check.car import SLOWER, Controls, Setup
from car_interface.tools.first_check.check import FirstCheck
from car_interface.tools.first_check.files import find_folder, plan, write, write_page

RATE_HZ = 20
READY_WITHIN_NS = 8 * NS_PER_S
TUNED_WITHIN_S, POLL_S = 5.0, 0.02
INTRODUCTION = """First check: five minutes, one question at a time, the car on a box.
With keyboard_drive in another terminal: M is the manual deadman, P the
autonomous one, A and D the left stick, W and S the right one, E and C the right
one slowly."""
KEYS = {MANUAL: "key M", AUTONOMOUS: "key P", SLOWER: "key -"}  # of keyboard_drive
SERVO = "throttle_arb/servo"  # where it is tuned
PAGE = "first_check_%Y-%m-%d_%H-%M-%S.html"


def kill_node(name: str) -> str:
    """Kill a node's process, as a crash would; return why it can't be, or nothing."""
    try:
        _, reason, uri = rospy.get_master().lookupNode(name)
        if not uri:
            return reason
        _, _, pid = call(uri, "getPid", rospy.get_name())
        if not any(name.rpartition("/")[2] in word for word in command_line(pid)):  # it is another process here
            return f"{name} runs on another computer"
        os.kill(pid, signal.SIGKILL)
    except Exception as error:  # whatever it answers
        return f"{name} can't be reached: {error}"
    return ""


class FirstCheckNode:
    """Carry messages and keys to the check, and its requests to the car.

    Args:
        text, keys: the terminal; ``None`` = the one that the program runs in.
        kill: ends a node's process by its name, and returns why it can't; empty: it did.
    """

    def __init__(self, params, inbox, text=None, keys=None, kill=kill_node):
        params.finish()
        graph, self._inbox = inbox.graph, inbox
        self._folder = find_folder(graph.parameter("turn_arb/config_folder", None))
        setup = read_setup(graph.parameter, self._folder)
        self._check, self._start_neutral = FirstCheck(setup, kill), setup.throttle and setup.throttle.neutral
        self._neutral = self._start_neutral  # that throttle_arb was asked for
        self._text, self._keys = text or LiveText(), keys or Keys()
        now_ns = inbox.clocks.now_ns()
        self._timer, self._begun_ns, self._stage = RateTimer(RATE_HZ, now_ns), now_ns, self._wait
        self._printed, self._edits = "", []  # the question that was printed last; the changes of the files
        self._steering = advertise("av_steer_req", Float32, inbox)
        self._asked = False  # whether it steered with the last tick
        self._is_tuning = False  # until throttle_arb has answered
        self._gamepad, self._entries = graph.parameter("teleop_logi", {}), load_entries(self._folder)
        self._sender, self._model = None, ""  # of the newest joy message
        self._subscribe()
        if not self._keys.start():
            raise CarInterfaceError("no terminal to ask in: start it by rosrun in a terminal of its own, not by "
                                    "roslaunch and not in the background")
        self._text.say(f"{INTRODUCTION}\nNothing is written before the end; then to {self._folder}, if you say so.\n")

    def _subscribe(self):
        inbox, car = self._inbox, self._check.car
        for topic, message_type, update, field in (
                ("teleop_logi/human_in_loop", Bool, car.human.update, "data"),
                ("teleop_logi/mode", String, car.mode.update, "data"),
                ("teleop_logi/tele_steer_req", Float32, car.steering_stick.update, "data"),
                ("teleop_logi/tele_throt_req", Float32, car.throttle_stick.update, "data"),
                ("teleop_logi/state", TeleopState, car.gamepad.update, "reason"),
                ("joy", Joy, self._on_joy, ""),
                ("turn_arb/state", SteeringState, car.steering.update, ""),
                ("throttle_arb/state", ThrottleState, car.update_throttle, ""),
                ("servo/output", Int32MultiArray, self._on_output, ""),
                ("teensy_sensor_hub/link", LinkStatus, car.link.update, "open"),
                ("teensy_wheel", Wheel, car.update_wheels, ""),
                ("odom", Odometry, car.update_speed, "twist.twist.linear.x"),
                *((f"sonar/{name}", Range, partial(car.update_range, name), "range") for name in SONARS)):
            subscribe(topic, message_type, inbox, _taking(field, update) if field else update, wakes=False)

    def _on_joy(self, message, now_ns):
        frame, axes, buttons = message.header.frame_id, len(message.axes), len(message.buttons)
        if (frame, axes, buttons) != self._sender:
            self._sender, self._model = (frame, axes, buttons), model_of(frame, axes, buttons)
            self._check.car.controls = find_controls(frame, self._model, self._gamepad, self._entries)
        pressed = tuple(index for index, is_held in enumerate(message.buttons) if is_held)
        self._check.car.buttons.update(pressed, now_ns)

    def _on_output(self, message, now_ns):
        if len(message.data) == CHANNELS:
            self._check.car.output.update(message.data, now_ns)
            self._check.car.sender = sender_of(message)

    def step(self, now_ns):
        """Handle what arrived; then the stage."""
        self._inbox.dispatch()
        if self._timer.is_due(now_ns):
            typed = self._keys.read()
            if typed is None and self._keys.is_closed():
                raise EndedEarly("its terminal was closed: nothing is written")
            if "q" in (typed or "").lower():
                raise EndedEarly("ended before it was over: nothing is written")
            self._stage(now_ns, typed or "")
        return self._timer.due_ns

    def shut_down(self):
        """Center the steering, restore the terminal, take back a neutral that isn't written."""
        self._steer(None)
        self._keys.restore()
        self._text.keep()
        self._await_tuning()
        tuned = self._neutral
        if tuned != self._start_neutral:
            self._tune(self._start_neutral)
            if not self._await_tuning():
                rospy.logwarn("%s has not answered: its neutral may still be %d",
                              self._inbox.resolve_name(SERVO), tuned)

    def _wait(self, now_ns, typed):
        car = self._check.car
        lacks = [timed.stale_reason(now_ns) for timed in (car.steering, car.output) if timed.is_stale(now_ns)]
        if not lacks:
            self._stage = self._ask
        elif now_ns - self._begun_ns > READY_WITHIN_NS:
            raise CarInterfaceError(f"it can't begin: {'; '.join(lacks)}. Is the car launched, and in this namespace "
                                    "(ROS_NAMESPACE)? rosrun car_interface doctor")

    def _ask(self, now_ns, typed):
        check, car = self._check, self._check.car
        check.step(now_ns, typed)
        if check.refusal:
            raise EndedEarly(f"{check.refusal}. Nothing is written")
        question, is_held = check.question, car.held_mode(now_ns) == AUTONOMOUS
        self._steer(question.steering if question and is_held else None)
        if car.neutral != self._neutral and not self._is_tuning:  # one after the other, the newest last
            self._tune(car.neutral)
        if question is None:
            self._summarize()
            self._printed = ""  # P asks the last one again
            return
        lines = check.lines(now_ns, self._text.width)
        if self._text.is_live:
            self._text.show(lines)
        elif question.text != self._printed:
            self._text.say("\n".join(lines))
        self._printed = question.text

    def _steer(self, request):
        """Ask for a steering; for the center once where nothing is asked any more."""
        if request is not None or self._asked:
            self._steering.publish(Float32(request or 0.0))
        self._asked = request is not None

    def _tune(self, neutral):
        """Have throttle_arb take a neutral."""
        self._neutral, self._is_tuning = neutral, True
        request_values(self._inbox, SERVO, {"neutral": neutral}, partial(self._on_tuned, neutral))

    def _on_tuned(self, neutral, accepted, problem):
        if accepted is None:
            rospy.logwarn("%s can't be tuned: %s", self._inbox.resolve_name(SERVO), problem)
        if neutral == self._neutral:  # else a later one is under way
            self._is_tuning = False

    def _await_tuning(self):
        return self._inbox.clocks.wait_for(lambda: not self._is_tuning, TUNED_WITHIN_S, POLL_S)

    # --- its end ---

    def _summarize(self):
        self._text.keep()
        for title, result in self._check.results:
            self._say_beside(result.verdict, f"{title}: {result.answer}")
            if result.repair:
                self._say_beside("", f"-> {result.repair}")
        try:
            self._edits = plan(self._folder, self._check.changes(), self._entries.get(self._model) or ())
        except ConfigError as error:
            self._edits = []
            self._text.say(f"what was learned doesn't go together: {error}")
        lines = [line for edit in self._edits for line in edit.lines]
        self._text.say("\n".join(["", *lines] if lines else ["", "Nothing in the files is to be changed."]))
        question = f"Write this to {self._folder}? The old files are kept beside it." if lines else "Write the page?"
        self._text.say(f"{question}\nY yes, and a page{'   N only the page' if lines else ''}   P previous   Q nothing")
        self._stage = self._confirm

    def _say_beside(self, verdict, text):
        """Print a text in a column of its own."""
        self._text.say(textwrap.fill(text, max(40, self._text.width - 1), initial_indent=f"{verdict:<16}",
                                     subsequent_indent=" " * 16, break_on_hyphens=False))

    def _confirm(self, now_ns, typed):
        answer = next((key for key in typed.lower() if key in "ynp"), "")
        if answer == "p":
            self._check.step(now_ns, "p")
            self._stage = self._ask
        if answer not in ("y", "n"):
            return
        edits = self._edits if answer == "y" else []
        written = write(edits)
        if any("servo/neutral" in edit.values for edit in edits):
            self._start_neutral = self._neutral  # which stays
        for line in written:
            self._text.say(line)
        page = os.path.join(self._folder, SYSTEM.local_time(PAGE))
        self._text.say(write_page(page, SYSTEM.local_time("%Y-%m-%d %H:%M"), self._check.results,
                                  [line for edit in edits for line in edit.lines] + written))
        if written:
            self._text.say(f"to load it, launch again with config:={self._folder}, without calibration_drive")
        self._inbox.end()


def _taking(field, update):
    """Return a handler that hands on a field of the message."""
    value_of = attrgetter(field)
    return lambda message, now_ns: update(value_of(message), now_ns)


def read_setup(parameter: Callable[[str, Any], Any], folder: str) -> Setup:
    """Return what the car was launched with.

    Args:
        parameter: returns a parameter by its name, or the default.
        folder: of its files.

    Raises:
        CarInterfaceError: turn_arb's or throttle_arb's calibration isn't known.
    """
    throttle_arb, gamepad, hub = (parameter(name, {}) for name in ("throttle_arb", "teleop_logi", "teensy_sensor_hub"))
    throttle, profile = None, ""
    if "servo" in throttle_arb:
        try:
            throttle = read(Params(throttle_arb), ThrottleCalibration)
            profile = load_throttle(os.path.join(folder, "throttle.yaml")).esc.profile
        except ConfigError as error:
            raise CarInterfaceError(f"throttle_arb's calibration isn't known: {error}") from error
    used = throttle_arb.get("obstacle", {}).get("sonars", {})
    sequence = set(hub.get("sonar_sequence", ())) or set(range(len(SONARS)))
    return Setup(
        calibration_of(parameter("turn_arb", {})), throttle, profile,
        bool(parameter("throttle_arb/esc/calibration_drive", False)),
        gamepad.get("steer_scale", 1.0), gamepad.get("throttle_scale", 1.0),
        hub.get("pulses_per_revolution", PULSES_PER_REVOLUTION),
        [name for index, name in enumerate(SONARS) if index in sequence and used.get(name) != "absent"])


def find_controls(frame: str, model: str, parameters: Mapping[str, Any], entries: Entries) -> Controls:
    """Return which buttons are the deadmen, and their names.

    Args:
        frame: the frame_id of the joy message.
        model: see ``model_of``.
        parameters: teleop_logi's.
        entries: see ``load_entries``.
    """
    try:
        config = config_for(model, read(Params(parameters), GamepadConfig), entries)
    except ConfigError:
        return Controls()  # it drives nothing, and teleop_logi says so
    buttons = {MANUAL: config.manual_button, AUTONOMOUS: config.autonomous_button}
    named = {**buttons, SLOWER: config.slower_button}
    return Controls(buttons, KEYS if frame == KEYBOARD_FRAME else {
        mode: button_label(model, number) for mode, number in named.items()})


def main():
    """Run the program."""
    run("first_check", FirstCheckNode)
