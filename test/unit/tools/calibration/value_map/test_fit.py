"""Value maps from drives: synthetic ones, whose map, slope, battery and delay are known."""
import numpy as np
import pytest

from car_interface.tools.calibration.shared import NothingToFit, Series
from car_interface.tools.calibration.value_map.fit import fit
from car_interface.tools.calibration.value_map.recorded import MapConfig, MapDrive
from car_interface.tools.calibration.value_map.windows import RULES, STEERING
from tools.calibration.value_map.synthetic import DELAY_S, acceleration, drive, error, fitted_mixed

pytestmark = pytest.mark.once
KNOWN_DELAY = MapConfig(delay_s=DELAY_S)


def test_map_of_a_drive_on_a_slope_with_a_sagging_battery_is_the_level_one_at_mean_battery():
    mixed = fitted_mixed()
    assert error(mixed) < 0.03
    ground = mixed.grounds[0]
    assert mixed.delay_s == pytest.approx(DELAY_S, abs=0.01)
    assert ground.uphill == pytest.approx((0.012, -0.016), abs=0.002)
    assert ground.sag_above == pytest.approx(0.1, abs=0.02) and ground.sag_below == pytest.approx(0.0, abs=0.03)
    truth = acceleration(mixed.values[:, None], mixed.velocities[None, :])
    ratios = (np.abs(mixed.accelerations - truth) / mixed.sigma_mps2)[mixed.supported]
    assert np.mean(ratios < 2) > 0.8, "its error is of the size that its standard errors say"
    assert mixed.held_out_windows > 50
    assert mixed.held_out_mps2 < 1.5 * mixed.residual_mps2 + 0.01, "held-out manoeuvres are predicted nearly as well"


def test_turns_show_the_slope_and_nothing_else_where_straights_all_go_one_way():
    found = fit([drive(uphill=(0.02, 0.01), circles=True)], None, None, KNOWN_DELAY)
    assert found.rejected[RULES[STEERING]] > 100
    assert found.grounds[0].uphill == pytest.approx((0.02, 0.01), abs=0.003)
    assert error(found) < 0.04


@pytest.mark.parametrize("there_and_back", [True, False])
def test_slope_is_found_on_a_road_there_and_back_and_left_alone_where_headings_do_not_spread(there_and_back):
    one = drive(seconds=120.0, uphill=(0.02, 0.0), turns=False, there_and_back=there_and_back)
    found = fit([one], None, None, KNOWN_DELAY)
    if there_and_back:
        assert found.grounds[0].uphill[0] == pytest.approx(0.02, abs=0.003)
        assert error(found) < 0.03
    else:
        assert np.isnan(found.grounds[0].uphill).all()
        truth = acceleration(found.values[:, None], found.velocities[None, :])
        assert np.median((found.accelerations - truth)[found.supported]) == pytest.approx(-0.02 * 9.81, abs=0.03)


def test_pitch_takes_gravity_off_and_its_mounting_does_not_matter():
    one = drive(seconds=120.0, uphill=(0.012, -0.016), with_pitch=True, mounting_rad=0.03)
    found = fit([one], None, None, KNOWN_DELAY)
    assert found.grounds[0].pitch_offset_rad == pytest.approx(0.03, abs=0.002)
    assert error(found) < 0.03


def test_imu_and_odometry_s_speed_measure_too_and_a_slow_one_gets_longer_windows():
    one = drive(seconds=120.0, uphill=(0.012, -0.016), with_imu=True)
    assert error(fit([one], None, None, MapConfig(measured_by="imu", delay_s=DELAY_S))) < 0.05
    one = drive(seconds=120.0, pulses=False)
    assert error(fit([one], None, None, KNOWN_DELAY)) < 0.05
    slow = MapDrive(one.value, Series(one.speed.t_s[::5], one.speed.y[::5]), one.yaw)  # 10 a second
    assert error(fit([slow], None, None, KNOWN_DELAY)) < 0.08
    assert error(fit([drive(seconds=120.0), slow], None, None, KNOWN_DELAY)) < 0.08, "beside another one"


def test_two_drives_with_slopes_of_their_own_make_one_map():
    found = fit([drive(1, 120.0, (0.02, 0.0)), drive(2, 120.0, (0.0, -0.02))], None, None, KNOWN_DELAY)
    assert found.grounds[0].uphill == pytest.approx((0.02, 0.0), abs=0.003)
    assert found.grounds[1].uphill == pytest.approx((0.0, -0.02), abs=0.003)
    assert error(found) < 0.03


@pytest.mark.parametrize("one", [
    MapDrive(*[Series(np.zeros(1), np.ones(1))] * 3),
    MapDrive(Series(np.ones(1), np.ones(1)), *[Series(np.arange(90) / 90, np.ones(90))] * 2),
    MapDrive(Series(np.zeros(1), np.zeros(1)), Series(np.arange(900) / 9, np.zeros(900)),
             Series(np.arange(900) / 9, np.zeros(900))),
], ids=["one_message_of_each", "no_value", "stood_still"])
def test_nothing_to_fit_says_why(one):
    with pytest.raises(NothingToFit, match=r"shorter than a window|no value|a stop|too few"):
        fit([one], None, None)
