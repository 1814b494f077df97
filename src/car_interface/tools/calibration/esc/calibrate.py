"""Calibrates an ESC by recorded drives: the parameters of throttle.yaml, and a report on what shows each of them."""
from __future__ import annotations

from typing import Iterator, Sequence

from car_interface.common.declared import parameter_of
from car_interface.common.errors import CarInterfaceError
from car_interface.common.yaml_edit import Value, rewritten
from car_interface.throttle.calibration import ThrottleCalibration, trimmed
from car_interface.throttle.config import ThrottleConfig
from car_interface.throttle.esc_config import EscConfig
from car_interface.tools.calibration.esc.fit import NEUTRAL, PROFILE, EscFit, fit
from car_interface.tools.calibration.esc.recorded import joined
from car_interface.tools.calibration.shared import RecordedDrive

HEAD = ("Written by calibrate_esc; throttle_arb loads it. Duties are 0..65535 of the PWM period, dead bands fractions",
        "of the duty between neutral and each end.", "")
# Numbers of the fit, as throttle.yaml has them, and their units.
FITTED = {"dead_band_forward": "", "dead_band_reverse": "", "dwell_s": " s", "reverse_after_neutral_s": " s",
          "drag_deceleration_mps2": " m/s²"}
NOT_SHOWN = "not shown by the drive"


def calibrate(recorded: Sequence[RecordedDrive], base: ThrottleCalibration) -> EscFit:
    """Calibrate by recorded drives. An ESC that takes a shorter pulse for forward gets its neutral mirrored back.

    Raises:
        CarInterfaceError: two were driven with different neutrals.
    """
    first = recorded[0]
    for one in recorded:
        if one.drive.neutral != first.drive.neutral:
            raise CarInterfaceError(f"{first.path} was driven with servo/neutral {first.drive.neutral:.0f} and "
                                    f"{one.path} with {one.drive.neutral:.0f}: calibrate by one of them")
    found = fit(joined([one.drive for one in recorded]))
    if found.neutral is not None and base.duty_table[-1] < base.neutral:
        found.neutral = 2 * first.drive.neutral - found.neutral
    return found


def yaml_values(found: EscFit, base: ThrottleCalibration) -> dict[str, Value]:
    """Return the parameters that the drives show, by name."""
    values = {}
    if found.neutral is not None:
        neutral = round(found.neutral)
        values = {NEUTRAL: neutral, "servo/duty_table": list(trimmed(base, neutral).duty_table)}
    if found.profile is not None:
        values.update({PROFILE: found.profile, "esc/profile_measured": True})
    for field in FITTED:
        value = getattr(found, field)
        if value is not None:
            values[parameter_of(EscConfig, field).name] = value
    return values


def yaml_text(found: EscFit, base: ThrottleConfig, base_text: str, report: Sequence[str]) -> str:
    """Return the text of throttle_arb's file: the base with what the drives show, and the report as its head."""
    values = yaml_values(found, base.calibration)
    if base.esc.calibration_drive:
        values["esc/calibration_drive"] = False
    return rewritten(base_text, values, [*HEAD, *report])


def report(found: EscFit, recorded: Sequence[RecordedDrive], base: ThrottleConfig) -> Iterator[str]:
    """Yield the report's lines: each parameter, its value in the configuration before, and what shows it."""
    seconds = sum(one.duration_s for one in recorded)
    yield f"ESC by {', '.join(one.path for one in recorded)}: {seconds:.0f} s"
    yield from (f"  {note}" for one in recorded for note in one.notes)
    values = yaml_values(found, base.calibration)
    olds = {PROFILE: (base.esc.profile, ""), NEUTRAL: (base.calibration.neutral, ""),
            **{parameter_of(EscConfig, field).name: (getattr(base.esc, field), unit) for field, unit in FITTED.items()}}
    for name, (old, unit) in olds.items():
        if name not in values:
            yield f"  {name}: {NOT_SHOWN}, stays {old}{unit}"
            continue
        changed = f" (was {old}{unit})" if values[name] != old else ""
        shown = found.seen.get(name) or ("from there to where the car sets off" if "dead_band" in name else "")
        yield f"  {name}: {values[name]}{unit}{changed}" + (f": {shown}" if shown else "")
    yield from (f"  missing: {problem}" for problem in found.missing)
