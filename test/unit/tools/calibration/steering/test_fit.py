"""From drives to a steering curve: known curves come out; drives that show nothing are refused."""
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from car_interface.tools.calibration.shared import NothingToFit
from car_interface.tools.calibration.steering import fit
from car_interface.tools.calibration.steering.calibrate import LEFT, RIGHT, breakpoints, completed
from car_interface.tools.calibration.steering.drive import UNKNOWN_DELAY, CurveFitConfig, Delay
from tools.calibration.steering.synthetic import (
    CENTER,
    KNOWN,
    KNOWN_DELAY,
    LEFT_STOP,
    RIGHT_STOP,
    drive,
    fitted_mixed,
    fitted_steep,
    mixed,
    true_curvature,
)

pytestmark = pytest.mark.once


def test_curve_center_and_stops_are_those_of_the_car():  # positions are 75 duty apart
    found = fitted_mixed()
    inside = (found.duties > LEFT_STOP + 50) & (found.duties < RIGHT_STOP - 50)
    assert np.abs(found.curvatures - true_curvature(found.duties))[inside].max() < 0.01
    assert found.center == pytest.approx(CENTER, abs=8)
    assert abs(found.center - CENTER) < 3 * found.center_sigma + 2
    for side, stop_duty, curvature_per_m in ((found.left, LEFT_STOP, 1.0), (found.right, RIGHT_STOP, 0.9)):
        assert side.is_stop and side.duty == pytest.approx(stop_duty, abs=50) and side.duty % 16 == 0
        assert side.curvature_per_m == pytest.approx(curvature_per_m, abs=0.01)
        assert abs(found.curvature(side.duty)) >= 0.993 * side.curvature_per_m, "a stop turns as tight as any count"


def test_backlash_is_found_and_the_curve_is_that_of_its_middle():
    assert fitted_mixed().backlash_duty == pytest.approx(0, abs=6)
    found = fit.fit([drive(mixed(count=60), backlash=30.0, hold_s=2.0)], CurveFitConfig(delay=KNOWN_DELAY))
    assert found.backlash_duty == pytest.approx(30, abs=6)
    inside = (found.duties > LEFT_STOP + 100) & (found.duties < RIGHT_STOP - 100)
    assert np.abs(found.curvatures - true_curvature(found.duties))[inside].max() < 0.01


def test_servo_that_is_the_other_way_round_and_a_car_that_drives_backward_give_the_same_curve():
    found = fit.fit([drive(mixed(), curve=lambda duty: -true_curvature(duty), speed_mps=-1.0)], KNOWN)
    assert found.left.duty > found.center > found.right.duty
    left = breakpoints(found, [2.0], LEFT)[0]
    assert -true_curvature(left.duty) == pytest.approx(0.5, abs=0.01)
    assert found.curvature(4500) == pytest.approx(-true_curvature(4500), abs=0.01)


STEADY = (4100, 4500, 4900, 5500, 5900, 6300)


def steady_circles(backlash=0.0):
    """A recording for each, of a duty that never changes: 18 m."""
    return [drive([duty], speed_mps=1.2, hold_s=15.0, start_s=100.0 * index, seed=index, backlash=backlash)
            for index, duty in enumerate(STEADY)]


def test_steady_circles_give_the_curve_and_leave_delay_and_backlash_unknown():
    found = fit.fit(steady_circles())
    assert found.delay == UNKNOWN_DELAY and not found.backlash_is_known
    off = np.abs(found.curvature(np.array(STEADY)) - true_curvature(np.array(STEADY)))
    assert off.max() < 0.01
    # 1/1300 1/m per duty: the wheels may be 10 duty beside the servo, half of the usual backlash.
    assert np.interp(STEADY, found.duties, found.sigmas).min() > 0.006
    with pytest.raises(NothingToFit, match="the steering was held in fewer than four places"):
        fit.fit(steady_circles()[:1])


def test_steady_circles_beside_a_drive_that_shows_the_backlash_count_as_far_as_that_allows():
    alone = fit.fit([drive(mixed(), backlash=30.0)])
    found = fit.fit([drive(mixed(), backlash=30.0), *steady_circles()])
    assert found.backlash_is_known and found.backlash_duty == pytest.approx(alone.backlash_duty, abs=3)
    steady = found.observations.duty_sigma[len(alone.observations.duty):]
    assert len(steady) >= 12 and steady.min() == pytest.approx(30 / 12 ** 0.5, rel=0.2)


def test_reason_why_nothing_is_left_names_what_was_left_out():
    with pytest.raises(NothingToFit, match=r"for half a metre at speed; intervals that don't count: .*"
                                           r"\d+ fast in a bend: tyres may slide"):
        fit.fit([drive([4000, 4400], speed_mps=4.0)], KNOWN)


def test_duty_for_a_turn_is_such_that_the_nearest_count_is_the_best_one():
    found = fitted_steep()
    counts = np.arange(math.ceil(found.duties[0] / 16), math.floor(found.duties[-1] / 16) + 1) * 16.0
    made = found.curvature(counts)
    for curvature in np.linspace(-0.95, 1.05, 300):
        count = round(float(found.duty(curvature)) / 16) * 16.0
        assert abs(found.curvature(count) - curvature) <= np.abs(made - curvature).min() + 1e-4


@pytest.mark.parametrize("drives", (
    [], [drive([5200, 5216, 5200])], [drive(mixed())._replace(yaw_rad=np.zeros(6000))],
    [drive(mixed())._replace(distance_m=np.zeros(6000))], [drive(mixed())._replace(duty=np.full(40, math.nan))],
), ids=("none", "nearly one position", "no heading", "standing", "no pulses"))
def test_drives_without_a_curve_are_refused_with_the_reason(drives):
    with pytest.raises(NothingToFit, match=r"the|recordings"):
        fit.fit(drives)


@settings(max_examples=8, deadline=None)
@given(st.lists(st.tuples(st.integers(3600, 6800), st.floats(-1.5, 1.5)), min_size=6, max_size=20), st.integers(0, 99))
def test_curve_and_table_are_monotone_whatever_the_data(places, seed):
    duties = [duty for duty, _ in places]
    known, curvatures = np.array(duties), np.array([curvature for _, curvature in places])
    one = drive(duties, curve=lambda at: curvatures[np.argmin(np.abs(at[:, None] - known), axis=1)], seed=seed,
                lag_s=0.0)
    try:
        found = fit.fit([one], CurveFitConfig(delay=Delay(0.0, 0.0), backlash_duty=0.0))
    except NothingToFit:
        return
    steps = np.diff(found.curvatures)
    assert np.all(steps >= -1e-12) or np.all(steps <= 1e-12)
    for side in (LEFT, RIGHT):
        points = breakpoints(found, [0.7, 1.0, 1.5, 2.0, 5.0, 20.0, 300.0], side)
        center = found.center if math.isfinite(found.center) else 5200.0
        made = [point.duty for point in completed(points, center, [4000.0] * 7)]
        steps = np.diff(made)
        assert np.all(steps >= -1e-6) or np.all(steps <= 1e-6)
