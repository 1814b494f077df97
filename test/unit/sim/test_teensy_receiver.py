"""The simulated Teensy's receiver, with the four faults of the original."""

import pytest

from car_interface.sim.teensy_uart import COUNTER_NAMES, PacketPool, Receiver
from teensy_bench import GET_COUNTERS, GOOD, framed_for_the_receiver, message, received


def states_and_how_to_reach_them():
    """Every state of the receiver, by trying from each one found all kinds of bytes: (phase, filled) → wire."""
    found, new = {}, [b""]
    kinds = (b"\x7e", b"\x7d", b"\x00", framed_for_the_receiver(message(GET_COUNTERS)))
    while new:
        wire = new.pop(0)
        state = state_of(receiver_after(wire))
        if state not in found:
            found[state] = wire
            new += [wire + kind for kind in kinds]
    return found


def state_of(receiver):
    """(phase, bytes in the packet); without a packet it is idle."""
    return receiver._phase if receiver._packet is not None else "idle", receiver._filled


def receiver_after(wire):
    receiver = Receiver(PacketPool(None).acquire, dict.fromkeys(COUNTER_NAMES, 0))
    for byte in wire:
        receiver.byte(byte)
    return receiver


def test_receiver_in_any_state_waits_for_a_flag_after_39_zeros():
    states = states_and_how_to_reach_them()
    assert len(states) == 78
    for state, wire in states.items():
        assert state_of(receiver_after(wire + bytes(39))) == ("waiting", 0), state


@pytest.mark.parametrize(("wire", "accepted"), [
    pytest.param(GOOD * 3, 3, id="each_with_its_own_flags"),
    pytest.param(b"\x00\x55\x7d" + GOOD, 1, id="noise_before"),
    pytest.param(GOOD[:-1] + GOOD[:-1] + GOOD, 2, id="shared_flags_lose_every_second"),
    pytest.param(b"\x7e" + GOOD * 20, 0, id="one_odd_flag_before_loses_all"),
    pytest.param(b"\x7e" + GOOD * 20 + b"\x7e" + GOOD, 1, id="until_another_odd_flag"),
    pytest.param(GOOD[1:] + GOOD * 20, 0, id="a_missing_opening_flag_loses_all"),
    pytest.param(GOOD[:-1] + GOOD * 20, 1, id="a_missing_closing_flag_loses_all_later"),
    pytest.param(b"\x7e" + bytes(37) + b"\x7e" + GOOD, 1, id="36_bytes_and_a_wrong_checksum_lose_one"),
    pytest.param(b"\x7e" + bytes(38) + b"\x7e" + GOOD * 20, 0, id="37_bytes_before_the_checksum_lose_all"),
    pytest.param(b"\x7e" + GOOD * 9 + bytes(39) + GOOD, 1, id="39_zeros_bring_it_back"),
    pytest.param(b"\x7e\x02\x01\x7d" + GOOD, 0, id="an_escaped_flag_is_data"),
])
def test_receiver_accepts(wire, accepted):
    assert len(received(wire)[0]) == accepted
