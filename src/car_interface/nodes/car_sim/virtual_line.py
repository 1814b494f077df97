"""The virtual Teensy's serial line for car_sim: a pseudo-terminal, with the faults that tests and drives ask for.

Service:
    ~inject_fault (InjectFault): ``unplug`` (the port vanishes and comes back after so many seconds; 0 = with
        ``plug``), ``plug``, ``silence`` (for so many seconds nothing comes from the Teensy), ``scramble`` (for so many
        seconds both sides' baud rates differ), ``cut`` (the next so many bytes to the host are lost), ``flood`` (for so
        many seconds random bytes, 1 MB/s), ``bit_errors`` (this share of all bits, 0 = none), ``reboot`` (the Teensy
        has no power for so many seconds and boots for 0.3 s, in which the wheels turn uncounted), ``out_of_step`` (its
        receiver takes opening flags for closing ones, for good), ``sonar_missing``, ``sonar_stuck``, ``sonar_blink``,
        ``sonar_clone``, ``sonar_fine`` (the sonar of this number, 0 to 5, isn't connected; raises its echo pin at its
        next ping and holds it; has it high for 1.5 to 2 s; is a clone that takes 200 ms without an echo; is whole).
"""
from __future__ import annotations

import hashlib
import os
import socket
import tty
from contextlib import suppress
from typing import Any, Callable

from car_interface.common.errors import ConfigError, require
from car_interface.nodes.pca9685.virtual_board import serve_faults
from car_interface.ros.clocks import SYSTEM
from car_interface.sim.chip_link import peer
from car_interface.sim.line import LASTING, MAX_S, NS_PER_S, BadLine
from car_interface.sim.teensy_clock import NEVER_NS
from car_interface.sim.teensy_sensors import SONAR_CONDITIONS

READ_SIZE = 4096
ODD_FLAG = b"\x7e"
MAX_BACKLOG = 4096  # bytes on their way to the Teensy: beyond it the writer waits, as behind a real UART
END_WITHIN_S = 2.0  # a car_sim that is just being replaced by one of its name ends within this
POLL_S = 0.1


class PseudoTerminal:
    """A serial line without a cable: a link at ``path`` leads to the end that a program opens as its port.

    As on a real line, bytes that nobody reads are lost. Our own hold on the far end keeps the near one alive while no
    program has it open.

    Raises:
        ConfigError: when something other than a link is at ``path``, or no link can be put there.
    """

    def __init__(self, path: str):
        self._path = path
        self._near, self._far = os.openpty()
        tty.setraw(self._far)
        os.set_blocking(self._near, False)
        self.name = os.ttyname(self._far)
        self._put_link()

    def fileno(self) -> int:
        return self._near

    def read(self) -> bytes:
        try:
            return os.read(self._near, READ_SIZE)
        except BlockingIOError:
            return b""

    def write(self, data: bytes) -> None:
        """Send bytes to the program; what doesn't fit any more is lost."""
        with suppress(BlockingIOError):
            os.write(self._near, data)

    def close(self) -> None:
        with suppress(OSError):
            if os.readlink(self._path) == self.name:
                os.unlink(self._path)
        os.close(self._near)
        os.close(self._far)

    def _put_link(self):
        new = f"{self._path}.{os.getpid()}"
        try:
            # A killed virtual Teensy leaves its link; a real port's name or somebody's file stays.
            is_left = os.path.islink(self._path) and os.readlink(self._path).startswith("/dev/pts/")
            require(is_left or not os.path.lexists(self._path), "port", self._path,
                    "a path with nothing at it, or a virtual Teensy's old link")
            os.symlink(self.name, new)
            os.replace(new, self._path)
        except OSError as error:
            raise ConfigError("port", self._path, f"a path where a link can be made ({error.strerror})") from error


def claim_port(path: str, end_within_s: float = END_WITHIN_S) -> socket.socket:
    """Claim a path: of several simulated cars only one may put its serial port there. Closing what is returned ends it.

    The claim is an abstract Unix socket that is named after the path: it leaves no file, the kernel takes it back when
    its process ends, however that happens, and it says which process that is.

    Args:
        end_within_s: so long another car_sim may take to end.

    Raises:
        ConfigError: another living car_sim holds it.
    """
    place = os.path.join(os.path.realpath(os.path.dirname(path)), os.path.basename(path))
    name = "\0car_interface.car_sim." + hashlib.sha256(os.fsencode(place)).hexdigest()
    claim = socket.socket(socket.AF_UNIX)

    def has_bound():
        try:
            claim.bind(name)
            claim.listen()
        except OSError:  # EADDRINUSE
            return False
        return True

    if SYSTEM.wait_for(has_bound, end_within_s, POLL_S):
        return claim
    claim.close()
    raise ConfigError("port", path, "a path that no other car_sim uses: end that one, or start this one with "
                      f"another port, e.g. port:={path}_2", f"{path} is in use by another car_sim{_holder(name)}")


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


class VirtualLine:
    """Carries bytes between a virtual Teensy and the program that has opened its port.

    Args:
        path: where to put the link to the port.
        firmware: the Teensy, which also lives on while it's unplugged.
        make_terminal, make_claim: of other classes where a test connects the port.

    Raises:
        ConfigError: when another car_sim that runs uses ``path``, something other than a link is there, or no link can
            be put there.
    """

    def __init__(self, path: str, firmware, seed: int, inbox, make_terminal: Callable[[str], Any] = PseudoTerminal,
                 make_claim: Callable[[str], Any] = claim_port):
        self._make_terminal = make_terminal
        self._claim = make_claim(path)  # also while it's unplugged
        self._path, self._firmware, self._inbox = path, firmware, inbox
        self._bad = bad = BadLine(seed)
        self._terminal = self._make_terminal(path)
        self._unplugged_from = ""
        self._plug_ns = NEVER_NS
        clock_ns = inbox.clocks.now_ns  # when a fault begins
        serve_faults(inbox, {
            "unplug": lambda duration_s: self._unplug(duration_s, clock_ns()),
            "plug": lambda value: self._plug(),
            **{fault: lambda duration_s, fault=fault: bad.begin(fault, duration_s, clock_ns()) for fault in LASTING},
            "cut": bad.cut,
            "bit_errors": bad.bit_errors,
            "reboot": lambda off_s: firmware.reboot(clock_ns(), round(off_s * NS_PER_S)),
            "out_of_step": lambda value: firmware.receive(ODD_FLAG, clock_ns()),
            **{f"sonar_{condition}": lambda value, condition=condition: firmware.set_sonar(value, condition, clock_ns())
               for condition in SONAR_CONDITIONS},
        })

    def step(self, now_ns: int) -> None:
        """Carry what both sides have sent until now."""
        if self._terminal is None and now_ns >= self._plug_ns:
            self._plug()
        is_read = self._terminal is not None and self._firmware.receive_backlog(now_ns) < MAX_BACKLOG
        self._inbox.watch("line", self._terminal.fileno() if is_read else None)  # unread it would wake for ever
        if is_read:
            self._firmware.receive(self._bad.to_teensy(self._terminal.read(), now_ns), now_ns)
        sent = self._bad.to_host(self._firmware.transmit(now_ns), now_ns)
        if sent and self._terminal is not None:
            self._terminal.write(sent)

    def close(self) -> None:
        self._hang_up()
        self._claim.close()

    def _hang_up(self):
        self._inbox.watch("line", None)
        if self._terminal is not None:
            self._terminal.close()
            self._terminal = None

    def _unplug(self, duration_s, now_ns):
        require(0 <= duration_s <= MAX_S, "unplug", duration_s, f"0 (until plug) to {MAX_S} s")
        self._plug_ns = now_ns + round(duration_s * NS_PER_S) if duration_s else NEVER_NS
        if self._terminal is not None:
            self._unplugged_from = self._terminal.name
            self._hang_up()

    def _plug(self):
        """Connect the port by another name than before, as often happens; the system gives out the lowest free one."""
        if self._terminal is not None:
            return
        self._plug_ns = NEVER_NS
        self._terminal = self._make_terminal(self._path)
        if self._terminal.name == self._unplugged_from:
            same = self._terminal
            self._terminal = self._make_terminal(self._path)
            same.close()
