"""Decodes records from the Teensy, and encodes commands to it: the content of frames.

``decode`` turns the body of a frame into a record, or into ``Malformed`` with the reason; it never raises. Commands
are bodies of frames for ``framing.encode``; their functions raise ProtocolError for arguments that the Teensy can't
take. All fields are little endian and packed.
"""
from __future__ import annotations

from struct import Struct
from typing import NamedTuple, Sequence, Union

from car_interface.common.errors import ProtocolError
from car_interface.common.vehicle_geometry import SONARS

HOST, TEENSY = 1, 2  # addresses
(PING_QUERY, PONG_RESP, SET_SONAR_SEQ, SONAR_STOP, SONAR_START, SONAR_STATUS, WHEEL_STATUS, WHEEL_RESET, ERROR_COUNT,
 GET_COUNTERS, _SONAR_RETRY, SONAR_WAIT) = range(1, 13)

FORWARD, BACKWARD, NO_DIRECTION, DIRECTION_ERROR = range(4)
MAX_SEQUENCE = 24  # the firmware's array has four entries for each sonar
MAX_COUNTER_NAME = 23
UINT32 = 2 ** 32
MAX_SONAR_WAIT_MS = UINT32 // 2 - 1  # the firmware's comparison of times takes more than this for no wait at all


def ahead(later: int, earlier: int) -> int:
    """Return how far one wrapping 32-bit counter is ahead of another: −2**31 .. 2**31 − 1."""
    return (later - earlier + UINT32 // 2) % UINT32 - UINT32 // 2


class Pong(NamedTuple):
    timestamp1: int  # as the host sent it
    timestamp2: int  # the Teensy's clock, ms, wraps at 2**32


class SonarStatus(NamedTuple):
    sensor: int  # index in SONARS
    echo_us: int  # there and back, or the sensor's own time-out, see ranging; 0 = its pin was high all the time
    when: int  # the Teensy's clock, ms


class Wheel(NamedTuple):
    speed: int  # pulses per second over the last ten pulses and repeats; falls to 0 within 2 s after a stop
    direction: int  # FORWARD, BACKWARD, NO_DIRECTION yet, DIRECTION_ERROR; meaningless for the first two pulses
    when: int  # the Teensy's clock at the last pulse or repeat, ms; 0 before the first pulse
    dist: int  # dist_abs at the first pulse of the present direction
    dist_abs: int  # pulses since the last reset, in either direction


class WheelStatus(NamedTuple):
    left: Wheel
    right: Wheel


class ErrorCount(NamedTuple):
    count: int
    name: str


class Malformed(NamedTuple):
    """A frame with a right checksum that the Teensy can't have sent; 1 in 255 corrupt frames gets this far."""

    reason: str
    body: bytes
    is_unknown_command: bool = False


Record = Union[Pong, SonarStatus, WheelStatus, ErrorCount, Malformed]

_PONG = Struct("<4xII")
_SONAR = Struct("<4xBxHI")  # the byte after the sensor is filler: a random byte of the Teensy's stack
_WHEELS = Struct("<4xHBBIIIHBBIII")
_COUNT = Struct("<4xI")
_PING = Struct("<II")
_WAIT = Struct("<I")
_new = tuple.__new__  # builds a record in a third of the time that its own constructor takes


def _pong(body):
    return _new(Pong, _PONG.unpack(body))


def _sonar(body):
    record = _new(SonarStatus, _SONAR.unpack(body))
    return record if record[0] < len(SONARS) else Malformed("sensor above 5", body)


def _wheels(body):
    (left_speed, left_direction, left_reserved, left_when, left_dist, left_dist_abs,
     right_speed, right_direction, right_reserved, right_when, right_dist, right_dist_abs) = _WHEELS.unpack(body)
    if left_direction > DIRECTION_ERROR or right_direction > DIRECTION_ERROR:
        return Malformed("direction above 3", body)
    if left_reserved or right_reserved:
        return Malformed("a wheel's reserved byte isn't 0", body)
    return _new(WheelStatus, (_new(Wheel, (left_speed, left_direction, left_when, left_dist, left_dist_abs)),
                              _new(Wheel, (right_speed, right_direction, right_when, right_dist, right_dist_abs))))


def _error_count(body):
    name, end, rest = body[_COUNT.size:].partition(b"\0")
    if not name or not end or rest or len(name) > MAX_COUNTER_NAME or not name.isascii():
        return Malformed("a counter's name isn't 1 to 23 ASCII characters and a NUL", body)
    return ErrorCount(_COUNT.unpack_from(body)[0], name.decode("ascii"))


def _header(command):
    return bytes((HOST, TEENSY, command, 0))


_DECODERS = {
    _header(PONG_RESP): (_PONG.size, _pong),
    _header(SONAR_STATUS): (_SONAR.size, _sonar),
    _header(WHEEL_STATUS): (_WHEELS.size, _wheels),
    _header(ERROR_COUNT): (None, _error_count),
}


def decode(body: bytes) -> Record:
    """Return the record in a frame's body (header and payload, without checksum)."""
    size, decoder = _DECODERS.get(body[:4], _NO_DECODER)
    if size is not None and size != len(body):
        return Malformed(f"{len(body)} bytes where this command has {size}", body)
    return decoder(body)


def _unknown(body):
    if body[:2] != _header(0)[:2]:
        return Malformed("not from the Teensy to the host", body)
    if body[3:4] != b"\0":
        return Malformed("the header's reserved byte isn't 0", body)
    return Malformed(f"unknown command {body[2]}", body, is_unknown_command=True)


_NO_DECODER = (None, _unknown)


def _command(command, payload=b""):
    return bytes((TEENSY, HOST, command, 0)) + payload


STOP_SONARS, START_SONARS = _command(SONAR_STOP), _command(SONAR_START)
RESET_WHEELS = _command(WHEEL_RESET)  # both odometers to zero, their direction to "none yet"
# Every counter that isn't zero. Once a second at most: the answers take the Teensy's time.
SEND_COUNTERS = _command(GET_COUNTERS)


def ping(timestamp1: int) -> bytes:
    """Return PING_QUERY. ``timestamp1``, 0..2**32 − 1, comes back verbatim in the pong."""
    return _command(PING_QUERY, _PING.pack(timestamp1, 0))


def set_sonar_sequence(sensors: Sequence[int]) -> bytes:
    """Return SET_SONAR_SEQ: the order in which the sonars fire, 1 to 24 of the ids 0..5, repeats allowed.

    Raises:
        ProtocolError: for anything else; the Teensy would skip a bad id and keep the old entry in its place.
    """
    if not 1 <= len(sensors) <= MAX_SEQUENCE:
        raise ProtocolError(f"a sonar sequence has 1 to {MAX_SEQUENCE} entries, not {len(sensors)}")
    for sensor in sensors:
        if not 0 <= sensor < len(SONARS):
            raise ProtocolError(f"there is no sonar {sensor}: ids go from 0 to {len(SONARS) - 1}")
    return _command(SET_SONAR_SEQ, bytes((len(sensors), *sensors)))


def sonar_wait(wait_ms: int) -> bytes:
    """Return SONAR_WAIT: the pause between an echo and the next sonar's ping, 0..2**31 − 1 ms; 50 at power-up.

    Raises:
        ProtocolError: for anything else.
    """
    if not 0 <= wait_ms <= MAX_SONAR_WAIT_MS:
        raise ProtocolError(f"a sonar wait is 0 to {MAX_SONAR_WAIT_MS} ms, not {wait_ms}")
    return _command(SONAR_WAIT, _WAIT.pack(wait_ms))
