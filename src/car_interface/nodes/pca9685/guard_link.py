"""The pca9685 node's link to its guard: starts the process, gives it signs of life, and sees whether it is there.

``nodes.pca9685.pca9685_guard`` is the guard. It is started again when it dies or hangs.
"""
from __future__ import annotations

import io
import os
import subprocess
from contextlib import suppress
from typing import Callable, Sequence

import rospy

from car_interface.common.causes import GUARD_ABSENT, GUARD_BLOCKED
from car_interface.common.units import NS_PER_MS, NS_PER_S
from car_interface.nodes.pca9685 import small_process
from car_interface.pca9685.guard import GIVE_UP_NS
from car_interface.pca9685.guard_protocol import ENDED, ENDING, NOT_TRIED
from car_interface.pca9685.guard_watch import GuardWatch
from car_interface.ros.clocks import Clocks
from car_interface.ros.diagnostics import ERROR, OK, WARN
from car_interface.ros.logs import ThrottledWarnings

RESTART_PAUSE_NS = 500 * NS_PER_MS  # between two starts
SHOWN_NS = 10 * NS_PER_S  # how long /diagnostics names a guard that was lost and is back
MINUTE_NS = 60 * NS_PER_S
END_S = 0.3  # for a guard that was told to end


class GuardChild:
    """A guard's process, and the two pipes to it.

    Args:
        kind, path: ``i2c`` and the bus, or ``virtual`` and the socket of a virtual chip.
        off_after_ns: when the guard switches everything off.
        node_name, output_topic: the resolved names of the node and of its topic with what the chip holds.

    Raises:
        OSError: it can't be started.
    """

    def __init__(self, kind: str, path: str, address: int, off_after_ns: int, node_name: str, output_topic: str):
        guard_in, node_out = os.pipe()
        node_in, guard_out = os.pipe()
        # Closed by the garbage collector at the latest: a part of car_nodes may end by an error anywhere.
        ends = [io.FileIO(fd) for fd in (guard_in, guard_out)]
        self._to_guard, self._from_guard = io.FileIO(node_out, "w"), io.FileIO(node_in)
        os.set_blocking(node_out, False)
        os.set_blocking(node_in, False)
        arguments = (kind, path, address, os.getpid(), off_after_ns, guard_in, guard_out, node_name, output_topic)
        command = small_process.command("nodes.pca9685.pca9685_guard", *map(str, arguments))
        with _open_log() as log:
            self._process = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=log,
                pass_fds=(guard_in, guard_out), start_new_session=True, cwd="/")
        for end in ends:
            end.close()

    @property
    def pid(self) -> int:
        return self._process.pid

    def read(self) -> bytes | None:
        """Return what it has written since the last call; None = it has ended, and nothing is left."""
        data = self._from_guard.readall()  # None = nothing has come, empty = its end is closed
        return b"" if data is None else data or None

    def write(self, data: bytes) -> None:
        """Write to it, if it takes that."""
        with suppress(OSError):  # it is dead, or hangs: its answers show that
            os.write(self._to_guard.fileno(), data)

    def exit_text(self) -> str:
        try:
            code = self._process.wait(0.01)
        except subprocess.TimeoutExpired:
            return "its pipe is closed"
        return f"killed by signal {-code}" if code < 0 else f"exit code {code}"

    def kill(self) -> None:
        self._process.kill()
        self.close()

    def close(self) -> None:
        """Close the pipes: for the guard its node has ended."""
        self._to_guard.close()
        self._from_guard.close()

    def wait_or_kill(self, within_s: float) -> None:
        try:
            self._process.wait(within_s)
        except subprocess.TimeoutExpired:
            self._process.kill()


class GuardLink:
    """One node's guard.

    Args:
        start: starts a guard, as ``GuardChild``, and returns it; ``None`` = there is none.
        board: returns the board's name, for log lines.
    """

    def __init__(self, start: Callable[[], GuardChild] | None, off_after_ns: int, board: Callable[[], str],
                 warnings: ThrottledWarnings, clocks: Clocks):
        self.watch = GuardWatch()
        self._start_guard = start
        self._off_after_ns = off_after_ns
        self._board_name = board
        self._warnings = warnings
        self._clocks = clocks
        self._guard: GuardChild | None = None
        self._start_ns = 0  # not before
        self._fault = ""  # why there is none
        self._lost_ns = 0  # when it was lost last
        self._losses = 0
        self._is_reported = True  # the log knows whether it is there

    def receive(self, now_ns: int) -> None:
        """Take what the guard has written, and see whether it is there."""
        if self._guard is None:
            return
        data = self._guard.read()
        if data is None:
            self._lose(now_ns, f"it has ended ({self._guard.exit_text()})")
            return
        self.watch.receive(data, now_ns)
        if not self._is_reported and self.watch.watches:
            self._is_reported = True
            rospy.loginfo("the guard of %s watches again after %.2f s", self._board_name(),
                          (now_ns - self._lost_ns) / NS_PER_S)

    def step(self, now_ns: int, timeout_counts: Sequence[int], has_reached: bool, can_start: bool) -> None:
        """Start the guard if there is none, and give a sign of life if one is due.

        Args:
            timeout_counts: of each channel, 0..4096.
            has_reached: whether the node ever reached its chip, so that it may be pulsing.
            can_start: whether the board's bus is known.
        """
        if self._guard is not None and self.watch.hangs(now_ns):
            self._lose(now_ns, "it doesn't answer")
        if self._guard is None and self._start_guard is not None and can_start and now_ns >= self._start_ns:
            self._start(now_ns)
        if now_ns >= self.watch.due_ns:
            self._write(self.watch.sign_of_life(now_ns, timeout_counts, has_reached))

    def chip_is_reached(self, now_ns: int, timeout_counts: Sequence[int]) -> None:
        """Have the guard know at once that the chip may be pulsing: with a node that never reached it, it ends."""
        if self._guard is not None:
            self._write(self.watch.sign_of_life(now_ns, timeout_counts, True))

    def leave_to_node(self, now_ns: int, timeout_counts: Sequence[int]) -> None:
        """Have the guard leave the chip to this node, which makes it safe now, for as long as it lives."""
        self._write(self.watch.sign_of_life(now_ns, timeout_counts, True, ENDING))

    def end(self, now_ns: int, timeout_counts: Sequence[int], is_safe: bool) -> None:
        """End the guard, or, with a chip that isn't safe, leave it to the guard to go on trying."""
        guard = self._guard
        if guard is None:
            return
        if is_safe:
            self._write(self.watch.sign_of_life(now_ns, timeout_counts, True, ENDED))
        self._guard = None
        guard.close()
        if is_safe:
            guard.wait_or_kill(END_S)  # one that hangs has nothing left to guard

    def outlook(self) -> str:
        """Return what to add to the report of a node that ends without having reached its board."""
        return f"; its guard goes on trying for {GIVE_UP_NS // MINUTE_NS} minutes" if self.watch.is_present else ""

    def _start(self, now_ns):
        self._start_ns = now_ns + RESTART_PAUSE_NS
        try:
            self._guard = self._start_guard()
        except OSError as error:
            self._lose(now_ns, f"it can't be started ({error.strerror or error})")
            return
        self.watch.start(self._clocks.now_ns())

    def _write(self, data):
        if self._guard is not None:
            self._guard.write(data)

    def _lose(self, now_ns, fault):
        if self._guard is not None:
            self._guard.kill()
            self._guard = None
        self.watch.lose()
        self._fault = fault
        self._losses += 1
        if self._is_reported:
            self._is_reported = False
            self._lost_ns = now_ns
            self._warnings.warn(fault, f"{self._absence()}. Starting it anew")

    def _absence(self):
        return (f"{GUARD_ABSENT}: {self._fault}. Until there is one {self._board_name()} goes on pulsing if this node "
                "dies or hangs")

    def report(self, status, now_ns: int, board_runs: bool):
        """Report its state on /diagnostics. A board that the node can't reach either is the node's own report."""
        if self._start_guard is None:
            status.summary(OK, "off (guard: false): the board goes on pulsing if this node dies or hangs")
            return
        if self._guard is None and not self._losses:
            status.summary(OK, "starts as soon as the board's bus is known")
            return
        if not self.watch.is_present:
            status.summary(ERROR, self._absence())
            status.add("cause", GUARD_ABSENT)
        elif board_runs and self.watch.error not in (0, NOT_TRIED):
            status.summary(WARN, f"{GUARD_BLOCKED}: it can't reach the board ({os.strerror(self.watch.error)})")
            status.add("cause", GUARD_BLOCKED)
        elif self._losses and now_ns - self._lost_ns < SHOWN_NS:
            status.summary(WARN, f"it was lost ({self._fault}) and started anew")
            status.add("cause", GUARD_ABSENT)
        else:
            status.summary(OK, "watches" if self.watch.watches else "starts")
        status.add("process", self._guard.pid if self._guard else 0)
        status.add("acted", self.watch.interventions)
        status.add("started anew", self._losses)
        status.add("full off after", f"{self._off_after_ns / NS_PER_S:g} s")


def _open_log():
    """Open the file beside the node's log in which the guard writes what it did."""
    path = os.environ.get("ROS_LOG_FILENAME")
    try:
        return open(f"{os.path.splitext(path)[0]}-guard.log" if path else os.devnull, "ab")
    except OSError:
        return open(os.devnull, "ab")
