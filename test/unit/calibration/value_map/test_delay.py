"""Delay, slope and battery of a drive."""
from __future__ import annotations

import pytest

from calibration.value_map.synthetic import DELAY_S

pytestmark = pytest.mark.once


def test_delay_slope_and_battery_are_found(mixed):
    ground = mixed.grounds[0]
    assert mixed.delay_s == pytest.approx(DELAY_S, abs=0.01)
    assert ground.uphill == pytest.approx((0.012, -0.016), abs=0.002)
    assert ground.sag_above == pytest.approx(0.1, abs=0.02)
    assert ground.sag_below == pytest.approx(0.0, abs=0.03)
