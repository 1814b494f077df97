"""Which fits become a map, and why one should not be written."""
from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from car_interface.common.errors import CarInterfaceError
from car_interface.throttle.value_map import ValueMap
from car_interface.tools.calibration.value_map import calibrate as module
from car_interface.tools.calibration.value_map.calibrate import MapAxes, NoTable, calibrate
from car_interface.tools.calibration.value_map.config import FitConfig
from car_interface.tools.calibration.value_map.fit import NothingToFit
from tools.calibration.value_map.synthetic import fit_of

RECORDED = [SimpleNamespace(drive=None, trail=SimpleNamespace(path="drive.bag"))]


def calibrated(monkeypatch, fit, prior=None):
    monkeypatch.setattr(module.fitting, "fit", lambda *_: fit)
    return calibrate(RECORDED, MapAxes(), FitConfig(), prior)


def test_map_that_was_driven_has_no_problems(monkeypatch):
    assert calibrated(monkeypatch, fit_of(np.ones((3, 3)))).problems == []


@pytest.mark.parametrize("fit, problem", [
    (fit_of(np.ones((2, 3))), "the drives support only 2 values at 3 velocities, less than 3 each"),
    (fit_of(np.ones((3, 3)), held_out_mps2=0.7), "it misses what was held out by 0.70 m/s² RMS"),
], ids=["few_values", "poor_prediction"])
def test_map_that_is_not_good_enough_has_a_problem(monkeypatch, fit, problem):
    (found,) = calibrated(monkeypatch, fit).problems
    assert found.startswith(problem)


def test_map_that_is_mostly_the_priors_has_a_problem(monkeypatch):
    supported = np.zeros((4, 4))
    supported[:2, 0] = 1
    prior = ValueMap((-1.0, 0.0, 1.0, 2.0), (0.0, 1.0, 2.0, 3.0), [[-1.0 + row] * 4 for row in range(4)])
    (found,) = calibrated(monkeypatch, fit_of(supported), prior).problems
    assert found == "the drives tell only 12 % of the map, the rest is the prior's"


def test_drives_that_support_no_table_are_refused_with_what_they_support(monkeypatch):
    with pytest.raises(NoTable, match=r"drive\.bag support no two values at the same two velocities") as caught:
        calibrated(monkeypatch, fit_of([[1, 0], [0, 1]]))
    assert caught.value.coverage.startswith("what was driven: # enough, . not enough\n")


def test_drives_without_an_acceleration_are_refused_by_name(monkeypatch):
    def nothing(*_):
        raise NothingToFit("9 × a stop")
    monkeypatch.setattr(module.fitting, "fit", nothing)
    with pytest.raises(CarInterfaceError, match=r"^nothing in drive\.bag tells an acceleration: 9 × a stop$"):
        calibrate(RECORDED, MapAxes(), FitConfig())
