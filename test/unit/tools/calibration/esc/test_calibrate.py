"""From what a drive shows to the parameters in a file."""
import functools

import numpy as np
import pytest
import virtual_escs

from car_interface.common.errors import CarInterfaceError
from car_interface.throttle.arbiter import ThrottleArbiterConfig
from car_interface.throttle.calibration import ThrottleCalibration
from car_interface.throttle.config import ThrottleConfig
from car_interface.throttle.esc_config import EscConfig
from car_interface.throttle.limits import ThrottleLimits
from car_interface.tools.calibration.esc.calibrate import EscFit, calibrate, fit, yaml_text
from car_interface.tools.calibration.shared import RecordedDrive
from car_interface.tools.recordings.signals import Trail
from tools.calibration.esc.synthetic import Person

RISING = ThrottleCalibration(channel=1, value_axis=[-5, 0, 3], duty_table=[3277, 4912, 6554], neutral=4912)
FALLING = ThrottleCalibration(channel=1, value_axis=[-5, 0, 3], duty_table=[6554, 4912, 3277], neutral=4912)


@functools.lru_cache(maxsize=None)
def driven():
    return Person(virtual_escs.xl5(dwell_s=0.25), seed=3).drive()


def recorded(neutral=4912.0, path="a.bag"):
    return RecordedDrive(path, driven()._replace(neutral=neutral), (), 100.0, Trail(path, *[np.zeros(0)] * 3))


def base(**esc):
    return ThrottleConfig(RISING, ThrottleArbiterConfig(), EscConfig(**esc), ThrottleLimits(), None, None)


def test_drive_becomes_the_fit_s_numbers_and_the_neutral_of_a_mirrored_one_is_mirrored_back():
    found = calibrate([recorded()], RISING)
    assert (found.values["esc/profile"], found.missing) == ("brake_then_reverse", [])
    neutral = found.values["servo/neutral"]
    assert neutral == pytest.approx(fit([driven()]).values["servo/neutral"], abs=0.5) and isinstance(neutral, int)
    assert calibrate([recorded()], FALLING).values["servo/neutral"] == 2 * 4912 - neutral


def test_drives_with_different_neutrals_are_refused():
    said = r"a\.bag was driven with servo/neutral 4912 and b\.bag with 4930: calibrate by one of them"
    with pytest.raises(CarInterfaceError, match=said):
        calibrate([recorded(), recorded(4930.0, "b.bag")], RISING)


def test_values_have_the_table_shifted_by_the_neutral_and_the_profile_counts_as_measured():
    values = calibrate([recorded()], RISING).values
    assert values["servo/duty_table"] == [duty + values["servo/neutral"] - 4912 for duty in RISING.duty_table]
    assert values["esc/profile_measured"] is True and set(values) == {
        "servo/neutral", "servo/duty_table", "esc/profile", "esc/profile_measured", "esc/dead_band_forward",
        "esc/dead_band_reverse", "esc/dwell", "esc/reverse_after_neutral", "esc/drag_deceleration"}


def test_file_that_had_a_calibration_drive_has_none_any_more():
    text = yaml_text(EscFit({"servo/neutral": 4912}), base(calibration_drive=True),
                     "servo: {neutral: 4912, duty_table: [3277, 4912, 6554]}\nesc:\n  calibration_drive: true\n", [])
    assert "calibration_drive: false" in text
