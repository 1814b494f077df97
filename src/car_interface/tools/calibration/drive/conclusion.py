"""What a calibration drive ends with: the tool's own calibration of its samples, or the tool's refusal."""
from __future__ import annotations

from typing import NamedTuple

from car_interface.common.errors import CarInterfaceError
from car_interface.steering.calibration import SteeringCalibration
from car_interface.tools.calibration.drive.samples import Samples
from car_interface.tools.calibration.steering.calibrate import Calibrated, calibrate, yaml_text
from car_interface.tools.calibration.steering.drive import RecordedDrive
from car_interface.tools.calibration.steering.report import report, short_report
from car_interface.tools.calibration.steering.table import LEFT, RIGHT


class Conclusion(NamedTuple):
    """The end of a drive.

    Attributes:
        yaml_text: for turn_arb's file, the base with the new values; empty = refused.
        report: the most important lines of calibrate_steering's own; the file has them all.
        refusal: why nothing is to be written, in the tool's words; empty = nothing is missing.
        center_duty: the new servo_center, for servo.yaml too; 0 = refused.
        ends_duty: the new servo_left and servo_right; (0, 0) = refused.
        missing: what the refusal is made of, where more driving is what it takes: sentences; else empty.
    """

    yaml_text: str
    report: tuple[str, ...]
    refusal: str
    center_duty: int
    ends_duty: tuple[int, int]
    missing: tuple[str, ...] = ()


def conclude(samples: Samples, base: SteeringCalibration, base_text: str, name: str) -> Conclusion:
    """Calibrate by a drive's samples, as calibrate_steering would by its recording. Takes a second; never raises.

    Args:
        samples: of the drive.
        base: the calibration before.
        base_text: the text of its file, whose other parameters are kept.
        name: what the report calls the drive, such as the bag's file name.
    """
    recorded = [RecordedDrive(name, samples.drive(), (), samples.duration_s, False, None)]
    lines: tuple[str, ...] = ()
    missing: tuple[str, ...] = ()
    try:
        calibrated = calibrate(recorded, base)
        lines = tuple(short_report(calibrated, recorded))
        missing = tuple(calibrated.problems)
        refusal = "; ".join(missing) or _swapped(calibrated, base)
        text = "" if refusal else yaml_text(calibrated, base_text, list(report(calibrated, recorded, None)))
    except CarInterfaceError as error:
        refusal = str(error)
    if refusal:
        return Conclusion("", lines, refusal, 0, (0, 0), missing)
    return Conclusion(text, lines, "", round(calibrated.center),
                      (round(calibrated.ends[LEFT]), round(calibrated.ends[RIGHT])))


def _swapped(calibrated: Calibrated, base: SteeringCalibration) -> str:
    """That left and right are exchanged in the base; empty: they aren't."""
    left, right = calibrated.ends[LEFT], calibrated.ends[RIGHT]
    if (left - right) * (base.servo_left - base.servo_right) > 0:
        return ""
    return (f"servo_left {base.servo_left} turns right: exchange servo_left and servo_right, or steering by hand goes "
            "the wrong way")
