"""Reads what a car's topics carried from a recording, in the order in which it was recorded."""
from __future__ import annotations

from pathlib import Path
from typing import Any, Iterator, NamedTuple, Sequence

from rosbags.highlevel import AnyReader, AnyReaderError

from car_interface.errors import CarInterfaceError


class Recorded(NamedTuple):
    """One message."""

    time_ns: int  # ROS time at which the recorder took it
    topic: str  # without the car's namespace
    message: Any  # with the fields of its definition


class NoRecording(CarInterfaceError):
    """A file that can't be read as a recording, or one that lacks what is asked for."""


def read(path: str, topics: Sequence[str], namespace: str = "/") -> Iterator[Recorded]:
    """Yield what the topics of one car carried.

    Args:
        path: of a ROS 1 bag.
        topics: their names below ``namespace``, without a slash in front; those that weren't recorded yield nothing.
        namespace: the car's.

    Raises:
        NoRecording: it can't be read.
    """
    prefix = "/" + namespace.strip("/") + "/" if namespace.strip("/") else "/"
    names = {prefix + topic: topic for topic in topics}
    try:
        with AnyReader([Path(path)]) as reader:
            connections = [connection for connection in reader.connections if connection.topic in names]
            if not connections:
                return  # rosbags takes none of them for all of them
            for connection, time_ns, data in reader.messages(connections=connections):
                yield Recorded(time_ns, names[connection.topic], reader.deserialize(data, connection.msgtype))
    except (AnyReaderError, OSError) as error:
        raise NoRecording(f"{path} can't be read as a recording: {error}") from error
