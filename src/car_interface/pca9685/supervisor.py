"""Keeps one PCA9685 at its targets, and recovers from faults of bus and chip.

A failed transfer is repeated once; when that fails too, the bus is reopened and the chip initialised again: every 100
ms, since the chip may go on pulsing an old command, or with growing pauses where it has never run. Twice a second the
chip is read back: after a loss of power it has its reset values and still acknowledges every write, and another program
may have written to its channels.
"""
from __future__ import annotations

from typing import Callable, Sequence

from car_interface.common.units import CHANNELS, NS_PER_MS
from car_interface.pca9685.board import Board, BoardMismatch, ForeignWrite
from car_interface.pca9685.channels import differences

CHECK_PERIOD_NS = 500 * NS_PER_MS
FIRST_RETRY_NS, LAST_RETRY_NS = 100 * NS_PER_MS, 2000 * NS_PER_MS

# Events for ``on_event``.
RETRIED, DISCONNECTED, ABSENT, RUNNING, MISMATCH = "retried", "lost", "absent", "running", "mismatch"
FOUND = "found"  # the chip was initialised, and ``held`` is what its channels hold before the first write
FOREIGN = "foreign"  # another program wrote to channels: they are written again

# Called for each attempt to write, so that a repetition after a slow failure doesn't write a stale value.
Targets = Callable[[], Sequence[int]]


class BoardSupervisor:
    """Opens, writes, checks and reopens bus and chip.

    Args:
        open_board: opens the bus and returns the chip on it; raises OSError. Called again after a failure.
        on_event: called with one of the events above and the OSError or None, at each attempt.

    Attributes:
        ever_ran: the chip was connected at least once, so that it may be pulsing now.
        errors: failed transfers, first attempts and repetitions.
        reopenings: recoveries of bus and chip.
        reinitialisations: of a chip that answered and had been reset.
        foreign_writes: checks that found channels which another program had written.
    """

    def __init__(self, open_board: Callable[[], Board], on_event: Callable[[str, Exception | None], None]):
        self.errors = self.reopenings = self.reinitialisations = self.foreign_writes = 0
        self._open_board = open_board
        self._on_event = on_event
        self._board: Board | None = None
        self.ever_ran = False
        self._retry_ns = FIRST_RETRY_NS
        self._next_try_ns = 0
        self._next_check_ns = 0

    @property
    def running(self) -> bool:
        """Return whether the chip is connected, as far as is known."""
        return self._board is not None

    @property
    def held(self) -> list[int | None]:
        """Return the counts in the chip's registers; ``None`` = unknown."""
        return [None] * CHANNELS if self._board is None else self._board.held

    def next_due_ns(self) -> int:
        """Return when ``update`` must be called even if no target changes."""
        return self._next_try_ns if self._board is None else self._next_check_ns

    def update(self, targets: Targets, now_ns: int) -> None:
        """Open, check or write, as is due. Errors of the bus are handled here."""
        if self._board is None:
            if now_ns >= self._next_try_ns:
                self._try_to_open(targets, now_ns)
            return
        try:
            if now_ns >= self._next_check_ns:
                self._next_check_ns = now_ns + CHECK_PERIOD_NS
                self._check()
            self._write(targets)
        except OSError as error:
            self._disconnect(error, now_ns)

    def open(self, targets: Targets, now_ns: int) -> None:
        """Open bus and chip now, and write every target.

        Raises:
            OSError: it failed; BoardMismatch when the chip doesn't read back as written.
        """
        try:
            self._board = self._open_board()
            self._board.initialise()
            self._on_event(FOUND, None)
            self._board.write(differences(self._board.held, targets()))
        except OSError:
            self.errors += 1
            self.close()
            raise
        self.reopenings += self.ever_ran
        self.ever_ran = True
        self._retry_ns = FIRST_RETRY_NS
        self._next_check_ns = now_ns + CHECK_PERIOD_NS
        self._on_event(RUNNING, None)

    def read_back(self, now_ns: int) -> None:
        """Read back the counts of all channels, where another program may have written."""
        if self._board is not None:
            try:
                self._repeat(self._board.read_back)
            except OSError as error:
                self._disconnect(error, now_ns)

    def all_off(self, now_ns: int) -> bool:
        """Switch every output off; return whether the chip acknowledged."""
        if self._board is not None:
            try:
                self._repeat(self._board.all_off)
            except OSError as error:
                self._disconnect(error, now_ns)
        return self._board is not None

    def retry_now(self) -> None:
        """Let the next ``update`` try at once to open bus and chip."""
        self._next_try_ns = 0

    def _try_to_open(self, targets, now_ns):
        try:
            self.open(targets, now_ns)
        except OSError as error:
            self._on_event(ABSENT, error)
            self._wait(now_ns)

    def _check(self):
        try:
            self._repeat(self._board.check)
        except ForeignWrite as found:
            self.foreign_writes += 1
            self._on_event(FOREIGN, found)
        except BoardMismatch as mismatch:
            self._on_event(MISMATCH, mismatch)
            self._board.initialise()
            self.reinitialisations += 1
            self._on_event(FOUND, None)

    def _write(self, targets):
        self._repeat(lambda: self._board.write(differences(self._board.held, targets())))

    def _repeat(self, transfer):
        try:
            transfer()
        except BoardMismatch:
            raise
        except OSError as error:
            self.errors += 1
            self._on_event(RETRIED, error)
            transfer()

    def _disconnect(self, error, now_ns):
        self.errors += 1
        self._on_event(DISCONNECTED, error)
        self.close()
        self._wait(now_ns)

    def _wait(self, now_ns):
        self._next_try_ns = now_ns + self._retry_ns
        if not self.ever_ran:
            self._retry_ns = min(2 * self._retry_ns, LAST_RETRY_NS)

    def close(self) -> None:
        """Close the bus; the chip continues with its registers."""
        board, self._board = self._board, None
        if board is not None:
            board.close()
