"""A PCA9685 in software for the pca9685 node, with faults that a service injects.

Service:
    ~inject_fault (InjectFault): ``nack`` (number of the next transfers that fail), ``hold`` (the bus is held down, 1 or
        0), ``power`` (of the chip, 1 or 0), ``brownout`` (its registers are reset), ``address`` (its new address).
Parameter:
    ~virtual_log: the absolute path of a file to which each write to the chip is appended: monotonic time in ns,
        address, register and bytes.
"""
from __future__ import annotations

import time
from typing import TextIO

from car_interface.common.errors import ConfigError
from car_interface.ros.faults import serve_faults
from car_interface.sim.pca9685_chip import VirtualBus, VirtualPca9685


class VirtualBoardBus:
    """Opens and closes as a real bus does; the chip on it keeps its state.

    Args:
        address: the chip's.
        log_path: that of ~virtual_log; ``None`` = no log.

    Raises:
        ConfigError: the log can't be written.
    """

    def __init__(self, address: int, log_path: str | None = None):
        self._address = address
        self._chip = VirtualPca9685()
        self._log = _open_log(log_path)
        self._bus = VirtualBus({address: self._chip}, time.sleep, self._log_write)

    def open(self) -> VirtualBus:
        """The bus."""
        return self._bus

    def close(self, bus: VirtualBus) -> None:
        """Nothing to close."""

    def serve(self, inbox) -> None:
        """Offer the faults."""
        serve_faults(inbox, {
            "nack": self._nack,
            "hold": self._hold,
            "power": self._power,
            "brownout": lambda value: self._chip.power_up(),
            "address": self._set_address,
        })

    def _nack(self, transfers):
        if transfers < 0:
            raise ConfigError("nack", transfers, "how many transfers shall fail, at least 0")
        self._bus.nacks_left = int(transfers)

    def _hold(self, on):
        self._bus.held = bool(on)

    def _power(self, on):
        if on:
            self._chip.power_up()
            self._bus.attach(self._address, self._chip)
        else:
            self._bus.remove(self._address)

    def _set_address(self, address):
        has_power = self._bus.remove(self._address) is not None
        self._address = int(address)
        if has_power:
            self._bus.attach(self._address, self._chip)

    def _log_write(self, address, register, data):
        if self._log is not None:
            self._log.write(f"{time.monotonic_ns()} {address:02x} {register:02x} {bytes(data).hex()}\n")


def _open_log(path) -> TextIO | None:
    if path is None:
        return None
    try:
        return open(path, "a", buffering=1, encoding="ascii")
    except OSError as error:
        raise ConfigError("virtual_log", path, f"a file that can be written ({error.strerror})") from error
