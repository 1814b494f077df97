"""Converts keys to steering, throttle and deadmen. Pure: a terminal's characters, a keyboard's presses, ``now_ns``.

A terminal sends which key is pressed, and repeats the newest one, but never a release. A keyboard's own events have the
release, but may be meant for another program. So a key is held from its character on, until the keyboard reports its
release. Without such events it may be held for HOLD_NS after its newest character.
"""
from __future__ import annotations

import math
import re
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

from car_interface.common import declared
from car_interface.common.errors import require
from car_interface.common.units import NS_PER_S
from car_interface.teleop.gamepad import MAX_INDEX, NONE

LEFT, RIGHT, FORWARD, BACKWARD = "left", "right", "forward", "backward"
SLOWLY_FORWARD, SLOWLY_BACKWARD, MORE, LESS = "slowly forward", "slowly backward", "more", "less"
MANUAL, AUTONOMOUS, RELEASE, QUIT = "manual", "autonomous", "release", "quit"
THROTTLE_KEYS = frozenset({FORWARD, BACKWARD, SLOWLY_FORWARD, SLOWLY_BACKWARD})
# "=" is "+" without Shift on many keyboards.
CHARACTERS = {"a": LEFT, "d": RIGHT, "w": FORWARD, "s": BACKWARD, "e": SLOWLY_FORWARD, "c": SLOWLY_BACKWARD, "+": MORE,
              "=": MORE, "-": LESS, "m": MANUAL, "p": AUTONOMOUS, " ": RELEASE, "q": QUIT}
ARROWS = {"D": LEFT, "C": RIGHT, "A": FORWARD, "B": BACKWARD}  # how their sequences end (ECMA-48, cursor keys)
SEQUENCE = re.compile(r"\x1b[\[O][0-9;]*([A-Za-z~])|\x1b(?![\[O])|(.)", re.S)
CUT_SEQUENCE = re.compile(r"\x1b([\[O][0-9;]{0,8})?$")

HOLD_NS = 7 * NS_PER_S // 10  # longer than the delay before a key repeats: 0.25 s on a console, 0.5 to 0.66 s under X
PAIR_NS = 3 * NS_PER_S // 10  # between a press and its character at most
STEERING_PER_S = 4.0  # a quarter of a second from the centre to the end, so that a touch steers a little
# A push begins above throttle_arb's dead band, and is full after half a second, so that a touch moves a car a little.
PUSH_FROM, PUSH_PER_S = 0.1, 1.8
PULL_FROM = 1.0  # a pull is whole at once: it is the brake
# A slow one begins at the dead band. With a scale of 0.5 it takes four seconds to where a car sets off.
SLOWLY_FROM, SLOWLY_PER_S = 0.05, 0.07


def _teleop(declare, name, default, *arguments, **accepted):
    """Declare a parameter whose default is teleop_logi's, or where that has none another one."""
    shown = f"teleop_logi's, else {default:g}".replace("-", "−")
    return declare(name, default, *arguments, default_text=shown, **accepted)


_index = partial(_teleop, declared.integer, text="index in the message", low=0, high=MAX_INDEX)
_button = partial(_teleop, declared.integer, text="index in the message; −1 = none", low=NONE, high=MAX_INDEX)
_scale = partial(_teleop, declared.number, text="only its sign counts", low=-1, high=1)


@dataclass(frozen=True)
class KeyboardConfig:
    """Which axis and button does what, as teleop_logi's, and where keys come from."""

    steer_axis: int = _index("steer_axis", 0)
    throttle_axis: int = _index("throttle_axis", 4)
    manual_button: int = _index("manual_button", 4)
    autonomous_button: int = _index("autonomous_button", 5)
    faster_button: int = _button("faster_button", NONE)
    slower_button: int = _button("slower_button", NONE)
    steer_scale: float = _scale("steer_scale", 1.0)
    throttle_scale: float = _scale("throttle_scale", 1.0)
    input_devices: str = declared.text(
        "input_devices", "/dev/input/event*", "the keyboards; `none` = only the terminal is read")

    def __post_init__(self):
        require(self.manual_button != self.autonomous_button, "autonomous_button", self.autonomous_button,
                "a button other than manual_button's")


def help_text(has_releases: bool) -> str:
    """Return a text with what the keys do, for the start of a program."""
    hold = "hold M" if has_releases else ("press M, then hold another key: this terminal doesn't say when a key\n"
                                         f"is released, so each counts for {HOLD_NS / NS_PER_S:g} s")
    return ("M        deadman: you drive\n"
            "P        deadman: the planner drives, until you steer or push\n"
            "W A S D  or the arrows: faster, left, slower, right; the longer, the more\n"
            "S M S    reverse: hold S until it stands; then M alone for a second; then S\n"
            "E C      push and pull slowly, to see where the car sets off\n"
            "+ -      more and less throttle by W, A, S, D: wait a second between two\n"
            "space    let go of everything\n"
            "Q        quit\n"
            f"To drive: {hold}.")


class KeyReader:
    """Finds keys in the text of a terminal, whose escape sequences may be cut anywhere."""

    def __init__(self):
        self._rest = ""

    def feed(self, text: str) -> list[str]:
        """Return the keys that ``text`` completes, in order, without characters that mean nothing."""
        text = self._rest + text
        cut = CUT_SEQUENCE.search(text)
        self._rest = cut.group(0) if cut else ""
        found = []
        for match in SEQUENCE.finditer(text[:cut.start()] if cut else text):
            arrow, character = match.groups()
            found.append(ARROWS.get(arrow) if arrow else CHARACTERS.get((character or "").lower()))
        return [key for key in found if key]


class Controls(NamedTuple):
    steering: float = 0.0  # −1 right .. +1 left
    throttle: float = 0.0  # −1 .. +1
    manual: bool = False
    autonomous: bool = False
    scale: int = 0  # 1 and −1 while the key for more and less is held


class Keyboard:
    """The keys that are held.

    With ``counts_without_release`` a key whose release nothing reports is held for HOLD_NS after each character.
    """

    def __init__(self, counts_without_release: bool):
        self._counts_without_release = counts_without_release
        self._down: dict[int, int] = {}  # codes of the keyboard, and when each was pressed
        self._released_ns = -math.inf  # when the newest release was
        self._codes: dict[str, int] = {}  # of the keys that count until their release
        self._typed_ns: dict[str, int] = {}  # of those that count for a time
        self._steering = self._pushed = 0.0
        self._push: tuple[int, float] | None = None  # which way, and how fast it grows
        self._steered_ns: int | None = None  # when ``controls`` was last called

    def press(self, code: int, now_ns: int) -> None:
        """Take a press by the keyboard. The key is held once its character was typed."""
        self._down[code] = now_ns

    def release(self, code: int, now_ns: int) -> None:
        if self._down.pop(code, None) is not None:
            self._released_ns = now_ns
        self._codes = {key: held for key, held in self._codes.items() if held != code}

    def type(self, key: str, now_ns: int) -> bool:
        """Take a key from the terminal, at first or repeated; return whether it is obeyed."""
        if key == RELEASE:
            self.release_all()
            return True
        if key in self._codes:
            return True
        pressed = [(at_ns, code) for code, at_ns in self._down.items()
                   if code not in self._codes.values() and now_ns - at_ns <= PAIR_NS]
        if pressed:
            self._codes[key] = max(pressed)[1]
            self._typed_ns.pop(key, None)
            return True
        if now_ns - self._released_ns <= PAIR_NS:  # its key was released before the character came
            return True
        if self._counts_without_release:
            # Only the newest key repeats: the deadman's characters end when another key is held.
            held = self._held(now_ns)
            self._typed_ns.update({held_key: now_ns for held_key in (MANUAL, AUTONOMOUS) if held_key in held})
            # A brake right after a push, as calibrate_esc needs it, doesn't wait until the push is over.
            rivals = next((keys - {key} for keys in (THROTTLE_KEYS, {LEFT, RIGHT}) if key in keys), ())
            self._typed_ns = {typed: at_ns for typed, at_ns in self._typed_ns.items() if typed not in rivals}
            self._typed_ns[key] = now_ns
        return self._counts_without_release

    def release_all(self) -> None:
        """Release all keys until they are pressed again."""
        self._down.clear()
        self._codes.clear()
        self._typed_ns.clear()
        self._steering, self._push = 0.0, None

    def controls(self, now_ns: int) -> Controls:
        """Return the requests; none without a deadman. Steering and pushes move on from call to call."""
        held = self._held(now_ns)
        elapsed_s = 0.0 if self._steered_ns is None else (now_ns - self._steered_ns) / NS_PER_S
        step = STEERING_PER_S * elapsed_s
        self._steered_ns = now_ns
        if not held & {MANUAL, AUTONOMOUS}:
            self._steering, self._push = 0.0, None
            return Controls()
        target = (LEFT in held) - (RIGHT in held)
        self._steering = max(self._steering - step, min(self._steering + step, target))
        return Controls(self._steering, self._throttle(held, elapsed_s), MANUAL in held, AUTONOMOUS in held,
                        (MORE in held) - (LESS in held))

    def _throttle(self, held, elapsed_s):
        for ahead, back, push_from, pull_from, per_s in (
                (FORWARD, BACKWARD, PUSH_FROM, PULL_FROM, PUSH_PER_S),
                (SLOWLY_FORWARD, SLOWLY_BACKWARD, SLOWLY_FROM, SLOWLY_FROM, SLOWLY_PER_S)):
            if held & {ahead, back}:
                push = (ahead in held) - (back in held), per_s
                begin = push_from if ahead in held else pull_from
                self._pushed = min(1.0, self._pushed + per_s * elapsed_s) if push == self._push else begin
                self._push = push
                return push[0] * self._pushed
        self._push = None
        return 0.0

    def _held(self, now_ns):
        return set(self._codes) | {key for key, at_ns in self._typed_ns.items() if now_ns - at_ns <= HOLD_NS}
