"""The table that is written: nothing is invented."""
import numpy as np
import pytest

from car_interface.tools.calibration.value_map import calibrate as tables
from car_interface.tools.calibration.value_map.calibrate import supported_table
from tools.calibration.value_map.synthetic import fit_of

pytestmark = pytest.mark.once


BOTH, NONE = [1, 1], [0, 0]


@pytest.mark.parametrize("driven, values, velocities", [
    pytest.param([[0, 1, 1, 1], [0, 1, 1, 1], [1, 1, 0, 0]], [-1, 0], [1, 2, 3], id="the_largest_part"),
    pytest.param([[1, 1, 0, 0], [1, 1, 0, 0], [1, 1, 1, 1], [0, 1, 1, 1]], [-1, 0, 1], [0, 1],
                 id="rather_one_that_drives_and_brakes_than_one_that_reaches_farther"),
    pytest.param([[1, 1, 0], [1, 1, 0], *[[1, 1, 1]] * 3, [1, 1, 0], [1, 1, 0]], [1, 2, 3], [0, 1, 2],
                 id="rather_three_of_each_than_more_with_two"),
    pytest.param([BOTH, BOTH, NONE, NONE, BOTH], [-1, 0, 3], [0, 1], id="without_two_values_that_were_not_driven"),
    pytest.param([BOTH, BOTH, NONE, NONE, NONE, BOTH], [-1, 0], [0, 1], id="but_not_across_three"),
])
def test_axes_are_those_of_the_part_that_was_driven(driven, values, velocities):
    found = supported_table(fit_of(driven), 0.0)
    assert (list(found.values), list(found.velocities)) == (values, velocities)
    assert (found.origin == tables.DRIVEN).all()


def test_no_table_where_no_two_values_have_two_velocities():
    assert supported_table(fit_of([[0, 1, 0], [1, 0, 1]]), 0.0) is None


def test_what_lies_between_driven_nodes_and_is_as_sure_is_stated():
    driven = [[1, 1, 1], [1, 0, 1], [1, 1, 1]]
    found = supported_table(fit_of(driven, sure=np.ones((3, 3))), 0.0)
    assert found.origin[1, 1] == tables.BETWEEN and found.accelerations.shape == (3, 3)
    unsure = supported_table(fit_of(driven), 0.0)
    assert list(unsure.values) == [-1.0, 1.0] and (unsure.origin == tables.DRIVEN).all()


def test_prior_stays_where_nothing_was_driven_is_moved_where_it_contradicts_its_column_and_ends_the_axes():
    prior = np.add.outer(np.arange(3) * 1.0, np.full(3, -0.3))
    found = supported_table(fit_of([[1, 1, 0], [1, 1, 0], [1, 1, 0]]), 0.0, prior)
    assert list(found.accelerations[:, 2]) == [-0.3, 0.7, 1.7]
    assert set(found.origin[:, 2]) == {tables.OLD}
    prior = np.full((3, 2), -5.0)
    found = supported_table(fit_of([[1, 1], [1, 1], [0, 1]]), 0.0, prior)
    assert found.origin[2, 0] == tables.MOVED
    assert found.accelerations[1, 0] == 1.0 and found.accelerations[2, 0] == pytest.approx(1.002, abs=0.001)
    prior = np.add.outer(np.arange(3) * 1.0, np.array([0.0, 0.0, np.nan]))
    assert supported_table(fit_of([[1, 1, 0], [1, 0, 0], [1, 1, 0]]), 0.0, prior).accelerations.shape == (3, 2)
