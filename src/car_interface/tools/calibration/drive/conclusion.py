"""Ends a calibration drive: with the tool's own calibration of its samples, or its refusal, and the file to write."""
from __future__ import annotations

import itertools
import os
from pathlib import Path
from typing import Iterable, NamedTuple, Sequence

import numpy as np

from car_interface.common import output
from car_interface.common.errors import CarInterfaceError
from car_interface.common.package_files import is_package_file, package_file
from car_interface.common.yaml_file import read_yaml
from car_interface.steering.calibration import SteeringCalibration
from car_interface.steering.config import load_steering
from car_interface.tools.calibration.shared import RecordedDrive, write_table
from car_interface.tools.calibration.steering.calibrate import (
    LEFT,
    RIGHT,
    SIGNS,
    TABLE_HEAD,
    SteeringResult,
    calibrate,
    report,
    short_report,
    yaml_text,
)
from car_interface.tools.calibration.steering.drive import SteeringDrive
from car_interface.tools.calibration.steering.smooth import BAND
from car_interface.tools.recordings.calibration_result import CalibrationResult, SideRow

BASE = "config/turn_arb.yaml"


class Conclusion(NamedTuple):
    """The end of a drive."""

    yaml_text: str  # for turn_arb's file, the base with the new values; empty = refused
    report: tuple[str, ...]  # the most important lines of calibrate_steering's own; the file has them all
    refusal: str  # why nothing is to be written, in the tool's words; empty = nothing is missing
    # what the refusal is made of, where more driving is what it takes: sentences; else empty
    missing: tuple[str, ...] = ()
    result: CalibrationResult | None = None  # for the recording; ``None`` = there was nothing to fit


def conclude(drive: SteeringDrive, base: SteeringCalibration, base_text: str, name: str) -> Conclusion:
    """Calibrate by a drive, as calibrate_steering would by its recording. Takes a second; never raises.

    Args:
        base_text: the text of the base's file, whose other parameters are kept.
        name: what the report calls the drive, such as the bag's file name.
    """
    duration_s = float(np.ptp(drive.t_s)) if len(drive.t_s) else 0.0
    recorded = [RecordedDrive(name, drive, (), duration_s)]
    lines, missing, result = (), (), None
    try:
        calibrated = calibrate(recorded, base)
        lines, missing = tuple(short_report(calibrated, recorded)), tuple(calibrated.problems)
        refusal = "; ".join(missing) or _swapped(calibrated, base)
        whole = report(calibrated, recorded, None)
        text = yaml_text(calibrated, base_text, whole)
        result = _result(calibrated, base, refusal, whole)
    except CarInterfaceError as error:
        refusal = str(error)
    return Conclusion("" if refusal else text, lines, refusal, missing, result)


def _result(calibrated: SteeringResult, base: SteeringCalibration, refusal: str, lines: Iterable[str]):
    """Return the result for the recording, without what to do next."""
    curve, radii_m = calibrated.curve, [point.radius_m for point in calibrated.points[LEFT]]

    def row(sign, point):
        old_duty = base.planner_duty(sign * point.radius_m)
        return SideRow(old_duty, sign * float(curve.curvature(old_duty)), point.duty, BAND * point.duty_sigma,
                       point.radius_error, point.segments, point.distance_m, point.source)
    left, right = ([row(sign, point) for point in calibrated.points[side]] for side, sign in SIGNS.items())
    held, before_table = curve.observations, itertools.takewhile(lambda line: not line.startswith(TABLE_HEAD), lines)
    return CalibrationResult(
        refusal, [line.strip() for line in before_table], (), radii_m, left, right,
        (base.servo_center, float(calibrated.center)), np.column_stack((held.duty, held.curvature_per_m)).tolist(),
        np.column_stack((curve.duties, curve.curvatures, BAND * curve.sigmas)).tolist(),
        [(duty, 1 / base.turn_radius_m(duty)) for duty in curve.duties.tolist()])


def _swapped(calibrated: SteeringResult, base: SteeringCalibration) -> str:
    """Say that left and right are exchanged in the base; empty: they aren't."""
    left, right = calibrated.ends[LEFT], calibrated.ends[RIGHT]
    if (left - right) * (base.servo_left - base.servo_right) > 0:
        return ""
    return (f"servo_left {base.servo_left} turns right: exchange servo_left and servo_right, or steering by hand goes "
            "the wrong way")


# --- the file ---


class TableFile(NamedTuple):
    """Where the calibration goes."""

    path: Path  # to be written
    base_text: str  # of the file whose other parameters are kept

    @property
    def beside(self) -> Path:
        """The file that is written where this one isn't to be replaced."""
        return self.path.with_name(f"{self.path.stem}.new{self.path.suffix}")

    @property
    def taking(self) -> str:
        """The command that takes it."""
        return f"mv {self.beside} {self.path}"

    def write(self, text: str, replaces: bool) -> list[str]:
        """Write the calibration: the file itself is replaced, or else the one beside it is written. Return lines that
        say so.

        Raises:
            CarInterfaceError: it can't be written, or turn_arb would refuse it.
        """
        written = write_table(str(self.path if replaces else self.beside), text, load_steering, "turn_arb")
        kept = [] if replaces else [f"{self.path} is as it was. To take the new one: {self.taking}"]
        return [written, *kept, f"to load it, launch again with config:={self.path.parent}"]


def find_table_file(wanted: str | None, base: str | None, launched_with: str | None,
                    running: SteeringCalibration) -> TableFile:
    """Decide where to write, before the drive.

    Args:
        wanted: as the user named it; ``None`` = the file that turn_arb was launched with.
        base: whose other parameters are kept; ``None`` = the file to write, where there is one, else turn_arb's.
        launched_with: turn_arb's own file; ``None`` = unknown.
        running: turn_arb's calibration, which has the channel.

    Raises:
        CarInterfaceError: naming what is wrong.
    """
    if wanted is None and (launched_with is None or is_package_file(launched_with)):
        raise CarInterfaceError(
            "the car runs on the package's own files, which are not to be changed: copy them (cp -r $(rospack find "
            "car_interface)/config ~/my_car), launch with config:=$HOME/my_car, or name the file to write by -o")
    path = os.path.abspath(os.path.expanduser(wanted or launched_with))
    if is_package_file(path):
        raise CarInterfaceError(f"{path} is the package's own: name a file of your car's by -o")
    output.check(path)
    base_path = base or (path if os.path.exists(path) else launched_with or str(package_file(BASE)))
    kept = load_steering(base_path)
    if kept.servo_channel != running.servo_channel:
        raise CarInterfaceError(f"{base_path} has servo_channel {kept.servo_channel}, and turn_arb steers channel "
                                f"{running.servo_channel}: name another file by -o or --base")
    return TableFile(Path(path), read_yaml(base_path))


def next_steps(table: TableFile, refusal: str, replaces: bool | None) -> list[str]:
    """Return what to do after the drive, in sentences, for its page. ``replaces``: the file itself, else the new table
    is beside it; ``None`` = a person is asked, and may say no.
    """
    if refusal:
        return [("Drive again with more room (--radius 3.5) or more time (--max-time 420), or give this recording and "
                 "another one to calibrate_steering, which makes one table of both.")]
    answered = "If you answered no, take" if replaces is None else "Take"
    return [*([] if replaces else [f"{answered} the new table by: {table.taking}"]),
            f"Launch again with config:={table.path.parent}, which loads the table.",
            "Then ask for a circle, and measure it: rostopic pub -r 20 av_turnrad_req std_msgs/Float32 2.0",
            "bag_report of any later drive says how tight its slow turns were against this table."]


def board_center(centers: Sequence[float], board_duty: int | None) -> str:
    """Return a line about the servo board, which is to center the steering by the new duty, too, when nobody commands
    it. ``centers``: turn_arb's, old and new; ``board_duty``: pca9685's, ``None`` = another driver runs the board.
    """
    old_duty, center_duty = map(round, centers)
    if board_duty == old_duty:
        return f"the servo board centers the steering by the same file (duty {center_duty}): it needs nothing more"
    if board_duty is None:
        return (f"the servo board doesn't read this file: give its driver the new center, too, {center_duty}, as the "
                "value for when nobody commands it (timeout_value, or servo.yaml)")
    return (f"pca9685 has another center than turn_arb had, {board_duty} in place of {old_duty}: launch it with this "
            f"folder, too (config), so that it centers by duty {center_duty}")
