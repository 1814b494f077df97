"""Runs a virtual PCA9685 as its own process, so that it goes on pulsing when its node dies, as a real one does.

It serves a Unix socket, see ``chip_link``, and ends some seconds after its last client has gone. Its first client
starts it by ``nodes.pca9685.small_process``; its arguments are the socket's path and the chip's address.

No packet ends it. A malformed one is answered with an errno, such as EINVAL (an impossible length or value).
"""
from __future__ import annotations

import contextlib
import errno
import os
import select
import signal
import socket
import sys
import time

from car_interface.common.file_lock import lock_byte
from car_interface.common.own_files import OTHERS_BITS, UnsafeFile, check_socket, open_own
from car_interface.sim import chip_link as wire
from car_interface.sim.pca9685_chip import LED0, MODE1, SLEEP, VirtualPca9685

LINGER_S = 3.0  # after the last client: time for roslaunch to restart a node; a guard is a client, too
SERVER_LOCK = 0x100  # a byte of the lock file that is no address
MAX_CLIENTS = 32  # nodes, guards and observers of one chip are fewer than ten
HELD_S = 1.0  # the kernel's timeout, after which a transfer on a bus that is held fails


class ChipServer:
    """Serves the chip at a 7-bit address to who connects to a listening socket."""

    def __init__(self, listener: socket.socket, address: int):
        self._listener = listener
        self._address = address
        self._chip = VirtualPca9685()
        self._has_power = True
        self._is_held = False  # somebody holds the bus down
        self._nacks_left = 0  # how many of the next transfers are not acknowledged
        self._log_fd = -1
        self._clients = []  # their sockets
        self._observers = set()  # those of them that are sent what the pins do
        self._waiting = []  # transfers while the bus is held: (client, packet)
        self._fails_s = 0.0  # when the first of them fails
        self._outputs = self._pins()

    def run(self) -> None:
        """Serve until all clients have been gone for a while."""
        now_s = alone_since_s = time.monotonic()
        while self._clients or now_s - alone_since_s < LINGER_S:
            left_s = max(0.0, self._fails_s - now_s) if self._waiting else LINGER_S
            for ready in select.select([self._listener, *self._clients], [], [], left_s + 0.001)[0]:
                if ready is self._listener:
                    self._accept()
                elif not self._serve(ready, time.monotonic()):
                    self._drop(ready)
            now_s = time.monotonic()
            self._fail_waiting(now_s)
            if self._clients:
                alone_since_s = now_s

    def _accept(self):
        """Take a client of this user's, if there is room for one."""
        try:
            client, _ = self._listener.accept()
        except OSError:  # it has gone again
            return
        if len(self._clients) >= MAX_CLIENTS or wire.peer(client)[1] != os.geteuid():
            client.close()
            return
        client.setblocking(False)
        self._clients.append(client)

    def _drop(self, client):
        client.close()
        self._clients.remove(client)
        self._observers.discard(client)
        self._waiting = [each for each in self._waiting if each[0] is not client]

    def _serve(self, client, now_s):
        """Answer one request; return whether the client is still there."""
        try:
            packet = client.recv(wire.MAX_PACKET)  # of a longer one the rest is lost
        except BlockingIOError:
            return True
        except OSError:
            packet = b""
        if not packet:
            return False
        if self._is_held and packet[0] in (wire.READ, wire.WRITE):
            if not self._waiting:
                self._fails_s = now_s + HELD_S
            self._waiting.append((client, packet))
        else:
            self._answer(client, packet)
        return True

    def _fail_waiting(self, now_s):
        """Fail transfers on a bus that is held, one after the other, each after a second."""
        while self._waiting and now_s >= self._fails_s:
            self._send(self._waiting.pop(0)[0], wire.ANSWER.pack(errno.ETIMEDOUT))
            if not self._is_held:  # it was released since: waiting transfers go through
                for client, packet in self._waiting:
                    self._answer(client, packet)
                self._waiting.clear()
            self._fails_s += HELD_S

    def _answer(self, client, packet):
        try:
            data, number = self._handle(client, packet), 0
        except Exception as error:  # no request may end the chip's pulses, as with a real one
            data, number = b"", getattr(error, "errno", None) or errno.EIO
        self._send(client, wire.ANSWER.pack(number) + data)
        outputs = self._pins()
        if packet[0] == wire.OBSERVE or outputs != self._outputs:
            self._outputs = outputs
            for observer in self._observers:
                self._send(observer, wire.OUTPUTS.pack(*outputs))

    def _send(self, client, packet):
        with contextlib.suppress(OSError):  # it is dropped when its end is seen
            client.send(packet)

    def _handle(self, client, packet):
        """Do what a packet asks for and return the data of the answer; OSError where that fails or is impossible."""
        operation, address, register, value = wire.REQUEST.unpack_from(packet)
        data = packet[wire.REQUEST.size:]
        if operation == wire.READ:
            _check(len(data) == 1 and 1 <= data[0] <= wire.MAX_BLOCK, errno.EINVAL)
            return bytes(self._addressed(address).read(register, data[0]))
        if operation == wire.WRITE:
            _check(1 <= len(data) <= wire.MAX_BLOCK, errno.EINVAL)
            self._addressed(address).write(register, data)
            self._log_write(address, register, data)
        elif operation == wire.FAULT:
            self._inject(wire.FAULTS[register], value)
        elif operation == wire.LOG:
            self._open_log(data)
        else:
            _check(operation == wire.OBSERVE, errno.EOPNOTSUPP)
            self._observers.add(client)
        return b""

    def _addressed(self, address):
        """Return the chip, unless nothing acknowledges a transfer to the address."""
        nack, self._nacks_left = self._nacks_left > 0, max(0, self._nacks_left - 1)
        _check(not nack and self._has_power and address == self._address, errno.EREMOTEIO)
        return self._chip

    def _inject(self, fault, value):
        if fault == "nack":
            self._nacks_left = int(value)
        elif fault == "hold":
            self._is_held = bool(value)
        elif fault == "address":
            self._address = int(value)
        else:  # power or brownout
            self._chip.power_up()
            self._has_power = self._has_power if fault == "brownout" else bool(value)

    def _pins(self):
        return tuple(self._chip.high_counts(channel) if self._has_power else 0 for channel in range(16))

    def _open_log(self, path):
        """Append each write to the file at a path, in bytes; if it can't be opened, the one before stays in use."""
        _check(path.startswith(b"/") and b"\0" not in path, errno.EINVAL)
        log_fd = open_own(os.fsdecode(path), os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o644)
        if self._log_fd >= 0:
            os.close(self._log_fd)
        self._log_fd = log_fd
        if not self._chip.read(MODE1, 1)[0] & SLEEP:  # its present counts, as if they were written now
            for first in (LED0, LED0 + wire.MAX_BLOCK):
                self._log_write(self._address, first, b"".join(
                    bytes(self._chip.read(register, 1)) for register in range(first, first + wire.MAX_BLOCK)))

    def _log_write(self, address, register, data):
        if self._log_fd >= 0:
            line = f"{time.monotonic_ns()} {address:02x} {register:02x} {bytes(data).hex()}\n"
            os.write(self._log_fd, line.encode("ascii"))


def _check(is_ok, number):
    if not is_ok:
        raise OSError(number, os.strerror(number))


def main() -> None:
    """Serve a chip, unless another process serves it, or the file at its path isn't this user's own."""
    path, address = sys.argv[1], int(sys.argv[2])
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)  # it ends after its last client
    try:
        lock_fd = wire.open_lock(path)
    except UnsafeFile:  # its first client reports it
        return
    try:
        lock_byte(lock_fd, SERVER_LOCK)
        if not os.path.samestat(os.fstat(lock_fd), os.stat(wire.lock_path(path))):
            return  # the lock of a process that has just ended: the client starts this one again
        with contextlib.suppress(FileNotFoundError):
            check_socket(path)
            os.unlink(path)  # of a process that was killed
    except OSError:
        return
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as listener:
        mask = os.umask(OTHERS_BITS)
        listener.bind(path)
        os.umask(mask)
        listener.listen(16)
        ChipServer(listener, address).run()
        os.unlink(path)
        os.unlink(wire.lock_path(path))
