"""What all calibrations have in common: recorded drives in, a file that its node takes out, and curves that rise."""
from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Callable, NamedTuple, Sequence

import numpy as np

from car_interface.common import output
from car_interface.common.errors import CarInterfaceError

if TYPE_CHECKING:  # rosbags comes with it, which a car's own computer may not have
    from car_interface.tools.recordings.columns import Pulses
    from car_interface.tools.recordings.signals import Signals, Trail

MIN_PULSE, MAX_PULSE = 1638, 8192  # duties that a servo or an ESC takes for a command: 0.5 and 2.5 ms of 20 ms

MIN_PULSES = 200  # of a wheel, from which the length of one is known
PULSE_GAP_S = 0.3  # odometry comes at least every 0.2 s

MAX_NAMES = 3  # of recordings in front of a reason


class Series(NamedTuple):
    """Samples of one quantity at rising times; both of the shape (N,)."""

    t_s: np.ndarray
    y: np.ndarray


class RecordedDrive(NamedTuple):
    """One recording, or a drive that was measured as it went on."""

    path: str  # of the recording, or what the drive is called
    drive: Any  # what the fit takes
    notes: tuple[str, ...]  # what was guessed, left out or is unusual, a line each
    duration_s: float  # from the first message to the last
    trail: Trail | None = None  # to compare it with others; None = of no recording
    uses_imu: bool = False  # its heading is the IMU's


def is_pulse(duty: np.ndarray) -> np.ndarray:
    """Return which duties, of any shape, a servo or an ESC takes for a command."""
    return (duty >= MIN_PULSE) & (duty <= MAX_PULSE)


def recorded_duty(found: Signals, channel: int, what: str) -> Series:
    """Return the duties of what is on a channel of the servo board, NaN where there is no pulse.

    Raises:
        CarInterfaceError: the channel never had a pulse.
    """
    duty = found.output.duties[:, channel].astype(float)
    pulses = is_pulse(duty)
    if not pulses.any():
        raise CarInterfaceError(f"{found.path}: channel {channel} of the servo board never had a pulse: is the {what} "
                                "on another one (--channel)?")
    return Series(found.output.t_s, np.where(pulses, duty, np.nan))


def wheel_distances(pulses: Sequence[Pulses], speed: Series) -> tuple[Series, ...]:
    """Return the distance in m at its pulses of each wheel that made enough; the length of one is by odometry's speed.
    """
    new = [np.diff(wheel.count.astype(float), prepend=np.nan) != 0 for wheel in pulses]  # reports repeat the last pulse
    counts = [Series(wheel.t_s[is_new], wheel.count[is_new].astype(float)) for wheel, is_new in zip(pulses, new)]
    counts = [count for count in counts if count.t_s.size >= MIN_PULSES]
    distance_m = integral(speed.t_s, speed.y)
    rolled_m = counted = 0.0
    for count in counts:
        # In a gap of odometry the distance is unknown, while pulses are counted on.
        is_known = ~has_gap(speed.t_s, count.t_s[:-1], count.t_s[1:], PULSE_GAP_S)
        rolled_m += np.abs(np.diff(np.interp(count.t_s, speed.t_s, distance_m)))[is_known].sum()
        counted += np.abs(np.diff(count.y))[is_known].sum()
    if rolled_m <= 0 or counted < MIN_PULSES:
        return ()
    return tuple(Series(count.t_s, count.y * (rolled_m / counted)) for count in counts)


def integral(t_s: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return the integral of a signal (N,) over time, by trapezoids, from its first sample to each: (N,)."""
    return np.append(0.0, np.cumsum(np.diff(t_s) * (y[1:] + y[:-1]) / 2))


def held(t_s: np.ndarray, value: np.ndarray, at_s: np.ndarray) -> np.ndarray:
    """Return the values at the times ``at_s``, of any shape, of a signal (N,) that holds each sample until the next.

    Before the first sample its value counts.
    """
    return value[np.maximum(np.searchsorted(t_s, at_s, side="right") - 1, 0)]


def interval_s(t_s: np.ndarray, at_s: np.ndarray) -> np.ndarray:
    """Return the interval between samples (N,) around each of the times ``at_s`` (M,): (M,)."""
    return np.diff(t_s)[np.clip(np.searchsorted(t_s, at_s, side="right"), 1, len(t_s) - 1) - 1]


def has_gap(t_s: np.ndarray, begin_s: np.ndarray, end_s: np.ndarray, max_s: float) -> np.ndarray:
    """Return which spans of time (M,) hold an interval between samples (N,) longer than ``max_s``, or a part of one."""
    steps_s = np.diff(t_s)
    in_gaps_s = np.append(0.0, np.cumsum(np.where(steps_s > max_s, steps_s, 0.0)))
    return np.interp(begin_s, t_s, in_gaps_s) < np.interp(end_s, t_s, in_gaps_s)


def names_of(recorded: Sequence[RecordedDrive]) -> str:
    """Return the recordings' names without their folders, in front of a reason: of many the first ones and a count."""
    names = [Path(one.path).name for one in recorded[:MAX_NAMES]]
    others = len(recorded) - len(names)
    return ", ".join(names) + (f" and {others} more" if others else "")


class NothingToFit(ValueError):
    """Drives that show nothing of what is fitted; the text is the end of a sentence that says why."""


def write_table(path: str, text: str, load: Callable[[str, str], Any], node: str) -> str:
    """Write a file that a node loads, keep the old one beside it, and return the line that says so.

    Args:
        load: loads the file at a path from its text, as the node does.
        node: its name.

    Raises:
        CarInterfaceError: it can't be written, or the node would refuse it.
    """
    try:
        load(path, text)
    except CarInterfaceError as error:
        raise CarInterfaceError(f"nothing is written, {node} would refuse it: {error}") from error
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
