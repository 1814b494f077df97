"""From what a drive shows to the parameters in a file."""
import functools
from dataclasses import replace

import numpy as np
import pytest
import virtual_escs

from car_interface.common.errors import CarInterfaceError
from car_interface.throttle.arbiter import ThrottleArbiterConfig
from car_interface.throttle.calibration import ThrottleCalibration
from car_interface.throttle.config import ThrottleConfig
from car_interface.throttle.esc_config import EscConfig
from car_interface.throttle.limits import ThrottleLimits
from car_interface.tools.calibration.esc.calibrate import calibrate, yaml_text, yaml_values
from car_interface.tools.calibration.esc.fit import EscFit, fit
from car_interface.tools.calibration.shared import RecordedDrive
from car_interface.tools.recordings.signals import Trail
from tools.calibration.esc.synthetic import Person

RISING = ThrottleCalibration(channel=1, value_axis=[-5, 0, 3], duty_table=[3277, 4912, 6554], neutral=4912)
FALLING = ThrottleCalibration(channel=1, value_axis=[-5, 0, 3], duty_table=[6554, 4912, 3277], neutral=4912)
WHOLE = EscFit("brake_then_reverse", 4890.4, 0.11, 0.12, 0.3, 0.0, 0.5, ("esc/profile: 3 brakes",), ())
NOTHING = EscFit(*[None] * 7, (), ("the profile: drive",))


@functools.lru_cache(maxsize=None)
def driven():
    return Person(virtual_escs.xl5(dwell_s=0.25), seed=3).drive()


def recorded(neutral=4912.0, path="a.bag"):
    return RecordedDrive(path, driven()._replace(neutral=neutral), (), 100.0, Trail(path, *[np.zeros(0)] * 3))


def base(**esc):
    return ThrottleConfig(RISING, ThrottleArbiterConfig(), EscConfig(**esc), ThrottleLimits(), None, None)


def test_drive_becomes_the_fit_s_numbers_and_the_neutral_of_a_mirrored_one_is_mirrored_back():
    found = calibrate([recorded()], RISING)
    assert (found.profile, found.missing) == ("brake_then_reverse", ())
    assert found.neutral == pytest.approx(fit(driven()).neutral, abs=0.5)
    assert calibrate([recorded()], FALLING).neutral == pytest.approx(2 * 4912 - found.neutral)


def test_drives_with_different_neutrals_are_refused():
    said = r"a\.bag was driven with servo/neutral 4912 and b\.bag with 4930: calibrate by one of them"
    with pytest.raises(CarInterfaceError, match=said):
        calibrate([recorded(), recorded(4930.0, "b.bag")], RISING)


def test_values_have_the_table_shifted_by_the_neutral():
    assert yaml_values(WHOLE, RISING) == {
        "servo/neutral": 4890, "servo/duty_table": [3255, 4890, 6532], "esc/profile": "brake_then_reverse",
        "esc/profile_measured": True, "esc/dead_band_forward": 0.11, "esc/dead_band_reverse": 0.12, "esc/dwell": 0.3,
        "esc/reverse_after_neutral": 0.0, "esc/drag_deceleration": 0.5}
    assert yaml_values(NOTHING, RISING) == {}


def test_file_that_had_a_calibration_drive_has_none_any_more():
    text = yaml_text(replace(WHOLE, neutral=4912.0), base(calibration_drive=True),
                     "servo: {neutral: 4912, duty_table: [3277, 4912, 6554]}\nesc:\n  calibration_drive: true\n", [])
    assert "calibration_drive: false" in text
