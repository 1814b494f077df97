"""Adds the options that several commands share: which recordings, which of their topics, how many at a time."""
from __future__ import annotations

import argparse
import os
import re
from typing import Sequence

from car_interface.common.errors import ConfigError, require
from car_interface.common.input_file import finite_number
from car_interface.common.units import CHANNELS
from car_interface.tools.recordings.roles import ODOM, Role


def finite(text: str) -> float:
    """Return the finite number in an option's text."""
    value = finite_number(text)
    if value is None:
        raise argparse.ArgumentTypeError(f"{text!r} is no finite number")
    return value


def length_m(text: str) -> float:
    """Return the length above 0 in an option's text."""
    length = finite(text)
    if length <= 0:
        raise argparse.ArgumentTypeError(f"{text!r} is no length above 0 m")
    return length


def add_calibration_arguments(parser: argparse.ArgumentParser, kind: str, what: str) -> None:
    """Add what each calibration takes: recordings, and the file to write, which is of that kind."""
    parser.add_argument("bags", nargs="+", metavar="BAG", help="recordings of drives with one car")
    parser.add_argument("-o", "--output", required=True, metavar=kind, help=f"where to write the {what}")


def add_recording_arguments(parser: argparse.ArgumentParser, roles: Sequence[Role]) -> None:
    """Add the options ``--map`` and ``--odom``, of which ``topics_of`` makes topics, ``--ns`` and ``--jobs``."""
    lines = [f"{role.name} ({role.what}; default: {' or '.join((*role.preferred, *role.topics))}"
             + (", else the only topic of its type)" if role.is_guessed else ")") for role in roles]
    parser.add_argument("--map", action="append", default=[], metavar="TOPIC=ROLE", dest="mapped",
                        help="what a recorded topic is, as in --map /vesc/odom=odom; may be repeated. Roles: "
                             + "; ".join(lines))
    parser.add_argument("--odom", default=ODOM.topics[0], metavar="TOPIC",
                        help=f"of odometry, any nav_msgs/Odometry, as --map TOPIC=odom (default: {ODOM.topics[0]}, "
                             "else the only one)")
    parser.add_argument("--ns", "--namespace", dest="namespace", default="/", metavar="NAME",
                        help="the car's namespace, if its topics are below one (default: /)")
    parser.add_argument("--jobs", type=_count, default=os.cpu_count() or 1, metavar="N",
                        help="recordings to work on at the same time (default: as many as there are processors)")
    parser.set_defaults(role_names=tuple(role.name for role in roles))


def add_scheduler_argument(parser: argparse.ArgumentParser) -> None:
    """Add the option ``--scheduler``."""
    parser.add_argument("--scheduler", type=_address, metavar="tcp://HOST:PORT",
                        help="of a dask.distributed cluster, whose workers read the recordings in place of this "
                             "computer's processes; each sees them under the same path, and has the same version of "
                             "this package")


def topics_of(options: argparse.Namespace, **named: str | None) -> dict[str, str]:
    """Return the topics that the user named, by role; ``named``: those of other options than ``--map`` and ``--odom``.

    Raises:
        ConfigError: an unknown role, one that has two topics, or a topic with two roles.
    """
    found = {role: topic for role, topic in named.items() if topic is not None}
    if options.odom != ODOM.topics[0]:
        found[ODOM.name] = options.odom
    for text in options.mapped:
        topic, _, role = text.rpartition("=")
        if not topic or role not in options.role_names:
            raise ConfigError("--map", text, f"TOPIC=ROLE with a role of {', '.join(options.role_names)}")
        if found.get(role, topic) != topic:
            raise ConfigError("--map", text, f"one topic for each role, and {found[role]} is {role} already")
        twice = next((other for other, named in found.items() if named == topic and other != role), None)
        if twice:
            raise ConfigError("--map", text, f"one role for each topic, and {topic} is {twice} already")
        found[role] = topic
    return found


def check_channel(name: str, channel: int | None, accepted: str = "a channel of the servo board, 0 to 15") -> None:
    """Raise ConfigError, naming the option, when there is no such channel; ``None`` = not given."""
    require(channel is None or 0 <= channel < CHANNELS, name, channel, accepted)


def _address(text):
    if not re.fullmatch(r"t(cp|ls)://\S+:\d+", text):  # dask waits for ever on a kind that it doesn't know
        raise argparse.ArgumentTypeError(f"{text!r} is no address such as tcp://192.168.1.5:8786")
    return text


def _count(text):
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text!r} is no number of at least 1")
    return int(text)
