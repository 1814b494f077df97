"""Reads messages from a recording: ROS 1 bags, and ROS 2 bags in SQLite or MCAP.

A recording is read once, from the beginning to the end; memory doesn't grow with the file. Only the requested topics
are deserialized, so that others may have unknown types: by the recording's own definitions or by those that are known
here. ROS 1 bags always contain their definitions, ROS 2 bags since Iron. For older ones there are the standard types of
ROS 2 Humble, those in this package's ``msg`` folder, Autoware's equivalents of these, ackermann_msgs, and a VESC's
telemetry.
"""
from __future__ import annotations

import heapq
import os
import re
import shlex
import sys
from collections import Counter
from contextlib import contextmanager
from functools import lru_cache
from io import BytesIO
from itertools import count
from pathlib import Path
from typing import Any, Callable, Iterable, Iterator, Mapping, NamedTuple, Sequence

import numpy as np
from rosbags.rosbag1 import ReaderError as ReaderError1
from rosbags.rosbag1.reader import Header, Reader, RecordType, read_bytes, read_uint32
from rosbags.rosbag2 import Reader as Ros2Reader
from rosbags.rosbag2 import ReaderError as ReaderError2
from rosbags.typesys import Stores, TypesysError, get_types_from_idl, get_types_from_msg, get_typestore

from car_interface.common.errors import CarInterfaceError
from car_interface.common.input_file import check_kind
from car_interface.common.package_files import package_file
from car_interface.common.units import NS_PER_S

ROS2_SUFFIXES = (".db3", ".mcap")
METADATA = "metadata.yaml"
METADATA_KEY = b"rosbag2_bagfile_information"  # under which it has everything
# What a file begins with, and is not without it, by its suffix; one of another suffix is taken for a ROS 1 bag.
BEGINS = {".bag": (b"#ROSBAG V", "bag"), ".db3": (b"SQLite format 3\0", "SQLite database"),
          ".mcap": (b"\x89MCAP", "MCAP file")}
NESTED = re.compile(r"""\((["'])(.*?)\1,\)""")  # the arguments of another error, within rosbags' text of one
PACKAGE = "car_interface"
# Autoware's packages with messages that have the fields of ours.
EQUIVALENTS = {
    "autoware_control_msgs": ("Control", "Lateral", "Longitudinal"),
    "autoware_internal_debug_msgs": ("Float64Stamped",),
    "tier4_debug_msgs": ("Float64Stamped",),
}
# Common types that ROS 2 itself doesn't have.
OTHERS = {
    "ackermann_msgs/msg/AckermannDrive": "\n".join(f"float32 {name}" for name in (
        "steering_angle", "steering_angle_velocity", "speed", "acceleration", "jerk")),
    "ackermann_msgs/msg/AckermannDriveStamped": "std_msgs/Header header\nackermann_msgs/AckermannDrive drive",
    # As F1TENTH's ROS 2 driver has it; cars with a Humble or an older ROS 2 record it without its definition.
    "vesc_msgs/msg/VescState": "\n".join(f"{kind} {name}" for kind, names in (
        ("float64", "temp_fet temp_motor current_motor current_input avg_id avg_iq duty_cycle speed"),
        ("float64", "voltage_input charge_drawn charge_regen energy_drawn energy_regen"),
        ("int32", "displacement distance_traveled fault_code"), ("float64", "pid_pos_now"), ("int32", "controller_id"),
        ("float64", "ntc_temp_mos1 ntc_temp_mos2 ntc_temp_mos3 avg_vd avg_vq")) for name in names.split()),
    "vesc_msgs/msg/VescStateStamped": "std_msgs/Header header\nvesc_msgs/VescState state",
}
IDL_RULE = "=" * 80 + "\n"


class Recorded(NamedTuple):
    """One message."""

    time_ns: int  # ROS time at which the recorder received it
    topic: str  # as it was requested: without the car's namespace
    message: Any  # with the fields of its definition


class Topic(NamedTuple):
    """One topic of a recording."""

    type: str  # such as nav_msgs/msg/Odometry
    count: int  # messages


class Contents(NamedTuple):
    """Times and topics of a recording."""

    start_ns: int  # ROS time of the first message; 0 when there is none
    end_ns: int
    topics: dict  # Topic by absolute name


class NoRecording(CarInterfaceError):
    """A file that can't be read as a recording, or one that lacks what is requested."""


class UnknownType(CarInterfaceError):
    """A message type without a definition in the recording or here."""


def contents(path: str) -> Contents:
    """Return times and topics of a recording.

    Raises:
        NoRecording: it can't be read.
    """
    with _opened(path) as reader:
        found: dict = {}
        for connection in reader.connections:
            before = found[connection.topic].count if connection.topic in found else 0
            found[connection.topic] = Topic(connection.msgtype, before + connection.msgcount)
        begin, end = (reader.start_time, reader.end_time) if any(topic.count for topic in found.values()) else (0, 0)
        return Contents(begin, end, dict(sorted(found.items())))


def read(path: str, topics: Sequence[str] | Mapping[str, str | Sequence[str]], namespace: str = "/",
         progress: bool = False) -> Iterator[Recorded]:
    """Yield the messages on the topics of one car, in the order in which they were recorded.

    Args:
        path: of a ROS 1 bag, of a ROS 2 bag's folder, or of a file in that.
        topics: their names below ``namespace``; those that weren't recorded yield nothing. A name that begins with a
            slash and isn't found below the namespace is looked up as it is. In a dict each name has the accepted type,
            such as ``nav_msgs/Odometry``, or several of them.
        progress: show a bar on a terminal's standard error.

    Raises:
        NoRecording: it can't be read, or the type of a topic isn't accepted or isn't known.
    """
    with _opened(path) as reader:
        names = absolute_names({connection.topic for connection in reader.connections}, topics, namespace)
        connections = [connection for connection in reader.connections if connection.topic in names]
        if not connections:
            return  # for rosbags no connections mean all of them
        decoders = {}
        for connection in connections:
            accepted = _types(topics, names[connection.topic])
            if accepted and not is_of_type(connection.msgtype, accepted):
                raise NoRecording(f"{path}: {connection.topic} is of type {_short(connection.msgtype)}; accepted: "
                                  + _either(accepted))
            try:
                decoders[connection.id] = decoder(connection, isinstance(reader, Ros2Reader))
            except UnknownType as error:
                raise NoRecording(f"{path}: {connection.topic} can't be read: {error}") from error
        messages = reader.messages(connections=connections)
        if progress and sys.stderr.isatty():
            from tqdm import tqdm  # slow to import
            messages = tqdm(messages, Path(path).name, sum(connection.msgcount for connection in connections),
                            leave=False, unit=" messages", unit_scale=True)
        for connection, time_ns, data in messages:
            try:
                message = decoders[connection.id](data)
            except Exception as error:  # generated code may raise anything on a damaged message
                raise NoRecording(f"{path} is damaged: a message of {connection.topic} can't be read as "
                                  f"{connection.msgtype}") from error
            yield Recorded(time_ns, names[connection.topic], message)


def prefix(namespace: str) -> str:
    """Return what the names of a car's topics begin with, such as /car1/."""
    return "/" + "".join(f"{part}/" for part in namespace.split("/") if part)


def absolute_names(recorded: Iterable[str], topics: Iterable[str], namespace: str = "/") -> dict[str, str]:
    """Return the name by which a topic was requested, by each absolute name under which it was recorded."""
    recorded, names = set(recorded), {}
    for topic in topics:
        below = prefix(namespace) + topic.lstrip("/")
        if below in recorded:
            names[below] = topic
        elif topic.startswith("/") and topic in recorded:
            names[topic] = topic
    return names


def require(path: str, topics: Sequence[str] | Mapping[str, str | Sequence[str]], namespace: str = "/",
            why: str = "", hint: str = "") -> None:
    """Check that all topics were recorded.

    Args:
        topics: as for ``read``; where a dict has types, only topics of them are offered for one that is missing.
        why: what it is needed for.
        hint: what to do, if there is a topic that can be offered.

    Raises:
        NoRecording: names the first that wasn't recorded, and topics with similar names.
    """
    recorded = contents(path).topics
    found = set(absolute_names(recorded, topics, namespace).values())
    for topic in topics:
        if topic not in found:
            accepted = _types(topics, topic)
            offered = [name for name, one in recorded.items() if not accepted or is_of_type(one.type, accepted)]
            last = topic.rstrip("/").rsplit("/", 1)[-1]
            similar = [name for name in offered if last in name][:5] or offered[:8]
            below = "" if namespace.strip("/") == "" else f" below {namespace}"
            none = f"none of type {_either(accepted)}" if recorded and accepted else "none at all"
            raise NoRecording(f"{path} has no topic {topic}{below}{', ' + why if why else ''}"
                              + (f"{hint}; it has {', '.join(similar)}" if similar else f"; it has {none}"))


def is_of_type(kind: str, accepted: Iterable[str]) -> bool:
    """Return whether a type such as nav_msgs/msg/Odometry is an accepted one; both may be written as in ROS 1 or 2."""
    return _short(kind) in map(_short, accepted)


def other_version(path: str, recorded: Recorded) -> NoRecording:
    """Return the error for a message that lacks a field of its type."""
    return NoRecording(f"{path}: {recorded.topic} was recorded with another version of "
                       f"{_short(recorded.message.__msgtype__)}")


@contextmanager
def _opened(path):
    """Yield a reader of a recording; every error of the file becomes NoRecording."""
    file = Path(path)
    problem = _problem(file)
    if problem:
        raise NoRecording(f"{file} can't be read as a recording: {problem}")
    try:
        is_part = not file.is_dir() and (file.parent / METADATA).exists()
        with ChunkReader(file) if _is_ros1(file) else Ros2Reader(file.parent if is_part else file) as reader:
            yield reader
    except CarInterfaceError:
        raise
    except Exception as error:  # a damaged file makes rosbags raise almost anything
        raise NoRecording(_error_text(file, error)) from error


def _problem(file):
    """Return what a file, or one in a ROS 2 bag's folder, lacks to be a recording, as a sentence, or an empty text."""
    if not file.exists():
        return "there is no such file"
    if not os.access(str(file), os.R_OK):
        return "no permission"
    if not file.is_dir():
        try:
            check_kind(file.stat())
        except OSError as error:
            return error.strerror
        inside = [file]
    elif not (file / METADATA).exists():
        bags = sorted(str(inside) for inside in file.iterdir() if inside.suffix == ".bag")
        return (f"a ROS 2 bag's folder has a {METADATA}, this one "
                + (f"doesn't; {bags[0]} may be what you mean" if bags else "doesn't (ros2 bag reindex)"))
    elif METADATA_KEY not in (file / METADATA).read_bytes():
        return f"its {METADATA} isn't a ROS 2 bag's (ros2 bag reindex makes one)"
    else:
        inside = sorted(one for one in file.iterdir() if one.suffix in ROS2_SUFFIXES and one.is_file())
    for one in inside:
        begin, kind = BEGINS.get(one.suffix, BEGINS[".bag"])
        with one.open("rb") as opened:
            found = opened.read(len(begin))
        if found != begin:
            return f"{'it' if one is file else one.name} is {f'no {kind}' if found else 'empty'}"
    return ""


def _is_ros1(file):
    return not file.is_dir() and file.suffix not in ROS2_SUFFIXES


def _types(topics, requested):
    """Return the accepted types of a topic that was requested; empty: all are."""
    types = topics[requested] if isinstance(topics, Mapping) else ()
    return (types,) if isinstance(types, str) else types


def _either(types):
    return " or ".join(map(_short, types))


def _short(name):
    """Return a message type's name as ROS 1 has it."""
    return name.replace("/msg/", "/")


def _error_text(file, error):
    text = NESTED.sub(r"\2", " ".join(str(error).split()) or type(error).__name__).rstrip(".")
    if _is_ros1(file) and "supported" not in text:
        reindex = f"rosbag reindex {shlex.quote(str(file))}"
        if "not indexed" in text:
            return f"{file} was never closed: if its recorder still runs, end it by Ctrl-C; if it was killed: {reindex}"
        why = f" ({text})" if isinstance(error, ReaderError1) else ""  # another error's text is about Python
        return f"{file} is cut off or damaged{why}: {reindex} saves what is left"
    if file.suffix in ROS2_SUFFIXES and METADATA in text and not file.is_dir():
        text = f"this version of rosbags reads it only in its folder with a {METADATA} (ros2 bag reindex makes one)"
    elif not isinstance(error, (ReaderError1, ReaderError2, OSError)):
        text = "it's cut off or damaged; ros2 bag reindex saves what is left"
    return f"{file} can't be read as a recording: {text}"


# --- ROS 1 bags ---


class ChunkReader(Reader):
    """Reads a ROS 1 bag in the order in which it was recorded, with the memory of a few of its chunks.

    rosbags' own reader keeps the position of each message, which takes 170 MB for a million of them, some 20 minutes of
    a car's topics (measured with 0.9.23 and 0.11.9), and sorts them by time: after the clock was set back it alternates
    between two chunks, and mixes what was driven before and after. This reader goes from chunk to chunk, in 4 MB.

    It overrides ``read_index_data``, and uses the reader's attributes and its module's functions, which rosbags doesn't
    document: setup.py limits rosbags to the versions that this was tested with.
    """

    def __init__(self, path):
        super().__init__(path)
        self.steps_back = 0  # how often a topic's recording time went back
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
            self.steps_back += int((np.diff(times, prepend=self._newest.get(connection, times[0])) < 0).sum())
            self._newest[connection] = times[-1]

    def messages(self, connections=(), start=None, stop=None) -> Iterator[tuple]:
        """Yield connection, time in ns and bytes: by time, or, if the clock was ever set back, as they were written.

        ``start`` and ``stop`` are parameters of rosbags; they are ignored.
        """
        wanted = {connection.id: connection for connection in connections or self.connections}
        chunks = [info for info in self.chunk_infos if not wanted.keys().isdisjoint(info.connection_counts)]
        numbers, pending = count(), []  # chunks may overlap: pending messages go out before a chunk that begins later
        chunks.sort(key=lambda info: (0 if self.steps_back else info.start_time, info.pos))
        for info in [*chunks, None]:
            while pending and (info is None or pending[0][0] < info.start_time):
                *_, connection, time_ns, data = heapq.heappop(pending)
                yield wanted[connection], time_ns, data
            for connection, time_ns, data in self._chunk(info.pos, wanted) if info is not None else ():
                order = -1 if self.steps_back else time_ns  # -1: before the next chunk, as they were written
                heapq.heappush(pending, (order, next(numbers), connection, time_ns, data))

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


# --- definitions of messages ---


def decoder(connection, is_ros2: bool) -> Callable[[bytes], Any]:
    """Return a function from the bytes of one connection's messages to messages.

    Args:
        is_ros2: whether the bytes are CDR, as ROS 2 has them.

    Raises:
        UnknownType: neither the recording nor this package has its definition.
    """
    name, definition = connection.msgtype, connection.msgdef
    if isinstance(definition, str):  # rosbags before 0.10
        text, is_idl = definition, definition.startswith(IDL_RULE + "IDL: ")
    else:
        text, is_idl = definition.data, definition.format.name == "IDL"
    store = _store(name, text, is_idl) if text else known_types()
    try:
        store.get_msgdef(name)
    except (KeyError, TypesysError) as error:
        raise UnknownType(f"neither the recording nor this package knows all of its type {name}") from error
    deserialize = store.deserialize_cdr if is_ros2 else store.deserialize_ros1
    return lambda data: deserialize(data, name)


@lru_cache(maxsize=1)
def known_types() -> Any:
    """Return the types of ROS 2 Humble, of this package, Autoware's equivalents, and OTHERS, as rosbags' typestore."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    ours = {path.stem: path.read_text(encoding="utf-8") for path in sorted(package_file("msg").glob("*.msg"))}
    texts = {**{f"{PACKAGE}/msg/{name}": text for name, text in ours.items()}, **OTHERS,
             **{f"{package}/msg/{name}": ours[name] for package, names in EQUIVALENTS.items() for name in names}}
    types: dict = {}
    for name, text in texts.items():
        types.update(get_types_from_msg(text, name))
    store.register(types)
    return store


@lru_cache(maxsize=200)  # parsing takes longer than reading a small recording, and all of a car have the same ones
def _store(name, text, is_idl):
    store = get_typestore(Stores.EMPTY)
    try:
        if not is_idl:
            store.register(get_types_from_msg(text, name))
        elif text.startswith(IDL_RULE):
            for part in text.split(IDL_RULE)[1:]:
                store.register(get_types_from_idl(part.split("\n", 1)[1]))
        else:
            store.register(get_types_from_idl(text))
    except Exception as error:  # a parser may stumble over anything in a damaged text
        raise UnknownType(f"the recording's definition of its type {name} makes no sense") from error
    return store
