"""An ESC's calibration from recorded drives: the parameters of throttle.yaml, and what of them is not shown."""
from __future__ import annotations

from typing import NamedTuple, Sequence

from car_interface.common.errors import CarInterfaceError
from car_interface.common.yaml_edit import Value, rewritten
from car_interface.throttle.calibration import ThrottleCalibration, trimmed
from car_interface.throttle.esc_config import NUMBERS
from car_interface.throttle.params import ThrottleConfig
from car_interface.tools.calibration.esc.fit import EscFit, fit
from car_interface.tools.calibration.esc.recorded import RecordedDrive, joined

HEAD = ("Written by calibrate_esc; throttle_arb loads it. Duties are 0..65535 of the PWM period, dead bands fractions",
        "of the duty between neutral and each end.", "")
PROFILE, NEUTRAL = "esc/profile", "servo/neutral"
# Numbers of the fit, as throttle.yaml has them.
FITTED = ("dead_band_forward", "dead_band_reverse", "dwell_s", "reverse_after_neutral_s", "drag_deceleration_mps2")


class Calibrated(NamedTuple):
    """What drives show of an ESC.

    Attributes:
        fit: the fit.
        neutral: the duty; ``None`` = not shown.
        mirrored: the ESC takes a shorter pulse for forward; the fit's duties are mirrored at the drive's neutral.
    """

    fit: EscFit
    neutral: float | None
    mirrored: bool

    @property
    def problems(self) -> tuple[str, ...]:
        """What is not shown, and what to drive for it; empty = all is."""
        return self.fit.missing


def calibrate(recorded: Sequence[RecordedDrive], base: ThrottleCalibration) -> Calibrated:
    """Calibrate by recorded drives.

    Args:
        recorded: drives of one car.
        base: the calibration before.

    Raises:
        CarInterfaceError: two were driven with different neutrals.
    """
    first = recorded[0]
    for one in recorded:
        if one.drive.neutral != first.drive.neutral:
            raise CarInterfaceError(f"{first.path} was driven with servo/neutral {first.drive.neutral:.0f} and "
                                    f"{one.path} with {one.drive.neutral:.0f}: calibrate by one of them")
    found = fit(joined([one.drive for one in recorded]))
    mirrored = base.duty_table[-1] < base.neutral
    neutral = found.neutral
    if neutral is not None and mirrored:
        neutral = 2 * first.drive.neutral - neutral
    return Calibrated(found, neutral, mirrored)


def yaml_values(calibrated: Calibrated, base: ThrottleCalibration) -> dict[str, Value]:
    """The parameters that the drives show, by name."""
    found, values = calibrated.fit, {}
    if calibrated.neutral is not None:
        neutral = round(calibrated.neutral)
        values = {NEUTRAL: neutral, "servo/duty_table": list(trimmed(base, neutral).duty_table)}
    if found.profile is not None:
        values.update({PROFILE: found.profile, "esc/profile_measured": True})
    for field in FITTED:
        value = getattr(found, field)
        if value is not None:
            values["esc/" + NUMBERS[field][0]] = value
    return values


def yaml_text(calibrated: Calibrated, base: ThrottleConfig, base_text: str, report: Sequence[str]) -> str:
    """The text of throttle_arb's file: the base with what the drives show, and the report as its head."""
    values = yaml_values(calibrated, base.calibration)
    if base.esc.calibration_drive:
        values["esc/calibration_drive"] = False
    return rewritten(base_text, values, [*HEAD, *report])
