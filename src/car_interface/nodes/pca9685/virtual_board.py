"""A PCA9685 in software for the pca9685 node: a process of its own, which goes on pulsing when the node dies.

Service:
    ~inject_fault (InjectFault): ``nack`` (number of the next transfers that fail), ``hold`` (the bus is held down, 1 or
        0), ``power`` (of the chip, 1 or 0), ``brownout`` (its registers are reset), ``address`` (its new address).
The socket's default differs by user, master, and name of the node: two cars share none. The log has for each write to
the chip monotonic time in ns, address, register and bytes.
"""
from __future__ import annotations

import errno
import hashlib
import math
import os
import subprocess
import tempfile
from typing import Callable

import rosgraph
import rospy

from car_interface.common.errors import ConfigError, require
from car_interface.common.file_lock import lock_byte
from car_interface.common.own_files import UnsafeFile, folder_name, make_folder, open_own
from car_interface.nodes.pca9685 import small_process
from car_interface.ros.clocks import SYSTEM
from car_interface.ros.topics import serve
from car_interface.sim.chip_link import FAULTS, ChipLink
from car_interface.srv import InjectFault

START_S = 5.0  # for the chip's process
MAX_SOCKET_PATH = 107  # unix(7), without the final zero


def chip_path(node_name: str) -> str:
    """Return the socket of a pca9685 node's chip, by the node's name with its namespace."""
    folder = os.path.join(tempfile.gettempdir(), folder_name())
    name = node_name.strip("/").replace("/", "-")
    digest = hashlib.sha256(f"{rosgraph.get_master_uri()} {node_name}".encode()).hexdigest()[:10]
    return os.path.join(folder, f"{name[-40:]}-{digest}")


class VirtualBoardBus:
    """Opens and closes as a real bus does; starts the chip if it isn't there. The chip keeps its state.

    Args:
        log_path: that of ~virtual_log; ``None`` = no log.

    Raises:
        ConfigError: path or log can't be used.
    """

    kind = name = "virtual"
    exists = True

    def __init__(self, path: str, address: int, log_path: str | None, inbox):
        require(len(os.fsencode(path)) <= MAX_SOCKET_PATH, "virtual_chip", path,
                f"a path of at most {MAX_SOCKET_PATH} bytes")
        _check_log(log_path)
        self.path = path
        self._address = address
        self._log_path = log_path
        self._link = ChipLink(path, address)
        self._process: subprocess.Popen | None = None
        serve_faults(inbox, {fault: lambda value, fault=fault: self._inject(fault, value) for fault in FAULTS})

    def open(self) -> ChipLink:
        """Return the open bus.

        Raises:
            UnsafeFile: socket, lock or folder aren't this user's own.
            OSError: the chip can't be started, or another node has the lock.
        """
        if not SYSTEM.wait_for(self._is_open, START_S, 0.01):
            raise OSError(errno.ENXIO, "the virtual chip's process doesn't start")
        try:
            lock_byte(self._link.lock_fd(), self._address)
        except OSError:
            self._link.close()
            raise
        if self._log_path is not None:
            self._link.log_to(self._log_path)
        return self._link

    def _inject(self, fault, value):
        require(fault != "nack" or value >= 0, "nack", value, "how many transfers shall fail, at least 0")
        require(fault != "address" or 0 <= value <= 0x7F, "address", value, "0 to 127")
        link = ChipLink(self.path, self._address)  # the node's may be closed
        try:
            link.open()
            link.inject(fault, value)
        except OSError as error:
            raise ConfigError(fault, value, f"a virtual chip that runs ({error})") from error
        finally:
            link.close()

    def _is_open(self):
        try:
            self._link.open()
        except (FileNotFoundError, ConnectionRefusedError):
            self._start()
            return False
        return True

    def _start(self):
        """Start the chip's process; it ends by itself when another one serves the path."""
        if self._process is not None and self._process.poll() is None:
            return
        make_folder(os.path.dirname(self.path))
        self._process = subprocess.Popen(
            small_process.command("sim.chip_server", self.path, str(self._address)), stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True, cwd="/")


def _check_log(path) -> None:
    if path is None:
        return
    try:
        os.close(open_own(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o644))
    except OSError as error:
        why = error.cause if isinstance(error, UnsafeFile) else error.strerror
        raise ConfigError("virtual_log", path, f"a file of your own that can be written ({why})") from error


def serve_faults(inbox, faults: dict[str, Callable[[float], None]]) -> None:
    """Offer ~inject_fault of a virtual device, for tests and trials.

    Args:
        faults: functions by name, which run in the node's thread and raise ConfigError on a bad value.
    """
    def inject(request, done):
        if request.fault not in faults:
            done.set_result((False, f"there is no fault {request.fault!r}, only {', '.join(sorted(faults))}"))
        elif not math.isfinite(request.value):
            done.set_result((False, f"{request.value} is no number to act on"))
        else:
            try:
                faults[request.fault](request.value)
            except ConfigError as error:
                done.set_result((False, str(error)))
                return
            rospy.logwarn("fault: %s %g", request.fault, request.value)
            done.set_result((True, "done"))

    serve("~inject_fault", InjectFault, inbox, inject)
