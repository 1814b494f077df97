"""The table that is written: nothing is invented."""
import numpy as np
import pytest

from car_interface.throttle.value_map import load_value_map
from car_interface.tools.calibration.value_map import table as tables
from car_interface.tools.calibration.value_map.table import csv_text, table
from tools.calibration.value_map.synthetic import fit_of

pytestmark = pytest.mark.once


def test_axes_are_cut_to_the_largest_part_that_was_driven():
    found = table(fit_of([[0, 1, 1, 1], [0, 1, 1, 1], [1, 1, 0, 0]]), 0.0)
    assert (list(found.values), list(found.velocities)) == ([-1.0, 0.0], [1.0, 2.0, 3.0])
    assert found.driven_ratio() == 1.0


def test_a_part_that_drives_and_brakes_is_preferred_to_one_that_reaches_farther():
    found = table(fit_of([[1, 1, 0, 0], [1, 1, 0, 0], [1, 1, 1, 1], [0, 1, 1, 1]]), 0.0)
    assert list(found.values) == [-1.0, 0.0, 1.0]


def test_a_part_with_three_of_each_is_preferred_to_a_longer_one_with_two():
    driven = [[1, 1, 0, 0], [1, 1, 0, 0], [1, 1, 1, 0], [1, 1, 1, 0], [1, 1, 1, 0], [1, 1, 0, 0], [1, 1, 0, 0]]
    assert table(fit_of(driven), 0.0).accelerations.shape == (3, 3)


def test_a_value_that_was_hardly_driven_is_left_out_of_the_axis_but_no_three_side_by_side():
    driven, gap = [1, 1], [0, 0]
    found = table(fit_of([driven, driven, gap, gap, driven]), 0.0)
    assert list(found.values) == [-1.0, 0.0, 3.0] and found.driven_ratio() == 1.0
    found = table(fit_of([driven, driven, gap, gap, gap, driven]), 0.0)
    assert list(found.values) == [-1.0, 0.0]


def test_no_table_where_no_two_values_have_two_velocities():
    assert table(fit_of([[0, 1, 0], [1, 0, 1]]), 0.0) is None


def test_what_lies_between_driven_nodes_and_is_as_sure_is_stated():
    driven = [[1, 1, 1], [1, 0, 1], [1, 1, 1]]
    found = table(fit_of(driven, sure=np.ones((3, 3))), 0.0)
    assert found.origin[1, 1] == tables.BETWEEN and found.accelerations.shape == (3, 3)
    unsure = table(fit_of(driven), 0.0)
    assert list(unsure.values) == [-1.0, 1.0] and (unsure.origin == tables.DRIVEN).all()


def test_prior_stays_where_nothing_was_driven():
    prior = np.add.outer(np.arange(3) * 1.0, np.full(3, -0.3))
    found = table(fit_of([[1, 1, 0], [1, 1, 0], [1, 1, 0]]), 0.0, prior)
    assert list(found.accelerations[:, 2]) == [-0.3, 0.7, 1.7]
    assert set(found.origin[:, 2]) == {tables.OLD} and np.isnan(found.sigma_mps2[:, 2]).all()


def test_prior_that_contradicts_its_column_is_moved_and_what_was_driven_is_not():
    prior = np.full((3, 2), -5.0)
    found = table(fit_of([[1, 1], [1, 1], [0, 1]]), 0.0, prior)
    assert found.origin[2, 0] == tables.MOVED
    assert found.accelerations[1, 0] == 1.0 and found.accelerations[2, 0] == pytest.approx(1.002, abs=0.001)


def test_axes_end_where_the_prior_does():
    prior = np.add.outer(np.arange(3) * 1.0, np.array([0.0, 0.0, np.nan]))
    assert table(fit_of([[1, 1, 0], [1, 0, 0], [1, 1, 0]]), 0.0, prior).accelerations.shape == (3, 2)


def test_csv_is_what_the_converter_loads(tmp_path):
    written = tables.Table(np.array([-1.0, 0.0, 0.3]), np.array([0.5, 1.0]), np.array([[-1, -2], [0, -1], [1, 0.0005]]),
                          np.zeros((3, 2), int), np.zeros((3, 2)))
    path = tmp_path / "map.csv"
    path.write_text(csv_text(written), encoding="utf-8")
    assert load_value_map(str(path)).values == (-1.0, 0.0, 0.3)
    assert path.read_text(encoding="utf-8").splitlines()[0] == "default,0.5,1.0"
