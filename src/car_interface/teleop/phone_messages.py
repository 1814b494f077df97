"""The messages between phone_drive and its pages: JSON text, one object per WebSocket message.

A page sends an object with ``type`` and exactly the fields of that type, of at most MAX_SIZE characters:

    {"type": "pin", "pin": "123456"}           admits a page that is new
    {"type": "key", "key": "…"}                admits a page again, by the key that it got
    {"type": "drive", "token": "…", "n": 7}    asks to be the driver
    {"type": "leave"}                          gives the driver's seat up
    {"type": "echo", "token": "…", "n": 8, "touch": "manual", "steering": 0.5, "throttle": 0.1, "scale": 0}
        what is touched: "" (nothing), "manual" or "autonomous"; steering −1 right .. +1 left; throttle −1 .. +1; scale
        1 and −1 while its button is pressed. Sent for each token, and when the touch or a stick changes.
    {"type": "e_stop"}                         by any page
    {"type": "clear", "token": "…", "n": 9}    ends the e-stop; the driver's only

``token`` is the newest that the server sent on this connection. ``n`` rises with each message of the connection that
has it, so that a message which arrives twice counts once.

The server sends objects with one of these fields:

    {"token": "…"}         20 times a second
    {"key": "…"}           the page is admitted. It keeps the key to itself, for its next connection.
    {"refused": "…"}       why the last message had no effect, in words
    {"closed": "…"}        why the connection is closed now, in words; "replaced": the page must not connect again
    {"status": {"driver": "you", "e_stop": false, "why": "…", "shown": {…}}}    5 times a second, and on a change
        driver: "you", "another" or "nobody"; why: why a touch doesn't count, in words, else empty; shown: the states of
        the car, in their own words. A page that showed an e-stop before it was admitted again sends it again.
"""
from __future__ import annotations

import json
import math
from typing import Any, Callable, Mapping

from car_interface.common.causes import AUTONOMOUS, MANUAL

MAX_SIZE = 512  # characters; an echo has 130
MAX_NUMBER = 2 ** 53  # the integers that JavaScript has
NOTHING = ""  # as touch


def _is_text(value):
    return isinstance(value, str) and len(value) <= 64


def _is_pin(value):
    return isinstance(value, str) and len(value) == 6 and value.isascii() and value.isdigit()


def _is_count(value):
    return type(value) is int and 0 <= value < MAX_NUMBER


def _is_ratio(value):
    return type(value) in (int, float) and -1 <= value <= 1


def _is_touch(value):
    return isinstance(value, str) and value in (NOTHING, MANUAL, AUTONOMOUS)


def _is_sign(value):
    return type(value) is int and abs(value) <= 1


EVIDENCE = {"token": _is_text, "n": _is_count}
FIELDS: Mapping[str, Mapping[str, Callable[[Any], bool]]] = {
    "pin": {"pin": _is_pin},
    "key": {"key": _is_text},
    "drive": EVIDENCE,
    "leave": {},
    "echo": {**EVIDENCE, "touch": _is_touch, "steering": _is_ratio, "throttle": _is_ratio, "scale": _is_sign},
    "e_stop": {},
    "clear": EVIDENCE,
}


def parse(data: Any) -> dict[str, Any] | None:
    """Return a page's message, or None where it is malformed. It never raises.

    Args:
        data: what arrived: text, or bytes of a binary message, which is malformed.
    """
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


def text_of(**fields: Any) -> str:
    """Return a server's message."""
    return json.dumps(fields, separators=(",", ":"), ensure_ascii=False)
