"""Bytes on the I²C bus, by the log of the virtual chip: what pca9685 writes for a command."""
from __future__ import annotations

import time
from typing import Iterator

from std_msgs.msg import Int32MultiArray

from waiting import eventually

from .effort import Effort
from .rows import Row, Summary, Target
from .stage import Ear, Stage, mouth

CHANNELS = 16
SETTLING_S = 0.05  # of a command that writes nothing
ADDRESS_AND_REGISTER = 2  # bytes


class Log:
    """The chip's log of writes, as sizes in bytes; chip checks only read, and aren't there."""

    def __init__(self, path):
        self._path = path

    def sizes(self) -> list[int]:
        """Of all writes so far: address, register, data."""
        with open(self._path, encoding="ascii") as file:
            return [ADDRESS_AND_REGISTER + len(line.split()[3]) // 2 for line in file if line.endswith("\n")]


def measure_bus(effort: Effort, stage: Stage) -> Iterator[Row]:
    """A steering change, the same command again, and sixteen changes."""
    path = stage.path("bus")
    with stage.running(stage.node("pca9685", "_device:=virtual", f"_virtual_log:={path}", "_timeout:=0")):
        outputs = Ear("/servo/output", Int32MultiArray, lambda message: tuple(message.data)).connected()
        commands, log = mouth("/command", Int32MultiArray), Log(path)

        def written(duties, changes=True):
            before = len(log.sizes())
            commands.publish(Int32MultiArray(data=duties))
            if changes:
                outputs.first(lambda held: all(duty in (-1, output) for duty, output in zip(duties, held)))
                eventually(lambda: len(log.sizes()) > before, "a write")
            else:
                time.sleep(SETTLING_S)
            return log.sizes()[before:]
        written([1600] * CHANNELS)
        steering, unchanged, all_channels, blocks = [], [], [], []
        for index in range(effort.bus_commands):
            turn = [3200 + 16 * (index % 2)] + [-1] * (CHANNELS - 1)
            steering.append(sum(written(turn)))
            unchanged.append(sum(written(turn, changes=False)))
            sizes = written([4800 + 16 * (index % 2)] * CHANNELS)
            all_channels.append(sum(sizes))
            blocks.append(len(sizes))
        outputs.close()
        commands.unregister()
    for what, unit, figures, wanted in (
            ("bus: a steering change", "bytes", steering, 6), ("bus: a command that changes nothing", "bytes",
                                                                unchanged, 0),
            ("bus: 16 changed channels", "bytes", all_channels, 68), ("bus: 16 changed channels", "writes", blocks, 2)):
        yield Row("bus", what, unit, Summary.of(figures), (Target("max", low=wanted, high=wanted),))
