"""Locks on single bytes of a file, between processes."""
import os
import subprocess
import sys

import pytest

from car_interface.common.file_lock import NOBODY, LockedChip, lock_byte, lock_holder

HOLD = """
import os, sys
from car_interface.common.file_lock import MAX_GENERATION, lock_byte
fd = os.open(sys.argv[1], os.O_RDWR)
lock_byte(fd, int(sys.argv[2]))
lock_byte(fd, int(sys.argv[2]) * MAX_GENERATION + 5000)
print("locked", flush=True)
sys.stdin.read()
"""


class Chip(LockedChip):
    def __init__(self, fd, address=64):
        super().__init__("", address)
        self.lock_fd = lambda: fd


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
    Chip(fd).claim(5001)
    holder.kill()
    holder.wait()
    assert Chip(fd).lock_holder() == Chip(fd).successor(0) == NOBODY
    lock_byte(fd, 64)


def test_older_generation_finds_the_newer_one_of_its_address_but_not_itself(fd, holder):
    chip = Chip(fd)
    assert chip.successor(4999) == chip.successor(0) == chip.lock_holder() == holder.pid
    assert chip.successor(5000) == chip.successor(5001) == NOBODY
    assert Chip(fd, 63).successor(0) == Chip(fd, 65).successor(0) == NOBODY
    chip.claim(5001)
    chip.claim(5001)
    assert chip.successor(4000) == holder.pid
