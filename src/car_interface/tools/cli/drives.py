"""A table of all drives in a folder, with trends: who drove how far, what was lost, what drifts.

Recordings are read once: the next time only those that are new or have changed. It writes a page and a CSV.
"""
from __future__ import annotations

import argparse
import os
import sys
import time
from functools import partial
from urllib.parse import quote

from car_interface.common import output
from car_interface.common.black_box_folder import default_folder, newest
from car_interface.common.errors import CarInterfaceError, ConfigError
from car_interface.tools.cli.bag_report import page_path as report_path
from car_interface.tools.cli.drives_cache import find_recordings, fingerprint, load_rows, save_rows
from car_interface.tools.cli.jobs import try_each
from car_interface.tools.cli.main import version
from car_interface.tools.cli.options import add_recording_arguments, add_scheduler_argument, topics_of
from car_interface.tools.report.drives_page import csv_text, in_order, page, trends
from car_interface.tools.report.drives_row import VERSION, Row, row
from car_interface.tools.report.summary import ROLES, summarize

MAX_SHOWN = 5  # in the terminal, of the recordings that can't be read


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of drives."""
    parser.add_argument("folder", metavar="FOLDER", help="with recordings, ROS 1 and ROS 2 bags, in it and below it")
    parser.add_argument("-o", "--output", metavar="FILE",
                        help="the page; the CSV is written beside it (default: FOLDER/drives.html)")
    parser.add_argument("--fresh", action="store_true", help="read all recordings again")
    add_recording_arguments(parser, ROLES)
    add_scheduler_argument(parser)


def run(options: argparse.Namespace) -> int:
    """Read what is new, and write the table."""
    topics, folder = topics_of(options), options.folder
    page_path = options.output or os.path.join(folder, "drives.html")
    csv_path = os.path.splitext(page_path)[0] + ".csv"
    if page_path == csv_path:
        raise ConfigError("--output", page_path, "the page's name, as in drives.html: the CSV lies beside it")
    if not os.path.isdir(folder):
        raise CarInterfaceError(f"{folder} is no folder: name the one with the recordings")
    paths = find_recordings(folder)
    if not paths:
        raise CarInterfaceError(f"{folder} has no recording: no .bag, no .mcap, no .db3, here or below")
    _check_output((page_path, csv_path), [os.path.join(folder, path) for path in paths], options.output is None)
    rows, read = _read_rows(options, topics, paths)
    rows = in_order(rows)
    drawn = trends([one for one in rows if not one.error])
    shown = page(_title(folder), rows, drawn, _reports(options, page_path, rows))
    for path, text in ((csv_path, csv_text(rows)), (page_path, shown)):
        output.write(path, text.encode("utf-8", "replace"))  # a file's name may be no UTF-8
    bad = [one for one in rows if one.error]
    for one in bad[:MAX_SHOWN]:
        print(f"drives: {one.error}", file=sys.stderr)
    if len(bad) > MAX_SHOWN:
        print(f"drives: and {len(bad) - MAX_SHOWN} more that can't be read: the page says why", file=sys.stderr)
    print(f"{folder}: {len(rows)} recording{'s' if len(rows) > 1 else ''}, {read} read now, {len(rows) - read} "
          f"read before" + (f"; {len(bad)} can't be read" if bad else ""))
    print(f"written: {page_path}, {csv_path}")
    stop = newest(default_folder())
    if stop is not None:
        print(f"the last stop that nobody asked for: {stop.describe(time.time())}: {stop.command}")
    return int(len(bad) == len(rows))


def _reports(options, own_path, rows):
    """Return URLs of the pages that bag_report has written beside the recordings, by the recordings' paths."""
    pages = {one.path: report_path(os.path.join(options.folder, one.path), options.namespace) for one in rows}
    beside = os.path.dirname(os.path.abspath(own_path))
    return {path: quote(os.path.relpath(str(page), beside).encode("utf-8", "surrogateescape"))
            for path, page in pages.items() if page.is_file()}


def _title(folder):
    """Return the folder's name for its readers; "." has none."""
    is_named = os.path.basename(os.path.normpath(folder)).strip(".")
    return folder if is_named else os.path.realpath(folder)


def _check_output(outputs, recordings, is_default):
    """Refuse, before the work, what can't be written."""
    try:
        for path in outputs:
            output.check(path, recordings)
    except CarInterfaceError as error:
        if not is_default:
            raise
        raise CarInterfaceError(f"{error}; -o FILE writes it elsewhere") from error


def _read_rows(options, topics, paths):
    """Return the rows of the recordings at ``paths`` below the folder, and how many of them had to be read.

    What was read is kept even if this is interrupted.
    """
    settings = str([VERSION, version(), options.namespace, sorted(topics.items())])
    kept, note = load_rows(options.folder, settings)
    if note:
        print(f"drives: {note}", file=sys.stderr)
    states = {path: fingerprint(os.path.join(options.folder, path)) for path in paths}
    known = {path: kept[path][1] for path in paths
             if path in kept and kept[path][0] == states[path] and not options.fresh}
    rows, new = list(known.values()), [path for path in paths if path not in known]
    # A worker on another computer has another current folder.
    folder = os.path.abspath(options.folder)
    read = partial(_read, folder=folder, namespace=options.namespace, topics=topics)
    made = try_each(read, new, "no row can be made of it", options.jobs, options.scheduler)
    try:
        for path, (one, error) in zip(new, made):
            if not error:  # what prevents reading may be gone the next time
                kept[path] = states[path], one
            # It begins with the recording's name; a command to type keeps the whole path.
            rows.append(one or Row(path, error=error.replace(os.path.join(folder, path), path, 1)))
            if sys.stderr.isatty():
                print(f"{len(rows)} of {len(paths)}: {path}", file=sys.stderr)
    finally:
        present = {path: kept[path] for path in paths if path in kept}
        problem = save_rows(options.folder, settings, present) if new or note else ""
    if problem:
        print(f"drives: what was read can't be kept for the next time: {problem}", file=sys.stderr)
    return rows, len(new)


def _read(path, folder, namespace, topics):
    return row(summarize(os.path.join(folder, path), namespace, **topics), path)
