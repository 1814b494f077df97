"""What the questions of a first check have in common, and the first two of them.

Pure. A question sets its ``result`` by a key, or by what it sees. ``<`` and ``>`` are typed as they are or as the keys
that they share, comma and full stop.
"""
from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Callable, Mapping

from car_interface.common.causes import AUTONOMOUS, MANUAL
from car_interface.tools.first_check.car import Car

FINE, LEARNED, BROKEN, SKIPPED = "fine", "learned", "to be repaired", "not asked"
ENTER = "\n"
SAME_DUTY = 8  # half a count of the servo board
STEERING, THROTTLE, GAMEPAD, HUB = "turn_arb", "throttle", "teleop_logi", "teensy_sensor_hub"  # files


@dataclass(frozen=True)
class Result:
    """What an answer means.

    Attributes:
        verdict: FINE, LEARNED, BROKEN or SKIPPED.
        answer: what was seen.
        changes: new values of parameters, by file and name.
        repair: what a person has to do.
    """

    verdict: str
    answer: str
    changes: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    repair: str = ""


class Question:
    """One question.

    Attributes:
        title: what it checks.
        text: what to do, and what is asked.
        help: the keys.
        result: ``None`` until it is answered.
        steering: the request to turn_arb, −1 right .. +1 left; ``None`` = none.
        neutral: the duty that throttle_arb is to have as its neutral; ``None`` = as it is.
        kills_board: whether the servo board's node is to be killed now.
        note: why the last key was not taken.
    """

    title = text = help = ""

    def __init__(self, car: Car):
        self.car, self.setup = car, car.setup
        self.result: Result | None = None
        self.steering: float | None = None
        self.neutral: int | None = None
        self.kills_board = False
        self.note = ""
        self.keys: dict[str, Callable[[int], None]] = {}

    def missing(self, now_ns: int) -> str:
        """Return why it can't be asked; empty: it can."""
        return ""

    def seen(self, now_ns: int) -> str:
        """Return what is measured now."""
        return ""

    def step(self, now_ns: int) -> None:
        """Look at what has arrived."""

    def type(self, key: str, now_ns: int) -> None:
        """Take a key."""
        act = self.keys.get({"<": ",", ">": ".", "=": "+", "\r": ENTER}.get(key, key))
        if act is not None:
            self.note = ""
            act(now_ns)

    def _hold(self, mode):
        return f"Hold the {self.car.deadman(mode)}"

    def _fine(self, answer):
        self.result = Result(FINE, answer)

    def _learned(self, answer, file, **values):
        self.result = Result(LEARNED, answer, {file: values})

    def _broken(self, answer, repair):
        self.result = Result(BROKEN, answer, repair=repair)


class OnBox(Question):
    """Asks before anything else, since the wheels will turn."""

    title = "the car on a box"
    text = ("Put the car on a box, so that all four wheels hang free, and keep hands, hair and cables away from "
            "them. The battery is connected and the ESC is on. Is that so?")
    help = "Y yes   N no"

    def __init__(self, car):
        super().__init__(car)
        self.keys = {"y": self._yes, "n": lambda now_ns: self._broken("it is on the ground", "put it on a box first")}

    def _yes(self, now_ns):
        if self.car.stands(now_ns):
            self._fine("all wheels hang free")
        else:
            self.note = "the wheels turn: wait until they stand"


class Deadman(Question):
    """Both deadmen, pressed and released one after the other."""

    title = "the deadman"
    help = "N nothing happens"
    STAGES = (None, MANUAL, None, AUTONOMOUS, None)

    def __init__(self, car):
        super().__init__(car)
        self._stage = 0
        self.keys = {"n": self._nothing}

    @property
    def _wanted(self):
        return self.STAGES[self._stage]

    @property
    def text(self):
        if self._wanted is None:
            return "Let go of all buttons, sticks and keys of the gamepad." if not self._stage else "Let go of it."
        return f"{self._hold(self._wanted)}. It goes on by itself when it sees it."

    def seen(self, now_ns):
        held, reason = self.car.held_mode(now_ns), self.car.gamepad.value
        if self.car.human.is_stale(now_ns):
            return self.car.human.stale_reason(now_ns) + (f" ({reason})" if reason else "")
        return reason or "no deadman is held" if held is None else f"the {held or 'driving'} deadman is held"

    def step(self, now_ns):
        if self.car.human.is_stale(now_ns) or self.car.held_mode(now_ns) != self._wanted:
            return
        if self._stage + 1 < len(self.STAGES):
            self._stage += 1
        else:
            self._fine("both were seen held and released")

    def _nothing(self, now_ns):
        wanted, buttons = self._wanted, self.car.buttons
        pressed = () if buttons.is_stale(now_ns) else buttons.value
        others = [number for mode, number in self.car.controls.buttons.items() if mode != wanted]
        if wanted is None:
            self._broken(f"it is held though nobody holds it: {self.seen(now_ns)}",
                         "end other programs that publish human_in_loop: rosrun car_interface doctor")
        elif len(pressed) == 1 and pressed[0] not in others:
            self._learned(f"button {pressed[0]} is held, and {wanted}_button is another one", GAMEPAD,
                          **{f"{wanted}_button": pressed[0]})
        else:
            which = f"buttons {', '.join(map(str, pressed))} are held" if pressed else "no button of joy is seen"
            self._broken(f"the {wanted} deadman isn't seen: {which}",
                         f"switch the gamepad on, and set {wanted}_button in teleop_logi.yaml: rostopic echo /joy "
                         "shows the buttons")
