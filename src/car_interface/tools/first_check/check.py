"""Runs a first check: one question after the other, the answers, and what would be written.

Pure: keys and ``now_ns`` in, a ``View`` out. Nothing is written here: ``changes`` says what a person is asked about.
"""
from __future__ import annotations

import textwrap
from dataclasses import replace
from functools import partial
from typing import Callable, NamedTuple, Sequence

from car_interface.common.vehicle_geometry import SONARS
from car_interface.steering.calibration import SteeringCalibration, trimmed
from car_interface.throttle.calibration import trimmed as trimmed_throttle
from car_interface.tools.first_check.car import Car, Setup
from car_interface.tools.first_check.question import (
    FINE,
    GAMEPAD,
    HUB,
    SKIPPED,
    STEERING,
    THROTTLE,
    Deadman,
    OnBox,
    Question,
    Result,
    skipped,
)
from car_interface.tools.first_check.sensor_questions import Sonar, TeensyUnplugged, WheelSensor
from car_interface.tools.first_check.steering_questions import BoardKilled, Center, End, SteeringDirection
from car_interface.tools.first_check.throttle_questions import EscKind, LettingGo, NeutralDuty, ThrottleDirection

SKIP, AGAIN, PREVIOUS, TO_END = "sape"  # Q is the caller's
KEYS, FIRST_KEYS = "S skip   A again   P previous   E to the end   Q quit", "Q quit"
MAX_WIDTH = 79
Changes = "dict[str, dict[str, Any]]"  # new values of parameters by file, without .yaml, and name


class View(NamedTuple):
    """What to show, and to ask of the car."""

    kind: str  # changes with the question, and with what it asks
    lines: Sequence[str]  # for a terminal, none longer than its width
    steering: float | None = None  # the request to turn_arb; ``None`` = publish none
    neutral: int | None = None  # the duty that throttle_arb is to have as its neutral; ``None``: as at the start
    kills_board: bool = False  # kill the servo board's node now
    is_over: bool = False  # all was asked: ask whether to write


class FirstCheck:
    """The questions, in their order.

    Attributes:
        car: takes what arrives.
        question: that is asked now; ``None``: all were asked.
    """

    def __init__(self, setup: Setup):
        self.car, self._setup = Car(setup), setup
        self._makers: list[Callable[[Car], Question]] = [
            OnBox, Deadman, SteeringDirection, Center, partial(End, side=1), partial(End, side=-1), NeutralDuty,
            ThrottleDirection, EscKind, partial(WheelSensor, side=0), partial(WheelSensor, side=1),
            *(partial(Sonar, name=name) for name in setup.sonars), LettingGo, TeensyUnplugged, BoardKilled]
        self._results: list[Result | None] = [None] * len(self._makers)
        self._titles = [make(self.car).title for make in self._makers]
        self._go(0)

    def _make(self, index):
        """Return a question anew, which asks by what is known of the car by now."""
        calibration, learned = self._setup.steering, self.learned().get(STEERING, {})
        self.car.is_exchanged = "exchanged" in learned
        self.car.center = _request(calibration, learned.get("servo_center", calibration.servo_center))
        direction = self._results[self._titles.index(ThrottleDirection.title)]
        self.car.drives_forward = direction is None or direction.verdict in (FINE, SKIPPED)
        return self._makers[index](self.car)

    @property
    def refusal(self) -> str:
        """Return why it can't go on; empty: it can."""
        box = self._results[0]
        if box is not None and box.repair:
            return f"{box.answer}: {box.repair}"
        return self.car.ground_reason

    @property
    def results(self) -> list[tuple[str, Result]]:
        """Return what was answered, by the questions' titles."""
        return [(title, result or skipped("the check ended before"))
                for title, result in zip(self._titles, self._results)]

    def step(self, now_ns: int, keys: str = "", width: int = MAX_WIDTH) -> View:
        """Take the keys that were typed, and go on."""
        for key in keys.lower():
            self._type(key, now_ns)
            self._advance(now_ns)  # the next key is for the next question that can be asked
        if not keys:
            self._advance(now_ns)
        question = self.question
        if question is None:
            return View("end", [], None, self._neutral(), is_over=True)
        kills, question.kills_board = question.kills_board, False
        return View(f"{self._index} {question.text}", self._lines(now_ns, width), question.steering,
                    self._neutral(), kills)

    def _type(self, key, now_ns):
        if key == PREVIOUS and self._index:
            index = self._index - 1
            while index and self._make(index).missing(now_ns):
                index -= 1
            self._go(index)
        elif self.question is None:
            return
        elif key == AGAIN:
            self._go(self._index)
        elif key == SKIP and self._index:  # whether it stands on a box isn't skipped
            self._answer(skipped("skipped"))
        elif key == TO_END and self._index:
            self._ask(len(self._makers), False)
        else:
            self.question.type(key, now_ns)

    def _go(self, index):
        """Ask a question anew."""
        self._results[index] = None
        self._ask(index, True)

    def _answer(self, result):
        self._results[self._index] = result
        self._ask(self._index + 1, False)

    def _ask(self, index, has_begun):
        self._index, self._has_begun, self._warning = index, has_begun, ""
        self.question = self._make(index) if index < len(self._makers) else None

    def _advance(self, now_ns):
        """Let the question look, and ask the next one that can be asked."""
        while self.question is not None:
            missing = "" if self._has_begun else self.question.missing(now_ns)
            if missing:
                self._answer(skipped(missing))
                continue
            self._has_begun = True
            if self._is_warned(now_ns):
                return
            result = self.question.step(now_ns) or self.question.result
            if result is None:
                return
            self._answer(result)

    def _is_warned(self, now_ns):
        """Begin the question again where the wheels turn too fast or for too long, once they are let go."""
        trouble = self.car.trouble(now_ns)
        if trouble:
            self._go(self._index)
            self._warning = trouble
        elif self._warning and self.car.stands(now_ns) and not self.car.is_driven:
            self._warning = ""
        return bool(self._warning)

    def _neutral(self):
        """Return the neutral that throttle_arb is to have: the one that was found."""
        duty = self.question.neutral if self.question is not None else None
        if duty is None:
            duty = self.learned().get(THROTTLE, {}).get("neutral")
        if self._setup.throttle is not None:
            self.car.neutral = self._setup.throttle.neutral if duty is None else duty
        return duty

    def _lines(self, now_ns, width):
        question = self.question
        seen = question.seen(now_ns)
        parts = [f"{self._index + 1} of {len(self._makers)}: {question.title}", question.text,
                 question.help, f"Now: {seen}" if seen else "", self._warning or question.note,
                 KEYS if self._index else FIRST_KEYS]
        columns = min(width, MAX_WIDTH + 1) - 1
        return [line for part in parts for line in textwrap.wrap(part, columns) or [""]]

    # --- what was learned ---

    def learned(self) -> Changes:
        """Return what the answers say, by file: parameters, and what is computed from several of them."""
        found: Changes = {}
        for result in filter(None, self._results):
            for file, values in result.changes.items():
                found.setdefault(file, {}).update(values)
        return found

    def changes(self) -> Changes:
        """Return the new values of parameters, by file.

        Raises:
            ConfigError: they don't go together, such as a center beyond an end.
        """
        learned = {file: {} for file in (GAMEPAD, STEERING, THROTTLE, HUB)}
        learned.update(self.learned())
        present = [SONARS.index(name) for name in self._setup.sonars if name not in learned[HUB]]
        found = {GAMEPAD: learned[GAMEPAD], STEERING: _steering_changes(self._setup.steering, learned[STEERING]),
                 THROTTLE: _throttle_changes(self._setup.throttle, learned[THROTTLE]),
                 HUB: {"sonar_sequence": present} if learned[HUB] and present else {}}
        return {file: values for file, values in found.items() if values}


def _request(calibration, duty):
    """Return the request, −1..1, for which turn_arb gives a duty."""
    center = calibration.servo_center
    is_left = (duty - center) * (calibration.servo_left - center) > 0
    travel = abs((calibration.servo_left if is_left else calibration.servo_right) - center)
    return round((1 if is_left else -1) * abs(duty - center) / travel, 4) if travel and duty != center else 0.0


def exchanged(calibration: SteeringCalibration) -> SteeringCalibration:
    """Return the calibration of a servo that is built in the other way round."""
    return replace(calibration, servo_left=calibration.servo_right, servo_right=calibration.servo_left,
                   left_duties=calibration.right_duties, right_duties=calibration.left_duties)


def _steering_changes(calibration, learned):
    if not learned:
        return {}
    base = exchanged(calibration) if "exchanged" in learned else calibration
    new = trimmed(base, **{name: learned.get(name, getattr(base, name))
                           for name in ("servo_left", "servo_center", "servo_right")})
    return {"servo_left": new.servo_left, "servo_center": new.servo_center, "servo_right": new.servo_right,
            "k_pwmcmd_left_table_servo": list(new.left_duties), "k_pwmcmd_right_table_servo": list(new.right_duties)}


def _throttle_changes(calibration, learned):
    found = {name: value for name, value in learned.items() if name.startswith("esc/")}
    new = trimmed_throttle(calibration, learned["neutral"]) if "neutral" in learned else calibration
    if "exchanged" in learned:
        new = replace(new, duty_table=[2 * new.neutral - duty for duty in new.duty_table])
    if new is not calibration:
        found.update({"servo/neutral": new.neutral, "servo/duty_table": list(new.duty_table)})
    return found
