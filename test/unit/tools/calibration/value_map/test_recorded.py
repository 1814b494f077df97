"""Parts of what is read from a recording: the values of duties, whether one reached the ESC, the wheels' distances."""
from types import SimpleNamespace

import numpy as np
import pytest

from car_interface.tools.calibration.shared import Series, wheel_distances
from car_interface.tools.calibration.value_map import recorded
from car_interface.tools.calibration.value_map.recorded import (
    MapConfig,
    load_map_drive,
    load_throttle_table,
    reached_esc,
)
from car_interface.tools.recordings.columns import Pulses


def test_duties_become_values_by_the_throttles_table_the_other_way_round(tmp_path):
    path = tmp_path / "throttle.yaml"
    path.write_text("servo: {channel: 2, value_axis: [-1, 0, 4], duty_table: [6000, 5000, 3000], neutral: 5000}\n"
                    "command_timeout: 0.3\n", encoding="utf-8")
    table = load_throttle_table(str(path))
    assert table.neutral == 0.0
    assert table.value_of(np.array([6000, 5500, 5000, 4000, 3000])).tolist() == [-1, -0.5, 0, 2, 4]
    assert table.value_of(np.array([6016, 2984])).tolist() == [-1, 4]  # the board's rounding
    assert np.isnan(table.value_of(np.array([6100, 2900, 0]))).all()


def test_value_that_did_not_reach_the_esc_is_seen_and_a_channel_that_nobody_drives_shows_nothing():
    t_s = np.arange(0.0, 3.0, 0.02)
    commanded = Series(t_s, np.where(t_s > 0.5, 2.0, 0.0))
    duty = Series(t_s, np.where((t_s > 0.55) & (t_s < 2.0), 6000.0, 4915.0))  # the human lets go after 2 s
    driven = reached_esc(commanded, duty, 0.0, 4915)
    gone = driven.t_s[driven.y == 0]
    assert gone.min() == pytest.approx(2.0, abs=0.03) and gone.max() > 2.9
    t_s = np.arange(0.0, 3.0, 0.02)
    assert reached_esc(Series(t_s, t_s), Series(t_s, np.full(t_s.size, -1.0)), 0.0, 4915) is None


def test_pulses_are_as_long_as_odometry_makes_them_but_for_those_while_nothing_was_recorded():
    t_s = np.arange(0.0, 20.0, 0.01)
    wheel = Pulses(t_s[::2], np.floor(t_s[::2] * 2.0 / 0.0149))
    distances = wheel_distances((wheel, wheel), Series(t_s, np.full(t_s.size, 2.0)))
    left = distances[0]
    assert (left.y[-1] - left.y[0]) / (left.t_s[-1] - left.t_s[0]) == pytest.approx(2.0, rel=0.002)
    few = Pulses(wheel.t_s[:199], wheel.count[:199])
    assert len(wheel_distances((wheel, few), Series(t_s, t_s))) == 1
    t_s = np.arange(0.0, 40.0, 0.01)
    speed = np.where((t_s > 11.0) & (t_s < 13.0), 4.0, 1.0)
    count = np.floor(np.cumsum(speed) * 0.01 / 0.0149)
    kept = (t_s < 10.0) | (t_s > 14.0)
    wheel = Pulses(t_s[kept], count[kept])
    distances = wheel_distances((wheel, wheel), Series(t_s[kept], speed[kept]))
    assert (distances[0].y[-1] - distances[0].y[0]) / (count[-1] - count[0]) == pytest.approx(0.0149, rel=0.003)


@pytest.mark.parametrize("count, wheels", [(900, 2), (199, 0)], ids=["both", "one_alone_does_not_count"])
def test_accelerations_are_by_the_wheels_where_both_made_enough_pulses(monkeypatch, count, wheels):
    t_s = np.arange(0.0, 20.0, 0.02)
    zeros, pulses = np.zeros(t_s.size), Pulses(t_s, np.arange(t_s.size))
    found = SimpleNamespace(
        path="a.bag", start_s=0.0, duration_s=20.0, notes=(), output=None, imu=None,
        odom=SimpleNamespace(t_s=t_s, x_m=t_s, y_m=zeros, yaw_rad=zeros, speed_mps=zeros + 1.0),
        value=SimpleNamespace(t_s=t_s, value=zeros), pulses=(pulses, Pulses(t_s[:count], np.arange(count))))
    monkeypatch.setattr(recorded.signals, "load", lambda *_, **__: found)
    assert len(load_map_drive("a.bag", MapConfig()).drive.wheels) == wheels
