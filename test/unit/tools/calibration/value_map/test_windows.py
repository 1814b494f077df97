"""Which windows count for a fit, and for which reason others don't."""
import numpy as np
import pytest

from car_interface.tools.calibration.value_map import acceleration as windowing
from car_interface.tools.calibration.value_map import windows as windows_module
from car_interface.tools.calibration.value_map.acceleration import Series
from car_interface.tools.calibration.value_map.windows import RULES
from tools.calibration.value_map.synthetic import drive, rejected, with_

pytestmark = pytest.mark.once


def test_each_rule_counts_its_own_and_a_clean_drive_loses_little():
    one = drive(seconds=84.0, with_imu=True)

    def within(t_s, begin_s):
        return (t_s > begin_s) & (t_s < begin_s + 6.0)

    def without(series, begin_s):
        kept = ~within(series.t_s, begin_s)
        return Series(series.t_s[kept], series.y[kept])
    t_s = one.speed.t_s
    spoiled = with_(
        one, yaw=Series(t_s, one.yaw.y + 3.0 * np.clip(t_s - 10.0, 0.0, 6.0)), value=without(one.value, 22.0),
        wheels=[without(wheel, 34.0) for wheel in one.wheels],
        driven=Series(np.array([0.0, 46.0, 52.0]), np.array([1.0, 0.0, 1.0])),
        imu=Series(one.imu.t_s, one.imu.y + np.where(within(one.imu.t_s, 58.0), 20.0, 0.0)),
        pitch=Series(t_s, np.where(within(t_s, 70.0), 0.5, 0.0)))
    clean, found = rejected(one), rejected(spoiled)
    assert sum(clean.values()) < 40
    for rule in (windowing.STEERING, windows_module.NO_VALUE, windowing.NOT_MEASURED, windows_module.NOT_DRIVEN,
                 windowing.SLIPPING, windows_module.STEEP):
        assert 24 <= found[RULES[rule]] - clean.get(RULES[rule], 0) <= 36, RULES[rule]
