"""A page about a drive: who drove, how it steered, where it went, how fast, and what went wrong.

It is one HTML file without external resources: it needs no network.
"""
from __future__ import annotations

import argparse
import os
import shlex
import sys
from functools import partial
from pathlib import Path

from car_interface.common import output
from car_interface.common.errors import CarInterfaceError
from car_interface.tools.cli.jobs import try_each
from car_interface.tools.cli.options import add_recording_arguments, add_scheduler_argument, length_m, topics_of
from car_interface.tools.report.page import page
from car_interface.tools.report.plots import plots
from car_interface.tools.report.summary import ROLES, summarize


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of bag_report."""
    parser.add_argument("bags", nargs="+", metavar="BAG", help="a ROS 1 bag, or a ROS 2 bag (its folder)")
    parser.add_argument("-o", "--output", metavar="FILE",
                        help="the page, or for several recordings a folder (default: BAG.html beside each)")
    parser.add_argument("--wheelbase", type=length_m, metavar="M", help="between the axles: which curvature an asked "
                        "steering angle (ackermann) is")
    add_recording_arguments(parser, ROLES)
    add_scheduler_argument(parser)


def run(options: argparse.Namespace) -> int:
    """Write the pages."""
    if options.scheduler is not None:  # a worker on another computer has another current folder
        options.bags = list(map(os.path.abspath, options.bags))
    topics, failed, pages = topics_of(options), 0, []
    for bag, path in _pages(options):
        try:
            output.check(path, options.bags)
            pages.append((bag, path))
        except CarInterfaceError as error:
            failed = _failed(error)
    report = partial(_report, namespace=options.namespace, wheelbase_m=options.wheelbase,
                     progress=len(options.bags) == 1, **topics)
    made = try_each(report, [bag for bag, _ in pages], "no page can be made of it", options.jobs, options.scheduler)
    for (bag, path), (report_of_it, error) in zip(pages, made):
        try:
            if error:
                raise CarInterfaceError(error)
            notes, content = report_of_it
            for note in notes:
                print(f"bag_report: {bag}: {note}", file=sys.stderr)
            output.write(path, content)
            print(path)
        except CarInterfaceError as refused:
            failed = _failed(refused)
    return failed


def _failed(error):
    print(f"bag_report: {error}", file=sys.stderr)
    return 1


def _pages(options):
    """Return pairs of a recording and its page's path."""
    bags, folder = options.bags, options.output
    if folder is not None and not os.path.isdir(folder):
        if len(bags) == 1:
            return [(bags[0], folder)]
        raise CarInterfaceError(f"-o {folder} is no folder, and {len(bags)} recordings need one: "
                                f"mkdir {shlex.quote(folder)}")
    pages = [(bag, str(page_path(bag, options.namespace, folder))) for bag in bags]
    names = [os.path.realpath(page) for _, page in pages]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice:
        raise CarInterfaceError(f"two recordings would both get the page {Path(twice).name}: report them one by one")
    return pages


def page_path(bag: str, namespace: str, folder: str | None = None) -> Path:
    """Return where the page about a recording is written; ``folder``: ``None`` = beside it."""
    place = Path(bag) if Path(bag).suffix == ".bag" else Path(bag).resolve()  # "." or "bag/" name a folder, too
    stem = place.stem if place.suffix == ".bag" or folder is not None else place.name
    return Path(folder or place.parent) / ".".join([stem, *filter(None, namespace.split("/")), "html"])


def _report(bag, **options):
    """Return lines on the topics that a page is about, and the page."""
    drive = summarize(bag, **options)
    drive.path = os.path.abspath(bag)  # whoever reads the page, or a worker elsewhere, is in another folder
    return drive.notes, page(drive, plots(drive))
