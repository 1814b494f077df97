"""A table of all drives in a folder, with trends: who drove how far, what was lost, what drifts.

Recordings are read once: the next time only those that are new or have changed. It writes a page and a CSV.
"""
from __future__ import annotations

import argparse
import os
import sys
from dataclasses import dataclass, field
from functools import partial
from typing import Mapping

from car_interface.common import output
from car_interface.common.errors import CarInterfaceError, ConfigError
from car_interface.common.memory_limit import describe_shortage
from car_interface.tools.cli.drives_cache import Cache
from car_interface.tools.cli.jobs import add_jobs_argument, for_each
from car_interface.tools.cli.options import add_namespace_argument
from car_interface.tools.cli.topics import add_topic_arguments, topics_of
from car_interface.tools.cli.version import version
from car_interface.tools.recordings.folder import find_recordings, fingerprint
from car_interface.tools.report.drives_page import csv_text, in_order, page
from car_interface.tools.report.drives_plots import trends
from car_interface.tools.report.drives_row import VERSION, Row, row
from car_interface.tools.report.summary import ROLES, summarize

MAX_SHOWN = 5  # in the terminal, of the recordings that can't be read


@dataclass(frozen=True)
class Config:
    """Which drives to compare, and where to write it.

    Attributes:
        folder: with the recordings, in it and below it.
        output: path of the page; the CSV lies beside it.
        namespace: the car's.
        topics: named by the user, by role.
        fresh: read all recordings again.
        jobs: recordings to read at the same time.

    Raises:
        ConfigError: naming the option.
    """

    folder: str
    output: str
    namespace: str = "/"
    topics: Mapping[str, str] = field(default_factory=dict)
    fresh: bool = False
    jobs: int = 1

    @property
    def csv(self) -> str:
        """Path of the CSV."""
        return os.path.splitext(self.output)[0] + ".csv"

    @property
    def title(self) -> str:
        """The folder's name for its readers; "." has none."""
        is_named = os.path.basename(os.path.normpath(self.folder)).strip(".")
        return self.folder if is_named else os.path.realpath(self.folder)

    def __post_init__(self):
        if self.output == self.csv:
            raise ConfigError("--output", self.output, "the page's name, as in drives.html: the CSV lies beside it")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of drives."""
    parser.add_argument("folder", metavar="FOLDER", help="with recordings, ROS 1 and ROS 2 bags, in it and below it")
    parser.add_argument("-o", "--output", metavar="FILE",
                        help="the page; the CSV is written beside it (default: FOLDER/drives.html)")
    add_namespace_argument(parser)
    add_topic_arguments(parser, ROLES)
    parser.add_argument("--fresh", action="store_true", help="read all recordings again")
    add_jobs_argument(parser)


def run(options: argparse.Namespace) -> int:
    """Read what is new, and write the table."""
    config = Config(options.folder, options.output or os.path.join(options.folder, "drives.html"), options.namespace,
                    topics_of(options), options.fresh, options.jobs)
    if not os.path.isdir(config.folder):
        raise CarInterfaceError(f"{config.folder} is no folder: name the one with the recordings")
    paths = find_recordings(config.folder)
    if not paths:
        raise CarInterfaceError(f"{config.folder} has no recording: no .bag, no .mcap, no .db3, here or below")
    recordings = [os.path.join(config.folder, path) for path in paths]
    _check_output(config, recordings, options.output is None)
    rows, read = read_rows(config, paths)
    rows = in_order(rows)
    drawn = trends([one for one in rows if not one.error])
    for path, text in ((config.csv, csv_text(rows)), (config.output, page(config.title, rows, drawn))):
        output.write(path, text.encode("utf-8", "replace"))  # a file's name may be no UTF-8
    bad = [one for one in rows if one.error]
    for one in bad[:MAX_SHOWN]:
        print(f"drives: {one.error}", file=sys.stderr)
    if len(bad) > MAX_SHOWN:
        print(f"drives: and {len(bad) - MAX_SHOWN} more that can't be read: the page says why", file=sys.stderr)
    print(f"{config.folder}: {len(rows)} recording{'s' if len(rows) > 1 else ''}, {read} read now, {len(rows) - read} "
          f"read before" + (f"; {len(bad)} can't be read" if bad else ""))
    print(f"written: {config.output}, {config.csv}")
    return int(len(bad) == len(rows))


def _check_output(config, recordings, is_default):
    """Refuse, before the work, what can't be written."""
    try:
        for path in (config.output, config.csv):
            output.check(path, recordings)
    except CarInterfaceError as error:
        if not is_default:
            raise
        raise CarInterfaceError(f"{error}; -o FILE writes it elsewhere") from error


def read_rows(config: Config, paths: list[str]) -> tuple[list[Row], int]:
    """The rows of the recordings at ``paths`` below the folder, and how many of them had to be read.

    What was read is kept even if this is interrupted.

    Raises:
        CarInterfaceError: a process that read was killed.
    """
    settings = [VERSION, version(), config.namespace, sorted(config.topics.items())]
    cache = Cache(config.folder, str(settings))
    if cache.problem:
        print(f"drives: {cache.problem}: all recordings are read again", file=sys.stderr)
    if cache.damaged:
        print(f"drives: {cache.path} has damaged rows ({cache.damaged}): their recordings are read again",
              file=sys.stderr)
    states = {path: _state(config.folder, path) for path in paths}
    known = {} if config.fresh else {path: cache.row(path, states[path]) for path in paths}
    new = [path for path in paths if known.get(path) is None]
    rows = [known[path] for path in paths if known.get(path) is not None]
    try:
        for one in for_each(partial(_read, config=config), new, config.jobs):
            rows.append(one)
            cache.add(states[one.path], one)
            if sys.stderr.isatty():
                print(f"{len(rows)} of {len(paths)}: {one.path}", file=sys.stderr)
    finally:
        problem = cache.save(paths) if new or cache.problem or cache.damaged else ""
    if problem:
        print(f"drives: what was read can't be kept for the next time: {problem}", file=sys.stderr)
    return rows, len(new)


def _state(folder, path):
    try:
        return fingerprint(os.path.join(folder, path))
    except OSError:  # it is gone: reading says so
        return None


def _read(path, config):
    """The row of one recording; whatever is wrong with it becomes the row's error."""
    full = os.path.join(config.folder, path)
    try:
        return row(summarize(full, config.namespace, **config.topics), path)
    except CarInterfaceError as error:
        text = str(error)
    except OSError as error:
        text = f"{error.filename or full}: {error.strerror}"
    except Exception as error:  # one bad recording must not prevent the table of the others
        why = describe_shortage(error) or f"{type(error).__name__}: {' '.join(str(error).split())}"
        text = f"{full}: no row can be made of it ({why})"
    # It begins with the recording's name; a command to type keeps the whole path.
    return Row(path, error=text.replace(full, path, 1))
