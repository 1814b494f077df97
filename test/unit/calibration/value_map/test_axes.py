"""Rounded maps still rise."""
from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from car_interface.calibration.value_map.axes import rounded

pytestmark = pytest.mark.once


@given(st.lists(st.tuples(st.floats(-10, 10), st.floats(-10, 10)), min_size=2, max_size=8))
def test_rounded_columns_rise_and_are_near(rows):
    table = rounded(np.sort(np.array(rows), axis=0) + 0.002 * np.arange(len(rows))[:, None])
    assert (np.diff(table, axis=0) > 0).all()
    assert np.abs(table - np.sort(np.array(rows), axis=0)).max() < 0.002 * len(rows) + 0.001


def test_rounding_makes_even_level_columns_rise():
    assert rounded(np.array([[1.0], [1.0], [0.9999]]))[:, 0].tolist() == [1.0, 1.001, 1.002]
