"""Segments of drives: where the wheels were, which are used, which are left out; stops and limits at the ends."""
import numpy as np
import pytest

from car_interface.tools.calibration.steering import fit
from car_interface.tools.calibration.steering.calibrate import END, RIGHT, breakpoints
from car_interface.tools.calibration.steering.drive import CurveFitConfig, Delay, WheelPosition
from car_interface.tools.calibration.steering.fit import find_side
from car_interface.tools.calibration.steering.segments import Segments
from tools.calibration.steering import synthetic
from tools.calibration.steering.synthetic import KNOWN, KNOWN_DELAY, drive, mixed, true_curvature

pytestmark = pytest.mark.once


def test_several_drives_count_together():
    halves = mixed(count=40)
    found = fit.fit([drive(halves[:20]), drive(halves[20:], seed=5, start_s=1000.0)], KNOWN)
    assert found.curvature(5800) == pytest.approx(true_curvature(5800), abs=0.01)
    assert len(found.observations.duty) > 1.8 * len(fit.fit([drive(halves[:20])], KNOWN).observations.duty)


def test_intervals_that_are_left_out_are_counted_by_reason():
    slow, fast = drive(mixed(seed=9), start_s=500.0), drive(mixed(seed=9), start_s=1000.0)
    found = fit.fit([drive(mixed()), slow._replace(distance_m=slow.distance_m * 0.1),
                     fast._replace(distance_m=fast.distance_m * 4, yaw_rad=fast.yaw_rad * 4)], KNOWN)
    assert found.counts["slow or standing"] > 0 and found.counts["fast in a bend: tyres may slide"] > 0
    assert found.curvature(4500) == pytest.approx(true_curvature(4500), abs=0.01)


def test_what_the_servo_did_in_a_gap_of_the_recording_is_not_taken_for_known():
    whole = drive(mixed(count=60), backlash=30.0)
    # The recorder misses 1 s around each third change of the duty; the servo moves meanwhile.
    missed = np.zeros(len(whole.t_s), bool)
    kept_duty = np.ones(len(whole.duty), bool)
    for index in range(3, len(whole.duty), 3):
        missed |= np.abs(whole.t_s - whole.duty_t_s[index]) < 0.5
        kept_duty[index] = False
    gappy = whole._replace(t_s=whole.t_s[~missed], distance_m=whole.distance_m[~missed], yaw_rad=whole.yaw_rad[~missed],
                           duty_t_s=whole.duty_t_s[kept_duty], duty=whole.duty[kept_duty])
    assert missed.any()
    # Each piece, not the curve: that one is robust, and would pass over a few that rest on a duty from before the gap.
    found = Segments([gappy], KNOWN_DELAY).observations(backlash_duty=0.0)
    assert len(found.duty) > 15
    assert np.abs(found.curvature_per_m - true_curvature(found.duty)).max() < 0.05


def test_position_of_the_wheels_is_less_known_when_the_linkage_floats_in_its_backlash():
    sure = np.repeat(synthetic.from_both_sides(mixed(count=30)), 5)
    # Half a second a little beyond, and back by less than the play: how far it came is a matter of the servo's lag.
    floating = [6000] * 5 + [4940] + [5000] * 6
    found = fit.fit([drive(np.concatenate([sure, floating]), hold_s=0.5, backlash=30.0)],
                    CurveFitConfig(delay=KNOWN_DELAY))
    observations = found.observations
    assert np.median(observations.duty_sigma) < 1.2
    assert observations.duty_sigma[-1] > 4.0, "the last one"


@pytest.mark.parametrize("noise_rad, heading_sigma_rad", ((0.0, 0.003), (0.0065, 0.0065), (0.03, 0.008)),
                         ids=("better than that is luck", "as it is seen", "never worse than what is usual"))
def test_the_heading_is_as_good_as_the_drive_shows(noise_rad, heading_sigma_rad):
    found = fit.fit([drive(mixed(), noise_rad=noise_rad)], KNOWN).observations
    independent = np.clip(found.distance_m / 0.15, 2, 26)
    expected = np.hypot(heading_sigma_rad * np.sqrt(12 / independent) / found.distance_m, 0.001)
    assert found.sigma_per_m == pytest.approx(expected, rel=0.2)


def test_delay_and_lag_of_the_servo_are_found_though_the_recording_has_gaps():
    gappy = synthetic.with_gaps(drive(mixed(count=90), lag_s=0.2, hold_s=2.0), every_s=7.0, missed_s=2.5)
    for found, expected_s, within_s in (
            (synthetic.fitted_mixed(), 0.15, 0.04), (fit.fit([drive(mixed(), lag_s=0.05, delay_s=0.2)]), 0.25, 0.04),
            (fit.fit([gappy]), 0.2, 0.03)):
        assert found.delay.delay_s + found.delay.lag_s == pytest.approx(expected_s, abs=within_s)


def test_servo_is_unknown_until_it_had_time_to_arrive_from_anywhere():
    swings = synthetic.with_gaps(drive(np.tile([4800, 5600], 60), hold_s=0.3), every_s=9.0, missed_s=2.0)
    wheels = WheelPosition(swings, Delay(0.05, 0.2))
    for end_s in (5.0, 14.0, 23.0):
        known_s = wheels.t_s[(wheels.t_s > end_s) & wheels.is_known][0] - end_s
        assert 0.05 + 5 * 0.2 <= known_s < 2.5  # less than 1 % of its way is left, wherever that began


def test_limit_of_the_stick_is_an_end_too():
    found = fit.fit([drive(mixed(low=3700, high=6000))], CurveFitConfig(limits=(3800, 6000), delay=KNOWN_DELAY))
    assert found.right.is_end and not found.right.is_stop
    assert breakpoints(found, [1.0], RIGHT)[0].source == END


@pytest.mark.parametrize("backlash_duty, is_end", [(0.0, False), (20.0, False), (32.0, True), (60.0, True)])
def test_end_that_the_wheels_miss_by_half_of_the_backlash_counts_as_driven(backlash_duty, is_end):
    low, high, limit = 4000.0, 6000.0, 6032.0  # two counts beyond what the wheels did
    knots = np.arange(low, high + 1, 8.0)
    side = find_side(knots, (5000.0 - knots) / 1000, np.full(len(knots), 0.001), 1, low, high,
                     (3000.0, limit), backlash_duty)
    assert (side.is_end, side.is_stop, side.duty) == (is_end, False, high)
