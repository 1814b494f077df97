"""What all calibrations have in common: recorded drives in, a file that its node takes out, and curves that rise."""
from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Callable, NamedTuple, Sequence

import numpy as np

from car_interface.common import output
from car_interface.common.errors import CarInterfaceError

if TYPE_CHECKING:  # rosbags comes with it, which a car's own computer may not have
    from car_interface.tools.recordings.signals import Trail

MIN_PULSE, MAX_PULSE = 1638, 8192  # duties that a servo or an ESC takes for a command: 0.5 and 2.5 ms of 20 ms

MAX_NAMES = 3  # of recordings in front of a reason


class RecordedDrive(NamedTuple):
    """One recording, or a drive that was measured as it went on."""

    path: str  # of the recording, or what the drive is called
    drive: Any  # what the fit takes
    notes: tuple[str, ...]  # what was guessed, left out or is unusual, a line each
    duration_s: float  # from the first message to the last
    trail: Trail | None = None  # to compare it with others; None = of no recording
    uses_imu: bool = False  # its heading is the IMU's


def names_of(recorded: Sequence[RecordedDrive]) -> str:
    """Return the recordings' names without their folders, in front of a reason: of many the first ones and a count."""
    names = [Path(one.path).name for one in recorded[:MAX_NAMES]]
    others = len(recorded) - len(names)
    return ", ".join(names) + (f" and {others} more" if others else "")


class NothingToFit(ValueError):
    """Drives that show nothing of what is fitted; the text is the end of a sentence that says why."""


def write_table(path: str, text: str, load: Callable[[str, str], Any], refusal: str) -> str:
    """Write a file that a node loads, keep the old one beside it, and return the line that says so.

    Args:
        load: loads the file at a path from its text, as the node does.
        refusal: what the message begins with where the node would refuse the file.

    Raises:
        CarInterfaceError: it can't be written, or the node would refuse it.
    """
    try:
        load(path, text)
    except CarInterfaceError as error:
        raise CarInterfaceError(f"{refusal}: {error}") from error
    return output.written_text(path, output.write(path, text, keeps_old=True))


def rising(values: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Return the nearest sequence (N,) in weighted least squares that never falls: pool adjacent violators."""
    pools: list = []  # (mean, weight, how many), means rising
    for value, weight in zip(np.asarray(values).tolist(), np.asarray(weights).tolist()):
        pool = (value, weight, 1)
        while pools and pools[-1][0] >= pool[0]:
            mean, before, count = pools.pop()
            total = before + pool[1]
            pool = ((mean * before + pool[0] * pool[1]) / total, total, count + pool[2])
        pools.append(pool)
    return np.repeat([mean for mean, _, _ in pools], [count for _, _, count in pools])


def runs(flags: np.ndarray) -> list[tuple[int, int]]:
    """Return begin and end of each run of true in flags (N,); the end is the index behind its last one."""
    edges = np.flatnonzero(np.diff(np.r_[0, flags.astype(int), 0]))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist()))
