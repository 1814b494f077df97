"""Every frame that the real Teensy firmware sent in the golden capture, field by field.

test/data/capture_mixed.bin is what it sent; the lines of test/data/capture_mixed.jsonl are from its own structures.
"""
from __future__ import annotations

import json
import random
from pathlib import Path

import pytest

from car_interface.teensy.link.framing import FrameDecoder
from car_interface.teensy.link.protocol import ErrorCount, Pong, SonarStatus, WheelStatus, decode

DATA = Path(__file__).resolve().parents[3] / "data"
CAPTURE = (DATA / "capture_mixed.bin").read_bytes()
LINES = [json.loads(text) for text in (DATA / "capture_mixed.jsonl").read_text(encoding="utf-8").splitlines()]
BOOT, FRAMES = LINES[0], LINES[1:]
COMMANDS = {Pong: 2, SonarStatus: 6, WheelStatus: 7, ErrorCount: 9}


def fields_of(record):
    """A record as the capture's description has it."""
    fields = record._asdict()
    if isinstance(record, SonarStatus):
        fields["distance"] = fields.pop("echo_us")
    elif isinstance(record, WheelStatus):
        fields = {side: wheel._asdict() for side, wheel in fields.items()}
    return {"cmd": COMMANDS[type(record)], **fields}


def expected_fields(frame):
    """Of a frame's description, what a record carries: not the header, the bytes and the filler."""
    left_out = {"n", "start", "end", "dst", "src", "reserved", "len", "raw", "filler"}
    fields = {key: value for key, value in frame.items() if key not in left_out}
    for side in ("left", "right"):
        if side in fields:
            assert fields[side]["reserved"] == 0
            fields[side] = {key: value for key, value in fields[side].items() if key != "reserved"}
    return fields


def random_pieces(data):
    pieces, start, choose = [], 0, random.Random(2)
    while start < len(data):
        size = choose.choice((1, 2, 3, 7, 30, 64, 500))
        pieces.append(data[start:start + size])
        start += size
    return pieces


@pytest.mark.parametrize("cut", [lambda data: [data], random_pieces], ids=["whole", "random_pieces"])
def test_capture_gives_each_frame_s_bytes_and_fields_in_order_and_no_fault_but_the_boot_frame(cut):
    decoder = FrameDecoder()
    bodies = [body for piece in cut(CAPTURE) for body in decoder.feed(piece)]
    assert [body.hex() for body in bodies] == [frame["raw"] for frame in FRAMES]
    for body, frame in zip(bodies, FRAMES):
        assert fields_of(decode(body)) == expected_fields(frame), frame
    tally = decoder.tally
    assert (tally.frames, tally.too_short, tally.bad_frames, decoder.pending) == (795, 1, 0, 0)
    assert tally.noise_bytes == BOOT["end"] - BOOT["start"] - 1 == 2
    assert tally.bytes_in == len(CAPTURE) == tally.frame_bytes + tally.flags + tally.noise_bytes
    assert tally.flags == CAPTURE.count(b"\x7e")
