"""A page about a drive: who drove, how it steered, where it went, how fast, and what went wrong.

It is one HTML file that needs nothing besides itself, no network either.
"""
from __future__ import annotations

import argparse
import os
import sys
import tempfile
from functools import partial
from pathlib import Path

from car_interface.bags.drive import look_at
from car_interface.bags.jobs import add_jobs_argument, for_each
from car_interface.bags.report_page import page
from car_interface.bags.report_plots import plots
from car_interface.errors import CarInterfaceError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of bag_report."""
    parser.add_argument("bags", nargs="+", metavar="BAG", help="a ROS 1 bag, or a ROS 2 bag (its folder)")
    parser.add_argument("-o", "--output", metavar="FILE",
                        help="the page, or for several recordings a folder (default: BAG.html beside each)")
    parser.add_argument("--ns", default="/", metavar="NAME", help="the car's namespace (default: /)")
    parser.add_argument("--odom", default="odom", metavar="TOPIC", help="the topic of its odometry (default: odom)")
    add_jobs_argument(parser)


def run(options: argparse.Namespace) -> int:
    """Write the pages."""
    pages = _pages(options.bags, options.output)
    work = partial(_report, namespace=options.ns, odom=options.odom, progress=len(options.bags) == 1)
    failed = 0
    for (bag, _), trouble in zip(pages, for_each(work, pages, options.jobs)):
        if trouble:
            failed = 1
            print(f"bag_report: {trouble}", file=sys.stderr)
        else:
            print(dict(pages)[bag])
    return failed


def _pages(bags, output):
    """Pairs of a recording and where its page goes."""
    if output is None:
        return [(bag, str(Path(bag).with_suffix(".html") if Path(bag).suffix == ".bag" else
                          Path(bag).resolve().with_name(Path(bag).resolve().name + ".html"))) for bag in bags]
    if len(bags) == 1 and not os.path.isdir(output):
        return [(bags[0], output)]
    if not os.path.isdir(output):
        raise CarInterfaceError(f"-o {output} is no folder, and {len(bags)} recordings need one: mkdir {output}")
    names = [Path(bag).resolve().stem + ".html" for bag in bags]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice:
        raise CarInterfaceError(f"two recordings would both get the page {twice}: report them one by one")
    return [(bag, os.path.join(output, name)) for bag, name in zip(bags, names)]


def _report(bag_and_page, namespace, odom, progress):
    """Write one page; what went wrong, or an empty text."""
    bag, output = bag_and_page
    try:
        drive = look_at(bag, namespace, odom, progress)
        _write(output, page(drive, plots(drive)))
    except CarInterfaceError as error:
        return str(error)
    except OSError as error:
        return f"{error.filename or output}: {error.strerror}"
    return ""


def _write(path, text):
    """All of it or nothing: a page that is half written looks like a bad drive."""
    folder = os.path.dirname(os.path.abspath(path))
    handle, temporary = tempfile.mkstemp(dir=folder, prefix=".bag_report")
    try:
        with os.fdopen(handle, "w", encoding="utf-8") as file:
            file.write(text)
        os.chmod(temporary, 0o666 & ~_umask())
        os.replace(temporary, path)
    except BaseException:
        os.unlink(temporary)
        raise


def _umask():
    mask = os.umask(0)
    os.umask(mask)
    return mask
