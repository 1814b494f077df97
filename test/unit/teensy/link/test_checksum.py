"""What is sent to the Teensy, against the simulated receiver with the faults that the deployed firmware has.

That receiver shares nothing with this package's own framing; test/unit/sim holds it against the original's.
"""

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from car_interface.teensy.link.framing import CORRECTED, RESYNC_FILLER, SHIPPED, encode
from teensy_bench import ping, received

BYTES = st.integers(0, 255) | st.sampled_from([0x7d, 0x7e, 0x5d, 0x5e, 0x00, 0xff])
BODIES = st.tuples(st.integers(1, 12), st.lists(BYTES, max_size=32)).map(
    lambda case: bytes([2, 1, case[0], 0, *case[1]]))
FLAG_AS_CHECKSUM = ping(0x00003e3f)  # 4 + 3e + 3f = 81, ff - 81 = 7e
ESCAPE_AS_CHECKSUM = ping(0x00003f3f)  # 4 + 3f + 3f = 82, ff - 82 = 7d


@pytest.mark.once
@pytest.mark.parametrize("checksum", [SHIPPED, CORRECTED])
@given(st.lists(BODIES, max_size=4))
@example([FLAG_AS_CHECKSUM, ESCAPE_AS_CHECKSUM, ping(0x0000007e), FLAG_AS_CHECKSUM])
def test_frames_of_any_payloads_are_received_and_leave_the_receiver_in_step(checksum, bodies):
    packets, _ = received(b"".join(encode(body, checksum) for body in bodies), corrected=checksum == CORRECTED)
    assert [packet[:len(body)] for packet, body in zip(packets, bodies)] == bodies and len(packets) == len(bodies)


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
    assert encode(ping(timestamp)) == encode(ping(timestamp), SHIPPED) == bytes.fromhex(shipped)
    assert encode(ping(timestamp), CORRECTED) == bytes.fromhex(corrected)


@pytest.mark.once
def test_half_of_the_textbook_pings_are_answered_as_measured_on_the_real_firmware():
    answered = [bool(received(encode(ping(ms), CORRECTED))[0]) for ms in range(0, 60_000, 7)]
    assert sum(answered) / len(answered) == pytest.approx(0.51, abs=0.01)


@pytest.mark.parametrize("before", ["7e", "7e 02010100", "7e" + "55" * 50 + "7e"])
def test_receiver_out_of_step_loses_every_later_frame_until_the_filler_which_changes_nothing_in_step(before):
    frame = encode(ping(1))
    lost = bytes.fromhex(before) + frame * 10
    assert received(lost)[0] == []
    assert len(received(lost + RESYNC_FILLER + frame)[0]) == 1
    assert len(received(lost + RESYNC_FILLER + frame + RESYNC_FILLER + frame)[0]) == 2


def test_filler_is_just_long_enough_for_a_receiver_that_waits_for_the_end_of_an_escape():
    before, frame = bytes.fromhex("7e" + "55" * 37 + "7d"), encode(ping(1))
    assert [len(received(before + bytes(zeros) + frame)[0]) for zeros in (38, 39)] == [0, 1]
    assert len(RESYNC_FILLER) == 39 and not any(RESYNC_FILLER)
