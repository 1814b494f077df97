"""A table of all drives in a folder, with trends: who drove how far, what was lost, what drifts.

Recordings are read once: the next time only those that are new or have changed. It writes a page and a CSV.
"""
from __future__ import annotations

import argparse
import hashlib
import json
import os
import sys
import time
from functools import partial
from typing import Mapping
from urllib.parse import quote

from car_interface.common import output
from car_interface.common.atomic_file import replace
from car_interface.common.black_box_folder import default_folder, newest
from car_interface.common.errors import CarInterfaceError, require
from car_interface.common.input_file import read_file
from car_interface.tools.cli.bag_report import page_path as report_path
from car_interface.tools.cli.jobs import try_each
from car_interface.tools.cli.main import version
from car_interface.tools.cli.options import add_recording_arguments, add_scheduler_argument, topics_of
from car_interface.tools.recordings.recording import METADATA, ROS2_SUFFIXES
from car_interface.tools.report.drives import VERSION, Row, csv_text, in_order, page, row, trends
from car_interface.tools.report.summary import ROLES, summarize

MAX_SHOWN = 5  # in the terminal, of the recordings that can't be read
# A bag that is being recorded, or whose recorder was killed, has the second one.
ROS1_SUFFIXES = (".bag", ".bag.active")
ORIGINAL = ".orig"  # rosbag reindex keeps a damaged a.bag as a.orig.bag
# The rows of what was read before: a line with the checksum of the second one, so that damage is noticed.
CACHE = ".car_interface_drives.json"
MAX_CACHE_BYTES = 64_000_000  # a row has about 1 kB: 60,000 recordings


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
    require(page_path != csv_path, "--output", page_path, "the page's name, as in drives.html: the CSV lies beside it")
    if not os.path.isdir(folder):
        raise CarInterfaceError(f"{folder} is no folder: name the one with the recordings")
    paths = find_recordings(folder)
    if not paths:
        raise CarInterfaceError(f"{folder} has no recording: no .bag, no .mcap, no .db3, here or below")
    _check_output((page_path, csv_path), [os.path.join(folder, path) for path in paths], options.output is None)
    rows, read = _read_rows(options, topics, paths)
    rows = in_order(rows)
    drawn = trends([one for one in rows if not one.error])
    is_named = os.path.basename(os.path.normpath(folder)).strip(".")  # "." says nothing to who reads the page
    shown = page(folder if is_named else os.path.realpath(folder), rows, drawn, _reports(options, page_path, rows))
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
    pages = {one.path: report_path(os.path.join(options.folder, one.path), options.namespace)
             for one in rows if not one.error}
    beside = os.path.dirname(os.path.abspath(own_path))
    return {path: quote(os.path.relpath(str(page), beside).encode("utf-8", "surrogateescape"))
            for path, page in pages.items() if page.is_file()}


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


def find_recordings(folder: str) -> list[str]:
    """Return the paths of all recordings in a folder and below it, relative to it, in order.

    A ROS 2 bag is its folder, or a file that lies in no such folder. Left out are hidden folders, and what rosbag
    reindex has kept of a recording that it repaired.

    Raises:
        OSError: the folder can't be read.
    """
    found = []
    os.scandir(folder).close()  # os.walk leaves out what it can't read, also the first
    for place, folders, files in os.walk(folder):
        if METADATA in files and any(name.endswith(ROS2_SUFFIXES) for name in files):
            found.append(os.path.relpath(place, folder))
            folders.clear()
            continue
        folders[:] = [name for name in folders if not name.startswith(".")]
        found += [os.path.relpath(os.path.join(place, name), folder) for name in files
                  if name.endswith((*ROS1_SUFFIXES, *ROS2_SUFFIXES)) and not _is_original(name, files)]
    return sorted(found)


def _is_original(name, files):
    """Return whether the repaired recording lies beside it."""
    stem, suffix = os.path.splitext(name)
    return stem.endswith(ORIGINAL) and stem[:-len(ORIGINAL)] + suffix in files


def fingerprint(path: str) -> list[int] | None:
    """Return what differs once a recording has changed: size in bytes and time of change in ns, of a folder those of
    all its files together; ``None``: it is gone.
    """
    try:
        paths = [os.path.join(path, name) for name in os.listdir(path)] if os.path.isdir(path) else [path]
        stats = [os.stat(one) for one in paths]
    except OSError:
        return None
    return [sum(one.st_size for one in stats), max((one.st_mtime_ns for one in stats), default=0)]


def load_rows(folder: str, version: str) -> tuple[dict, str]:
    """Return the rows that were kept of a folder's recordings; those of another version, as with other options, aren't.

    Returns:
        (fingerprint, Row) by path, and in words what can't be used; empty: nothing is wrong.
    """
    path = next(filter(os.path.exists, _cache_paths(folder)), None)
    if path is None:
        return {}, ""
    try:
        checksum, body = read_file(path, MAX_CACHE_BYTES).decode("ascii").split("\n")[:2]
    except OSError as error:
        return {}, f"{path} can't be read ({error.strerror}): all recordings are read again"
    except ValueError:
        checksum = body = ""
    if checksum != _checksum(body):
        return {}, f"{path} is damaged: all recordings are read again"
    content = json.loads(body)
    rows = content["rows"] if content["version"] == version else {}
    return {name: (state, Row(*values)) for name, (state, values) in rows.items()}, ""


def save_rows(folder: str, version: str, rows: Mapping[str, tuple[list[int] | None, Row]]) -> str:
    """Keep the rows, as ``load_rows`` returns them; return why they can't be written, or an empty text."""
    body = json.dumps({"version": version, "rows": rows}, ensure_ascii=True)
    problem = ""
    for path in _cache_paths(folder):
        try:
            os.makedirs(os.path.dirname(path), exist_ok=True)
            replace(path, f"{_checksum(body)}\n{body}\n".encode("ascii"), keeps_old=False)
            return ""
        except OSError as error:
            problem = problem or f"{path}: {error.strerror}"
    return problem


def _cache_paths(folder):
    """Return where the file may be: in the folder, or, where that can't be written, in the user's cache folder."""
    cache = os.environ.get("XDG_CACHE_HOME") or os.path.join(os.path.expanduser("~"), ".cache")
    name = hashlib.sha256(os.path.realpath(folder).encode("utf-8", "surrogateescape")).hexdigest()[:16]
    return os.path.join(folder, CACHE), os.path.join(cache, "car_interface", f"drives-{name}.json")


def _checksum(body):
    return hashlib.sha256(body.encode("ascii")).hexdigest()
