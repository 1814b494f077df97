"""What the questions of a first check have in common; and those that measure what a person's hands do.

Pure. A question is answered by a key, or by what it sees.
"""
from __future__ import annotations

import math
from functools import partial
from itertools import takewhile
from typing import Any, Mapping, NamedTuple

from car_interface.common.causes import AUTONOMOUS, MANUAL
from car_interface.tools.first_check.car import GAMEPAD, HUB, SIDES, Car, in_brackets

FINE, LEARNED, BROKEN, SKIPPED = "fine", "learned", "to be repaired", "not asked"
CLASSES = {FINE: "good", LEARNED: "warn", BROKEN: "bad", SKIPPED: "faint"}  # as which a page shows them
ENTER = "\n"
YES_NO = "yn"  # the keys of what comes second
SAME_KEYS = {"<": ",", ">": ".", "=": "+", "\r": ENTER}  # typed as they are, or as the keys that they share
MIN_PULSES = 5  # less is a wheel that was touched
TURN_TOLERANCE = 0.25  # of the pulses of one turn by hand
NEAR_M, NEAR_REPORTS = 0.4, 3  # a hand


class Result(NamedTuple):
    """What an answer means."""

    verdict: str  # FINE, LEARNED, BROKEN or SKIPPED
    answer: str  # what was seen
    repair: str = ""  # what a person has to do
    changes: Mapping[str, Mapping[str, Any]] = {}  # new values of parameters, by file and name


fine, learned, broken, skipped = (partial(Result, verdict) for verdict in (FINE, LEARNED, BROKEN, SKIPPED))


def first(*cases: tuple[Any, Result | str]) -> Result | str | None:
    """Return the outcome of the first case that holds, if one does; a case is whether it does, and its outcome."""
    return next((outcome for holds, outcome in cases if holds), None)


class Question:
    """One question. ``ask`` may have {manual} and {autonomous}: they stand for the order to hold that deadman."""

    title = ask = ""  # what it checks; what to do, and what is asked
    help = keys = ""  # the keys, as they are shown; those that it takes, see SAME_KEYS
    note = ""  # why the last key was not taken
    result: Result | None = None  # until it is answered
    steering: float | None = None  # the request to turn_arb, −1 right .. +1 left; ``None`` = none

    def __init__(self, car: Car):
        self.car, self.setup = car, car.setup

    @property
    def text(self) -> str:
        """Return what to do, and what is asked."""
        return self.ask.format(**{mode: f"Hold the {mode} deadman{in_brackets(self.car.controls.names.get(mode))}"
                                  for mode in (MANUAL, AUTONOMOUS)})

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

    def go_on(self, ask: str, keys_text: str = "Y yes   N no", keys: str = YES_NO) -> None:
        """Ask what comes next."""
        self.ask, self.help, self.keys = ask, keys_text, keys

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
        return first((key == "n", broken("it is on the ground", "put it on a box first")),
                     (self.car.stands(now_ns), fine("all wheels hang free")),
                     (True, "the wheels turn: wait until they stand"))


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
            return self.car.human.stale_reason(now_ns) + in_brackets(reason)
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
        wanted, pressed = self._wanted, self.car.buttons.fresh(now_ns) or ()
        others = [number for mode, number in self.car.controls.buttons.items() if mode != wanted]
        button = pressed[0] if len(pressed) == 1 and pressed[0] not in others else None
        which = f"buttons {', '.join(map(str, pressed))} are held" if pressed else "no button of joy is seen"
        return first(
            (wanted is None,
             broken(f"it is held though nobody holds it: {self.seen(now_ns)}",
                    "end other programs that publish human_in_loop: rosrun car_interface doctor")),
            (button is not None,
             learned(f"button {button} is held, and {wanted}_button is another one",
                     changes={GAMEPAD: {f"{wanted}_button": button}})),
            (True,
             broken(f"the {wanted} deadman isn't seen: {which}",
                    f"switch the gamepad on, and set {wanted}_button in teleop_logi.yaml: rostopic echo /joy shows the "
                    "buttons")))


class WheelSensor(Question):
    """One rear wheel, turned by hand."""

    help, keys = "Enter it is done", f"{ENTER}yn"

    def __init__(self, car, side: int):
        super().__init__(car)
        self._side = side
        self.title = f"the sensor of the {SIDES[side]} rear wheel"
        self.ask = (f"Let go of the gamepad. Turn the {SIDES[side].upper()} rear wheel by hand, one full turn, as "
                    "when the car drives FORWARD. It doesn't matter if the other one turns back.")

    def missing(self, now_ns):
        return "" if not self.car.wheels.is_stale(now_ns) else "no wheel is heard: is the Teensy plugged in?"

    def seen(self, now_ns):
        return ", ".join(f"{name} {count:+d}" for name, count in zip(SIDES, self.car.pulses)) + " pulses"

    def answer(self, key, now_ns):
        ours, other = self.car.pulses[self._side], self.car.pulses[1 - self._side]
        expected, seen = self.setup.pulses_per_revolution, self.seen(now_ns)
        return first(
            (self.car.held_mode(now_ns) is not None, "let go of the deadman first, and begin again with A"),
            (max(abs(ours), abs(other)) < MIN_PULSES,
             broken("it counts nothing", "look at the sensor's plug, and at its distance from the magnets")),
            (other >= MIN_PULSES > ours,
             broken(f"the other sensor counts it ({seen})", "exchange the plugs of the two sensors")),
            (ours <= -MIN_PULSES,
             broken(f"it counts backward ({ours} pulses)", "exchange the two signal wires of this sensor")),
            (ours < MIN_PULSES,
             broken(f"it counts too little ({seen})", "look at the sensor's plug and magnets")),
            (abs(ours - expected) > TURN_TOLERANCE * expected,
             broken(f"{ours} pulses in one turn",
                    f"count a turn once more: pulses_per_revolution in teensy_sensor_hub.yaml is {expected}")),
            (True, fine(f"it counts forward, {ours} pulses in one turn")))


class Sonar(Question):
    """One sonar, by a hand before it."""

    help, keys = "N nothing happens   X the car has no such sonar", "nx"

    def __init__(self, car, name: str):
        super().__init__(car)
        self.name = name
        self.title = f"the sonar {_words(name)}"
        self.ask = (f"Hold your hand 20 cm in front of the sonar {_words(name).upper()}, and nothing near the others. "
                    "It goes on by itself.")

    def missing(self, now_ns):
        is_heard = any(not timed.is_stale(now_ns) for timed in self.car.ranges.values())
        return "" if is_heard else "no sonar is heard: is the Teensy plugged in?"

    def seen(self, now_ns):
        near = [_words(name) for name in self.car.ranges if self._near(name)]
        timed = self.car.ranges[self.name]
        own = timed.stale_reason(now_ns) if timed.is_stale(now_ns) else f"it sees {_range_text(timed.value)}"
        first = "; take the hand away first" if timed.was_received and timed.value < NEAR_M and not near else ""
        return f"{own}; near: {', '.join(near) or 'nothing'}{first}"

    def _near(self, name):
        """Return how many of a sonar's newest reports see something near, after one that saw nothing there."""
        reports = self.car.reports[name]
        near = list(takewhile(lambda range_m: range_m < NEAR_M, reversed(reports)))
        return len(near) if len(near) < len(reports) else 0

    def step(self, now_ns):
        if self._near(self.name) < NEAR_REPORTS:
            return None
        return fine(f"it sees the hand: {_range_text(self.car.ranges[self.name].value)}")

    def answer(self, key, now_ns):
        other = next((_words(name) for name in self.car.ranges if self._near(name) >= NEAR_REPORTS), "")
        timed, reports = self.car.ranges[self.name], self.car.reports[self.name]
        range_m = timed.value if timed.was_received else math.inf
        return first(
            (key == "x",
             learned("the car has none", f"with obstacle_stop set obstacle/sonars/{self.name}: absent in throttle.yaml",
                     {HUB: {self.name: "absent"}})),
            (other, broken(f"{other} sees the hand in its place",
                           f"exchange the plugs of {_words(self.name)} and {other}")),
            (timed.is_stale(now_ns),
             broken("it isn't heard", "look at its plug, and at sonar_sequence in teensy_sensor_hub.yaml")),
            (all(each_m < NEAR_M for each_m in (range_m, *reports)),
             broken(f"it always sees something: {_range_text(range_m)}",
                    "look for what is in its cone: the box, a cable, the body")),
            (True, broken("it sees no hand", "look at its plug (trigger and echo), and at its aim")))


def _words(name):
    return name.replace("_", " ")


def _range_text(range_m):
    """Return a range in words; REP-117: inf = nothing, −inf = too near to be measured."""
    if math.isinf(range_m):
        return "nothing" if range_m > 0 else "something too near"
    return f"{range_m:.2f} m"


class TeensyUnplugged(Question):
    """The Teensy's cable, pulled and plugged in again."""

    title = "unplugging the Teensy"
    ask = "Pull the Teensy's USB cable (one that is soldered on: S). It goes on by itself."
    help, keys = "N it is unplugged, and nothing happens", "n"
    _was_lost = False

    def missing(self, now_ns):
        return "" if self.car.link.was_received else "teensy_sensor_hub isn't heard"

    def seen(self, now_ns):
        link = self.car.link
        return link.stale_reason(now_ns) if link.is_stale(now_ns) else f"the port is {'' if link.value else 'not '}open"

    def step(self, now_ns):
        is_there = self.car.link.fresh(now_ns)
        if not self._was_lost and not is_there:
            self._was_lost = True
            self.go_on("It was noticed. Plug it in again; it goes on by itself.", "N it is back, and nothing happens",
                       self.keys)
        elif self._was_lost and is_there and not self.car.wheels.is_stale(now_ns):
            return fine("noticed, and its wheels were heard again")
        return None

    def answer(self, key, now_ns):
        return first(
            (self._was_lost,
             broken("it doesn't come back", "rosrun car_interface setup_hardware, and port:=/dev/serial/by-id/… in the "
                                            "launch: the port has another name now")),
            (True, broken("it wasn't noticed",
                          "another device is opened: look at port:=…, rosrun car_interface doctor")))
