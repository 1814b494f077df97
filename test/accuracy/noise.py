#!/usr/bin/env python3
"""Line noise, measured: what gets past the checksum, the protocol's checks and the gates, and what it does to the way.

    PYTHONPATH=src:test python3 -m accuracy.noise

The golden capture is sent over and over with bits flipped at random. Each frame that comes out is compared with what
the firmware meant. Each round begins with a rebooted Teensy, for the gates too, which live on from round to round. Exit
code 1 when more gets past than must, or when a wrong frame moves a wheel by more than 10 cm.

What must get past. A body of bytes sums up when the number that they spell is a multiple of 255 (256 ≡ 1), so a flip
of bit k of any byte changes the sum by +2**k or −2**k modulo 255, and noise is seen unless the changes add up to a
multiple of 255. Two flips do when they hit the same bit of two bytes in opposite directions. ``passing`` has any
number of flips, by the characteristic function of the sum, less the frame without a flip:

    P(change ≡ 0) = 1/255 × Σ over t = 0..254 of Π over bits of (1 − p + p × exp(±2πi × t × 2**k / 255))

Flips that make or break a flag or an escape cut frames up and join them; of such pieces 1 in 255 sums up. Hardly one
has a header and the length that goes with it, so that these count for the checksum and not for what makes sense.
"""
from __future__ import annotations

import json
import math
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from car_interface.teensy.link.framing import ESCAPE, FLAG, FrameDecoder
from car_interface.teensy.link.protocol import FORWARD, Malformed, Pong, SonarStatus, WheelStatus, decode
from car_interface.teensy.sensing.plausibility import Gates

CAPTURE = Path(__file__).resolve().parents[1] / "data" / "capture_mixed.bin"
RATES = (1e-5, 1e-4, 1e-3)
PULSE_M = math.pi * 0.095 / 20
MOST_HARM_M = 0.10
CHECKSUM = 255
MARGIN_SIGMAS = 5  # of a Poisson count; a run in CI must not fail by chance
ROUNDS_AT_ONCE = 50


class Sent(NamedTuple):
    chunk: tuple  # start and end of its bytes on the line, its closing flag included
    body: bytes
    record: object
    way: tuple | None  # pulses of both wheels since the last reset, signed; of a wheel report
    drive: int  # how many resets there were before


@dataclass
class Result:
    rate: float
    frames: int = 0
    lost: int = 0  # didn't come out as they were sent
    summed_up: int = 0  # wrong, but the checksum is right
    made_sense: int = 0  # of these, those that the protocol's checks let past
    got_past: int = 0  # of these, those that the gates let past
    refused: int = 0  # right ones, by the gates
    harm_m: float = 0.0  # the most by which a wrong frame moved a wheel
    error_m: float = 0.0  # the largest error of a wheel's way at any right report
    must_sum_up: float = 0.0
    must_make_sense: float = 0.0

    def failures(self) -> list[str]:
        found = [f"{count} wrong frames {name} where {must:.1f} must" for name, count, must in (
            ("summed up", self.summed_up, self.must_sum_up), ("made sense", self.made_sense, self.must_make_sense))
            if count > must + MARGIN_SIGMAS * math.sqrt(must) + MARGIN_SIGMAS]
        if self.harm_m > MOST_HARM_M:
            found.append(f"a wrong frame moved a wheel by {100 * self.harm_m:.1f} cm")
        return found


def load() -> tuple[bytes, list[Sent]]:
    """The capture, and what its frames are; the way is summed up here from the firmware's own structures."""
    lines = list(map(json.loads, CAPTURE.with_suffix(".jsonl").read_text(encoding="utf-8").splitlines()))
    frames, end, last, way, drive = [], lines[0]["end"] + 1, None, (0, 0), 0
    for line in lines[1:]:
        body = bytes.fromhex(line["raw"])
        is_report = line["cmd"] == 7
        if is_report:
            if last is not None and any(line[side]["dist_abs"] < last[side]["dist_abs"] for side in ("left", "right")):
                way, drive, last = (0, 0), drive + 1, None
            # Nothing was lost on the firmware's side: a report holds pulses of one direction only.
            way = tuple(sum_ + signed(line[side]["dist_abs"] - (last[side]["dist_abs"] if last else 0),
                                      line[side]["direction"]) for sum_, side in zip(way, ("left", "right")))
            last = line
        frames.append(Sent((end, line["end"] + 1), body, decode(body), way if is_report else None, drive))
        end = line["end"] + 1
    return CAPTURE.read_bytes(), frames


def signed(pulses: int, direction: int) -> int:
    return pulses if direction == FORWARD else -pulses


def passing(wire: bytes, rate: float) -> float:
    """The share of copies of this frame (its bytes on the line, without flags) that noise changes and that sum up."""
    unescaped = wire.replace(b"\x7d\x5e", FLAG).replace(b"\x7d\x5d", ESCAPE)
    bits = np.unpackbits(np.frombuffer(unescaped, np.uint8)[:, None], axis=1, bitorder="little")
    ones, zeros = bits.sum(axis=0), (1 - bits).sum(axis=0)
    turns = np.exp(2j * np.pi * np.outer(np.arange(CHECKSUM), 2 ** np.arange(8)) / CHECKSUM)
    product = ((1 - rate + rate * turns) ** zeros * (1 - rate + rate * turns.conj()) ** ones).prod(axis=1)
    return float(product.sum().real / CHECKSUM - (1 - rate) ** bits.size)


def cut_up(wire: bytes, rate: float) -> float:
    """At most how many pieces of this frame sum up because a flip made or broke a flag or an escape."""
    near = sum(1 for byte in wire for bit in range(8) if byte ^ 1 << bit in (*FLAG, *ESCAPE))
    escapes = 2 * wire.count(ESCAPE)
    return 2 * rate * (near + 8 * escapes + 2 * 8) / CHECKSUM


def must_get_past(capture: bytes, frames: list[Sent], rate: float) -> tuple[float, float]:
    """How many wrong frames in a round of the capture must sum up, and make sense, at most."""
    whole = pieces = 0.0
    for sent in frames:
        wire = capture[slice(*sent.chunk)].strip(FLAG)
        whole += passing(wire, rate)
        pieces += cut_up(wire, rate)
    return whole + pieces, whole


def flipped(capture: bytes, rounds: int, rate: float, random: np.random.Generator) -> bytes:
    """So many rounds of the capture, each bit flipped with this probability."""
    data = np.tile(np.frombuffer(capture, np.uint8), rounds)
    places = random.integers(0, 8 * data.size, random.binomial(8 * data.size, rate))
    np.bitwise_xor.at(data, places >> 3, (1 << (places & 7)).astype(np.uint8))
    return data.tobytes()


class Listener:
    """The end of the line: decoder, checks, gates, and the way of both wheels by what they let past."""

    def __init__(self, capture: bytes, frames: list[Sent], result: Result):
        self._capture, self._frames, self._result = capture, frames, result
        self._decoder, self._gates = FrameDecoder(), Gates()
        self._pings = {sent.record.timestamp1 for sent in frames if isinstance(sent.record, Pong)}
        self._pulses, self._offset = (0, 0), (0, 0)
        self._drive = None  # since the first right report after the last true reset the way is compared
        self._round = 0

    def hear(self, data: bytes) -> None:
        """Take some rounds, frame by frame."""
        feed = self._decoder.feed
        for start in range(0, len(data), len(self._capture)):
            feed(data[start:start + self._frames[0].chunk[0]])
            for sent in self._frames:
                first, end = sent.chunk
                self._result.frames += 1
                self._result.lost += 1
                for body in feed(data[start + first:start + end]):
                    self._take(body, sent)
            self._round += 1

    def _take(self, body, sent):
        result, record = self._result, decode(body)
        right = body == sent.body
        result.lost -= right
        if not right:
            result.summed_up += 1
            if isinstance(record, Malformed):
                return
            right = record == sent.record  # the filler alone is wrong, which nobody reads
            result.made_sense += not right
        verdict = self._judge(record)
        accepted = verdict is None or verdict.accepted
        result.got_past += accepted and not right
        result.refused += right and not accepted
        if isinstance(record, WheelStatus):
            # In this capture the firmware knew the directions of the first pulses, too.
            self._pulses = tuple(
                sum_ + proven + signed(unproven, wheel.direction)
                for sum_, proven, unproven, wheel in zip(self._pulses, verdict.pulses, verdict.unproven, record))
            if sent.way is not None and accepted:
                self._compare(sent, right)

    def _judge(self, record):
        if isinstance(record, WheelStatus):
            return self._gates.wheels(record)
        if isinstance(record, SonarStatus):
            return self._gates.sonar(record)
        return self._gates.pong(record, record.timestamp1 in self._pings) if isinstance(record, Pong) else None

    def _compare(self, sent, right):
        off = tuple(have - true for have, true in zip(self._pulses, sent.way))
        if self._drive != (self._round, sent.drive):
            if not right:
                return
            self._drive, self._offset = (self._round, sent.drive), off
        error_m = PULSE_M * max(abs(now - before) for now, before in zip(off, self._offset))
        if right:
            self._result.error_m = max(self._result.error_m, error_m)
        else:
            self._result.harm_m = max(self._result.harm_m, error_m)


def measure(frames: int, rate: float) -> Result:
    """Send at least so many frames."""
    capture, sent = load()
    random = np.random.default_rng([1, round(rate * 1e9)])
    result = Result(rate)
    listener = Listener(capture, sent, result)
    rounds = -(-frames // len(sent))
    for done in range(0, rounds, ROUNDS_AT_ONCE):
        listener.hear(flipped(capture, min(ROUNDS_AT_ONCE, rounds - done), rate, random))
    result.must_sum_up, result.must_make_sense = (rounds * count for count in must_get_past(capture, sent, rate))
    return result


def main() -> int:
    results = [measure(1_000_000, rate) for rate in RATES]
    for name, cell in (
            ("bit errors", "{0.rate:.0e}"), ("frames", "{0.frames:,}"), ("lost", "{0.lost:,}"),
            ("wrong, sum right", "{0.summed_up:,}"), ("must at most", "{0.must_sum_up:,.1f}"),
            ("wrong, sense", "{0.made_sense:,}"), ("must at most", "{0.must_make_sense:,.1f}"),
            ("wrong, past gates", "{0.got_past:,}"), ("harm of one, m", "{0.harm_m:.3f}")):
        print(f"{name:<20}" + "".join(f"{cell.format(result):>14}" for result in results))
    failures = [f"{result.rate:.0e}: {failure}" for result in results for failure in result.failures()]
    print("\n" + ("\n".join(failures) or "no more than must"))
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
