"""Windows of a drive: their accelerations, which of them count for a fit, and for which reason others don't."""
import numpy as np
import pytest

from car_interface.tools.calibration.shared import Series
from car_interface.tools.calibration.value_map import windows as windowing
from car_interface.tools.calibration.value_map.recorded import MapDrive
from car_interface.tools.calibration.value_map.windows import RULES, windows
from tools.calibration.value_map.synthetic import NOTHING, PULSE_M, drive, rejected, with_

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
    for rule in (windowing.STEERING, windowing.NO_VALUE, windowing.NOT_MEASURED, windowing.NOT_DRIVEN,
                 windowing.SLIPPING, windowing.STEEP):
        assert 24 <= found[RULES[rule]] - clean.get(RULES[rule], 0) <= 36, RULES[rule]


def test_window_over_a_step_of_the_value_is_exactly_its_mean_under_phi(monkeypatch):
    monkeypatch.setattr(windowing, "MAX_MPS2", 99.0)
    t_s = np.arange(0.0, 4.0, 0.0001)
    a = np.where(t_s < 2.1, 1.0, -3.0)
    v = 3.0 + np.cumsum(a) * 0.0001
    s = np.cumsum(v) * 0.0001
    places = np.arange(0.0, s[-1], PULSE_M)
    wheel = Series(np.interp(places, s, t_s), places)
    one = MapDrive(NOTHING, Series(t_s[::100], v[::100]), Series(t_s[::100], 0 * t_s[::100]), (wheel, wheel))
    found = windows(one)
    counts = found.state == windowing.MEASURED
    expected = (np.where(found.t_s < 2.1, 1.0, -3.0) * found.weight).sum(axis=1)
    assert found.acceleration_mps2[counts] == pytest.approx(expected[counts], abs=0.06)  # φ's grid is 10 ms
    assert found.acceleration_mps2[counts][:5] == pytest.approx(1.0, abs=0.01)


def test_stops_and_rolling_backward_and_the_change_of_gear_after_it_do_not_count():
    t_s = np.arange(0.0, 20.0, 0.02)
    speed = np.interp(t_s, [0, 5, 6, 8, 9, 11, 12, 20], [2, 2, 0, 0, -1, -1, 0.5, 4])
    state = windows(MapDrive(Series(t_s, t_s), Series(t_s, speed), Series(t_s, 0 * t_s))).state
    middle = 0.2 + 0.2 * np.arange(state.size)
    assert set(state[(middle > 6.2) & (middle < 7.8)]) == {windowing.STANDING}
    assert set(state[(middle > 9.2) & (middle < 10.8)]) == {windowing.BACKWARD}
    assert windowing.GEAR_CHANGE in state[(middle > 11.2) & (middle < 12.4)]
    assert set(state[middle > 13.0]) == {windowing.MEASURED}


def test_wheels_that_spin_are_slipping():
    t_s = np.arange(0.0, 10.0, 0.02)
    speed = np.interp(t_s, [0, 5, 5.5, 6, 10], [2, 2, 9, 2, 2])
    state = windows(MapDrive(Series(t_s, t_s), Series(t_s, speed), Series(t_s, 0 * t_s))).state
    assert windowing.SLIPPING in state


def test_wheels_that_were_never_heard_at_the_same_time_measure_nothing():
    t_s = np.arange(0.0, 20.0, 0.02)
    left, right = (Series(np.arange(begin_s, begin_s + 8.0, 0.02), np.arange(400) * 0.02) for begin_s in (0.0, 12.0))
    state = windows(MapDrive(Series(t_s, t_s), Series(t_s, 0 * t_s + 1.0), Series(t_s, 0 * t_s), (left, right))).state
    assert set(state) == {windowing.NOT_MEASURED}
