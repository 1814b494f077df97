"""Which windows count for a fit, and for which reason others don't."""
from __future__ import annotations

import numpy as np
import pytest

from calibration.value_map.synthetic import drive, rejected, with_
from car_interface.calibration.value_map import acceleration as windowing
from car_interface.calibration.value_map import windows as windows_module
from car_interface.calibration.value_map.acceleration import Series
from car_interface.calibration.value_map.windows import RULES

pytestmark = pytest.mark.once


def test_a_clean_drive_loses_little():
    one = drive(seconds=60.0)
    assert sum(rejected(one).values()) < 30


def test_each_rule_counts_its_own():
    one = drive(seconds=60.0, with_imu=True)
    t_s = one.speed.t_s
    later = (t_s > 20.0) & (t_s < 30.0)
    twisted = Series(t_s, one.yaw.y + np.where(later, 3.0 * (t_s - 20.0), np.where(t_s >= 30.0, 30.0, 0.0)))
    silent = one.value.t_s[(one.value.t_s < 20.0) | (one.value.t_s > 30.0)]
    gone = Series(silent, np.interp(silent, one.value.t_s, one.value.y))
    unplugged = [Series(wheel.t_s[keep], wheel.y[keep]) for wheel in one.wheels
                 for keep in [(wheel.t_s < 20.0) | (wheel.t_s > 30.0)]]
    idle = Series(np.array([0.0, 20.0, 30.0]), np.array([1.0, 0.0, 1.0]))
    lying = Series(one.imu.t_s, one.imu.y + np.where((one.imu.t_s > 20.0) & (one.imu.t_s < 30.0), 20.0, 0.0))
    for changes, rule in (
        ({"yaw": twisted}, windowing.STEERING),
        ({"value": gone}, windows_module.NO_VALUE),
        ({"wheels": unplugged}, windowing.NOT_MEASURED),
        ({"driven": idle}, windows_module.NOT_DRIVEN),
        ({"imu": lying}, windowing.SLIPPING),
        ({"pitch": Series(t_s, np.where(later, 0.5, 0.0))}, windows_module.STEEP),
    ):
        assert 40 <= rejected(with_(one, **changes))[RULES[rule]] <= 60, RULES[rule]
