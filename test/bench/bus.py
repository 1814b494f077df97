"""Bytes that pca9685 writes to the I²C bus for a command, by the log of the virtual chip."""
from __future__ import annotations

import time
from typing import Iterator

from std_msgs.msg import Int32MultiArray

from waiting import eventually

from .effort import Effort
from .rows import Row, Summary, Target
from .stage import Stage, TimedSubscriber, connected_publisher

CHANNELS = 16


def sizes(log: str) -> list[int]:
    """Return the size of each write in the chip's log, bytes: address, register, data. Checks of the chip only read."""
    with open(log, encoding="ascii") as file:
        return [2 + len(line.split()[3]) // 2 for line in file if line.endswith("\n")]


def measure_bus(effort: Effort, stage: Stage) -> Iterator[Row]:
    path = stage.path("bus")
    with stage.running(stage.node("pca9685", "_device:=virtual", f"_virtual_log:={path}", "_timeout:=0")):
        outputs = TimedSubscriber("/servo/output", Int32MultiArray, lambda message: tuple(message.data)).connected()
        commands = connected_publisher("/command", Int32MultiArray)

        def written(duties, changes=True):
            before = len(sizes(path))
            commands.publish(Int32MultiArray(data=duties))
            if changes:
                outputs.first(lambda held: all(duty in (-1, output) for duty, output in zip(duties, held)))
                eventually(lambda: len(sizes(path)) > before, "a write")
            else:
                time.sleep(0.05)
            return sizes(path)[before:]
        written([1600] * CHANNELS)
        steering, unchanged, all_channels, blocks = [], [], [], []
        for index in range(effort.bus_commands):
            steer = [3200 + 16 * (index % 2)] + [-1] * (CHANNELS - 1)
            steering.append(sum(written(steer)))
            unchanged.append(sum(written(steer, changes=False)))
            writes = written([4800 + 16 * (index % 2)] * CHANNELS)
            all_channels.append(sum(writes))
            blocks.append(len(writes))
    for what, unit, figures, wanted in (("bus: a steering change", "bytes", steering, 6),
                                        ("bus: a command that changes nothing", "bytes", unchanged, 0),
                                        ("bus: 16 changed channels", "bytes", all_channels, 68),
                                        ("bus: 16 changed channels", "writes", blocks, 2)):
        yield Row("bus", what, unit, Summary.of(figures), (Target("max", low=wanted, high=wanted),))
