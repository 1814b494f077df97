"""The report on an ESC's calibration, as lines of text: each parameter, its old value, and what shows it."""
from __future__ import annotations

from typing import Iterator, Sequence

from car_interface.throttle.esc_config import NUMBERS
from car_interface.throttle.params import ThrottleConfig
from car_interface.tools.calibration.esc.calibrate import FITTED, NEUTRAL, PROFILE, Calibrated, yaml_values
from car_interface.tools.calibration.esc.recorded import RecordedDrive

UNITS = {"dwell_s": " s", "reverse_after_neutral_s": " s", "drag_deceleration_mps2": " m/s²"}
# What a line of the fit shows beside the parameter that it begins with.
SHOWN_WITH = {"dead_band_forward": NEUTRAL, "dead_band_reverse": NEUTRAL}
NOT_SHOWN = "not shown by the drive"


def report(calibrated: Calibrated, recorded: Sequence[RecordedDrive], base: ThrottleConfig) -> Iterator[str]:
    """Yield the lines.

    Args:
        calibrated: what is reported.
        recorded: the drives.
        base: the configuration before.
    """
    seconds = sum(one.duration_s for one in recorded)
    yield f"ESC by {', '.join(one.path for one in recorded)}: {seconds:.0f} s"
    yield from (f"  {note}" for one in recorded for note in one.notes)
    values = yaml_values(calibrated, base.calibration)
    seen = dict(text.split(": ", 1) for text in calibrated.fit.seen)
    yield _line(PROFILE, values.get(PROFILE), base.esc.profile, "", seen.get(PROFILE))
    yield _line(NEUTRAL, values.get(NEUTRAL), base.calibration.neutral, "", seen.get(NEUTRAL))
    for field in FITTED:
        name = "esc/" + NUMBERS[field][0]
        shown = seen.get(name) or ("from there to where the car sets off" if field in SHOWN_WITH else None)
        yield _line(name, values.get(name), getattr(base.esc, field), UNITS.get(field, ""), shown)
    yield from (f"  missing: {problem}" for problem in calibrated.problems)


def _line(name, value, old, unit, shown):
    if value is None:
        return f"  {name}: {NOT_SHOWN}, stays {old}{unit}"
    changed = f" (was {old}{unit})" if value != old else ""
    return f"  {name}: {value}{unit}{changed}" + (f": {shown}" if shown else "")
