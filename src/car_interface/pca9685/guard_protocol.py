"""Messages in the pipes between the pca9685 node, its guard and the guard's relay, on one computer.

From the node: signs of life with the timeout values; the last one means that it has ended and left the chip safe.
From the guard: its state, as the answer to each sign of life and whenever the state changes.
From the guard to the relay, which publishes it: the counts of the chip when the guard read it back, and in the end that
a node has the chip again.
"""
from __future__ import annotations

import struct
from collections import namedtuple
from functools import partial

from car_interface.common.units import CHANNELS

# Kinds of a node's messages.
ALIVE, ENDING, ENDED = 0, 1, 2

# States of the guard.
WAITING = 0  # for the node's first sign of life
WATCHING = 1
ACTING = 2  # the node is silent or dead; the timeout values are not verified yet
SAFE = 3  # the chip holds the timeout values, by reading back
OFF = 4  # every output is off, by reading back

# Kinds of the guard's messages to its relay.
HELD, LEFT_TO_NODE = 0, 1

NOT_TRIED = -1  # as ``error`` of a guard that has not tried to reach the chip yet

_NODE = struct.Struct(f"=B?II{CHANNELS}H")
_GUARD = struct.Struct("=BIIi")
_OUTPUT = struct.Struct(f"=B{CHANNELS}H")


class NodeMessage(namedtuple("NodeMessage", "kind has_reached sequence acknowledged timeout_counts")):
    """A sign of life.

    ``acknowledged`` is the newest intervention that the node knows of, ``timeout_counts`` are 0..4096.
    """

    def encode(self) -> bytes:
        """Return the bytes: fewer than PIPE_BUF, so that a pipe takes all or none of them."""
        return _NODE.pack(*self[:-1], *self.timeout_counts)


class GuardMessage(namedtuple("GuardMessage", "state sequence interventions error")):
    """An answer: ``sequence`` is that of the last sign of life, ``error`` the errno of the last attempt on the chip,
    0 = it worked.
    """

    def encode(self) -> bytes:
        return _GUARD.pack(*self)


class OutputMessage(namedtuple("OutputMessage", "kind counts")):
    """What the channels held, 0..4096 counts."""

    def encode(self) -> bytes:
        return _OUTPUT.pack(self.kind, *self.counts)


class MessageReader:
    """Assembles messages from the bytes of a pipe."""

    def __init__(self, structure, decode):
        self._structure = structure
        self._decode = decode
        self._buffer = b""

    def feed(self, data: bytes) -> list:
        """Return the messages that these bytes complete, oldest first."""
        self._buffer += data
        size = self._structure.size
        whole = len(self._buffer) // size * size
        complete, self._buffer = self._buffer[:whole], self._buffer[whole:]
        return [self._decode(*fields) for fields in self._structure.iter_unpack(complete)]


node_reader = partial(MessageReader, _NODE, lambda *fields: NodeMessage(*fields[:-CHANNELS], fields[-CHANNELS:]))
guard_reader = partial(MessageReader, _GUARD, GuardMessage)
output_reader = partial(MessageReader, _OUTPUT, lambda kind, *counts: OutputMessage(kind, counts))
