"""What is sent to the Teensy, against a model of its receiver with the faults that the deployed firmware has.

The receiver here is written from the description of the protocol alone; it shares nothing with the package.
"""
from __future__ import annotations

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


@pytest.mark.once
@given(st.lists(BODIES, max_size=6))
@example([CHECKSUM_WOULD_BE_A_FLAG, CHECKSUM_WOULD_BE_AN_ESCAPE, CHECKSUM_WOULD_BE_A_FLAG])
def test_shipped_frames_of_any_payloads_are_received_and_leave_the_receiver_in_step(bodies):
    receiver = ShippedReceiver().feed(b"".join(encode(body, SHIPPED) for body in bodies))
    assert receiver.accepted == bodies
    assert receiver.waits_for_an_opening_flag


@given(BODIES)
@example(ping_body(0x0000007e))  # the textbook checksum is 7d
def test_corrected_frame_of_any_payload_is_received_by_a_corrected_receiver(body):
    assert corrected_receiver_takes(encode(body, CORRECTED)) == body


@pytest.mark.parametrize("timestamp, shipped, corrected", [
    pytest.param(0x01020304, "7e 02010100 04030201 00000000 f1 7e", "7e 02010100 04030201 00000000 f1 7e",
                 id="nothing_carries_or_escapes"),
    pytest.param(0xffffffff, "7e 02010100 ffffffff 00000000 ff 7e", "7e 02010100 ffffffff 00000000 fb 7e",
                 id="a_carry_is_not_added_and_comes_round"),
    pytest.param(0x0000007e, "7e 02010100 7d5e000000 00000000 9d 7e", "7e 02010100 7d5e000000 00000000 7d5d 7e",
                 id="an_escaped_byte_counts_as_5e_and_a_checksum_is_escaped"),
    pytest.param(0x0000007d, "7e 02010100 7d5d000000 00000000 9e 7e", "7e 02010100 7d5d000000 00000000 7d5e 7e",
                 id="an_escaped_byte_counts_as_5d_and_a_checksum_is_escaped"),
    pytest.param(0x00003e3f, "7e 0201017d20 3f3e0000 00000000 5e 7e", "7e 02010100 3f3e0000 00000000 7d5e 7e",
                 id="a_checksum_of_7e_is_moved_by_the_reserved_byte"),
    pytest.param(0x00003f3f, "7e 0201017d20 3f3f0000 00000000 5d 7e", "7e 02010100 3f3f0000 00000000 7d5d 7e",
                 id="a_checksum_of_7d_is_moved_by_the_reserved_byte"),
])
def test_frame_spelled_out_by_hand(timestamp, shipped, corrected):
    assert encode(ping_body(timestamp)) == encode(ping_body(timestamp), SHIPPED) == bytes.fromhex(shipped)
    assert encode(ping_body(timestamp), CORRECTED) == bytes.fromhex(corrected)


# The model is only worth what it predicts: these shares were measured on the real firmware with the textbook checksum.

@pytest.mark.parametrize("timestamps, ratio, error", [
    pytest.param(range(0, 60_000, 3), 0.51, 0.01, id="a_minute_in_ms"),
    pytest.param([n * 2654435761 % 2 ** 32 for n in range(20_000)], 0.05, 0.015, id="spread_over_all_32_bits"),
])
def test_textbook_pings_are_answered_as_rarely_as_measured(timestamps, ratio, error):
    answered = sum(bool(received(encode(ping_body(timestamp), CORRECTED))) for timestamp in timestamps)
    assert answered / len(timestamps) == pytest.approx(ratio, abs=error)


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
    assert receiver.feed(RESYNC_FILLER + PING).accepted == [ping_body(1)] * 2  # in step it changes nothing


@pytest.mark.parametrize("longest", [LONGEST, LONGEST + 1, LONGEST + 2])
@pytest.mark.parametrize("escaped", [b"", b"\x7d"], ids=["plain", "after_an_escape"])
def test_filler_brings_the_receiver_to_wait_for_an_opening_flag_from_every_state(longest, escaped):
    for received_so_far in range(longest + 1):
        receiver = ShippedReceiver(longest).feed(b"\x7e" + b"\x55" * received_so_far + escaped)
        receiver.feed(RESYNC_FILLER)
        assert receiver.waits_for_an_opening_flag
        assert receiver.feed(PING).accepted == [ping_body(1)]
