"""A computer with several I²C buses, for what finds the servo board; it notes what was asked and written."""
import errno
import os

from virtual_bus import VirtualBus


class Computer:
    """Buses by path, each with its chips by address, or the number of the error that opening it has.

    Attributes:
        taken: (path, address) that a kernel driver has: it's busy for everybody who doesn't force it.
        asked: each (path, address, register) that was read.
        written: each register that was written.
        open: the paths of the buses that are open.
    """

    def __init__(self, buses, taken=()):
        self.buses, self.taken = buses, taken
        self.asked, self.written, self.open = [], [], set()

    def make_bus(self):
        """Return a closed bus, as ``smbus2.SMBus()``."""
        computer = self

        class Bus(VirtualBus):
            path = fd = None

            def __init__(self):
                super().__init__({}, on_write=lambda *write: computer.written.append(write))

            def open(self, path):
                chips = computer.buses.get(path, errno.ENOENT)
                if isinstance(chips, int):
                    raise OSError(chips, os.strerror(chips), path)
                self.path = path
                computer.open.add(path)
                for address, chip in chips.items():
                    self.chips[address] = chip

            def read_i2c_block_data(self, address, register, length):
                computer.asked.append((self.path, address, register))
                if (self.path, address) in computer.taken:
                    raise OSError(errno.EBUSY, "Device or resource busy")
                return super().read_i2c_block_data(address, register, length)

            def close(self):
                computer.open.discard(self.path)
        return Bus()


class Ina3221:
    """A power monitor with its reset values: CONFIG 0x7127, MANUFACTURER_ID 0x5449, whose first bytes are read."""

    def read(self, register, length):
        return [{0x00: 0x71, 0xFE: 0x54}.get(register, 0)]
