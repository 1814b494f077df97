"""Messages in the pipes between the pca9685 node, its guard and the guard's relay, on one computer.

From the node: signs of life with the timeout values; the last one means that it has ended and left the chip safe.
From the guard: its state, as the answer to each sign of life and whenever the state changes.
From the guard to the relay, which publishes it: the counts of the chip when the guard read it back, and in the end that
a node has the chip again.
"""
from __future__ import annotations

import struct

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

# Kind; whether the node has reached its chip, 0 or 1; sequence number; the newest intervention that it knows of;
# counts of the timeout values, 0..4096.
_NODE = struct.Struct(f"=BBII{CHANNELS}H")
# State; sequence number of the last sign of life; number of interventions; errno of the last attempt on the chip, 0 =
# it worked.
_GUARD = struct.Struct("=BIIi")
# Kind; counts that the channels held, 0..4096.
_OUTPUT = struct.Struct(f"=B{CHANNELS}H")


class NodeMessage:
    """One message of the node; ``_NODE`` describes its attributes."""

    def __init__(self, kind, has_reached, sequence, acknowledged, timeout_counts):
        self.kind = kind
        self.has_reached = has_reached
        self.sequence = sequence
        self.acknowledged = acknowledged
        self.timeout_counts = timeout_counts

    def encode(self) -> bytes:
        """Return the bytes: fewer than PIPE_BUF, so that a pipe takes all or none of them."""
        return _NODE.pack(self.kind, self.has_reached, self.sequence, self.acknowledged, *self.timeout_counts)


class GuardMessage:
    """One message of the guard; ``_GUARD`` describes its attributes."""

    def __init__(self, state, sequence, interventions, error):
        self.state = state
        self.sequence = sequence
        self.interventions = interventions
        self.error = error

    def encode(self) -> bytes:
        """The bytes."""
        return _GUARD.pack(self.state, self.sequence, self.interventions, self.error)


class OutputMessage:
    """One message of the guard to its relay; ``_OUTPUT`` describes its attributes."""

    def __init__(self, kind, counts):
        self.kind = kind
        self.counts = counts

    def encode(self) -> bytes:
        """The bytes."""
        return _OUTPUT.pack(self.kind, *self.counts)


class MessageReader:
    """Assembles messages from the bytes of a pipe.

    Args:
        decode: makes a message of one structure's fields.
    """

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


def node_reader() -> MessageReader:
    """Return a reader of the node's messages."""
    return MessageReader(_NODE, lambda kind, has_reached, sequence, acknowledged, *counts: NodeMessage(
        kind, bool(has_reached), sequence, acknowledged, counts))


def guard_reader() -> MessageReader:
    """Return a reader of the guard's messages."""
    return MessageReader(_GUARD, GuardMessage)


def output_reader() -> MessageReader:
    """Return a reader of the guard's messages to its relay."""
    return MessageReader(_OUTPUT, lambda kind, *counts: OutputMessage(kind, counts))
