"""Reads messages from a recording: ROS 1 bags, and ROS 2 bags in SQLite or MCAP.

A recording is read once, from the beginning to the end; memory doesn't grow with the file. Only the requested topics
are deserialized, so that others may have unknown types.
"""
from __future__ import annotations

import os
import re
import shlex
import sys
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Iterable, Iterator, Mapping, NamedTuple, Sequence

from rosbags.rosbag1 import ReaderError as ReaderError1
from rosbags.rosbag2 import Reader as Ros2Reader
from rosbags.rosbag2 import ReaderError as ReaderError2

from car_interface.common.errors import CarInterfaceError
from car_interface.common.input_file import check_kind
from car_interface.tools.recordings.definitions import UnknownType, decoder
from car_interface.tools.recordings.rosbag1 import ChunkReader

ROS2_SUFFIXES = (".db3", ".mcap")
METADATA = "metadata.yaml"
METADATA_KEY = b"rosbag2_bagfile_information"  # under which it has everything
# What a file begins with, and is not without it, by its suffix; one of another suffix is taken for a ROS 1 bag.
BEGINS = {".bag": (b"#ROSBAG V", "bag"), ".db3": (b"SQLite format 3\0", "SQLite database"),
          ".mcap": (b"\x89MCAP", "MCAP file")}
NESTED = re.compile(r"""\((["'])(.*?)\1,\)""")  # the arguments of another error, within rosbags' text of one


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
    steps_back: int  # how often the recording time went back by more than a second; known of ROS 1 bags only


class NoRecording(CarInterfaceError):
    """A file that can't be read as a recording, or one that lacks what is requested."""


def contents(path: str) -> Contents:
    """Return times and topics of a recording.

    Raises:
        NoRecording: it can't be read.
    """
    with _opened(path) as reader:
        found: dict = {}
        for connection in reader.connections:
            count = connection.msgcount + (found[connection.topic].count if connection.topic in found else 0)
            found[connection.topic] = Topic(connection.msgtype, count)
        begin, end = (reader.start_time, reader.end_time) if any(topic.count for topic in found.values()) else (0, 0)
        return Contents(begin, end, dict(sorted(found.items())), getattr(reader, "clock_steps_back", 0))


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
        with _reader(file) as reader:
            yield reader
    except CarInterfaceError:
        raise
    except Exception as error:  # a damaged file makes rosbags raise almost anything
        raise NoRecording(_error_text(file, error)) from error


def _problem(file):
    """Return what a file lacks to be a recording, as a sentence, or an empty text."""
    if not file.exists():
        return "there is no such file"
    if not os.access(str(file), os.R_OK):
        return "no permission"
    if file.is_dir():
        return _folder_problem(file)
    try:
        check_kind(file.stat())
    except OSError as error:
        return error.strerror
    return _beginning_problem(file, "it")


def _folder_problem(folder):
    """Return the same of a folder, or what in a ROS 2 bag's folder is not what its name says."""
    if not (folder / METADATA).exists():
        bags = sorted(str(inside) for inside in folder.iterdir() if inside.suffix == ".bag")
        return (f"a ROS 2 bag's folder has a {METADATA}, this one "
                + (f"doesn't; {bags[0]} may be what you mean" if bags else "doesn't (ros2 bag reindex)"))
    if METADATA_KEY not in (folder / METADATA).read_bytes():
        return f"its {METADATA} isn't a ROS 2 bag's (ros2 bag reindex makes one)"
    inside = sorted(file for file in folder.iterdir() if file.suffix in ROS2_SUFFIXES and file.is_file())
    return next(filter(None, (_beginning_problem(file, file.name) for file in inside)), "")


def _beginning_problem(file, name):
    """Return what a file is not, as a sentence, or an empty text."""
    begin, kind = BEGINS.get(file.suffix, BEGINS[".bag"])
    with file.open("rb") as opened:
        found = opened.read(len(begin))
    return "" if found == begin else f"{name} is {f'no {kind}' if found else 'empty'}"


def _reader(file):
    if file.is_dir():
        return Ros2Reader(file)
    if file.suffix in ROS2_SUFFIXES:
        return Ros2Reader(file.parent if (file.parent / METADATA).exists() else file)
    return ChunkReader(file)


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
    text = " ".join(str(error).split()) or type(error).__name__
    text = NESTED.sub(r"\2", text).rstrip(".")
    reindex = f"rosbag reindex {shlex.quote(str(file))}"
    is_ros1 = not file.is_dir() and file.suffix not in ROS2_SUFFIXES
    if is_ros1 and "not indexed" in text:
        return f"{file} was never closed: if its recorder still runs, end it by Ctrl-C; if it was killed: {reindex}"
    if is_ros1 and "supported" not in text:
        why = f" ({text})" if isinstance(error, ReaderError1) else ""  # another error's text is about Python
        return f"{file} is cut off or damaged{why}: {reindex} saves what is left"
    if not is_ros1 and not file.is_dir() and METADATA in text:
        text = f"this version of rosbags reads it only in its folder with a {METADATA} (ros2 bag reindex makes one)"
    elif not isinstance(error, (ReaderError1, ReaderError2, OSError)):
        text = "it's cut off or damaged; ros2 bag reindex saves what is left"
    return f"{file} can't be read as a recording: {text}"
