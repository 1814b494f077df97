"""The pipes between node, guard and relay: what goes in comes out, however the bytes are split."""

import select

import pytest

from car_interface.pca9685 import guard_protocol as protocol
from car_interface.pca9685.guard_protocol import GuardMessage, NodeMessage, OutputMessage

COUNTS = (*range(0, 4095, 273), 4096)
NODE = [(protocol.ALIVE, True, 1, 0, COUNTS), (protocol.ENDED, False, 2 ** 32 - 1, 7, (0,) * 16)]
GUARD = [(protocol.SAFE, 1, 2, 0), (0, 0, 0, -1), (4, 2 ** 32 - 1, 2 ** 32 - 1, 121)]
OUTPUT = [(protocol.HELD, COUNTS), (protocol.LEFT_TO_NODE, (0,) * 16)]


def test_numbers_of_kinds_and_states_differ_and_no_errno_is_negative():
    assert (protocol.ALIVE, protocol.ENDING, protocol.ENDED) == (0, 1, 2)
    assert (protocol.WAITING, protocol.WATCHING, protocol.ACTING, protocol.SAFE, protocol.OFF) == (0, 1, 2, 3, 4)
    assert (protocol.HELD, protocol.LEFT_TO_NODE, protocol.NOT_TRIED) == (0, 1, -1)


@pytest.mark.parametrize("size", [1, 7, 1000], ids="in_pieces_of_{}".format)
@pytest.mark.parametrize("reader, kind, cases", [
    (protocol.node_reader, NodeMessage, NODE), (protocol.guard_reader, GuardMessage, GUARD),
    (protocol.output_reader, OutputMessage, OUTPUT)], ids=["node", "guard", "relay"])
def test_messages_come_out_as_they_went_in(reader, kind, cases, size):
    data = b"".join(kind(*case).encode() for case in cases)
    messages = reader()
    found = [message for start in range(0, len(data), size) for message in messages.feed(data[start: start + size])]
    assert found == cases


def test_messages_are_small_enough_for_a_pipe_to_take_all_or_none_of_one():
    for message in (NodeMessage(*NODE[0]), GuardMessage(*GUARD[0]), OutputMessage(*OUTPUT[0])):
        assert len(message.encode()) <= select.PIPE_BUF
