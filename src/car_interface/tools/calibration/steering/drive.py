"""One recorded drive as the fit of a steering curve takes it, and the fit's settings."""
from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from car_interface.tools.calibration.delay import Delay

if TYPE_CHECKING:  # rosbags comes with it, which a car's own computer may not have
    from car_interface.tools.recordings.overlap import Trail

COUNT = 16.0  # duty of one count of the servo board, which can't output anything in between
KNOT = COUNT / 2  # duty from one knot of the curve to the next
MAX_BACKLASH_DUTY = 80.0
MIN_PULSE, MAX_PULSE = 1638, 8192  # duties that a servo accepts as a command: 0.5 and 2.5 ms of 20 ms


@dataclass(frozen=True)
class FitConfig:
    """Which driving counts, and how much.

    Attributes:
        min_speed_mps: at lower speeds the heading changes too little.
        max_lateral_mps2: above this tyres may begin to slide.
        settled_duty: the servo has arrived when it is this near to its command, by delay and lag.
        max_wander_duty: how far the wheels may move within a segment.
        min_length_m, max_length_m, min_duration_s: of a segment.
        max_gap_s: between samples of odometry that belong together.
        max_jump_rad: of the heading from sample to sample.
        heading_sigma_rad: standard error of odometry's heading, at most: where a drive shows that it is better, that
            counts.
        min_heading_sigma_rad: the same, at least.
        min_sigma_per_m: no segment's curvature is known better: floors are uneven, tyres flex.
        delay: of the servo; ``None`` = estimated.
        backlash_duty: of the linkage; ``None`` = estimated.
        backlash_sigma: the standard error of the one that is given.
        max_backlash_duty: the upper bound of that estimate.
        known_ratio, known_per_m: a breakpoint is supported when its curvature is known to this ratio or to this
            magnitude, to either side, beyond half of what the board's next count would change.
        stop_duty: a mechanical stop is one when the curve stays level over this duty.
        stop_ratio: level is a curvature that differs from the tightest by at most this ratio.
        understeer: by how much turns widen with speed where a drive doesn't show it.
        limits: duties beyond which nobody means to steer.
    """

    min_speed_mps: float = 0.25
    max_lateral_mps2: float = 4.0
    settled_duty: float = 6.0
    max_wander_duty: float = 24.0
    min_length_m: float = 0.5
    max_length_m: float = 8.0
    min_duration_s: float = 0.3
    max_gap_s: float = 0.3
    max_jump_rad: float = 0.5
    heading_sigma_rad: float = 0.008
    min_heading_sigma_rad: float = 0.003
    min_sigma_per_m: float = 0.001
    delay: Delay | None = None
    backlash_duty: float | None = None
    backlash_sigma: float = 0.0
    max_backlash_duty: float = MAX_BACKLASH_DUTY
    known_ratio: float = 0.08
    known_per_m: float = 0.01
    stop_duty: float = 40.0
    stop_ratio: float = 0.007
    understeer: float = 0.0
    limits: tuple = ()


DEFAULTS = FitConfig()


class Drive(NamedTuple):
    """One recording: N samples of odometry, M of the servo's duty.

    The drives of a calibration are all of one car, with nothing changed in between.
    """

    t_s: np.ndarray  # (N,), rising
    distance_m: np.ndarray  # (N,), travelled since any moment, backward negative
    yaw_rad: np.ndarray  # (N,), unwrapped
    duty_t_s: np.ndarray  # (M,), rising
    duty: np.ndarray  # (M,), of the steering channel, each until the next; NaN where there is no pulse


class RecordedDrive(NamedTuple):
    """One recording, or a drive that was measured as it went on."""

    path: str
    drive: Drive
    notes: tuple[str, ...]
    duration_s: float
    uses_imu: bool
    trail: Trail | None  # None: of no recording


class NothingToFit(ValueError):
    """Drives from which no steering curve can be found; the text is the end of a sentence that says why."""
