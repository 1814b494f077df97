"""The distance by a car's odometry."""
from __future__ import annotations

import numpy as np
import pytest

from car_interface.calibration.steering.distance import distance_m
from car_interface.recordings.series import Odom


def test_distance_is_as_long_whether_the_recording_has_gaps_or_not():
    t_s = np.arange(0.0, 60.0, 0.02)
    circle = Odom(t_s, np.sin(t_s), 1 - np.cos(t_s), t_s, np.full(len(t_s), 1.02), np.ones(len(t_s)))
    recorded = t_s % 10 < 7  # by speed it's 2 % longer than between positions; across a gap these are no use
    gappy = Odom(*(column[recorded] for column in circle))
    for odom in (circle, gappy):
        travelled_m = distance_m(odom)
        assert np.median(np.diff(travelled_m) / np.diff(odom.t_s)) == pytest.approx(1.0, abs=2e-4)
