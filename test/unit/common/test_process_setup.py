"""A process whose memory is limited takes less of it, or ends with one line that says so."""
import errno
import os
import resource
import subprocess
import sys
from pathlib import Path

import pytest

from car_interface.common import process_setup
from car_interface.common.errors import CarInterfaceError
from car_interface.common.process_setup import MIB, describe_shortage, prepare

ROOT = Path(__file__).resolve().parents[3]


def chained(outer, inner):
    outer.__context__ = inner
    return outer


@pytest.mark.parametrize("error, words", [
    (MemoryError(), "out of memory"),
    (OSError(errno.ENOMEM, "Cannot allocate memory"), "out of memory"),
    (ImportError("liblapack.so.3: failed to map segment from shared object"), "out of memory"),
    (RuntimeError("can't start new thread"), "can't start new thread"),
    (chained(ImportError("IMPORTANT: PLEASE READ THIS"), MemoryError()), "out of memory"),
], ids=repr)
@pytest.mark.parametrize("limit", [None, 400 * MIB])
def test_want_of_memory_is_one_line_with_a_remedy(error, words, limit, monkeypatch):
    monkeypatch.setattr(process_setup, "limit_bytes", lambda: limit)
    line = describe_shortage(error)
    assert line.startswith(f"{words}: ") and "\n" not in line
    assert ("400 MB" in line and "ulimit -v unlimited" in line) == (limit is not None)


@pytest.mark.parametrize("error", [ValueError("x"), ImportError("no module"), RuntimeError("x"), OSError(5, "I/O"),
                                   SystemError("x"), chained(ValueError("a"), ValueError("b"))])
def test_other_errors_are_none_even_one_that_is_its_own_context(error):
    if error.__context__ is not None:
        error.__context__.__context__ = error
    assert describe_shortage(error) is None


@pytest.mark.parametrize("error", [
    ValueError("field 'target' is required for AnnAssign"),
    SyntaxError("unexpected EOF while parsing", ("module.py", 318, 1, "")),
    SystemError("error return without exception set"),
], ids=repr)
def test_error_in_whose_place_python_lost_its_memory_error_is_one_where_memory_is_limited(error, monkeypatch):
    monkeypatch.setattr(process_setup, "limit_bytes", lambda: 130 * MIB)
    assert describe_shortage(error).startswith("out of memory: its limit of address space is 130 MB")
    monkeypatch.setattr(process_setup, "limit_bytes", lambda: None)
    assert describe_shortage(error) is None


def test_limit_below_what_is_needed_is_refused_and_no_limit_is_not(monkeypatch):
    monkeypatch.setattr(process_setup, "limit_bytes", lambda: 100 * MIB)
    with pytest.raises(CarInterfaceError, match="needs 380 MB of address space, and its limit is 100 MB: raise"):
        prepare(380)
    monkeypatch.setattr(process_setup, "limit_bytes", lambda: None)
    monkeypatch.setenv("MPLBACKEND", "Agg")  # which is set in any case
    before = dict(os.environ)
    prepare(380)
    assert dict(os.environ) == before  # nothing is changed where nothing is limited


def limited(mib, *command):
    return subprocess.run(
        [sys.executable, "-B", *command], capture_output=True, text=True, check=False, timeout=60,
        env={**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT / "src"), *filter(None, sys.path)])},
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (mib * MIB, mib * MIB)))


@pytest.mark.parametrize("name", ["turn_arb", "car_nodes", "doctor"])
def test_node_starts_nothing_where_it_could_not_work(name):
    done = limited(300, str(ROOT / "scripts" / name))
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr == (f"{name}: it needs 380 MB of address space, and its limit is 300 MB: raise that in the "
                           "shell that starts it (ulimit -v unlimited)\n")


def test_threads_take_little_address_space():
    """With glibc's 64 MiB and Python's 8 MiB for each, 20 of them would need 1.4 GiB."""
    done = limited(200, "-c", """
import threading
from car_interface.common.process_setup import prepare
prepare()
barrier = threading.Barrier(21)
threads = [threading.Thread(target=lambda: (bytearray(300_000), barrier.wait())) for _ in range(20)]
[thread.start() for thread in threads]
barrier.wait()
""")
    assert (done.returncode, done.stderr) == (0, "")
