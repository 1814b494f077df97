"""A bad serial line: what each fault does to the bytes, by itself. Time is passed in."""

import math
from pathlib import Path

import pytest

from car_interface.common.errors import ConfigError
from car_interface.sim.line import LASTING, BadLine, BitErrors, SlowReceiver

MS, S = 1_000_000, 1_000_000_000
NOW = 100 * S
SOME = bytes(range(256))
CAPTURE = (Path(__file__).resolve().parents[2] / "data" / "capture_mixed.bin").read_bytes()


@pytest.fixture
def line():
    return BadLine(seed=7)


def test_silence_keeps_everything_from_the_host_and_nothing_from_the_teensy_until_it_ends(line):
    line.begin("silence", 2.0, NOW)
    assert line.to_host(SOME, NOW) == line.to_host(SOME, NOW + 2 * S - 1) == b""
    assert line.to_teensy(SOME, NOW) == SOME
    assert line.to_host(SOME, NOW + 2 * S) == SOME


@pytest.mark.parametrize("fault", LASTING)
def test_fault_of_no_duration_ends_one_under_way(line, fault):
    line.begin(fault, 10, NOW)
    line.begin(fault, 0, NOW + S)
    assert line.to_host(SOME, NOW + S) == SOME


def test_cut_loses_so_many_bytes_and_no_more(line):
    line.cut(3)
    assert [line.to_host(data, NOW) for data in (b"", b"a", b"bcde", b"f")] == [b"", b"", b"de", b"f"]


def test_scramble_leaves_nothing_of_what_was_sent_in_either_direction_until_it_ends(line):
    line.begin("scramble", 1.0, NOW)
    for carry in (line.to_host, line.to_teensy):
        garbage = carry(CAPTURE, NOW)
        assert 0.4 < len(garbage) / len(CAPTURE) < 0.6
        assert CAPTURE[5:9] not in garbage
        assert carry(CAPTURE, NOW + S) == CAPTURE


@pytest.mark.parametrize("sent, received", [
    # 0 01100111 1 and 0 00011001 1 on the line; two by two: start 00, data 11 00 11 11 00 00 11 00, stop 11.
    pytest.param(b"\xe6\x98", b"\x4d", id="bits_that_come_in_pairs"),
    # The first stop bit is all that is high among 0 00000000 1 0 00000000 1: it falls on the fourth data bit.
    pytest.param(bytes(6), b"\x08\x08\x08", id="zeros"),
    pytest.param(b"\xff\x00", b"", id="start_bits_too_short_to_be_any"),
])
def test_receiver_at_half_the_rate_takes_two_bits_for_one(sent, received):
    assert SlowReceiver().receive(sent) == received


def test_flood_is_a_megabyte_a_second_behind_the_teensy_s_bytes(line):
    line.begin("flood", 1.0, NOW)
    total = 0
    for now_ns in range(NOW + 2 * MS, NOW + 2 * S, 2 * MS):
        data = line.to_host(b"teensy", now_ns)
        assert data.startswith(b"teensy")
        total += len(data) - len(b"teensy")
    assert total == 1_000_000


def test_bit_errors_come_at_their_rate_and_anywhere():
    noise = BitErrors(seed=3)
    noise.set_rate(0.01)
    size = 100_000
    wrong = b"".join(noise.flip(bytes(100)) for _ in range(size // 100))
    count = sum(bin(byte).count("1") for byte in wrong)
    expected, deviation = 8 * size * 0.01, math.sqrt(8 * size * 0.01 * 0.99)
    assert abs(count - expected) < 4 * deviation
    for bit in range(8):
        assert abs(sum(byte >> bit & 1 for byte in wrong) - expected / 8) < 4 * deviation / math.sqrt(8)


def test_bit_errors_reach_both_directions_and_end(line):
    line.bit_errors(0.1)
    assert line.to_host(SOME, NOW) != SOME != line.to_teensy(SOME, NOW)
    line.bit_errors(0)
    assert line.to_host(SOME, NOW) == line.to_teensy(SOME, NOW) == SOME


@pytest.mark.parametrize("fault, refuse, accepted", [
    ("silence", lambda line: line.begin("silence", -1, NOW), "0 to 3600 s"),
    ("scramble", lambda line: line.begin("scramble", 3601, NOW), "0 to 3600 s"),
    ("flood", lambda line: line.begin("flood", -0.1, NOW), "0 to 3600 s"),
    ("cut", lambda line: line.cut(-1), "a whole number from 0 to 1000000"),
    ("cut", lambda line: line.cut(1.5), "a whole number from 0"),
    ("bit_errors", lambda line: line.bit_errors(0.6), "0 to 0.5"),
    ("bit_errors", lambda line: line.bit_errors(-0.1), "0 to 0.5"),
])
def test_value_that_no_fault_can_have_is_refused(line, fault, refuse, accepted):
    with pytest.raises(ConfigError, match=f"^{fault} is .*; accepted: {accepted}"):
        refuse(line)
    assert line.to_host(SOME, NOW + S) == SOME
