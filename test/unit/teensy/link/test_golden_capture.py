"""Every frame that the real Teensy firmware sent in the golden capture, field by field.

test/data/capture_mixed.bin is what it sent; the lines of test/data/capture_mixed.jsonl are from its own structures.
"""
from __future__ import annotations

import json
import random
from pathlib import Path

import pytest

from car_interface.teensy.link.framing import FrameDecoder
from car_interface.teensy.link.protocol import ErrorCount, Malformed, Pong, SonarStatus, WheelStatus, decode

DATA = Path(__file__).resolve().parents[3] / "data"
CAPTURE = (DATA / "capture_mixed.bin").read_bytes()
LINES = [json.loads(text) for text in (DATA / "capture_mixed.jsonl").read_text(encoding="utf-8").splitlines()]
BOOT, FRAMES = LINES[0], LINES[1:]


def fields_of(record):
    """A record as the capture's description has it."""
    if isinstance(record, Pong):
        return {"cmd": 2, "timestamp1": record.timestamp1, "timestamp2": record.timestamp2}
    if isinstance(record, SonarStatus):
        return {"cmd": 6, "sensor": record.sensor, "distance": record.echo_us, "when": record.when}
    if isinstance(record, WheelStatus):
        return {"cmd": 7, "left": wheel_fields(record.left), "right": wheel_fields(record.right)}
    if isinstance(record, ErrorCount):
        return {"cmd": 9, "count": record.count, "name": record.name}
    return record


def wheel_fields(wheel):
    return {"speed": wheel.speed, "direction": wheel.direction, "when": wheel.when, "dist": wheel.dist,
            "dist_abs": wheel.dist_abs}


def expected_fields(frame):
    """Of a frame's description, what a record carries: not the header, the bytes and the filler."""
    left_out = {"n", "start", "end", "dst", "src", "reserved", "len", "raw", "filler"}
    fields = {key: value for key, value in frame.items() if key not in left_out}
    for side in ("left", "right"):
        if side in fields:
            assert fields[side]["reserved"] == 0
            fields[side] = {key: value for key, value in fields[side].items() if key != "reserved"}
    return fields


def whole(data):
    return [data]


def byte_by_byte(data):
    return [data[index:index + 1] for index in range(len(data))]


def random_pieces(data):
    pieces, start, choose = [], 0, random.Random(2)
    while start < len(data):
        size = choose.choice((1, 2, 3, 7, 30, 64, 500))
        pieces.append(data[start:start + size])
        start += size
    return pieces


@pytest.fixture(scope="module", params=[whole, byte_by_byte, random_pieces])
def fed(request):
    """The bodies found in the capture, and the decoder that found them."""
    decoder = FrameDecoder()
    return [body for piece in request.param(CAPTURE) for body in decoder.feed(piece)], decoder


def test_capture_fed_gives_each_frame_s_bytes_in_order(fed):
    bodies, _ = fed
    assert [body.hex() for body in bodies] == [frame["raw"] for frame in FRAMES]


def test_capture_fed_gives_each_frame_s_fields_in_order(fed):
    bodies, _ = fed
    assert len(bodies) == len(FRAMES)
    for body, frame in zip(bodies, FRAMES):
        assert fields_of(decode(body)) == expected_fields(frame), frame


def test_capture_fed_has_no_fault_but_the_boot_frame(fed):
    _, decoder = fed
    tally = decoder.tally
    assert (tally.frames, tally.too_short, tally.bad_frames) == (795, 1, 0)
    assert tally.noise_bytes == BOOT["end"] - BOOT["start"] - 1 == 2
    assert tally.bytes_in == len(CAPTURE) == tally.frame_bytes + tally.flags + tally.noise_bytes
    assert tally.flags == CAPTURE.count(b"\x7e")
    assert decoder.pending == 0


def test_capture_with_each_body_s_header_spoiled_is_malformed():
    for frame in FRAMES[::11]:
        for place, value in ((0, 2), (1, 1), (2, 11), (3, 1)):
            body = bytearray.fromhex(frame["raw"])
            body[place] = value
            assert isinstance(decode(bytes(body)), Malformed)
