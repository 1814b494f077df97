"""Options that several commands have in common."""
from __future__ import annotations

import argparse

from car_interface.common.input_file import finite_number


def add_namespace_argument(parser: argparse.ArgumentParser) -> None:
    """Add the option ``--ns``, also ``--namespace``."""
    parser.add_argument("--ns", "--namespace", dest="namespace", default="/", metavar="NAME",
                        help="the car's namespace, if its topics are below one (default: /)")


def finite(text: str) -> float:
    """A finite number out of an option's text."""
    value = finite_number(text)
    if value is None:
        raise argparse.ArgumentTypeError(f"{text!r} is no finite number")
    return value


def length_m(text: str) -> float:
    """A length above 0 out of an option's text."""
    length = finite(text)
    if length <= 0:
        raise argparse.ArgumentTypeError(f"{text!r} is no length above 0 m")
    return length
