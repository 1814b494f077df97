"""The simulated Teensy's packets: their content, and the pool that receiver, queues and transmitter share."""
from __future__ import annotations

import random
from collections import deque

FLAG, ESCAPE, ESCAPE_XOR = 0x7E, 0x7D, 0x20
RPI, TEENSY = 1, 2

PING_QUERY, PONG_RESP, SET_SONAR_SEQ, SONAR_STOP, SONAR_START, SONAR_STATUS = 1, 2, 3, 4, 5, 6
WHEEL_STATUS, WHEEL_RESET, ERROR_COUNT, GET_COUNTERS, SONAR_WAIT = 7, 8, 9, 10, 12

HEADER_SIZE = 4
MESSAGE_MAX = 36  # header + WHEEL_STATUS, the longest message; the checksum follows it
PACKET_SIZE = MESSAGE_MAX + 4
COUNTER_NAMES = (
    "rxErrorChecksum", "rxErrorTooShort", "rxErrorTooLong", "rxErrorBuffer", "rxErrorDropped", "rxErrorUnknown",
    "txErrorNoBuf", "txInfoSonarDrop", "txInfoWheelDrop", "txBytes", "txPackets", "rxBytes", "rxPackets",
    "pingFail", "badSeqCommand", "badSonarId", "unknownCommand", "badSeqLen", "badSonarIdx",
    "rotBufFull", "rotUpdSkip", "errPing0", "errPing1", "errPing2", "errPing3", "errPing4", "errPing5",
)

BITS_PER_BYTE_S = 10 * 1_000_000_000  # 8N1 sends ten bits a byte; times nanoseconds a second


class PoolEmpty(Exception):
    """The firmware wrote through a null pointer, to a packet that it didn't get."""


class PacketPool:
    """The packets that all parts share. A used one keeps its content, which later shows in the filler byte."""

    def __init__(self, size: int, seed: int | None):
        memory = bytes(size * PACKET_SIZE)
        if seed is not None:
            memory = random.Random(seed).getrandbits(8 * len(memory)).to_bytes(len(memory), "little")
        chunks = (memory[start : start + PACKET_SIZE] for start in range(0, len(memory), PACKET_SIZE))
        self._free: deque[bytearray] = deque(bytearray(chunk) for chunk in chunks)

    def acquire(self) -> bytearray | None:
        """Return the packet that has been free for longest, or None when all are in use."""
        return self._free.popleft() if self._free else None

    def release(self, packet: bytearray):
        self._free.append(packet)
