"""What the questions of a first check have in common, and the first two of them.

Pure. A question is answered by a key, or by what it sees.
"""
from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from typing import Any, Mapping

from car_interface.common.causes import AUTONOMOUS, MANUAL
from car_interface.tools.first_check.car import Car

FINE, LEARNED, BROKEN, SKIPPED = "fine", "learned", "to be repaired", "not asked"
CLASSES = {FINE: "good", LEARNED: "warn", BROKEN: "bad", SKIPPED: "faint"}  # as which a page shows them
ENTER = "\n"
SAME_KEYS = {"<": ",", ">": ".", "=": "+", "\r": ENTER}  # typed as they are, or as the keys that they share
STEERING, THROTTLE, GAMEPAD, HUB = "turn_arb", "throttle", "teleop_logi", "teensy_sensor_hub"  # files


@dataclass(frozen=True)
class Result:
    """What an answer means."""

    verdict: str  # FINE, LEARNED, BROKEN or SKIPPED
    answer: str  # what was seen
    changes: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)  # new values of parameters, by file and name
    repair: str = ""  # what a person has to do


fine, skipped = partial(Result, FINE), partial(Result, SKIPPED)
learned = partial(Result, LEARNED)  # with the changes, and a repair if there is one


def broken(answer: str, repair: str) -> Result:
    """Return what a person has to repair."""
    return Result(BROKEN, answer, repair=repair)


class Question:
    """One question. ``ask`` may have {manual} and {autonomous}: they stand for the order to hold that deadman."""

    title = ask = ""  # what it checks; what to do, and what is asked
    help = keys = ""  # the keys, as they are shown; those that it takes, see SAME_KEYS
    note = ""  # why the last key was not taken
    result: Result | None = None  # until it is answered
    steering: float | None = None  # the request to turn_arb, −1 right .. +1 left; ``None`` = none
    neutral: int | None = None  # the duty that throttle_arb is to have as its neutral; ``None`` = as it is
    kills_board = False  # whether the servo board's node is to be killed now

    def __init__(self, car: Car):
        self.car, self.setup = car, car.setup

    @property
    def text(self) -> str:
        """Return what to do, and what is asked."""
        return self.ask.format(**{mode: f"Hold the {self.car.deadman(mode)}" for mode in (MANUAL, AUTONOMOUS)})

    def missing(self, now_ns: int) -> str:
        """Return why it can't be asked; empty: it can."""
        return ""

    def seen(self, now_ns: int) -> str:
        """Return what is measured now."""
        return ""

    def step(self, now_ns: int) -> Result | None:
        """Look at what has arrived; return the answer that it gives, if any."""

    def answer(self, key: str, now_ns: int) -> Result | str | None:
        """Return the answer that one of ``keys`` gives, or why it isn't taken; ``None``: it goes on."""

    def type(self, key: str, now_ns: int) -> None:
        """Take a key."""
        key = SAME_KEYS.get(key, key)
        if key in self.keys:
            outcome = self.answer(key, now_ns)
            self.note = outcome if isinstance(outcome, str) else ""
            self.result = outcome if isinstance(outcome, Result) else self.result


class OnBox(Question):
    """Asks before anything else, since the wheels will turn."""

    title = "the car on a box"
    ask = ("Put the car on a box, so that all four wheels hang free, and keep hands, hair and cables away from "
           "them. The battery is connected and the ESC is on. Is that so?")
    help, keys = "Y yes   N no", "yn"

    def answer(self, key, now_ns):
        if key == "n":
            return broken("it is on the ground", "put it on a box first")
        return fine("all wheels hang free") if self.car.stands(now_ns) else "the wheels turn: wait until they stand"


class Deadman(Question):
    """Both deadmen, pressed and released one after the other."""

    title = "the deadman"
    help, keys = "N nothing happens", "n"
    GOES_ON, RELEASE = "It goes on by itself when it sees it.", (None, "Let go of it.")
    STAGES = ((None, "Let go of all buttons, sticks and keys of the gamepad."), (MANUAL, f"{{manual}}. {GOES_ON}"),
              RELEASE, (AUTONOMOUS, f"{{autonomous}}. {GOES_ON}"), RELEASE)  # the mode to be held, and what is asked

    def __init__(self, car):
        super().__init__(car)
        self._left = iter(self.STAGES)
        self._wanted, self.ask = next(self._left)

    def seen(self, now_ns):
        held, reason = self.car.held_mode(now_ns), self.car.gamepad.value
        if self.car.human.is_stale(now_ns):
            return self.car.human.stale_reason(now_ns) + (f" ({reason})" if reason else "")
        return reason or "no deadman is held" if held is None else f"the {held or 'driving'} deadman is held"

    def step(self, now_ns):
        if self.car.human.is_stale(now_ns) or self.car.held_mode(now_ns) != self._wanted:
            return None
        following = next(self._left, None)
        if following is None:
            return fine("both were seen held and released")
        self._wanted, self.ask = following
        return None

    def answer(self, key, now_ns):
        wanted, buttons = self._wanted, self.car.buttons
        pressed = () if buttons.is_stale(now_ns) else buttons.value
        others = [number for mode, number in self.car.controls.buttons.items() if mode != wanted]
        if wanted is None:
            return broken(f"it is held though nobody holds it: {self.seen(now_ns)}",
                          "end other programs that publish human_in_loop: rosrun car_interface doctor")
        if len(pressed) == 1 and pressed[0] not in others:
            return learned(f"button {pressed[0]} is held, and {wanted}_button is another one",
                           {GAMEPAD: {f"{wanted}_button": pressed[0]}})
        which = f"buttons {', '.join(map(str, pressed))} are held" if pressed else "no button of joy is seen"
        return broken(f"the {wanted} deadman isn't seen: {which}",
                      f"switch the gamepad on, and set {wanted}_button in teleop_logi.yaml: rostopic echo /joy "
                      "shows the buttons")
