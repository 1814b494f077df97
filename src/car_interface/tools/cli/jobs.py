"""Does the same work on several recordings at once: in processes, or on the workers of a dask cluster."""
from __future__ import annotations

import logging
import multiprocessing
import os
import signal
import socket
import threading
from collections import deque
from concurrent.futures import FIRST_COMPLETED, CancelledError, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from functools import partial
from itertools import combinations
from typing import Any, Callable, Iterator, Sequence

import numpy as np

from car_interface.common import process_setup
from car_interface.common.errors import CarInterfaceError
from car_interface.tools.cli.main import version
from car_interface.tools.recordings.recording import NoRecording
from car_interface.tools.recordings.signals import Trail

SCHEDULER_TIMEOUT_S = 10  # to connect, and to have a worker
MAX_PENDING = 1000  # recordings at a time in a cluster: more than it has workers, and few for its scheduler
SAME_TIME_S = 1e-5  # odometry of two recordings at the same place within this time is the same message
MIN_SAME = 50  # so many messages alike are no coincidence
WORKER_LOCK = threading.Lock()  # a worker may have several threads, and matplotlib is made for one


def for_each(function: Callable[[Any], Any], items: Sequence[Any], jobs: int,
             scheduler: str | None = None) -> Iterator[Any]:
    """Yield ``function(item)`` for each item, in order; raise whatever the function raises.

    An item whose workers were killed again and again is worked on once more, alone: others that were on their way to
    these workers are under suspicion, too. If that fails as well, ``function(item, killed=True)`` takes its place.

    Args:
        jobs: how many processes there may be; with one of them, or for one item, this process does the work.
        scheduler: address of a dask cluster's, which does the work in their place.

    Raises:
        CarInterfaceError: a process was killed, or the cluster doesn't do the work.
    """
    jobs = min(jobs, len(items))
    if not items or scheduler is None and jobs < 2:
        yield from map(function, items)
        return
    with _processes(jobs) if scheduler is None else _cluster(scheduler) as (submit, max_pending, killed):
        results: deque = deque()
        for item in items:
            running = [result for _, result in results if not result.done()]
            if len(running) == max_pending:
                wait(running, return_when=FIRST_COMPLETED)
            results.append((item, submit(function, item)))
            while results and results[0][1].done():
                yield _result(function, results, submit, killed)
        while results:
            yield _result(function, results, submit, killed)


def try_each(function: Callable[[str], Any], paths: Sequence[str], refusal: str, jobs: int,
             scheduler: str | None = None) -> Iterator[tuple[Any, str]]:
    """Yield (``function(path)``, empty) for each recording, or (``None``, why not, in one line), as ``for_each`` does.

    One bad recording must not prevent the work on the others; ``refusal`` says of it what can't be done.
    """
    return for_each(partial(_tried, function, refusal), paths, jobs, scheduler)


def _tried(function, refusal, path, killed=False):
    try:
        if killed:
            raise CarInterfaceError(f"{path} ended each worker that read it, maybe for want of memory: read it on a "
                                    "computer with more, without --scheduler")
        return function(path), ""
    except CarInterfaceError as error:
        return None, str(error)
    except OSError as error:
        return None, f"{error.filename or path}: {error.strerror}"
    except Exception as error:
        why = process_setup.describe_shortage(error) or f"{type(error).__name__}: {' '.join(str(error).split())}"
        return None, f"{path}: {refusal} ({why})"


def _result(function, results, submit, killed):
    item, result = results.popleft()
    try:
        return result.result()
    except killed:
        wait([other for _, other in results])
    try:
        return submit(function, item).result()
    except killed:
        return function(item, killed=True)


@contextmanager
def _processes(jobs):
    """Yield what ``for_each`` gives the work to, how much at a time, and what a result raises whose workers are killed.

    That is as many as there are processes: pending work would have to be cancelled when other work fails, and in Python
    3.8 a pool that has only cancelled work left never ends.
    """
    # A fork of this process would copy the locks of its threads: numpy's OpenBLAS has some.
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(jobs, context, initializer=_prepare_process) as executor:
        def submit(function, item):  # it starts processes; Ctrl-C is to end them without a traceback, also then
            signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
            try:
                return executor.submit(function, item)
            finally:
                signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
        try:
            yield submit, jobs, ()
        except BrokenProcessPool as error:
            raise CarInterfaceError("a process that read a recording was killed, maybe for want of memory: "
                                    "try again with --jobs 1") from error


def _prepare_process():
    """Do in a new process what ``main`` has done in this one, and let Ctrl-C end it."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    process_setup.prepare()


@contextmanager
def _cluster(address):
    """Yield the same for a dask cluster. It gives the work of a worker that was lost to another one."""
    import distributed  # an extra of setup.py

    logging.disable(logging.CRITICAL)  # what it logs, by loggers with levels of their own, ends as one line of ours
    place = f"--scheduler {address}"
    try:
        client = distributed.Client(address, timeout=SCHEDULER_TIMEOUT_S, set_as_default=False)
    except (OSError, TimeoutError, ValueError) as error:  # of an address, too
        raise CarInterfaceError(f"{place}: no scheduler of a dask cluster answers there") from error
    with client:
        try:
            client.wait_for_workers(1, timeout=SCHEDULER_TIMEOUT_S)
        except Exception as error:  # its TimeoutError is another one in each version
            raise CarInterfaceError(f"{place}: it has no worker: start one by dask worker {address}") from error
        submit = partial(client.get_executor(pure=False).submit, _on_worker, version())
        try:
            yield submit, MAX_PENDING, (distributed.KilledWorker,)
        except CancelledError as error:
            raise CarInterfaceError(f"{place}: it has ended before its work was done") from error
        except ModuleNotFoundError as error:
            raise CarInterfaceError(f"{place}: a worker lacks {error.name}: install car_interface[tools,cluster] on "
                                    "each") from error


def _on_worker(expected, function, item):
    if version() != expected:  # its rows would be others
        raise CarInterfaceError(f"the worker on {socket.gethostname()} has car_interface {version()}, here is "
                                f"{expected}: install the same on both")
    with WORKER_LOCK:
        return function(item)


def load_all(load: Callable[[str], Any], paths: Sequence[str], jobs: int) -> list[Any]:
    """Return ``load(path)`` for each recording; each result has a ``trail`` by which it is compared with the others.

    Raises:
        NoRecording: two have the same driving in them; besides whatever ``load`` raises.
    """
    check_paths_differ(paths)
    loaded = list(for_each(load, paths, jobs))
    check_no_overlap([one.trail for one in loaded])
    return loaded


def check_paths_differ(paths: Sequence[str]) -> None:
    """Raise NoRecording with both names when a file is given twice."""
    files = [(path, os.path.realpath(path)) for path in paths]
    for (path, file), (other, other_file) in combinations(files, 2):
        if file == other_file:
            raise NoRecording(f"{path} and {other} are the same recording: it would count twice")


def check_no_overlap(trails: Sequence[Trail]) -> None:
    """Raise NoRecording with the names of two that have driving in common, such as a copy or a part of another one.

    Times alone don't show it: a computer without a battery-backed clock may start at the same time again.
    """
    for other, one in combinations(trails, 2):
        if not one.t_s.size or not other.t_s.size:
            continue
        nearest = np.clip(np.searchsorted(other.t_s, one.t_s - SAME_TIME_S), 0, other.t_s.size - 1)
        same = ((np.abs(other.t_s[nearest] - one.t_s) <= SAME_TIME_S) & (other.x_m[nearest] == one.x_m)
                & (other.y_m[nearest] == one.y_m)).sum()
        if same >= MIN_SAME:
            raise NoRecording(f"{other.path} and {one.path} have the same driving in them, at {same} moments of "
                              "odometry: it would count twice")
