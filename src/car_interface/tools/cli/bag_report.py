"""A page about a drive: who drove, how it steered, where it went, how fast, and what went wrong.

It is one HTML file without external resources: it needs no network.
"""
from __future__ import annotations

import argparse
import os
import shlex
import sys
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Mapping

from car_interface.common import output
from car_interface.common.errors import CarInterfaceError
from car_interface.common.memory_limit import describe_shortage
from car_interface.tools.cli.jobs import add_jobs_argument, for_each
from car_interface.tools.cli.options import add_namespace_argument, length_m
from car_interface.tools.cli.topics import add_topic_arguments, topics_of
from car_interface.tools.report.page import page
from car_interface.tools.report.plots import plots
from car_interface.tools.report.summary import ROLES, summarize


@dataclass(frozen=True)
class Config:
    """What to report, and where to.

    Attributes:
        recordings: paths.
        output: path of the page, for several recordings of a folder; ``None`` = beside each recording.
        namespace: the car's.
        topics: named by the user, by role.
        wheelbase_m: by which an asked steering angle is a curvature; ``None`` = unknown.
        jobs: recordings to read at the same time.
    """

    recordings: tuple[str, ...]
    output: str | None = None
    namespace: str = "/"
    topics: Mapping[str, str] = field(default_factory=dict)
    wheelbase_m: float | None = None
    jobs: int = 1


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of bag_report."""
    parser.add_argument("bags", nargs="+", metavar="BAG", help="a ROS 1 bag, or a ROS 2 bag (its folder)")
    parser.add_argument("-o", "--output", metavar="FILE",
                        help="the page, or for several recordings a folder (default: BAG.html beside each)")
    add_namespace_argument(parser)
    add_topic_arguments(parser, ROLES)
    parser.add_argument("--wheelbase", type=length_m, metavar="M", help="between the axles: which curvature an asked "
                        "steering angle (ackermann) is")
    add_jobs_argument(parser)


def run(options: argparse.Namespace) -> int:
    """Write the pages."""
    config = Config(tuple(options.bags), options.output, options.namespace, topics_of(options),
                    options.wheelbase, options.jobs)
    pages = _pages(config)
    failed = 0
    for (bag, path), (notes, error) in zip(pages, for_each(partial(_report, config=config), pages, config.jobs)):
        for note in notes:
            print(f"bag_report: {bag}: {note}", file=sys.stderr)
        if error:
            failed = 1
            print(f"bag_report: {error}", file=sys.stderr)
        else:
            print(path)
    return failed


def _pages(config):
    """Pairs of a recording and its page's path."""
    bags, folder = config.recordings, config.output
    ending = ".".join(["", *filter(None, config.namespace.split("/")), "html"])
    if len(bags) == 1 and folder is not None and not os.path.isdir(folder):
        return [(bags[0], folder)]
    if folder is not None and not os.path.isdir(folder):
        raise CarInterfaceError(f"-o {folder} is no folder, and {len(bags)} recordings need one: "
                                f"mkdir {shlex.quote(folder)}")
    pages = []
    for bag in bags:
        # A folder may be given as "." or with a slash behind it.
        place = Path(bag) if Path(bag).suffix == ".bag" else Path(bag).resolve()
        stem = place.stem if place.suffix == ".bag" or folder is not None else place.name
        pages.append((bag, str(Path(folder or place.parent) / (stem + ending))))
    names = [os.path.realpath(page) for _, page in pages]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice:
        raise CarInterfaceError(f"two recordings would both get the page {Path(twice).name}: report them one by one")
    return pages


def _report(bag_and_page, config):
    """Write one page: (lines on the topics that it is about, an error as text, empty without one)."""
    bag, path = bag_and_page
    try:
        output.check(path, config.recordings)
        drive = summarize(bag, config.namespace, config.wheelbase_m, progress=len(config.recordings) == 1,
                          **config.topics)
        output.write(path, page(drive, plots(drive)))
        return drive.notes, ""
    except CarInterfaceError as error:
        return [], str(error)
    except OSError as error:
        return [], f"{error.filename or path}: {error.strerror}"
    except Exception as error:  # one bad recording must not prevent the pages of the others
        why = describe_shortage(error) or f"{type(error).__name__}: {' '.join(str(error).split())}"
        return [], f"{bag}: no page can be made of it ({why})"
