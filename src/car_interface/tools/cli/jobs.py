"""Does the same work on several recordings at once, in processes."""
from __future__ import annotations

from collections import deque
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from typing import Any, Callable, Iterator, Sequence

from car_interface.common.errors import CarInterfaceError
from car_interface.common.library_warnings import hide_warnings
from car_interface.common.memory_limit import describe_shortage
from car_interface.tools.recordings.overlap import check_no_overlap, check_paths_differ


def for_each(function: Callable[[Any], Any], items: Sequence[Any], jobs: int) -> Iterator[Any]:
    """Yield ``function(item)``, which is pickled, for each item, in order; in processes, at most ``jobs`` at a time.

    Raises:
        CarInterfaceError: a process was killed; besides whatever the function raises.
    """
    if jobs == 1 or len(items) < 2:
        yield from map(function, items)
        return
    # As many as there are processes: pending work would have to be cancelled when other work fails, and in Python 3.8
    # a pool that has only cancelled work left never ends.
    with ProcessPoolExecutor(min(jobs, len(items)), initializer=hide_warnings) as pool:
        results: deque = deque()
        try:
            for item in items:
                running = [result for result in results if not result.done()]
                if len(running) == jobs:
                    wait(running, return_when=FIRST_COMPLETED)
                results.append(pool.submit(function, item))
                while results and results[0].done():
                    yield results.popleft().result()
            while results:
                yield results.popleft().result()
        except BrokenProcessPool as error:
            raise CarInterfaceError("a process that read a recording was killed, maybe for want of memory: "
                                    "try again with --jobs 1") from error


def failure_text(error: Exception, path: str, refusal: str) -> str:
    """Return in one line why the work on a recording failed; the other recordings are worked on all the same."""
    if isinstance(error, CarInterfaceError):
        return str(error)
    if isinstance(error, OSError):
        return f"{error.filename or path}: {error.strerror}"
    why = describe_shortage(error) or f"{type(error).__name__}: {' '.join(str(error).split())}"
    return f"{path}: {refusal} ({why})"


def load_all(load: Callable[[str], Any], paths: Sequence[str], jobs: int) -> list[Any]:
    """Return ``load(path)`` for each recording; each result has a ``trail`` by which it is compared with the others.

    Raises:
        NoRecording: two have the same driving in them; besides whatever ``load`` raises.
    """
    check_paths_differ(paths)
    loaded = list(for_each(load, paths, jobs))
    check_no_overlap([one.trail for one in loaded])
    return loaded
