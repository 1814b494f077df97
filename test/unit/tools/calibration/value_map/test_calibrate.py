"""Which fits become a map, and why one should not be written."""
import dataclasses
import math
from types import SimpleNamespace

import numpy as np
import pytest

from car_interface.throttle.value_map import ValueMap
from car_interface.tools.calibration.value_map import calibrate as module
from car_interface.tools.calibration.value_map import calibrate as tables
from car_interface.tools.calibration.value_map.calibrate import (
    MapResult,
    Table,
    calibrate,
    coverage_text,
    report,
)
from car_interface.tools.calibration.value_map.fit import Fit, Ground
from car_interface.tools.calibration.value_map.recorded import MapConfig
from tools.calibration.value_map.synthetic import fit_of

RECORDED = [SimpleNamespace(drive=None, path="drive.bag")]


def calibrated(monkeypatch, fit, prior=None):
    monkeypatch.setattr(module.fitting, "fit", lambda *_: fit)
    return calibrate(RECORDED, None, None, MapConfig(), prior)


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


def test_drives_that_support_no_table_have_none_but_what_they_support(monkeypatch):
    found = calibrated(monkeypatch, fit_of([[1, 0], [0, 1]]))
    assert found.table is None
    assert coverage_text(found.fit, None).startswith("what was driven: # enough, . not enough\n")


VALUES, VELOCITIES = np.array([-1.0, 0.0, 1.0]), np.array([0.5, 1.0, 2.0])
ACCELERATIONS = np.array([[-2.0, -2.1, -2.2], [-0.3, -0.4, -0.5], [1.0, 0.9, 0.8]])
GROUND = Ground((0.03, 0.04), 0.1, 0.02, (0.01, 0.005), math.nan)
UNKNOWN_GROUND = GROUND._replace(uphill=(math.nan, math.nan))
ALL = np.ones((3, 3), bool)


def reported_fit(supported=ALL, **changes):
    supported = np.array(supported, bool)
    made = Fit(VALUES, VELOCITIES, ACCELERATIONS, np.full((3, 3), 0.05), np.full((3, 3), 1.5),
               supported, supported, 0.08, 0.004, (GROUND,), {"counted": 40, "a stop": 9, "steep": 0}, 0.12, 0.2,
               8)
    return dataclasses.replace(made, **changes)


def table_of(origin=tables.DRIVEN, accelerations=ACCELERATIONS, values=VALUES, velocities=VELOCITIES):
    return Table(values, velocities, accelerations, np.broadcast_to(origin, accelerations.shape))


def drive_of(notes=(), path="/bags/a.bag", **changes):
    drive = SimpleNamespace(**{"pitch": None, "wheels": ("left", "right"), **changes})
    return SimpleNamespace(path=path, drive=drive, notes=notes)


def lines(recorded=None, fit=None, table=None, problems=(), prior_path=None, delay_s=None):
    config = MapConfig(topics={"value": "throttle"}, delay_s=delay_s)
    found = MapResult(table or table_of(), fit or reported_fit(), list(problems))
    return report(recorded or [drive_of()], config, found, prior_path).split("\n")


# --- what it rests on ---

def test_report_names_the_drives_how_they_were_measured_what_was_left_out_and_how_well_it_is_known():
    found = lines([drive_of(), drive_of(path="b.bag")], fit=reported_fit(grounds=(GROUND, GROUND)))
    assert found[:2] == ["A value map from a.bag, b.bag",
                         "value: throttle; accelerations by pulse times of the wheels"]
    at = found.index("windows of 0.4 s: 49, of which count 40; the others:")
    assert found[at + 1:at + 3] == ["       9  a stop", ""]
    assert "error of single windows: 0.120 m/s² RMS" in found
    assert "held out (every 5th manoeuvre, from the others): 0.200 m/s² RMS over 8 windows" in found
    errors, seconds = found.index("standard error in m/s²"), found.index("seconds of driving")
    assert found[errors + 2] == "      1.0 |  0.050  0.050  0.050"
    assert found[seconds + 2] == "      1.0 |    1.5    1.5    1.5"
    for word in ("prior:", "at 0 m/s", "not good enough"):
        assert not any(line.startswith(word) for line in found)


def test_report_names_prior_notes_problems_and_what_holds_at_standstill():
    standing = np.array([0.0, 1.0, 2.0])
    found = lines([drive_of(notes=("no pulses of the left wheel",), wheels=())], prior_path="old.csv",
                  fit=reported_fit(velocities=standing, held_out_windows=0, held_out_mps2=math.nan),
                  table=table_of(velocities=standing), problems=["too few values", "poor"])
    assert found[1].endswith("accelerations by odometry's speed")
    assert found[2:4] == ["prior: old.csv", "a.bag: no pulses of the left wheel"]
    assert any(line.startswith("at 0 m/s the map says") for line in found)
    assert not any("held out" in line for line in found)
    assert found[-3:] == ["", "not good enough: too few values", "not good enough: poor"]


@pytest.mark.parametrize("sigma_s, given_s, text", [
    (0.004, None, "80 ± 4 ms (estimated)"),
    (0.0001, None, "80 ± 1 ms (estimated)"),
    (math.nan, 0.08, "80 ms (given)"),
    (math.nan, None, "80 ms (the drives don't tell it)"),
], ids=["estimated", "at_least_1_ms", "given", "unknown"])
def test_delay_has_its_standard_error_and_where_it_is_from(sigma_s, given_s, text):
    assert f"from value to acceleration: {text}" in lines(fit=reported_fit(delay_sigma_s=sigma_s), delay_s=given_s)


def ground_line(ground, **changes):
    (found,) = [line for line in lines([drive_of(**changes)], fit=reported_fit(grounds=(ground,)))
                if line.startswith("a.bag: ")]
    return found


def test_slope_is_given_by_its_size_and_direction_or_by_what_takes_its_place():
    # √(0.03² + 0.04²) = 0.05; atan2(0.04, 0.03) = 53.1°
    assert ground_line(GROUND) == ("a.bag: ground rises by 5.00 % towards yaw 53°, taken off; drive fell by 10.0 ± "
                                   "1.0 %, brake by 2.0 ± 0.5 %: the map is that of the middle")
    assert "headings don't spread: a slope, if there is one, is in the map" in ground_line(UNKNOWN_GROUND)
    assert ("gravity taken off by pitch, less 1.00° of its mounting"
            in ground_line(GROUND._replace(pitch_offset_rad=math.radians(1.0)), pitch=object()))


# --- the map ---

def test_coverage_shows_the_origin_inside_of_the_table_and_what_is_cut_off():
    part = table_of(np.array([[tables.DRIVEN, tables.BETWEEN], [tables.OLD, tables.MOVED]]), ACCELERATIONS[:2, :2],
                    VALUES[:2], VELOCITIES[:2])
    assert [line.split("|")[-1].split() for line in coverage_text(reported_fit(), part).split("\n")[2:]] == [
        ["(#)", "(#)", "(#)"], ["o", "m", "(#)"], ["#", "+", "(#)"]]


def test_map_is_described_by_its_axes_origins_and_neutral_band():
    origin = np.array([[tables.DRIVEN] * 3, [tables.BETWEEN] * 3, [tables.OLD, tables.OLD, tables.MOVED]])
    found = lines(table=table_of(origin))
    at = found.index("the map: 3 values, -1.0 to 1.0; 3 velocities, 0.5 to 2.0 m/s")
    assert found[at + 1:at + 5] == ["  #  3 of 9 driven", "  +  3 of 9 between what was driven",
                                    "  o  2 of 9 the prior's",
                                    "  m  1 of 9 the prior's, moved so that its column rises"]
    level = ACCELERATIONS.copy()
    level[1] = level[0] + 0.001
    for accelerations, is_level in ((level, True), (ACCELERATIONS, False)):
        found = lines(table=table_of(accelerations=accelerations))
        assert any(line.startswith("from value -1.0 to 0.0 acceleration hardly changes") for line in found) is is_level
