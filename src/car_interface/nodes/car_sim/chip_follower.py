"""Follows what the pins of a virtual servo board do, whoever writes to it, as a car on its outputs would."""
from __future__ import annotations

from car_interface.common.own_files import UnsafeFile
from car_interface.common.units import NS_PER_MS
from car_interface.pca9685.registers import duty_of_counts
from car_interface.ros.inbox import Inbox
from car_interface.sim.chip_link import ChipLink

RETRY_NS = 200 * NS_PER_MS


class ChipFollower:
    """An observer of a chip's process, which may come and go.

    Args:
        path: of the chip's socket.
        inbox: woken by a change.

    Attributes:
        duties: of the 16 pins, 0 = no pulse; ``None`` while there is no chip.
        problem: why nothing that is at the path is used; empty: nothing is wrong with it.
    """

    def __init__(self, path: str, inbox: Inbox):
        self.duties: list[int] | None = None
        self.problem = ""
        self._link = ChipLink(path, 0)
        self._inbox = inbox
        self._fd: int | None = None
        self._next_try_ns = 0

    def step(self, now_ns: int) -> None:
        """Connect if there is a chip, and take what it sent."""
        try:
            if self._fd is None and now_ns >= self._next_try_ns:
                self._next_try_ns = now_ns + RETRY_NS
                self.problem = ""
                self._link.open()
                self._fd = self._link.observe()
                self._inbox.watch(self._fd)
            if self._fd is not None:
                for counts in self._link.changes():
                    self.duties = [duty_of_counts(each) for each in counts]
        except UnsafeFile as error:
            self.problem = str(error)
            self.close()
        except OSError:
            self.close()

    def close(self) -> None:
        """Disconnect."""
        if self._fd is not None:
            self._inbox.unwatch(self._fd)
        self._link.close()
        self._fd = self.duties = None
