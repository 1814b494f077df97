"""Pictures of a steering calibration and of a value map."""
from xml.etree import ElementTree

import pytest

from car_interface.steering.calibration import SteeringCalibration
from car_interface.throttle.value_map import ValueMap
from car_interface.tools.report import plots
from car_interface.tools.report.plots import draw

RADII_M = (1.0, 2.0, 5.0, 100.0)
STEERING = SteeringCalibration(3800, 5100, 6700, 0, RADII_M, (3800, 4400, 4800, 5080), (6700, 5900, 5400, 5120))
REVERSED = SteeringCalibration(6700, 5100, 3800, 0, RADII_M, (6700, 5900, 5400, 5120), (3800, 4400, 4800, 5080))
MAP = ValueMap([0, 1], [0, 2], [[-1, -2], [3, 2.5]])


@pytest.mark.once
def test_picture_is_of_the_kind_asked_for_and_has_the_files_name_without_its_folder():
    assert draw(STEERING, "pdf", "a").startswith(b"%PDF-")
    first = draw(STEERING, "svg", "/home/car/a")
    assert ElementTree.fromstring(first).tag == "{http://www.w3.org/2000/svg}svg"
    assert draw(STEERING, "svg", "a") == first != draw(REVERSED, "svg", "a")
    assert draw(MAP, "svg", "mine.csv") != draw(MAP, "svg", "other.csv")


@pytest.mark.parametrize("axis", [RADII_M, [float(index) for index in range(1, 101)], [3.0, 3.01, 3.02, 300.0]],
                         ids=["few", "many", "crowded"])
def test_labels_below_radii_are_a_twelfth_of_the_axis_apart(axis):
    shown = plots._labelled(list(axis))
    assert set(shown) <= set(axis) and shown[-1] == axis[-1]
    min_ratio = (axis[-1] / axis[0]) ** (1 / 12)
    assert all(later / earlier >= min_ratio * (1 - 1e-9) for earlier, later in zip(shown, shown[1:]))
