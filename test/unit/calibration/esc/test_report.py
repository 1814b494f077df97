"""The lines of the report."""
from __future__ import annotations

import numpy as np

from car_interface.calibration.esc.calibrate import Calibrated
from car_interface.calibration.esc.fit import EscFit
from car_interface.calibration.esc.recorded import RecordedDrive
from car_interface.calibration.esc.report import report
from car_interface.recordings.overlap import Trail
from car_interface.throttle.arbiter import ArbiterConfig
from car_interface.throttle.calibration import ThrottleCalibration
from car_interface.throttle.esc_config import EscConfig
from car_interface.throttle.limits import ThrottleLimits
from car_interface.throttle.params import ThrottleConfig

SHIPPED = ThrottleCalibration(channel=1, value_axis=[-5, 0, 3], duty_table=[3277, 4915, 6554], neutral=4915)
BASE = ThrottleConfig(SHIPPED, ArbiterConfig(), EscConfig(), ThrottleLimits(), None, None)


def recorded(path, *notes):
    return RecordedDrive(path, None, notes, 80.4, Trail(path, *[np.zeros(0)] * 3))


def test_each_parameter_has_its_value_the_old_one_and_what_shows_it():
    fit = EscFit("direct_reverse", 4915.2, 0.11, 0.08, None, None, 0.45,
                 ("esc/profile: 3 brakes", "servo/neutral: the car set off: twice",
                  "esc/drag_deceleration: 0.45 to 0.5"), ())
    drives = [recorded("a.bag", "odom: a note"), recorded("b.bag")]
    assert list(report(Calibrated(fit, 4915.2, False), drives, BASE)) == [
        "ESC by a.bag, b.bag: 161 s",
        "  odom: a note",
        "  esc/profile: direct_reverse (was unverified): 3 brakes",
        "  servo/neutral: 4915: the car set off: twice",
        "  esc/dead_band_forward: 0.11 (was 0.08): from there to where the car sets off",
        "  esc/dead_band_reverse: 0.08: from there to where the car sets off",
        "  esc/dwell: not shown by the drive, stays 0.5 s",
        "  esc/reverse_after_neutral: not shown by the drive, stays 0.0 s",
        "  esc/drag_deceleration: 0.45 m/s² (was 0.3 m/s²): 0.45 to 0.5",
    ]


def test_what_is_missing_stands_below():
    fit = EscFit(*[None] * 7, (), ("the profile: drive", "esc/dwell: drive"))
    lines = list(report(Calibrated(fit, None, False), [recorded("a.bag")], BASE))
    assert lines[1] == "  esc/profile: not shown by the drive, stays unverified"
    assert lines[-2:] == ["  missing: the profile: drive", "  missing: esc/dwell: drive"]
