"""From a fitted steering curve to turn_arb's values, and which drives are refused.

The curve is a line of 1/1200 1/m per duty: a radius of R m to the left has the duty 5200 − 1200/R.
"""
import math
from dataclasses import replace

import pytest
import yaml

from car_interface.common.errors import CarInterfaceError
from car_interface.steering.calibration import SteeringCalibration
from car_interface.tools.calibration.shared import NothingToFit
from car_interface.tools.calibration.steering import calibrate as module
from car_interface.tools.calibration.steering.calibrate import DRIVEN, END, LEFT, OLD, RIGHT, calibrate, yaml_text
from car_interface.tools.calibration.steering.fit import Side, Understeer
from tools.calibration.steering.known_curve import line_curve, recorded

BASE = SteeringCalibration(servo_left=3600, servo_center=5100, servo_right=6600, servo_channel=0,
                           radius_axis_m=(1.0, 2.0, 100.0), left_duties=(3700, 4400, 5090),
                           right_duties=(6500, 5900, 5110))
BASE_TEXT = """# The stock calibration
servo_left: 3600
servo_center: 5100  # straight on
servo_right: 6600
servo_channel: 0  # of the PCA9685
m_turnrad_axis_servo: [1, 2, 100]
k_pwmcmd_left_table_servo: [3700, 4400, 5090]
k_pwmcmd_right_table_servo: [6500, 5900, 5110]
"""
AXIS_M = (1.0, 2.0, 4.0, 100.0)


@pytest.fixture
def fits(monkeypatch):
    """The curve of each recording by its path, and of all of them together under ``None``."""
    curves = {None: line_curve()}

    def fit(drives, config):
        curves["limits"] = config.limits
        curve = curves.get(drives[0] if len(drives) == 1 else None, curves[None])
        if isinstance(curve, Exception):
            raise curve
        return curve
    monkeypatch.setattr(module.fitting, "fit", fit)
    return curves


def duties(found, side):
    return [point.duty for point in found.points[side]]


def test_duties_are_those_of_the_curve_within_the_ends_of_the_base(fits):
    found = calibrate([recorded()], BASE, AXIS_M)
    assert duties(found, LEFT) == pytest.approx([4000, 4600, 4900, 5188])
    assert duties(found, RIGHT) == pytest.approx([6400, 5800, 5500, 5212])
    assert [point.source for point in found.points[LEFT]] == [END, DRIVEN, DRIVEN, DRIVEN]
    assert (found.center, found.ends) == (5200.0, {LEFT: 4000.0, RIGHT: 6400.0})
    assert found.problems == [] and found.disagreement == ""
    assert fits["limits"] == (3600, 6600)


def test_radii_are_chosen_by_the_drives_or_continued_to_almost_straight_on(fits):
    radii_m = [point.radius_m for point in calibrate([recorded()], BASE).points[LEFT]]
    assert radii_m[0] == 1.0 and radii_m[-1] == 300.0
    assert radii_m == sorted(set(radii_m))
    asked = calibrate([recorded()], BASE, (1.0, 2.0, 20.0)).points[RIGHT]
    assert [point.radius_m for point in asked] == [1.0, 2.0, 20.0, 30.0, 50.0, 100.0, 300.0]


def test_side_that_was_not_driven_keeps_its_old_duties_and_is_a_problem(fits):
    fits[None] = line_curve(high=5200.0, right=Side(5200.0, 0.0, False, False, 5200.0))
    found = calibrate([recorded()], BASE, (1.0, 2.0, 100.0))
    assert duties(found, RIGHT) == [6500, 5900, 5200]  # 5110 would be left of the center that was found
    assert {point.source for point in found.points[RIGHT]} == {OLD}
    assert found.ends == {LEFT: 4000.0, RIGHT: 6600}
    assert duties(found, LEFT) == pytest.approx([4000, 4600, 5188])
    assert [problem.split(":")[0] for problem in found.problems] == ["no data for right turns"]


@pytest.mark.parametrize("is_stop, duty", [(False, 3600), (True, 4000.0)], ids=["limit_stays", "stop_is_the_end"])
def test_limit_that_the_wheels_stay_behind_is_kept(fits, is_stop, duty):
    # Half of the backlash is between servo and wheels: else each calibration would make the range smaller by that.
    fits[None] = line_curve(left=Side(4000.0, 1.0, is_stop, True, 4000.0))
    found = calibrate([recorded()], BASE, AXIS_M)
    assert found.ends == {LEFT: duty, RIGHT: 6400.0}
    assert found.points[LEFT][0].duty == pytest.approx(4000)


def test_limit_on_the_other_side_of_the_center_is_not_kept(fits):
    fits[None] = line_curve(left=Side(4000.0, 1.0, False, True, 4000.0))
    swapped = replace(BASE, servo_left=6600, servo_right=3600, left_duties=(6500, 5900, 5110),
                      right_duties=(3700, 4400, 5090))
    assert calibrate([recorded()], swapped, AXIS_M).ends[LEFT] == 4000.0


def test_center_that_was_not_driven_is_the_bases(fits):
    fits[None] = replace(line_curve(), center=math.nan, center_sigma=math.nan)
    found = calibrate([recorded()], BASE, AXIS_M)
    assert found.center == 5100
    assert found.problems[0].startswith("the car never went straight")


def test_axis_outside_of_what_was_driven_is_refused(fits):
    with pytest.raises(CarInterfaceError) as caught:
        calibrate([recorded()], BASE, (0.2, 0.5))
    assert str(caught.value) == ("--axis 0.2 to 0.5 m lies outside of what was driven: the tightest circle was one of "
                                 "1.00 m")


def test_drives_that_show_no_steering_are_refused_by_their_names(fits):
    fits[None] = NothingToFit("the car never moved")
    for names, named in (("ab", "a.bag, b.bag"), ("abcdef", "a.bag, b.bag, c.bag and 3 more")):
        with pytest.raises(CarInterfaceError) as caught:
            calibrate([recorded(f"/home/a/long/path/{name}.bag") for name in names], BASE)
        assert str(caught.value) == f"{named}: no steering can be told from this: the car never moved"


# --- several recordings ---

def test_recordings_before_and_after_a_change_of_the_linkage_are_refused_unless_that_is_accepted(fits):
    both = [recorded("a.bag"), recorded("b.bag")]
    fits["b.bag"] = line_curve(center=5201.0)
    assert calibrate(both, BASE, AXIS_M).disagreement == "", "of one linkage"
    fits["b.bag"] = line_curve(center=5260.0)
    with pytest.raises(CarInterfaceError, match=r"^no calibration is written: a\.bag and b\.bag disagree by 60 duty "
                                                r"about .*: was the linkage changed between them\? Give those"):
        calibrate(both, BASE, AXIS_M)
    found = calibrate(both, BASE, AXIS_M, accept_disagreement=True)
    assert found.disagreement.startswith("a.bag and b.bag disagree by 60 duty")
    assert duties(found, LEFT) == pytest.approx([4000, 4600, 4900, 5188])


def test_recording_that_shows_nothing_alone_may_still_be_used_with_others(fits):
    fits["b.bag"] = NothingToFit("too short")
    assert calibrate([recorded("a.bag"), recorded("b.bag")], BASE, AXIS_M).center == 5200.0


# --- turn_arb's file ---

def test_file_has_the_values_in_whole_duties_and_the_report_as_its_head(fits):
    text = yaml_text(calibrate([recorded()], BASE, (1.0, 3.0, 100.0)), BASE_TEXT, ["a line of the report"])
    assert yaml.safe_load(text) == {
        "servo_left": 4000, "servo_center": 5200, "servo_right": 6400, "servo_channel": 0,
        "m_turnrad_axis_servo": [1, 3, 100], "k_pwmcmd_left_table_servo": [4000, 4800, 5188],
        "k_pwmcmd_right_table_servo": [6400, 5600, 5212]}
    assert text.startswith("# Written by calibrate_steering; turn_arb loads it.")
    assert "\n# a line of the report\n" in text and "stock calibration" not in text
    assert "servo_channel: 0  # of the PCA9685\n" in text
    assert "# straight on" not in text  # it described the old value


def test_file_has_the_understeer_that_the_drives_show_and_else_that_of_the_base(fits):
    with_one = BASE_TEXT + "understeer: 0.002\n"

    def written(base_text):
        return yaml.safe_load(yaml_text(calibrate([recorded()], BASE, (1.0, 3.0, 100.0)), base_text, []))["understeer"]
    assert written(with_one) == 0.002
    fits["drives/a.bag"] = line_curve(understeer=Understeer(0.00781234, 0.0005, 40))
    assert written(BASE_TEXT) == written(with_one) == 0.00781
