"""Locks on single bytes of a file, between processes."""
from __future__ import annotations

import os
import subprocess
import sys

import pytest

from car_interface.common.file_lock import NOBODY, lock_byte, lock_generation, lock_holder, newer_generation

HOLD = """
import os, sys
from car_interface.common.file_lock import lock_byte, lock_generation
fd = os.open(sys.argv[1], os.O_RDWR)
lock_byte(fd, int(sys.argv[2]))
lock_generation(fd, int(sys.argv[2]), 5000)
print("locked", flush=True)
sys.stdin.read()
"""


@pytest.fixture
def fd(tmp_path):
    fd = os.open(tmp_path / "file", os.O_RDWR | os.O_CREAT)
    yield fd
    os.close(fd)


@pytest.fixture
def holder(tmp_path, fd):
    """Another process that has locked byte 64."""
    with subprocess.Popen([sys.executable, "-c", HOLD, str(tmp_path / "file"), "64"], stdin=subprocess.PIPE,
                          stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout.readline() == "locked\n"
        yield process
        process.kill()


def test_byte_that_nobody_has_locked_has_no_holder(fd):
    assert lock_holder(fd, 64) == NOBODY


def test_own_lock_does_not_count(fd):
    lock_byte(fd, 64)
    assert lock_holder(fd, 64) == NOBODY


def test_holder_is_known_by_its_process_and_for_its_byte_only(fd, holder):
    assert lock_holder(fd, 64) == holder.pid
    assert lock_holder(fd, 63) == lock_holder(fd, 65) == NOBODY


def test_byte_of_another_process_is_refused_and_its_neighbour_is_not(fd, holder):
    with pytest.raises(OSError, match=r"Resource temporarily unavailable|Permission denied"):
        lock_byte(fd, 64)
    lock_byte(fd, 65)


def test_lock_of_a_process_that_died_is_gone(fd, holder):
    holder.kill()
    holder.wait()
    assert lock_holder(fd, 64) == NOBODY
    lock_byte(fd, 64)


def test_older_generation_finds_the_newer_one_of_its_address(fd, holder):
    assert newer_generation(fd, 64, 4999) == newer_generation(fd, 64, 0) == holder.pid
    assert newer_generation(fd, 64, 5000) == newer_generation(fd, 64, 5001) == NOBODY
    assert newer_generation(fd, 63, 0) == newer_generation(fd, 65, 0) == NOBODY


def test_own_generation_does_not_count_and_may_be_locked_again(fd, holder):
    lock_generation(fd, 64, 5001)
    lock_generation(fd, 64, 5001)
    assert newer_generation(fd, 64, 4000) == holder.pid
    holder.kill()
    holder.wait()
    assert newer_generation(fd, 64, 4000) == NOBODY
