"""Reads ROS 1 bags in the order in which they were recorded, with the memory of a few of their chunks.

rosbags' own reader keeps the position of each message, which takes gigabytes for the messages of a day, and sorts them
by time: after the clock was set back it alternates between two chunks, and mixes what was driven before and after. This
reader goes from chunk to chunk.

It overrides ``read_index_data`` and uses ``chunks``, ``chunk_infos`` and ``bio``, which rosbags doesn't document:
setup.py limits rosbags to the versions that this was tested with.
"""
from __future__ import annotations

import heapq
import struct
from typing import Any, Iterator

import numpy as np
from rosbags.rosbag1 import Reader, ReaderError

from car_interface.common.units import NS_PER_S

MESSAGE = 2  # the op of a record that holds a message
LENGTH = struct.Struct("<I")
TIME = struct.Struct("<II")


class ChunkReader(Reader):
    """A ROS 1 bag.

    Attributes:
        steps_back: how often a topic's recording time went back.
        clock_steps_back: how often by more than a second: the clock was set.
    """

    def __init__(self, path):
        super().__init__(path)
        self.steps_back = self.clock_steps_back = 0
        self._newest: dict = {}  # time of the newest message, by connection

    def read_index_data(self, pos, indexes):
        """Read only the times from a chunk's index; rosbags calls this once for each connection of each chunk."""
        header = _fields(self._read(LENGTH.unpack(self._read(LENGTH.size))[0]))
        entries = np.frombuffer(self._read(LENGTH.unpack(self._read(LENGTH.size))[0]), "<u4").reshape(-1, 3)
        connection = header[b"conn"]
        times = entries[:, 0].astype(np.int64) * NS_PER_S + entries[:, 1]
        if len(times):
            steps_ns = np.diff(times, prepend=self._newest.get(connection, times[0]))
            self.steps_back += int((steps_ns < 0).sum())
            self.clock_steps_back += int((steps_ns < -NS_PER_S).sum())
            self._newest[connection] = times[-1]

    def counts(self) -> dict[int, int]:
        """How many messages each connection has, by its id."""
        total: dict = {}
        for info in self.chunk_infos:
            for connection, count in info.connection_counts.items():
                total[connection] = total.get(connection, 0) + count
        return total

    def messages(self, connections=(), start=None, stop=None) -> Iterator[tuple]:
        """Yield connection, time in ns and bytes: by time, or, if the clock was ever set back, as they were written.

        ``start`` and ``stop`` are parameters of rosbags; they are ignored.
        """
        wanted = {connection.id: connection for connection in connections or self.connections}
        chunks = [info for info in self.chunk_infos if not wanted.keys().isdisjoint(info.connection_counts)]
        if self.steps_back:
            for info in sorted(chunks, key=lambda info: info.pos):
                for connection, time_ns, data in self._chunk(info.pos, wanted):
                    yield wanted[connection], time_ns, data
            return
        number, pending = 0, []  # chunks may overlap: pending messages go out before a chunk that begins later
        for info in sorted(chunks, key=lambda info: (info.start_time, info.pos)):
            while pending and pending[0][0] < info.start_time:
                time_ns, _, connection, data = heapq.heappop(pending)
                yield wanted[connection], time_ns, data
            for connection, time_ns, data in self._chunk(info.pos, wanted):
                heapq.heappush(pending, (time_ns, number, connection, data))
                number += 1
        while pending:
            time_ns, _, connection, data = heapq.heappop(pending)
            yield wanted[connection], time_ns, data

    def _chunk(self, position, wanted) -> Iterator[tuple[int, int, bytes]]:
        chunk = self.chunks[position]
        self.bio.seek(chunk.datapos)
        records = chunk.decompressor(self._read(chunk.datasize))
        at, end = 0, len(records)
        while at < end:
            header_end = at + LENGTH.size + LENGTH.unpack_from(records, at)[0]
            header = _fields(records[at + LENGTH.size:header_end])
            begin = header_end + LENGTH.size
            at = begin + LENGTH.unpack_from(records, header_end)[0]
            if at > end:
                raise ReaderError("a record reaches beyond its chunk")
            if header[b"op"] == MESSAGE and header[b"conn"] in wanted:
                yield header[b"conn"], header[b"time"], records[begin:at]

    def _read(self, size) -> bytes:
        data = self.bio.read(size)
        if len(data) != size:
            raise ReaderError("it ends in the middle of a record")
        return data


def _fields(header: bytes) -> dict[bytes, Any]:
    """The fields of a record's header that a reader of messages needs."""
    fields: dict = {}
    at = 0
    while at < len(header):
        begin = at + LENGTH.size
        at = begin + LENGTH.unpack_from(header, at)[0]
        name, _, value = header[begin:at].partition(b"=")
        if name == b"op":
            fields[name] = value[0]
        elif name == b"time":
            seconds, nanoseconds = TIME.unpack(value)
            fields[name] = seconds * NS_PER_S + nanoseconds
        elif name == b"conn":
            fields[name], = LENGTH.unpack(value)
    return fields
