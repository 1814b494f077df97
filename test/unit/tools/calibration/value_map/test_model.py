"""The model: the map rises whatever the data, and outliers don't bend it."""
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from car_interface.throttle.value_map import ValueMap
from car_interface.tools.calibration.shared import Series
from car_interface.tools.calibration.value_map.fit import fit
from car_interface.tools.calibration.value_map.recorded import MapConfig, MapDrive
from car_interface.tools.calibration.value_map.surface import DECIMALS
from car_interface.tools.calibration.value_map.windows import OUTLYING, RULES
from tools.calibration.value_map.synthetic import DELAY_S, acceleration, drive, error, with_

pytestmark = pytest.mark.once


@settings(max_examples=8)
@given(seed=st.integers(0, 10_000), size=st.integers(2, 8), noise=st.floats(0.0, 5.0), falling=st.booleans())
def test_map_rises_whatever_the_data(seed, size, noise, falling):
    rng = np.random.default_rng(seed)
    t_s = np.arange(0.0, 20.0, 0.05)
    value = np.repeat(rng.uniform(-1, 1, 20), 20)
    speed = np.abs(np.cumsum(value * (-0.05 if falling else 0.05)) + 2 + rng.normal(0, noise, t_s.size) / 10) + 0.4
    one = MapDrive(Series(t_s, value), Series(t_s, speed), Series(t_s, np.zeros(t_s.size)))
    found = fit([one], np.linspace(-1, 1, size), np.linspace(0, 5, size), MapConfig(delay_s=0.0))
    assert (np.diff(found.accelerations, axis=0) > 0).all()
    written = [[float(f"{cell:.{DECIMALS}f}") for cell in row] for row in found.accelerations]
    ValueMap(found.values, found.velocities, written)


def test_flat_band_around_neutral_rises_all_the_same():
    def with_band(value, speed):
        return acceleration(np.sign(value) * np.maximum(0.0, np.abs(value) - 0.5), speed)
    found = fit([drive(map_of=with_band)], np.array([-4, -2, -1, -0.5, -0.25, 0, 0.25, 0.5, 1, 2, 3.0]), None,
                MapConfig(delay_s=DELAY_S))
    assert (np.diff(found.accelerations, axis=0) > 0).all()
    assert error(found, with_band) < 0.08


def test_outliers_do_not_bend_the_map():
    one = drive(seconds=120.0)
    bump = np.where((one.speed.t_s % 20 > 10) & (one.speed.t_s % 20 < 10.6), 1.0, 0.0)
    kicked = with_(one, speed=Series(one.speed.t_s, one.speed.y + bump), wheels=())
    found = fit([kicked], None, None, MapConfig(delay_s=DELAY_S))
    assert found.rejected[RULES[OUTLYING]] > 5
    assert error(found) < 0.08


def test_a_drive_of_one_value_supports_no_other():
    one = drive(seconds=60.0)
    lonely = MapDrive(Series(one.value.t_s, np.full(one.value.y.size, 1.0)), one.speed, one.yaw, one.wheels)
    found = fit([lonely], np.array([-1.0, 0.0, 1.0, 2.0]), None, MapConfig(delay_s=0.0))
    assert not found.supported[[0, 1, 3]].any()
