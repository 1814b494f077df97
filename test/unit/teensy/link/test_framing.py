"""Frames in a stream of bytes. Every frame here was sent by the real firmware (n = its line in the golden capture),
or is spelled out by hand from the protocol; none comes from this package's own encoder.
"""

from dataclasses import asdict

import pytest
from hypothesis import given
from hypothesis import strategies as st

from car_interface.teensy.link.framing import FrameDecoder
from teensy_bench import framed_by_the_textbook


def line(text):
    return bytes.fromhex(text)


BOOT = line("7e c1 3e 7e")  # n = 0
SONAR = line("7e 01020600 006b11057b0000 f9 7e")  # n = 2
SONAR_BODY = line("01020600 006b11057b0000")
WHEELS = line("7e 01020700 00000000327b00000100000001000000 000000004b7b00000100000001000000 7d5d 7e")  # n = 5
WHEELS_BODY = line("01020700 00000000327b00000100000001000000 000000004b7b00000100000001000000")
PONG = line("7e 01020200 7d5e7d5d7d5e7d5ddc7d5d0000 a8 7e")  # n = 45
PONG_BODY = line("01020200 7e7d7e7ddc7d0000")
COUNTER = line("7e 01020900 9b0b0000 7478427974657300 57 7e")  # n = 98
COUNTER_BODY = line("01020900 9b0b0000 7478427974657300")


def byte_by_byte(data):
    return [data[index:index + 1] for index in range(len(data))]


def decode(chunks):
    decoder = FrameDecoder()
    bodies = [body for chunk in chunks for body in decoder.feed(chunk)]
    return bodies, decoder


def adds_up(decoder, data, bodies):
    frame_bytes = sum(len(framed_by_the_textbook(body)) - 2 for body in bodies)
    return len(data) == frame_bytes + data.count(b"\x7e") + decoder.tally.noise_bytes + decoder.pending


CASES = {
    "nothing": (b"", [], {}),
    "frame_alone": (SONAR, [SONAR_BODY], {}),
    "frames_that_share_a_flag": (SONAR + COUNTER[1:], [SONAR_BODY, COUNTER_BODY], {}),
    "flags_doubled_and_more": (SONAR + line("7e7e7e") + COUNTER, [SONAR_BODY, COUNTER_BODY], {}),
    "longest_body_and_an_escaped_checksum": (WHEELS, [WHEELS_BODY], {}),
    "escapes_in_a_row": (PONG, [PONG_BODY], {}),
    "checksum_7e_is_escaped": (line("7e 01020200 7d5d0000005f9f0000 7d5e 7e"), [line("01020200 7d0000005f9f0000")], {}),
    "escaped_7d_before_a_plain_5e": (
        line("7e 01020600 0000 7d5d5e 00000000 1b 7e"), [line("01020600 0000 7d5e 00000000")], {}),
    "header_without_payload": (line("7e 00000001 fe 7e"), [line("00000001")], {}),
    "sum_that_carries_and_ends_at_ff": (line("7e ffffffff ff 7e"), [line("ffffffff")], {}),

    "boot_frame_that_shares_its_flag": (BOOT + SONAR[1:], [SONAR_BODY], {}),
    "header_cut_to_three_bytes": (line("7e 010206 f6 7e"), [], {}),
    "body_of_37_bytes": (line("7e 01020700") + bytes(33) + line("f5 7e"), [], {"too_long": 1}),
    "overlong_frame_before_a_good_one": (line("7e") + bytes(500) + line("ff") + SONAR, [SONAR_BODY], {"too_long": 1}),
    "overlong_frame_of_bad_escapes": (line("7e") + line("7d00") * 100 + SONAR, [SONAR_BODY], {"too_long": 1}),
    "longest_frame_on_the_line_is_still_looked_at": (
        line("7e") + line("7d5d") * 37 + line("7e"), [], {"bad_checksum": 1}),
    "checksum_wrong_by_one": (line("7e 01020600 006b11057b0000 f8 7e"), [], {"bad_checksum": 1}),
    "all_zeros_sum_to_0_and_not_to_ff": (line("7e 0000000000 7e"), [], {"bad_checksum": 1}),
    "frame_cut_in_the_middle": (SONAR[:9] + COUNTER, [COUNTER_BODY], {"bad_checksum": 1}),
    "frame_cut_with_the_next_flag_lost": (SONAR[:9] + COUNTER[1:], [], {"bad_checksum": 1}),
    "frame_aborted_by_7d_7e": (SONAR[:9] + line("7d") + COUNTER, [COUNTER_BODY], {"bad_escape": 1}),
    "abort_right_after_a_flag": (line("7e 7d 7e"), [], {"bad_escape": 1}),
    "escape_before_a_byte_that_needs_none": (line("7e 01020600 0000 7d05 00 00000000 f1 7e"), [], {"bad_escape": 1}),
    "escape_of_an_escape": (line("7e 01020600 0000 7d7d5e 00000000 1b 7e"), [], {"bad_escape": 1}),

    "tail_of_a_frame_in_whose_middle_the_port_was_opened": (SONAR[5:] + COUNTER, [COUNTER_BODY], {}),
    "much_noise_before_the_first_flag": (bytes(range(0x7d)) * 3 + SONAR, [SONAR_BODY], {"too_long": 1}),
    "as_much_of_it_as_a_frame_may_have": (bytes(74) + SONAR, [SONAR_BODY], {}),
    "frame_without_its_closing_flag_waits": (SONAR + COUNTER[:-1], [SONAR_BODY], {}),
    "resync_filler": (SONAR + bytes(39) + COUNTER, [SONAR_BODY, COUNTER_BODY], {"too_long": 1}),
    "bad_frame_between_good_ones": (
        SONAR + COUNTER[1:].replace(b"t", b"u") + WHEELS, [SONAR_BODY, WHEELS_BODY], {"bad_checksum": 1}),
}


@pytest.mark.parametrize("name", CASES)
def test_decoder_finds_the_frames_and_counts_the_faults_however_the_bytes_are_cut(name):
    data, bodies, faults = CASES[name]
    found, decoder = decode([data])
    assert found == bodies
    counted = asdict(decoder.tally)
    assert {kind: counted[kind] for kind in ("bad_checksum", "bad_escape", "too_long")} == {
        "bad_checksum": 0, "bad_escape": 0, "too_long": 0, **faults}
    assert decoder.tally.bad_frames == sum(faults.values())
    assert (decoder.tally.frames, decoder.tally.bytes_in) == (len(bodies), len(data))
    assert adds_up(decoder, data, bodies)
    for pieces in (byte_by_byte(data), *([data[:cut], data[cut:]] for cut in range(len(data)))):
        found, other = decode(pieces)
        assert found == bodies and other.tally == decoder.tally
    assert decoder.feed(b"\x7e" + WHEELS)[-1] == WHEELS_BODY  # the next frame is found after any of it


def test_pending_bytes_are_at_most_those_of_the_longest_frame_with_each_byte_escaped():
    _, decoder = decode([b"\x7e" + line("7d5d") * 37])
    assert (decoder.pending, decoder.tally.too_long) == (74, 0)
    decoder.feed(b"\x00")
    assert (decoder.pending, decoder.tally.too_long) == (0, 1)
    decoder.feed(b"\x00" * 1000)
    assert (decoder.pending, decoder.tally.too_long) == (0, 1)


def test_line_reopened_in_the_middle_of_a_frame_forgets_it():
    for middle, pending in ((SONAR[:9], 8), (bytes(200), 0)):  # the latter is overlong
        decoder = FrameDecoder()
        decoder.feed(middle)
        assert decoder.pending == pending
        decoder.reset()
        assert decoder.pending == 0
        assert decoder.feed(COUNTER[5:] + SONAR) == [SONAR_BODY]  # it was opened in the middle of another
        assert decoder.tally.bad_checksum == 0 and adds_up(decoder, middle + COUNTER[5:] + SONAR, [SONAR_BODY])


BYTES = st.integers(0, 255) | st.sampled_from([0x7e, 0x7d, 0x5e, 0x5d, 0x20, 0x00, 0xff])
BODIES = st.lists(BYTES, min_size=4, max_size=36).map(bytes).filter(any)  # zeros alone sum to 0 by any checksum


@pytest.mark.once
@given(st.lists(BODIES, max_size=8), st.booleans(), st.lists(st.integers(1, 40), min_size=1))
def test_decoder_fed_any_frames_in_any_pieces_returns_their_bodies(bodies, shares_flags, sizes):
    frames = [framed_by_the_textbook(body) for body in bodies]
    data = b"".join(frame[:-1] for frame in frames) + b"\x7e" if shares_flags else b"".join(frames)
    decoder, found, start = FrameDecoder(), [], 0
    while start < len(data):
        size = sizes[start % len(sizes)]
        found += decoder.feed(data[start:start + size])
        start += size
    assert found == bodies
    assert decoder.tally.frames == len(bodies) and decoder.tally.noise_bytes == 0


