"""What is sent to the Teensy, against a model of its receiver with the faults that the deployed firmware has.

The receiver here is written from the description of the protocol alone; it shares nothing with the package.
"""
from __future__ import annotations

from itertools import product

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from car_interface.teensy.link.framing import CORRECTED, RESYNC_FILLER, SHIPPED, encode

FLAG, ESCAPE = 0x7e, 0x7d
LONGEST = 36  # bytes before the checksum


class ShippedReceiver:
    """The receiver in the cars' flash: ``accepted`` holds the bodies of the frames that it took."""

    def __init__(self, longest=LONGEST + 1):
        self.accepted = []
        self._longest = longest
        self._inside = False

    def feed(self, data):
        for byte in data:
            if byte == FLAG:
                self._flag()
            elif self._inside:
                self._take(byte)
        return self

    @property
    def waits_for_an_opening_flag(self):
        return not self._inside

    def _flag(self):
        if self._inside:
            if len(self._frame) > 4 and self._sum % 256 == 0xff:  # fault 1: no carry is added
                self.accepted.append(bytes(self._frame[:-1]))
            self._inside = False  # fault 3: a closing flag never opens the next frame
        else:
            self._inside, self._escaped, self._sum, self._frame = True, False, 0, []

    def _take(self, byte):
        if byte == ESCAPE and not self._escaped:
            self._escaped = True
            return
        self._sum += byte  # fault 2: as it is on the wire, still escaped; and the escape itself is left out
        self._frame.append(byte ^ 0x20 if self._escaped else byte)
        self._escaped = False
        if len(self._frame) > self._longest:
            self._inside = False  # fault 3: from here the next flag opens, though it was meant to close


def corrected_receiver_takes(frame):
    """Whether a firmware that keeps to the textbook would take one frame, and the body that it would see."""
    assert frame[0] == frame[-1] == FLAG and FLAG not in frame[1:-1]
    plain, escaped = [], False
    for byte in frame[1:-1]:
        if byte == ESCAPE and not escaped:
            escaped = True
        else:
            plain.append(byte ^ 0x20 if escaped else byte)
            escaped = False
    total = 0
    for byte in plain:
        total += byte
        total = total % 256 + total // 256
    return bytes(plain[:-1]) if total == 0xff else None


def received(frame):
    return ShippedReceiver().feed(frame).accepted


def ping_body(timestamp1):
    return bytes([2, 1, 1, 0]) + timestamp1.to_bytes(4, "little") + bytes(4)


BYTES = st.integers(0, 255) | st.sampled_from([0x7d, 0x7e, 0x5d, 0x5e, 0x00, 0xff])
BODIES = st.tuples(st.integers(1, 12), st.lists(BYTES, max_size=LONGEST - 4)).map(
    lambda case: bytes([2, 1, case[0], 0, *case[1]]))
CHECKSUM_WOULD_BE_A_FLAG = ping_body(0x00003e3f)  # 4 + 3e + 3f = 81, ff - 81 = 7e
CHECKSUM_WOULD_BE_AN_ESCAPE = ping_body(0x00003f3f)  # 4 + 3f + 3f = 82, ff - 82 = 7d


@given(BODIES)
@example(CHECKSUM_WOULD_BE_A_FLAG)
@example(CHECKSUM_WOULD_BE_AN_ESCAPE)
def test_shipped_frame_of_any_payload_is_received_as_it_was_meant(body):
    assert received(encode(body, SHIPPED)) == [body]


@given(BODIES)
@example(CHECKSUM_WOULD_BE_A_FLAG)
@example(CHECKSUM_WOULD_BE_AN_ESCAPE)
def test_shipped_frame_has_two_flags_of_its_own_and_a_checksum_that_is_neither_flag_nor_escaped(body):
    frame = encode(body, SHIPPED)
    assert frame[0] == frame[-1] == FLAG and FLAG not in frame[1:-1]
    assert frame[-2] not in (FLAG, ESCAPE) and frame[-3] != ESCAPE


@given(BODIES)
def test_shipped_frame_unescaped_holds_the_body_also_for_a_corrected_receiver(body):
    """A corrected one would refuse most of them by their checksum; but it would see the same body."""
    frame = encode(body, SHIPPED)[1:-1]
    plain = frame.replace(b"\x7d\x20", b"\x00").replace(b"\x7d\x5e", b"\x7e").replace(b"\x7d\x5d", b"\x7d")
    assert plain[:-1] == body


@given(BODIES)
def test_shipped_frame_where_nothing_carries_or_escapes_is_the_textbook_s(body):
    total = sum(body)
    checksum = 0xff - total % 256
    if total <= 0xff and not {FLAG, ESCAPE} & {*body, checksum}:
        assert encode(body, SHIPPED) == encode(body, CORRECTED) == bytes([FLAG, *body, checksum, FLAG])


@given(BODIES)
@example(ping_body(0x0000007e))  # the textbook checksum is 7d
def test_corrected_frame_of_any_payload_is_received_by_a_corrected_receiver(body):
    assert corrected_receiver_takes(encode(body, CORRECTED)) == body


@pytest.mark.once
@given(st.lists(BODIES, max_size=6))
def test_shipped_frames_in_a_row_leave_the_receiver_in_step(bodies):
    receiver = ShippedReceiver().feed(b"".join(encode(body, SHIPPED) for body in bodies))
    assert receiver.accepted == bodies
    assert receiver.waits_for_an_opening_flag


def test_shipped_frame_of_every_payload_of_two_bytes_is_received():
    for pair in product(range(256), repeat=2):
        body = bytes([2, 1, 3, 0, *pair])
        assert received(encode(body)) == [body]


@pytest.mark.parametrize("body, frame", [
    pytest.param(ping_body(0x01020304), "7e 02010100 04030201 00000000 f1 7e", id="nothing_carries_or_escapes"),
    pytest.param(ping_body(0xffffffff), "7e 02010100 ffffffff 00000000 ff 7e", id="a_carry_is_not_added"),
    pytest.param(ping_body(0x0000007e), "7e 02010100 7d5e000000 00000000 9d 7e", id="an_escaped_byte_counts_as_5e"),
    pytest.param(ping_body(0x0000007d), "7e 02010100 7d5d000000 00000000 9e 7e", id="an_escaped_byte_counts_as_5d"),
    pytest.param(CHECKSUM_WOULD_BE_A_FLAG, "7e 0201017d20 3f3e0000 00000000 5e 7e",
                 id="a_checksum_of_7e_is_moved_by_the_reserved_byte"),
    pytest.param(CHECKSUM_WOULD_BE_AN_ESCAPE, "7e 0201017d20 3f3f0000 00000000 5d 7e",
                 id="a_checksum_of_7d_is_moved_by_the_reserved_byte"),
])
def test_shipped_frame_spelled_out_by_hand(body, frame):
    assert encode(body, SHIPPED) == bytes.fromhex(frame)


@pytest.mark.parametrize("body, frame", [
    pytest.param(ping_body(0x01020304), "7e 02010100 04030201 00000000 f1 7e", id="nothing_carries_or_escapes"),
    pytest.param(ping_body(0xffffffff), "7e 02010100 ffffffff 00000000 fb 7e", id="carries_come_round"),
    pytest.param(ping_body(0x0000007e), "7e 02010100 7d5e000000 00000000 7d5d 7e", id="an_escaped_checksum"),
])
def test_corrected_frame_spelled_out_by_hand(body, frame):
    assert encode(body, CORRECTED) == bytes.fromhex(frame)


# The model is only worth what it predicts: these shares were measured on the real firmware with the textbook checksum.

def test_textbook_pings_of_a_minute_in_ms_are_answered_by_half_as_measured():
    answered = sum(bool(received(encode(ping_body(ms), CORRECTED))) for ms in range(60_000))
    assert answered / 60_000 == pytest.approx(0.51, abs=0.01)


def test_textbook_pings_over_all_32_bits_are_answered_by_one_in_twenty_as_measured():
    timestamps = [n * 2654435761 % 2 ** 32 for n in range(20_000)]  # spread evenly over the range
    answered = sum(bool(received(encode(ping_body(timestamp), CORRECTED))) for timestamp in timestamps)
    assert 0.035 < answered / len(timestamps) < 0.065


PING = encode(ping_body(1))


@pytest.mark.parametrize("before", [
    pytest.param("7e", id="an_odd_flag"),
    pytest.param("7e 02010100", id="a_frame_that_lost_its_end"),
    pytest.param("7e 02010100 7d", id="a_frame_that_ended_in_an_escape"),
    pytest.param("7e" + "55" * 50 + "7e", id="an_overlong_frame"),
])
def test_receiver_out_of_step_loses_every_later_frame_until_the_filler(before):
    receiver = ShippedReceiver().feed(bytes.fromhex(before) + PING * 10)
    assert receiver.accepted == []
    assert receiver.feed(RESYNC_FILLER + PING).accepted == [ping_body(1)]


@pytest.mark.parametrize("longest", [LONGEST, LONGEST + 1, LONGEST + 2])
@pytest.mark.parametrize("escaped", [b"", b"\x7d"], ids=["plain", "after_an_escape"])
def test_filler_brings_the_receiver_to_wait_for_an_opening_flag_from_every_state(longest, escaped):
    for received_so_far in range(longest + 1):
        receiver = ShippedReceiver(longest).feed(b"\x7e" + b"\x55" * received_so_far + escaped)
        receiver.feed(RESYNC_FILLER)
        assert receiver.waits_for_an_opening_flag
        assert receiver.feed(PING).accepted == [ping_body(1)]


def test_filler_to_a_receiver_in_step_changes_nothing():
    receiver = ShippedReceiver().feed(PING + RESYNC_FILLER + PING)
    assert receiver.accepted == [ping_body(1)] * 2


def test_filler_is_39_zeros():
    assert RESYNC_FILLER == b"\x00" * 39
