"""Connects to the process of a virtual PCA9685, as an open I²C bus does to a real one.

Requests and answers are packets of a Unix socket. A request is an operation, an address, a register or the number of a
fault, and data; an answer is an errno and data. The clients of one chip take turns, as on a bus.

The socket and the files beside it are only used if they are this user's own: see ``own_files``.
"""
from __future__ import annotations

import errno
import os
import socket
import struct

from car_interface.common.file_lock import LockedChip
from car_interface.common.own_files import check_owner, check_socket, open_own

READ, WRITE, FAULT, LOG, OBSERVE = range(5)  # operations
REQUEST = struct.Struct("=BBBd")  # operation, address, register; the value of a fault
ANSWER = struct.Struct("=i")
OUTPUTS = struct.Struct("=16H")  # what an observer is sent: the counts, 0..4096, for which each pin is high
FAULTS = ("nack", "hold", "power", "brownout", "address")
MAX_PACKET = 1024
MAX_BLOCK = 32  # data bytes of a transfer, as of SMBus
ANSWER_S = 3.0  # a bus that is held fails after one second
PEER = struct.Struct("3i")  # SO_PEERCRED: process, user, group; see unix(7)


def lock_path(path: str) -> str:
    """Return the path of the file that is locked in place of the bus's."""
    return f"{path}.lock"


def open_lock(path: str) -> int:
    """Open the lock file of the chip at ``path`` and return its descriptor.

    Raises:
        UnsafeFile: it isn't this user's own file.
    """
    return open_own(lock_path(path), os.O_RDWR | os.O_CREAT)


def peer(connection: socket.socket) -> tuple[int, int]:
    """Return process and user at the other end of a connected Unix socket."""
    return PEER.unpack(connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, PEER.size))[:2]


class ChipLink(LockedChip):
    """One client of a chip; connected when it is first needed, and again after ``close``.

    To a guard it is what ``pca9685.i2c_device.I2cDevice`` is, and to a node's board what ``smbus2.SMBus`` is.
    Its locks are on ``lock_path``.
    """

    def __init__(self, path: str, address: int):
        super().__init__(path, address)
        self._socket = None
        self._lock_fd = -1

    def open(self) -> None:
        """Connect, unless it is connected.

        Raises:
            UnsafeFile: the socket, or the folder that it lies in, isn't this user's own.
            OSError: there is no such chip.
        """
        if self._socket is not None:
            return
        check_socket(self._path)
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        try:
            self._socket.settimeout(ANSWER_S)
            self._socket.connect(self._path)
            check_owner(peer(self._socket)[1], self._path)  # of the process: the file could have been replaced since
        except OSError:
            self.close()
            raise

    def close(self) -> None:
        if self._socket is not None:
            self._socket.close()
            self._socket = None
        if self._lock_fd >= 0:
            os.close(self._lock_fd)
            self._lock_fd = -1

    def lock_fd(self) -> int:
        """Return the descriptor of the file for locks, opened at the first call."""
        if self._lock_fd < 0:
            self._lock_fd = open_lock(self._path)
        return self._lock_fd

    def is_gone(self, error: OSError) -> bool:
        """Return whether an error means that the chip's process has ended, and with it the chip."""
        return error.errno in (errno.ENOENT, errno.ECONNREFUSED, errno.ENXIO)

    def read(self, register: int, length: int) -> bytes:
        return self.transfer(READ, register, bytes((length,)))

    def write(self, register: int, values: bytes) -> None:
        self.transfer(WRITE, register, bytes(values))

    def read_i2c_block_data(self, address: int, register: int, length: int) -> bytes:
        return self.read(register, length)

    def write_i2c_block_data(self, address: int, register: int, values: list) -> None:
        self.write(register, values)

    def inject(self, fault: str, value: float) -> None:
        """Have the chip or its bus fail."""
        self.transfer(FAULT, FAULTS.index(fault), value=value)

    def log_to(self, path: str) -> None:
        """Have each write to the chip, by any client, appended to a file."""
        self.transfer(LOG, 0, os.fsencode(path))

    def observe(self) -> int:
        """Have the pins' state sent, now and at each change; return the descriptor to wait for."""
        self.transfer(OBSERVE, 0)
        self._socket.setblocking(False)
        return self._socket.fileno()

    def changes(self) -> list:
        """Return the states that were sent to an observer since the last call, oldest first: 16 counts each.

        Raises:
            OSError: the chip is gone.
        """
        found = []
        while True:
            try:
                packet = self._socket.recv(MAX_PACKET)
            except BlockingIOError:
                return found
            if not packet:
                raise ConnectionResetError(errno.ECONNRESET, "the chip is gone")
            if len(packet) != OUTPUTS.size:
                raise OSError(errno.EPROTO, os.strerror(errno.EPROTO))
            found.append(OUTPUTS.unpack(packet))

    def transfer(self, operation: int, register: int, data: bytes = b"", value: float = 0.0) -> bytes:
        """Make a request and return the data of its answer.

        Raises:
            OSError: as of a real bus; ENXIO: the chip's process is gone.
        """
        try:
            self._socket.send(REQUEST.pack(operation, self._address, register, value) + data)
            answer = self._socket.recv(MAX_PACKET)
        except socket.timeout as error:
            raise OSError(errno.ETIMEDOUT, "Connection timed out") from error
        except OSError as error:
            raise OSError(errno.ENXIO, "the virtual chip is gone") from error
        if not answer:
            raise OSError(errno.ENXIO, "the virtual chip is gone")
        number = ANSWER.unpack_from(answer)[0] if len(answer) >= ANSWER.size else errno.EPROTO
        if number:
            raise OSError(number, os.strerror(number))
        return answer[ANSWER.size:]
