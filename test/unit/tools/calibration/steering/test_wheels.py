"""Where the wheels were: the servo's delay and lag, and what is unknown after a gap."""
import numpy as np
import pytest

from car_interface.tools.calibration.delay import Delay
from car_interface.tools.calibration.steering import fit
from car_interface.tools.calibration.steering.wheels import WheelPosition
from tools.calibration.steering.synthetic import drive, fitted_mixed, mixed, with_gaps

pytestmark = pytest.mark.once


def test_delay_and_lag_of_the_servo_are_found_though_the_recording_has_gaps():
    gappy = with_gaps(drive(mixed(count=90), lag_s=0.2, hold_s=2.0), every_s=7.0, missed_s=2.5)
    for found, expected_s, within_s in (
            (fitted_mixed(), 0.15, 0.04), (fit.fit([drive(mixed(), lag_s=0.05, delay_s=0.2)]), 0.25, 0.04),
            (fit.fit([gappy]), 0.2, 0.03)):
        assert found.delay.delay_s + found.delay.lag_s == pytest.approx(expected_s, abs=within_s)


def test_servo_is_unknown_until_it_had_time_to_arrive_from_anywhere():
    swings = with_gaps(drive(np.tile([4800, 5600], 60), hold_s=0.3), every_s=9.0, missed_s=2.0)
    wheels = WheelPosition(swings, Delay(0.05, 0.2, 1.0))
    for end_s in (5.0, 14.0, 23.0):
        known_s = wheels.t_s[(wheels.t_s > end_s) & wheels.is_known][0] - end_s
        assert 0.05 + 5 * 0.2 <= known_s < 2.5  # less than 1 % of its way is left, wherever that began
