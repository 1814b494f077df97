"""Does the same work on several recordings at once: in processes, or on the workers of a dask cluster."""
from __future__ import annotations

import logging
import multiprocessing
import signal
import socket
import threading
from collections import deque
from concurrent.futures import FIRST_COMPLETED, CancelledError, Executor, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from typing import Any, Callable, Iterator, NamedTuple, Sequence

from car_interface.common import memory_limit
from car_interface.common.errors import CarInterfaceError
from car_interface.common.library_warnings import hide_warnings
from car_interface.tools.cli.main import version
from car_interface.tools.recordings.overlap import check_no_overlap, check_paths_differ

SCHEDULER_TIMEOUT_S = 10  # to connect, and to have a worker
MAX_PENDING = 1000  # recordings at a time in a cluster: more than it has workers, and few for its scheduler
WORKER_LOCK = threading.Lock()  # a worker may have several threads, and matplotlib is made for one


class Workers(NamedTuple):
    """Where the work is done."""

    executor: Executor  # pickles functions, arguments and results, unless it works in this process
    max_pending: int  # how much it is given at a time
    killed: tuple = ()  # what a result raises whose workers were killed again and again


@contextmanager
def workers(count: int, jobs: int, scheduler: str | None = None) -> Iterator[Workers]:
    """Open what works on ``count`` recordings, and close it in the end.

    Args:
        jobs: how many processes there may be; with one of them this process does the work.
        scheduler: address of a dask cluster's, which does the work in their place.

    Raises:
        CarInterfaceError: a process was killed, or the cluster doesn't do the work.
    """
    jobs = min(jobs, count)
    if scheduler is not None and count:
        with _cluster(scheduler) as done_by:
            yield done_by
    elif jobs < 2:
        yield Workers(_InTurn(), 1)
    else:
        # A fork of this process would copy the locks of its threads: numpy's OpenBLAS has some.
        context = multiprocessing.get_context("spawn")
        with _Processes(jobs, context, initializer=_prepare_process) as executor:
            try:
                # As many as there are processes: pending work would have to be cancelled when other work fails, and in
                # Python 3.8 a pool that has only cancelled work left never ends.
                yield Workers(executor, jobs)
            except BrokenProcessPool as error:
                raise CarInterfaceError("a process that read a recording was killed, maybe for want of memory: "
                                        "try again with --jobs 1") from error


def for_each(function: Callable[[Any], Any], items: Sequence[Any], done_by: Workers) -> Iterator[Any]:
    """Yield ``function(item)`` for each item, in order; raise whatever the function raises.

    An item whose workers were killed again and again is worked on once more, alone: others that were on their way to
    these workers are under suspicion, too. If that fails as well, ``function(item, killed=True)`` takes its place.
    """
    results: deque = deque()
    for item in items:
        running = [result for _, result in results if not result.done()]
        if len(running) == done_by.max_pending:
            wait(running, return_when=FIRST_COMPLETED)
        results.append((item, done_by.executor.submit(function, item)))
        while results and results[0][1].done():
            yield _result(function, results, done_by)
    while results:
        yield _result(function, results, done_by)


def _result(function, results, done_by):
    item, result = results.popleft()
    try:
        return result.result()
    except done_by.killed:
        wait([other for _, other in results])
    try:
        return done_by.executor.submit(function, item).result()
    except done_by.killed:
        return function(item, killed=True)


class _InTurn(Executor):
    """Does the work at once, in this process."""

    def submit(self, function, *arguments):
        done: Future = Future()
        try:
            done.set_result(function(*arguments))
        except Exception as error:
            done.set_exception(error)
        return done


class _Processes(ProcessPoolExecutor):
    """Does the work in processes, which Ctrl-C ends without a traceback, also while they start."""

    def submit(self, function, *arguments):  # it starts them, with the signals that are blocked here
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            return super().submit(function, *arguments)
        finally:
            signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})


class _OnCluster(Executor):
    """Does the work on a cluster's workers, by the version that is here."""

    def __init__(self, executor):
        self._executor, self._version = executor, version()

    def submit(self, function, *arguments):
        return self._executor.submit(_on_worker, self._version, function, *arguments)


def _on_worker(expected, function, *arguments):
    if version() != expected:  # its rows would be others
        raise CarInterfaceError(f"the worker on {socket.gethostname()} has car_interface {version()}, here is "
                                f"{expected}: install the same on both")
    with WORKER_LOCK:
        return function(*arguments)


def _prepare_process():
    """Do in a new process what ``main`` has done in this one, and let Ctrl-C end it."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    hide_warnings()
    memory_limit.adapt()


@contextmanager
def _cluster(address) -> Iterator[Workers]:
    """Yield what works on a dask cluster. It gives the work of a worker that was lost to another one."""
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
        try:
            yield Workers(_OnCluster(client.get_executor(pure=False)), MAX_PENDING, (distributed.KilledWorker,))
        except CancelledError as error:
            raise CarInterfaceError(f"{place}: it has ended before its work was done") from error
        except ModuleNotFoundError as error:
            raise CarInterfaceError(f"{place}: a worker lacks {error.name}: install car_interface[tools,cluster] on "
                                    "each") from error


def check_not_killed(killed: bool, path: str) -> None:
    """Raise CarInterfaceError where all workers that read a recording were killed."""
    if killed:
        raise CarInterfaceError(f"{path} ended each worker that read it, maybe for want of memory: read it on a "
                                "computer with more, without --scheduler")


def failure_text(error: Exception, path: str, refusal: str) -> str:
    """Return in one line why the work on a recording failed; the other recordings are worked on all the same."""
    if isinstance(error, CarInterfaceError):
        return str(error)
    if isinstance(error, OSError):
        return f"{error.filename or path}: {error.strerror}"
    why = memory_limit.describe_shortage(error) or f"{type(error).__name__}: {' '.join(str(error).split())}"
    return f"{path}: {refusal} ({why})"


def load_all(load: Callable[[str], Any], paths: Sequence[str], jobs: int) -> list[Any]:
    """Return ``load(path)`` for each recording; each result has a ``trail`` by which it is compared with the others.

    Raises:
        NoRecording: two have the same driving in them; besides whatever ``load`` raises.
    """
    check_paths_differ(paths)
    with workers(len(paths), jobs) as done_by:
        loaded = list(for_each(load, paths, done_by))
    check_no_overlap([one.trail for one in loaded])
    return loaded
