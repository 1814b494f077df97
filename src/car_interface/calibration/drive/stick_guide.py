"""The same drive by hand: it tells a person who steers with the stick where to hold it, and for how long still.

The person keeps the car away from walls, and slow; nothing is published. Fits, progress and end are those of
``CalibrationDrive``, and so is the loop of a node, but for update_range and update_grant.
"""
from __future__ import annotations

from car_interface.calibration.drive.config import DriveConfig
from car_interface.calibration.drive.knowledge import FitTask, Knowledge
from car_interface.calibration.drive.samples import Samples
from car_interface.calibration.drive.step import Guidance, Progress
from car_interface.steering.calibration import SteeringCalibration


class StickGuide:
    """One drive by hand."""

    def __init__(self, base: SteeringCalibration, config: DriveConfig = DriveConfig()):
        raise NotImplementedError

    @property
    def samples(self) -> Samples:
        """All that was measured so far, for ``conclude``."""
        raise NotImplementedError

    def update_odometry(self, x_m: float, y_m: float, yaw_rad: float, speed_mps: float, measured_ns: int,
                        now_ns: int) -> None:
        """As CalibrationDrive's."""
        raise NotImplementedError

    def update_duty(self, duty: float, now_ns: int) -> None:
        """As CalibrationDrive's: it shows where the stick is."""
        raise NotImplementedError

    def step(self, now_ns: int) -> Guidance:
        """What to do now; 10 times a second and more."""
        raise NotImplementedError

    def take_fit_task(self) -> FitTask | None:
        """As CalibrationDrive's."""
        raise NotImplementedError

    def update_knowledge(self, knowledge: Knowledge, now_ns: int) -> None:
        """As CalibrationDrive's."""
        raise NotImplementedError

    def progress(self, now_ns: int) -> Progress:
        """As CalibrationDrive's; driven_s counts the time in which the car moved."""
        raise NotImplementedError

    def finish(self) -> None:
        """As CalibrationDrive's."""
        raise NotImplementedError
