"""The messages between phone_drive and its pages: JSON text, one object per WebSocket message.

A page sends an object with ``type`` and exactly the fields of that type, of at most MAX_SIZE characters:

    {"type": "pin", "pin": "123456"}           admits a page that is new
    {"type": "key", "key": "…"}                admits a page again, by the key that it got
    {"type": "watch"}                          admits a guest, who sees and stops; refused unless a parameter allows it
    {"type": "drive", "token": "…", "n": 7}    asks to be the driver
    {"type": "leave"}                          gives the driver's seat up
    {"type": "echo", "token": "…", "n": 8, "touch": "manual", "steering": 0.5, "throttle": 0.1, "scale": 0}
        what is touched: "" (nothing), "manual" or "autonomous"; steering −1 right .. +1 left; throttle −1 .. +1; scale
        1 and −1 while its button is pressed. Sent for each token, and when the touch or a stick changes.
    {"type": "e_stop"}                         by any page
    {"type": "clear", "token": "…", "n": 9}    ends the e-stop; the driver's only

The next four are the driver's, too. Each is answered by "done" or "refused":

    {"type": "record", "token": "…", "n": 9, "on": true}       begins a recording; false ends it, and makes its report
    {"type": "trim", "token": "…", "n": 9, "name": "center", "value": 5130}    "center" or "neutral", duty; see "trims"
    {"type": "save", "token": "…", "n": 9}                     writes both into the car's files
    {"type": "calibrate", "token": "…", "n": 9, "what": "begin"}    or "finish" (with what is known) or "give up"; it
        drives while the touch is "autonomous"

And a page that isn't a guest's:

    {"type": "open", "name": "car_2026-11-26_12-00-00.html"}    a name of "recordings"; answered by "file"

``token`` is the newest that the server sent on this connection. ``n`` rises with each message of the connection that
has it, so that a message which arrives twice counts once.

The server sends objects with one of these fields:

    {"token": "…"}         20 times a second
    {"key": "…"}           the page is admitted. It keeps the key to itself, for its next connection; a guest has none.
    {"refused": "…"}       why the last message had no effect, in words
    {"done": "…"}          what it had, in words
    {"file": "/files/…"}   where to get a file, once, within a minute: a report for a new tab, a recording to be saved
    {"closed": "…"}        why the connection is closed now, in words; "replaced": the page must not connect again
    {"status": {"driver": "you", "guest": false, "e_stop": false, "why": "…", "delay": 0.04}}    5 times a second, and
        on a change
        driver: "you", "another" or "nobody"; why: why a touch doesn't count, in words, else empty; delay: [s] from a
        token to its echo, null: none came
    {"car": {…}}           groups of the car's state: all of them at first, then 5 times a second those that changed

Groups, each null until it is known. A number that isn't known is null; infinite ones are "inf" and "-inf". ``cause`` is
a constant of common/causes.py, for the page's own use; ``text`` is the node's own words, for people, also where its
node is silent (cause "silent", level 2).

    who        cause, text: whose deadman is held, of teleop_logi
    steering   source ("locked", "no human", "neutral", "teleop", "planner"), cause, text; asked, granted: −1 right ..
               +1 left (asked is null while a planner steers); asked_radius, radius: [m], left positive, "inf": straight
               on, asked_radius 0: nobody asks; limit, limit_text: what cuts it, empty: nothing
    throttle   source, cause, text, limit, limit_text: likewise; mode ("manual", "autonomous", …); scale: 0 .. 1, of
               driving by hand; asked, granted: −1 .. +1
    speed      [m/s], forward positive
    planner    source ("drive", "cmd_vel", …), cause, text, speed [m/s]: what is asked for
    esc        profile (its kind), state ("ARMING", "NEUTRAL", "FORWARD", "BRAKING", "HOLD", "REVERSE"), text
    sonars     name: [range in m, age in s]. The range is "inf": nothing in range, "-inf": too near
    layout     sonars: name: [x, y in m from the middle of the rear axle, x ahead, y to the left; yaw in rad];
               field_of_view [rad], max_range [m]; front, rear, width: [m] of the car, from the middle of the rear axle
    board, teensy, battery, worst    level (0 fine, 1 warning, 2 bad), text, remedy. Of the servo board, the Teensy's
               link (and delay: [s] of its newest ping), the battery, and the worst of all that is on /diagnostics
    recording  state ("off", "starting", "on", "closing", "report"), name, age [s], size [MB], text: what it does, or
               how the last one ended
    recordings [{"name": "….bag", "size": MB, "report": "….html" or ""}, …], the newest first
    trims      "center", "neutral": value, low, high [duty]; null: that node isn't there, or its limits are 0
    calibration    state ("off", "starting", "on", "over"), phase (of tools/calibration/drive/step.py), text: what it
               does or waits for, or how it ended; fraction 0 .. 1; known: lines, missing: lines; driven, left: [s]
"""
from __future__ import annotations

import json
import math
import re
from typing import Any, Callable, Mapping

from car_interface.common.causes import AUTONOMOUS, MANUAL
from car_interface.common.units import MAX_DUTY

MAX_SIZE = 512  # characters; an echo has 130
MAX_NUMBER = 2 ** 53 - 1  # the integers that JavaScript has
NOTHING = ""  # as touch
CENTER, NEUTRAL = "center", "neutral"  # trims
BEGIN, FINISH, GIVE_UP = "begin", "finish", "give up"
PIN = re.compile("[0-9]{6}")
FILE_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,90}\.(bag|html)")  # no folder, nothing hidden


def _is_text(value):
    return isinstance(value, str) and len(value) <= 64


def _is_ratio(value):
    return type(value) in (int, float) and -1 <= value <= 1


def _is_flag(value):
    return isinstance(value, bool)


def _is_one_of(*words):
    return lambda value: isinstance(value, str) and value in words


def _is_integer(low, high):
    return lambda value: type(value) is int and low <= value <= high


def _matches(pattern):
    return lambda value: isinstance(value, str) and pattern.fullmatch(value) is not None


EVIDENCE = {"token": _is_text, "n": _is_integer(0, MAX_NUMBER)}
FIELDS: Mapping[str, Mapping[str, Callable[[Any], bool]]] = {
    "pin": {"pin": _matches(PIN)},
    "key": {"key": _is_text},
    "drive": EVIDENCE,
    "leave": {},
    "echo": {**EVIDENCE, "touch": _is_one_of(NOTHING, MANUAL, AUTONOMOUS), "steering": _is_ratio,
             "throttle": _is_ratio, "scale": _is_integer(-1, 1)},
    "e_stop": {},
    "clear": EVIDENCE,
    "watch": {},
    "record": {**EVIDENCE, "on": _is_flag},
    "trim": {**EVIDENCE, "name": _is_one_of(CENTER, NEUTRAL), "value": _is_integer(0, MAX_DUTY)},
    "save": EVIDENCE,
    "calibrate": {**EVIDENCE, "what": _is_one_of(BEGIN, FINISH, GIVE_UP)},
    "open": {"name": _matches(FILE_NAME)},
}
DRIVERS = frozenset({"record", "trim", "save", "calibrate"})  # commands that the node executes for the driver


def parse(data: Any) -> dict[str, Any] | None:
    """Return a page's message, or None where it is malformed, as a binary one is. It never raises."""
    if not isinstance(data, str) or len(data) > MAX_SIZE:
        return None
    try:
        message = json.loads(data, parse_constant=lambda name: math.nan)
    except (ValueError, RecursionError):
        return None
    kind = message.get("type") if isinstance(message, dict) else None
    fields = FIELDS.get(kind) if isinstance(kind, str) else None
    if fields is None or set(message) != {"type", *fields}:
        return None
    return message if all(is_right(message[name]) for name, is_right in fields.items()) else None


def number(value: float, digits: int = 3) -> float | str | None:
    """Return a number as JSON has it: null for NaN, a text for an infinite one, else rounded."""
    if not math.isfinite(value):
        return None if math.isnan(value) else "inf" if value > 0 else "-inf"
    return round(value, digits)


def text_of(**fields: Any) -> str:
    """Return a server's message, in ASCII: a text with a byte that was no UTF-8 could not be sent otherwise."""
    return json.dumps(fields, separators=(",", ":"))
