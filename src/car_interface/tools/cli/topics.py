"""The options by which a user says which recorded topic plays which role."""
from __future__ import annotations

import argparse
from typing import Sequence

from car_interface.common.errors import ConfigError
from car_interface.tools.recordings.roles import ODOM, Role


def add_topic_arguments(parser: argparse.ArgumentParser, roles: Sequence[Role]) -> None:
    """Add the options ``--map`` and ``--odom``; ``topics_of`` has what they say.

    Args:
        parser: of the command.
        roles: those that the command reads.
    """
    lines = [f"{role.name} ({role.what}; default: {' or '.join((*role.preferred, *role.topics))}"
             + (", else the only topic of its type)" if role.is_guessed else ")") for role in roles]
    parser.add_argument("--map", action="append", default=[], metavar="TOPIC=ROLE", dest="mapped",
                        help="what a recorded topic is, as in --map /vesc/odom=odom; may be repeated. Roles: "
                             + "; ".join(lines))
    parser.add_argument("--odom", default=ODOM.topics[0], metavar="TOPIC",
                        help=f"of odometry, any nav_msgs/Odometry, as --map TOPIC=odom (default: {ODOM.topics[0]}, "
                             "else the only one)")
    parser.set_defaults(role_names=tuple(role.name for role in roles))


def topics_of(options: argparse.Namespace, **named: str | None) -> dict[str, str]:
    """The topics that the user named, by role.

    Args:
        options: the parsed options.
        named: by role, those of other options than ``--map`` and ``--odom``; ``None`` = not given.

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
