"""A bilinear grid, and columns that rise, rounded or not."""
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from car_interface.tools.calibration.value_map.surface import MIN_STEP_MPS2, Grid, rising_column, rounded

pytestmark = pytest.mark.once


def test_grid_gives_back_its_nodes_and_what_is_linear_between():
    grid = Grid(np.array([0.0, 1.0, 3.0]), np.array([0.0, 2.0]))
    nodes = np.array([[0.0, 2.0], [1.0, 3.0], [3.0, 5.0]])
    rows, columns = np.array([0.0, 0.5, 2.0, 3.0]), np.array([0.0, 1.0, 1.0, 2.0])
    weights = grid.averages(rows[:, None], columns[:, None], np.ones((4, 1)))
    assert weights @ nodes.ravel() == pytest.approx([0, 1.5, 3, 5])


@given(st.lists(st.floats(-10, 10), min_size=2, max_size=8))
def test_rising_column_rises_and_leaves_alone_what_does(column):
    risen = rising_column(np.array(column), np.ones(len(column)))
    assert (np.diff(risen) >= MIN_STEP_MPS2 - 1e-12).all()
    again = rising_column(risen, np.ones(len(column)))
    assert again == pytest.approx(risen, abs=1e-6)


@given(st.lists(st.tuples(st.floats(-10, 10), st.floats(-10, 10)), min_size=2, max_size=8))
def test_rounded_columns_rise_and_are_near(rows):
    table = rounded(np.sort(np.array(rows), axis=0) + 0.002 * np.arange(len(rows))[:, None])
    assert (np.diff(table, axis=0) > 0).all()
    assert np.abs(table - np.sort(np.array(rows), axis=0)).max() < 0.002 * len(rows) + 0.001
    assert rounded(np.array([[1.0], [1.0], [0.9999]]))[:, 0].tolist() == [1.0, 1.001, 1.002]
