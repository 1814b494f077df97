"""A virtual chip as a process of its own: it serves several clients as a bus does, and outlives each of them."""

import contextlib
import errno
import math
import os
import signal
import socket
import subprocess
import tempfile
import time

import pytest

from car_interface.common.own_files import UnsafeFile
from car_interface.nodes.pca9685 import small_process
from car_interface.sim.chip_link import ANSWER, FAULT, LOG, READ, REQUEST, WRITE, ChipLink
from loopback import PATIENCE_S, eventually

ADDRESS = 0x40
AWAKE = b"\x20"


@pytest.fixture
def path():
    with tempfile.TemporaryDirectory() as folder:  # tmp_path may be too long for a socket
        yield os.path.join(folder, "chip")


def serve(path):
    return subprocess.Popen(small_process.command("sim.chip_server", path, str(ADDRESS)))


class Server:
    def __init__(self, path):
        self.path = path
        self.links = []
        self.process = serve(path)
        eventually(self.takes_connections)
        self.links.pop().close()

    def connect(self, address=ADDRESS):
        link = ChipLink(self.path, address)
        link.open()
        self.links.append(link)
        return link

    def takes_connections(self):
        with contextlib.suppress(OSError):
            return self.connect()

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
    with pytest.raises(OSError, match=os.strerror(number) if number != errno.ENXIO else None) as caught:
        function(*arguments)
    return caught.value.errno == number


def test_what_one_client_writes_another_one_reads_and_the_chip_keeps_it_when_both_are_gone(server, link):
    link.write(0x06, bytes(range(32)))
    link.close()
    assert server.connect().read(0x06, 32)[:4] == bytes(range(4))


def test_chip_without_power_does_not_answer_and_has_forgotten_everything_afterwards(link):
    link.write(0x06, bytes((0, 0, 0x3F, 1)))
    link.inject("power", 0)
    assert fails_with(errno.EREMOTEIO, link.read, 0, 1)
    link.inject("brownout", 0)
    assert fails_with(errno.EREMOTEIO, link.read, 0, 1)
    link.inject("power", 1)
    assert link.read(0x00, 1) == b"\x11"
    assert link.read(0x09, 1) == b"\x10"


def test_only_the_chip_s_address_is_acknowledged(server, link):
    assert fails_with(errno.EREMOTEIO, server.connect(0x41).read, 0, 1)
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
    server.process = serve(server.path)  # its socket is replaced
    eventually(server.takes_connections)
    assert server.connect().read(0, 1) == b"\x11"


def test_second_process_for_one_path_ends_and_disturbs_nobody(server, link):
    assert serve(server.path).wait(PATIENCE_S) == 0
    assert link.read(0, 1) == AWAKE
    assert server.connect().read(0, 1) == AWAKE


@pytest.mark.once
def test_process_ignores_the_signals_of_its_group_and_ends_after_its_last_client_with_no_file_left(server, link):
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        server.process.send_signal(number)
    assert link.read(0, 1) == AWAKE
    began_s = time.monotonic()
    link.close()
    assert server.process.wait(PATIENCE_S) == 0
    assert time.monotonic() - began_s > 2.5
    assert os.listdir(os.path.dirname(server.path)) == []


@pytest.fixture
def raw(server):
    """A socket for packets of any content; each is answered by an errno."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as client:
        client.connect(server.path)
        client.settimeout(PATIENCE_S)
        yield client


def ask(client, packet):
    client.send(packet)
    return ANSWER.unpack_from(client.recv(2048))[0]


def request(operation, register=0, data=b"", value=0.0, address=ADDRESS):
    return REQUEST.pack(operation, address, register, value) + data


MALFORMED = [
    (b"\x00", errno.EIO), (request(WRITE, data=bytes(5000)), errno.EINVAL), (request(200), errno.EOPNOTSUPP),
    (request(FAULT, 9), errno.EIO),
    (request(READ, data=b"\0"), errno.EINVAL), (request(READ, data=b"\x21"), errno.EINVAL),
    (request(WRITE), errno.EINVAL), (request(WRITE, data=bytes(33)), errno.EINVAL),
    (request(FAULT, 0, value=math.nan), errno.EIO),
    (request(LOG, data=b"/tmp/a\0b"), errno.EINVAL), (request(LOG, data=b"/tmp"), errno.EACCES),
    (request(LOG, data=b"/nowhere/\xff\xfe"), errno.ENOENT),
    (request(READ, data=b"\1", address=255), errno.EREMOTEIO),
]


def test_malformed_packet_is_answered_with_an_error_and_the_chip_goes_on(server, link, raw):
    for packet, number in MALFORMED:
        assert ask(raw, packet) == number, packet
        assert ask(raw, request(READ, data=b"\1")) == 0 and link.read(0, 1) == AWAKE, packet
    os.mkfifo(f"{server.path}.pipe")
    os.symlink("/dev/null", f"{server.path}.link")
    for name in ("pipe", "link"):
        assert ask(raw, request(LOG, data=f"{server.path}.{name}".encode())) == errno.EACCES


def test_file_at_the_chips_path_is_not_removed(path):
    with open(path, "w", encoding="ascii") as file:
        file.write("precious")
    assert serve(path).wait(PATIENCE_S) == 0
    with open(path, encoding="ascii") as file:
        assert file.read() == "precious"
    with pytest.raises(UnsafeFile, match="chip is no socket"):
        ChipLink(path, ADDRESS).open()
