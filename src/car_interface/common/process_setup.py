"""Prepares a process: one whose memory is limited (ulimit -v) or used up takes less, or ends with one line.

It also hides the warnings of numpy, scipy and matplotlib, which are meant for programmers. They name no cause that a
user could mend. The tests turn each one that they can provoke into an error, so that its cause is mended; this is for
those of other versions. ``python3 -W default`` shows them.
"""
from __future__ import annotations

import ctypes
import errno
import logging
import mmap
import os
import re
import resource
import sys
import threading
import warnings
from contextlib import suppress

from car_interface.common.errors import CarInterfaceError

MIB = 1 << 20
M_ARENA_MAX = -8  # of glibc's malloc.h
STACK_BYTES = 2 * MIB  # of a thread; 8 MiB by default
# OpenBLAS 0.3.21 takes 128 MiB at its first product of matrices, and some to align them. It retries for ever.
BLAS_BYTES = 136 * MIB
# The dynamic linker's texts in an ImportError.
LINKER_TEXTS = ("failed to map segment", "cannot allocate memory", "cannot apply additional memory protection")
# From an extension module that has no memory left for its own error.
LOST_ERRORS = ("without setting an exception", "without exception set")
# From a compiler that goes on after its MemoryError: 3.8's ("field target is …") to 3.11's, and of 3.8's parser.
LOST_NODE = re.compile(r"^field '?\w+'? is required for \w+$")
LOST_END = "unexpected EOF while parsing"
NO_THREAD = "can't start new thread"


def limit_bytes() -> int | None:
    """Return this process's limit of address space; ``None`` = there is none."""
    limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    return None if limit == resource.RLIM_INFINITY else limit


def prepare(needed_mib: int = 0) -> None:
    """Hide warnings, and take less address space where it is limited.

    To be called before threads are started and these libraries are imported. glibc would reserve 64 MiB for most
    threads, and OpenBLAS start one for each processor.

    Args:
        needed_mib: with a lower limit parts of the process would fail.

    Raises:
        CarInterfaceError: the limit is lower.
    """
    if not sys.warnoptions:
        warnings.simplefilter("ignore")
    # Matplotlib also logs that it builds its cache of fonts, a folder that can't be written, a typo in a matplotlibrc.
    logging.getLogger("matplotlib").setLevel(logging.CRITICAL)
    os.environ["MPLBACKEND"] = "Agg"  # a backend that isn't installed, such as a notebook's, would end the import
    limit = limit_bytes()
    if limit is None:
        return
    if limit < needed_mib * MIB:
        raise CarInterfaceError(f"it needs {needed_mib} MB of address space, and its limit is {limit // MIB} MB: raise "
                                "that in the shell that starts it (ulimit -v unlimited)")
    with suppress(AttributeError, OSError):  # another C library than glibc
        ctypes.CDLL(None).mallopt(M_ARENA_MAX, 1)
    threading.stack_size(STACK_BYTES)
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
        os.environ.setdefault(name, "1")


def reserve_blas() -> None:
    """Have OpenBLAS take its memory now, as far as numpy and scipy are loaded and memory is limited.

    Raises:
        MemoryError: there is too little. Later OpenBLAS would wait for it without an error or an end.
    """
    numpy = sys.modules.get("numpy")
    if numpy is None or limit_bytes() is None:
        return
    matrix = numpy.ones((64, 64))
    products = [lambda: numpy.dot(matrix, matrix)]
    scipy_blas = sys.modules.get("scipy.linalg.blas")  # may come with an OpenBLAS of its own
    if scipy_blas is not None:
        products.append(lambda: scipy_blas.dgemm(1.0, matrix, matrix))
    for multiply in products:
        try:
            mmap.mmap(-1, BLAS_BYTES, flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS).close()
        except (OSError, ValueError) as error:
            raise MemoryError from error
        multiply()


def describe_shortage(error: BaseException) -> str | None:
    """Return one line with cause and remedy if an error is a want of memory or of threads; else ``None``."""
    seen: set = set()
    kind = None
    while error is not None and id(error) not in seen and kind is None:
        seen.add(id(error))
        kind = _kind(error)
        error = error.__cause__ or error.__context__
    if kind is None:
        return None
    limit = limit_bytes()
    if limit is not None:
        return (f"{kind}: its limit of address space is {limit // MIB} MB; raise that in the shell that starts it "
                "(ulimit -v unlimited)")
    if kind == NO_THREAD:
        return f"{kind}: raise the limit of processes (ulimit -u), or end other programs"
    return f"{kind}: end other programs"


def _kind(error):
    text = str(error)
    if isinstance(error, RuntimeError) and NO_THREAD in text:
        return NO_THREAD
    is_want = (isinstance(error, MemoryError) or isinstance(error, OSError) and error.errno == errno.ENOMEM
               or isinstance(error, ImportError) and any(words in text.lower() for words in LINKER_TEXTS))
    return "out of memory" if is_want or limit_bytes() is not None and _is_lost(error, text) else None


def _is_lost(error, text):
    """Return whether an error may stand for one of memory that was lost; nothing but imports compiles here."""
    return (isinstance(error, SystemError) and any(words in text for words in LOST_ERRORS)
            or isinstance(error, SyntaxError) and error.msg == LOST_END
            or isinstance(error, ValueError) and LOST_NODE.match(text) is not None)
