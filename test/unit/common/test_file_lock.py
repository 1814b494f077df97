"""Locks on single bytes of a file, between processes."""
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
    with subprocess.Popen([sys.executable, "-c", HOLD, str(tmp_path / "file"), "64"], stdin=subprocess.PIPE,
                          stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout.readline() == "locked\n"
        yield process
        process.kill()


def test_holder_is_another_process_that_has_locked_just_that_byte(fd, holder):
    assert lock_holder(fd, 64) == holder.pid
    assert lock_holder(fd, 63) == lock_holder(fd, 65) == NOBODY
    with pytest.raises(OSError, match=r"Resource temporarily unavailable|Permission denied"):
        lock_byte(fd, 64)
    lock_byte(fd, 65)
    assert lock_holder(fd, 65) == NOBODY  # its own doesn't count


def test_lock_of_a_process_that_died_is_gone_and_its_own_doesn_t_count(fd, holder):
    lock_generation(fd, 64, 5001)
    holder.kill()
    holder.wait()
    assert lock_holder(fd, 64) == newer_generation(fd, 64, 0) == NOBODY
    lock_byte(fd, 64)


def test_older_generation_finds_the_newer_one_of_its_address_but_not_itself(fd, holder):
    assert newer_generation(fd, 64, 4999) == newer_generation(fd, 64, 0) == holder.pid
    assert newer_generation(fd, 64, 5000) == newer_generation(fd, 64, 5001) == NOBODY
    assert newer_generation(fd, 63, 0) == newer_generation(fd, 65, 0) == NOBODY
    lock_generation(fd, 64, 5001)
    lock_generation(fd, 64, 5001)
    assert newer_generation(fd, 64, 4000) == holder.pid
