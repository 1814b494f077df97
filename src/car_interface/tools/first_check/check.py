"""Runs a first check: one question after the other, the answers, and what would be written.

Pure: keys and ``now_ns`` in. What is shown and asked of the car is the ``question``'s, and its ``lines``. Nothing is
written here: ``changes`` says what a person is asked about.
"""
from __future__ import annotations

import textwrap
from collections import defaultdict
from dataclasses import replace
from functools import partial
from typing import Callable

from car_interface.common.vehicle_geometry import SONARS
from car_interface.steering.calibration import trimmed
from car_interface.throttle.calibration import trimmed as trimmed_throttle
from car_interface.tools.first_check import driving_questions as driving
from car_interface.tools.first_check import questions
from car_interface.tools.first_check.car import GAMEPAD, HUB, STEERING, THROTTLE, Car, Setup
from car_interface.tools.first_check.questions import FINE, SKIPPED, Result, skipped

SKIP, AGAIN, PREVIOUS, TO_END = "sape"  # Q is the caller's
KEYS, FIRST_KEYS = "S skip   A again   P previous   E to the end   Q quit", "Q quit"
MAX_WIDTH = 79
Changes = "dict[str, dict[str, Any]]"  # new values of parameters by file, without .yaml, and name


class FirstCheck:
    """The questions, in their order.

    Args:
        kill: see ``Car``.

    Attributes:
        car: takes what arrives.
        question: that is asked now; ``None``: all were asked.
    """

    def __init__(self, setup: Setup, kill: Callable[[str], str]):
        self.car, self._setup = Car(setup, kill), setup
        self._makers: list[Callable[[Car], questions.Question]] = [
            questions.OnBox, questions.Deadman, driving.SteeringDirection, driving.Center,
            *(partial(driving.End, side=side) for side in (1, -1)), driving.NeutralDuty, driving.ThrottleDirection,
            driving.EscKind, *(partial(questions.WheelSensor, side=side) for side in (0, 1)),
            *(partial(questions.Sonar, name=name) for name in setup.sonars), driving.LettingGo,
            questions.TeensyUnplugged, driving.BoardKilled]
        self._results: list[Result | None] = [None] * len(self._makers)
        self._titles = [make(self.car).title for make in self._makers]
        self._go(0)

    @property
    def refusal(self) -> str:
        """Return why it can't go on; empty: it can."""
        box = self._results[0]
        return f"{box.answer}: {box.repair}" if box is not None and box.repair else self.car.ground_reason

    @property
    def results(self) -> list[tuple[str, Result]]:
        """Return what was answered, by the questions' titles."""
        return [(title, result or skipped("the check ended before"))
                for title, result in zip(self._titles, self._results)]

    def step(self, now_ns: int, keys: str = "") -> None:
        """Take the keys that were typed, and go on."""
        for key in keys.lower():
            self._type(key, now_ns)
            self._advance(now_ns)  # the next key is for the next question that can be asked
        if not keys:
            self._advance(now_ns)

    def _type(self, key, now_ns):
        if key == PREVIOUS and self._index:
            index = self._index - 1
            while index and self._makers[index](self.car).missing(now_ns):
                index -= 1
            self._go(index)
        elif self.question is None:
            return
        elif key == AGAIN:
            self._go(self._index)
        elif key == SKIP and self._index:  # whether it stands on a box isn't skipped
            self._answer(skipped("skipped"), now_ns)
        elif key == TO_END and self._index:
            self._ask(len(self._makers))
        else:
            self.question.type(key, now_ns)

    def _go(self, index):
        """Ask a question anew."""
        self._results[index] = None
        self._ask(index)

    def _answer(self, result, now_ns):
        """Take an answer, and ask the next question that can be asked."""
        self._results[self._index] = result
        self._ask(self._index + 1)
        missing = self.question and self.question.missing(now_ns)
        if missing:
            self._answer(skipped(missing), now_ns)

    def _ask(self, index):
        """Ask a question by what is known of the car by now; behind the last one, none."""
        self._index, self._warning = index, ""
        self.car.reports, self.car.pulses = {name: [] for name in SONARS}, [0, 0]
        steering, throttle = self.learned()[STEERING], self.learned()[THROTTLE]
        direction = self._results[self._titles.index(driving.ThrottleDirection.title)]
        self.car.is_exchanged, self.car.center = "exchanged" in steering, steering.get("center_request", 0.0)
        self.car.neutral = throttle.get("neutral", self._setup.throttle and self._setup.throttle.neutral)
        self.car.drives_forward = direction is None or direction.verdict in (FINE, SKIPPED)
        self.question = self._makers[index](self.car) if index < len(self._makers) else None

    def _advance(self, now_ns):
        """Let the question look, and the next one if that answers it."""
        while self.question is not None and not self._is_warned(now_ns):
            result = self.question.step(now_ns) or self.question.result
            if result is None:
                return
            self._answer(result, now_ns)

    def _is_warned(self, now_ns):
        """Begin the question again where the wheels turn too fast or for too long, once they are let go."""
        trouble = self.car.trouble(now_ns)
        if trouble:
            self._go(self._index)
            self._warning = trouble
        elif self._warning and self.car.stands(now_ns) and self.car.drives_since_ns is None:
            self._warning = ""
        return bool(self._warning)

    def lines(self, now_ns: int, width: int = MAX_WIDTH) -> list[str]:
        """Return the question for a terminal, no line longer than its ``width`` in columns."""
        question, seen = self.question, self.question.seen(now_ns)
        parts = [f"{self._index + 1} of {len(self._makers)}: {question.title}", question.text,
                 question.help, f"Now: {seen}" if seen else "", self._warning or question.note,
                 KEYS if self._index else FIRST_KEYS]
        columns = min(width, MAX_WIDTH + 1) - 1
        return [line for part in parts for line in textwrap.wrap(part, columns) or [""]]

    # --- what was learned ---

    def learned(self) -> Changes:
        """Return what the answers say, by file: parameters, and what is computed from several of them."""
        found: Changes = defaultdict(dict)
        for result in filter(None, self._results):
            for file, values in result.changes.items():
                found[file].update(values)
        return found

    def changes(self) -> Changes:
        """Return the new values of parameters, by file.

        Raises:
            ConfigError: they don't go together, such as a center beyond an end.
        """
        learned = self.learned()
        present = [SONARS.index(name) for name in self._setup.sonars if name not in learned[HUB]]
        found = {GAMEPAD: learned[GAMEPAD], STEERING: _steering_changes(self._setup.steering, learned[STEERING]),
                 THROTTLE: _throttle_changes(self._setup.throttle, learned[THROTTLE]),
                 HUB: {"sonar_sequence": present} if learned[HUB] and present else {}}
        return {file: values for file, values in found.items() if values}


def _steering_changes(calibration, learned):
    if not learned:
        return {}
    if "exchanged" in learned:  # the servo is built in the other way round
        calibration = replace(calibration, servo_left=calibration.servo_right, servo_right=calibration.servo_left,
                              left_duties=calibration.right_duties, right_duties=calibration.left_duties)
    new = trimmed(calibration, **{name: learned.get(name, getattr(calibration, name))
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
