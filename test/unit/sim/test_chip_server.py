"""A virtual chip as a process of its own: it serves several clients as a bus does, and outlives each of them."""
from __future__ import annotations

import errno
import os
import signal
import subprocess
import tempfile
import time

import pytest

from car_interface.common import small_process
from car_interface.common.file_lock import lock_byte
from car_interface.sim.chip_link import ChipLink

ADDRESS = 0x40
AWAKE = b"\x20"
PATIENCE_S = 10.0


def eventually(condition):
    deadline_s = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline_s
        time.sleep(0.005)


def listens(path):
    """Whether a process takes connections there: a socket's file exists a moment before that, proc(5)."""
    with open("/proc/net/unix", encoding="ascii") as file:
        sockets = [line.split() for line in file]
    return any(fields[-1] == path and int(fields[3], 16) & 0x10000 for fields in sockets)


@pytest.fixture
def path():
    with tempfile.TemporaryDirectory() as folder:  # tmp_path may be too long for a socket
        yield os.path.join(folder, "chip")


class Server:
    """A chip's process and its clients."""

    def __init__(self, path):
        self.path = path
        self.links = []
        self.process = self.start()
        eventually(lambda: listens(path))

    def start(self):
        return subprocess.Popen(small_process.command("sim.chip_server", self.path, str(ADDRESS)))

    def connect(self, address=ADDRESS):
        link = ChipLink(self.path, address)
        link.open()
        self.links.append(link)
        return link

    def connect_fails(self):
        try:
            self.connect()
        except OSError:
            return True
        return False

    def end(self):
        for link in self.links:
            link.close()
        self.process.kill()
        self.process.wait()


@pytest.fixture
def server(path):
    server = Server(path)
    yield server
    server.end()


@pytest.fixture
def link(server):
    link = server.connect()
    link.write(0x00, AWAKE)
    return link


def fails_with(number, function, *arguments):
    with pytest.raises(OSError, match=os.strerror(number) if number != errno.ENXIO else "") as caught:
        function(*arguments)
    return caught.value.errno == number


def test_registers_of_a_new_chip_are_those_of_the_data_sheet(server):
    link = server.connect()
    assert link.read(0x00, 1) == b"\x11"
    assert link.read(0xFE, 1) == b"\x1e"


def test_what_one_client_writes_another_one_reads_and_the_chip_keeps_it_when_both_are_gone(server, link):
    link.write(0x06, bytes(range(32)))
    link.close()
    assert server.connect().read(0x06, 32)[:4] == bytes(range(4))


def test_another_address_is_not_acknowledged(server, link):
    assert fails_with(errno.EREMOTEIO, server.connect(0x41).read, 0, 1)


def test_lock_of_one_process_is_seen_by_others_as_on_a_bus(server, link):
    fd = os.open(f"{server.path}.lock", os.O_RDWR)
    pid = os.fork()
    if not pid:
        lock_byte(os.open(f"{server.path}.lock", os.O_RDWR), ADDRESS)
        signal.pause()
    try:
        eventually(lambda: link.lock_holder() == pid)
        with pytest.raises(OSError, match=r"unavailable|denied"):
            lock_byte(link.lock_fd(), ADDRESS)
    finally:
        os.kill(pid, signal.SIGKILL)
        os.waitpid(pid, 0)
        os.close(fd)
    assert link.lock_holder() == 0


def test_transfers_that_shall_fail_fail_for_whoever_comes_first(server, link):
    other = server.connect()
    other.inject("nack", 2)
    assert fails_with(errno.EREMOTEIO, link.read, 0, 1)
    assert fails_with(errno.EREMOTEIO, other.write, 0, AWAKE)
    assert link.read(0, 1) == AWAKE


def test_bus_that_is_held_fails_after_a_second_one_transfer_after_the_other(server, link):
    link.inject("hold", 1)
    began_s = time.monotonic()
    assert fails_with(errno.ETIMEDOUT, link.read, 0, 1)
    assert 0.99 <= time.monotonic() - began_s < 1.9
    other = server.connect()
    other.inject("hold", 0)
    assert link.read(0, 1) == AWAKE


def test_chip_without_power_does_not_answer_and_has_forgotten_everything_afterwards(link):
    link.write(0x06, bytes((0, 0, 0x3F, 1)))
    link.inject("power", 0)
    assert fails_with(errno.EREMOTEIO, link.read, 0, 1)
    link.inject("brownout", 0)
    assert fails_with(errno.EREMOTEIO, link.read, 0, 1)
    link.inject("power", 1)
    assert link.read(0x00, 1) == b"\x11"
    assert link.read(0x09, 1) == b"\x10"


def test_chip_at_another_address_is_not_found_at_the_old_one(server, link):
    link.inject("address", 0x41)
    assert fails_with(errno.EREMOTEIO, link.read, 0, 1)
    assert server.connect(0x41).read(0, 1) == AWAKE


def test_observer_is_sent_what_the_pins_do_now_and_at_each_change(server, link):
    observer = server.connect()
    observer.observe()
    seen = []

    def sees(counts):
        seen.extend(observer.changes())
        return seen and seen[-1] == counts + (0,) * (16 - len(counts))
    eventually(lambda: sees((0,)))
    link.write(0x06, bytes((0, 0, 0x3F, 1)))
    eventually(lambda: sees((319,)))
    link.write(0x06, bytes((0, 0, 0x3F, 1)))  # no change
    link.write(0x0A, bytes((0, 0x10, 0, 0)))
    eventually(lambda: sees((319, 4096)))
    assert len(seen) == 3
    link.inject("power", 0)
    eventually(lambda: sees((0,)))


def test_observer_notices_that_the_chip_is_gone(server, link):
    observer = server.connect()
    observer.observe()
    server.process.kill()
    server.process.wait()
    with pytest.raises(OSError, match="gone"):
        eventually(lambda: observer.changes() is None)
    assert fails_with(errno.ENXIO, link.read, 0, 1)
    with pytest.raises(ConnectionRefusedError) as refused:
        server.connect()
    assert link.is_gone(refused.value)


def test_log_has_each_write_of_every_client_with_the_time(server, link):
    log = f"{server.path}.log"
    link.log_to(log)
    with open(log, encoding="ascii") as file:
        held = [line.split()[1:] for line in file.read().splitlines()]
    assert held == [["40", "06", "00000010" * 8], ["40", "26", "00000010" * 8]]
    before_ns = time.monotonic_ns()
    server.connect().write(0x06, bytes((0, 0, 0x3F, 1)))
    with open(log, encoding="ascii") as file:
        time_ns, *rest = file.read().splitlines()[-1].split()
    assert before_ns < int(time_ns) < time.monotonic_ns()
    assert rest == ["40", "06", "00003f01"]


def test_second_process_for_one_path_ends_and_disturbs_nobody(server, link):
    assert server.start().wait(PATIENCE_S) == 0
    assert link.read(0, 1) == AWAKE
    assert server.connect().read(0, 1) == AWAKE


def test_socket_of_a_process_that_was_killed_is_replaced(server, link):
    server.process.kill()
    server.process.wait()
    server.process = server.start()
    eventually(lambda: not server.connect_fails())
    assert server.connect().read(0, 1) == b"\x11"


def test_process_ignores_the_signals_of_its_group_and_ends_after_its_last_client_with_no_file_left(server, link):
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        server.process.send_signal(number)
    assert link.read(0, 1) == AWAKE
    began_s = time.monotonic()
    link.close()
    assert server.process.wait(PATIENCE_S) == 0
    assert time.monotonic() - began_s > 2.5
    assert os.listdir(os.path.dirname(server.path)) == []
