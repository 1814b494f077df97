"""What a calibration drive ends with: the tool's own calibration of its samples, or the tool's refusal."""
from __future__ import annotations

from typing import NamedTuple

from car_interface.calibration.drive.samples import Samples
from car_interface.steering.calibration import SteeringCalibration


class Conclusion(NamedTuple):
    """The end of a drive.

    Attributes:
        yaml_text: for turn_arb's file, the base with the new values; empty = refused.
        report: calibrate_steering's own lines.
        refusal: why nothing is to be written, in the tool's words; empty = nothing is missing.
        center_duty: the new servo_center, for servo.yaml too; 0 = refused.
        ends_duty: the new servo_left and servo_right; (0, 0) = refused.
    """

    yaml_text: str
    report: tuple[str, ...]
    refusal: str
    center_duty: int
    ends_duty: tuple[int, int]


def conclude(samples: Samples, base: SteeringCalibration, base_text: str, name: str) -> Conclusion:
    """Calibrate by a drive's samples, as calibrate_steering would by its recording. Takes a second; never raises.

    Args:
        samples: of the drive.
        base: the calibration before.
        base_text: the text of its file, whose other parameters are kept.
        name: what the report calls the drive, such as the bag's file name.
    """
    raise NotImplementedError
