"""A claim on a path: of several simulated cars only one may put its serial port there.

The claim is an abstract Unix socket that is named after the path: it leaves no file, the kernel takes it back when its
process ends, however that happens, and it says which process that is.
"""
from __future__ import annotations

import hashlib
import os
import socket

from car_interface.common.errors import ConfigError
from car_interface.ros.clocks import SYSTEM
from car_interface.sim.chip_link import peer

END_WITHIN_S = 2.0  # a car_sim that is just being replaced by one of its name ends within this
POLL_S = 0.1
BACKLOG = 128


class PortClaim:
    """A claim on a path, held until ``close`` or the end of the process.

    Args:
        end_within_s: so long another car_sim may take to end.

    Raises:
        ConfigError: another living car_sim holds it.
    """

    def __init__(self, path: str, end_within_s: float = END_WITHIN_S):
        place = os.path.join(os.path.realpath(os.path.dirname(path)), os.path.basename(path))
        name = "\0car_interface.car_sim." + hashlib.sha256(os.fsencode(place)).hexdigest()
        self._socket = socket.socket(socket.AF_UNIX)
        if SYSTEM.wait_for(lambda: self._has_bound(name), end_within_s, POLL_S):
            return
        self._socket.close()
        raise ConfigError("port", path, "a path that no other car_sim uses: end that one, or start this one with "
                          f"another port, e.g. port:={path}_2", f"{path} is in use by another car_sim{_holder(name)}")

    def _has_bound(self, name):
        try:
            self._socket.bind(name)
            self._socket.listen(BACKLOG)
        except OSError:  # EADDRINUSE
            return False
        return True

    def close(self) -> None:
        self._socket.close()


def _holder(name):
    """Return which process holds a claim, as text; empty if it is not known."""
    with socket.socket(socket.AF_UNIX) as probe:
        probe.setblocking(False)
        try:
            probe.connect(name)
            pid, _ = peer(probe)
        except OSError:  # it has just ended, or too many have asked
            return ""
    return f" (process {pid})" if pid else ""
