"""Reads ROS 1 bags in the order in which they were recorded, with the memory of a few of their chunks.

rosbags' own reader keeps the position of each message, which takes 170 MB for a million of them, some 20 minutes of a
car's topics (measured with 0.9.23 and 0.11.9), and sorts them by time: after the clock was set back it alternates
between two chunks, and mixes what was driven before and after. This reader goes from chunk to chunk, in 4 MB.

It overrides ``read_index_data``, and uses the reader's attributes and its module's functions, which rosbags doesn't
document: setup.py limits rosbags to the versions that this was tested with.
"""
from __future__ import annotations

import heapq
from collections import Counter
from io import BytesIO
from typing import Iterator

import numpy as np
from rosbags.rosbag1.reader import Header, Reader, RecordType, read_bytes, read_uint32

from car_interface.common.units import NS_PER_S


class ChunkReader(Reader):
    """A ROS 1 bag."""

    def __init__(self, path):
        super().__init__(path)
        self.steps_back = 0  # how often a topic's recording time went back
        self.clock_steps_back = 0  # how often by more than a second: the clock was set
        self._newest: dict = {}  # time of the newest message, by connection

    def open(self) -> None:
        """Open it and read its index. rosbags would count messages by the positions that this reader leaves out."""
        super().open()
        counts: Counter = Counter()
        for info in self.chunk_infos:
            counts.update(info.connection_counts)
        self.connections = [connection._replace(msgcount=counts[connection.id]) for connection in self.connections]

    def read_index_data(self, pos, indexes):
        """Read only the times from a chunk's index; rosbags calls this once for each connection of each chunk."""
        connection = Header.read(self.bio).get_uint32("conn")
        entries = np.frombuffer(read_bytes(self.bio, read_uint32(self.bio)), "<u4").reshape(-1, 3)
        times = entries[:, 0].astype(np.int64) * NS_PER_S + entries[:, 1]
        if len(times):
            steps_ns = np.diff(times, prepend=self._newest.get(connection, times[0]))
            self.steps_back += int((steps_ns < 0).sum())
            self.clock_steps_back += int((steps_ns < -NS_PER_S).sum())
            self._newest[connection] = times[-1]

    def messages(self, connections=(), start=None, stop=None) -> Iterator[tuple]:
        """Yield connection, time in ns and bytes: by time, or, if the clock was ever set back, as they were written.

        ``start`` and ``stop`` are parameters of rosbags; they are ignored.
        """
        wanted = {connection.id: connection for connection in connections or self.connections}
        chunks = [info for info in self.chunk_infos if not wanted.keys().isdisjoint(info.connection_counts)]
        number, pending = 0, []  # chunks may overlap: pending messages go out before a chunk that begins later
        chunks.sort(key=lambda info: (0 if self.steps_back else info.start_time, info.pos))
        for info in [*chunks, None]:
            while pending and (info is None or pending[0][0] < info.start_time):
                *_, connection, time_ns, data = heapq.heappop(pending)
                yield wanted[connection], time_ns, data
            for connection, time_ns, data in self._chunk(info.pos, wanted) if info is not None else ():
                order = -1 if self.steps_back else time_ns  # -1: before the next chunk, as they were written
                heapq.heappush(pending, (order, number, connection, time_ns, data))
                number += 1

    def _chunk(self, position, wanted) -> Iterator[tuple[int, int, bytes]]:
        chunk = self.chunks[position]
        self.bio.seek(chunk.datapos)
        data = chunk.decompressor(read_bytes(self.bio, chunk.datasize))
        records = BytesIO(data)
        while records.tell() < len(data):
            header = Header.read(records)
            content = read_bytes(records, read_uint32(records))
            if header.get_uint8("op") == RecordType.MSGDATA and header.get_uint32("conn") in wanted:
                yield header.get_uint32("conn"), header.get_time("time"), content
