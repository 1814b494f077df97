"""ROS 1 bags come in order, without the position of every message in memory."""
import random
import struct

import pytest
from rosbags.rosbag1 import Reader, ReaderError, Writer

from car_interface.tools.recordings.recording import ChunkReader
from written_recordings import START_NS, Written, write_ros1


def number(time_s, value, topic="/a"):
    return Written(time_s, topic, "std_msgs/Int32", {"data": value})


def bag(tmp_path, *rows, chunk_bytes=None):
    """A bag of (time in s, number), or (time in s, number, topic), in the order in which they are written."""
    return write_ros1(tmp_path / "a.bag", [number(*row) for row in rows], chunk_bytes=chunk_bytes)


def messages(path, *topics):
    """(topic, time in ns since the start, number) of all messages, or of those of some topics."""
    with ChunkReader(path) as reader:
        wanted = [connection for connection in reader.connections if connection.topic in topics]
        return [(connection.topic, time_ns - START_NS, struct.unpack("<i", data)[0])
                for connection, time_ns, data in reader.messages(wanted)]


def test_messages_have_their_topic_time_and_bytes_and_connections_limit_what_is_read(tmp_path):
    path = bag(tmp_path, (0.0, 1), (0.25, -2, "/b"), (0.5, 3, "/c"), (1.5, 4))
    assert messages(path) == [("/a", 0, 1), ("/b", 250_000_000, -2), ("/c", 500_000_000, 3), ("/a", 1_500_000_000, 4)]
    assert [row[0] for row in messages(path, "/a", "/c")] == ["/a", "/c", "/a"]


@pytest.mark.parametrize("seed", range(2))
def test_order_and_bytes_are_those_of_rosbags_own_reader(seed, tmp_path):
    source = random.Random(seed)
    rows = sorted((source.randrange(100) / 10, index, source.choice(["/a", "/b", "/c"])) for index in range(200))
    # Each topic is in order; their chunks overlap.
    path = bag(tmp_path, *sorted(rows, key=lambda row: row[2]), chunk_bytes=200)
    with Reader(path) as reader:
        expected = [(connection.topic, time_ns, bytes(data)) for connection, time_ns, data in reader.messages()]
    with ChunkReader(path) as reader:
        found = [(connection.topic, time_ns, bytes(data)) for connection, time_ns, data in reader.messages()]
    assert [time_ns for _, time_ns, _ in found] == [time_ns for _, time_ns, _ in expected]
    assert sorted(found) == sorted(expected) and len(found) == 200


@pytest.mark.parametrize("compression", ["BZ2", "LZ4"])
def test_chunks_may_be_compressed(compression, tmp_path):
    with Reader(bag(tmp_path, (0.0, 1))) as reader:
        (connection,) = reader.connections
    compressed = Writer(tmp_path / "b.bag")
    compressed.set_compression(getattr(Writer.CompressionFormat, compression))
    with compressed as writer:
        written = writer.add_connection("/a", "std_msgs/msg/Int32", msgdef="int32 data\n", md5sum=connection.digest)
        for index in range(50):
            writer.write(written, START_NS + index, struct.pack("<i", index))
    assert messages(tmp_path / "b.bag") == [("/a", index, index) for index in range(50)]


def test_counts_are_those_of_each_connection_over_all_chunks(tmp_path):
    path = bag(tmp_path, *((0.1 * index, index, "/b" if index % 5 == 0 else "/a") for index in range(50)),
               chunk_bytes=200)
    with ChunkReader(path) as reader:
        counts = {connection.topic: connection.msgcount for connection in reader.connections}
        assert len(reader.chunk_infos) > 1
    assert counts == {"/a": 40, "/b": 10}


@pytest.mark.parametrize("times_s, steps", [
    ((1.0, 1.0, 2.0), 0), ((2.0, 1.0, 3.0), 1), ((2.0, 0.9, 3.0, 1.0), 2), ((5.0, 4.5, 1.0), 2)])
@pytest.mark.parametrize("chunk_bytes", [None, 1], ids=["one_chunk", "chunk_each"])
def test_steps_back_of_a_topics_time_are_counted(times_s, steps, chunk_bytes, tmp_path):
    path = bag(tmp_path, *((time_s, 0) for time_s in times_s), chunk_bytes=chunk_bytes)
    with ChunkReader(path) as reader:
        assert reader.steps_back == steps


def test_topics_that_overlap_are_no_step_back(tmp_path):
    with ChunkReader(bag(tmp_path, (5.0, 1), (6.0, 2), (1.0, 3, "/b"))) as reader:
        assert reader.steps_back == 0


@pytest.mark.parametrize("chunk_bytes", [None, 1], ids=["one_chunk", "chunk_each"])
def test_after_a_step_back_messages_come_as_they_were_written(chunk_bytes, tmp_path):
    path = bag(tmp_path, (2.0, 1), (3.0, 2, "/b"), (1.0, 3), (2.5, 4), chunk_bytes=chunk_bytes)
    assert [row[2] for row in messages(path)] == [1, 2, 3, 4]


def test_record_longer_than_its_chunk_is_refused(tmp_path):
    path = bag(tmp_path, (0.0, 0x01020304))
    data = path.read_bytes()
    at = data.index(struct.pack("<II", 4, 0x01020304))  # the length of the message's bytes, and the bytes
    path.write_bytes(data[:at] + struct.pack("<I", 400) + data[at + 4:])
    with pytest.raises(ReaderError, match=r"^Got only 4 of requested 400 bytes"):
        messages(path)
