"""Where the car goes from here, and how fast it may."""
from __future__ import annotations

import math

import pytest

from calibration.drive.light_car import S, base
from car_interface.calibration.delay import Delay
from car_interface.calibration.drive.area import Area, Pose, moved
from car_interface.calibration.drive.config import DriveConfig
from car_interface.calibration.drive.hold import Hold
from car_interface.calibration.drive.knowledge import Knowledge
from car_interface.calibration.drive.motion import Motion
from car_interface.calibration.drive.outlook import Outlook
from car_interface.calibration.drive.positions import Measured
from car_interface.calibration.drive.survey import Survey

LEFT, CENTER, RIGHT = 3900, 5184, 6400
ACROSS = Pose(-2.0, 0.0, 0.0)


def outlook(pose, speed_mps=1.0, braking_mps2=1.0, coasting_mps2=math.inf):
    """Of a car that rolls straight on and is at a pose by now."""
    motion, config = Motion(), DriveConfig(braking_mps2=braking_mps2)
    for tick in range(20):
        motion.update(moved(pose, -0.02 * speed_mps * (19 - tick), 0.0), speed_mps, tick * S // 50)
    survey = Survey(base(), 300.0)
    survey.knowledge = Knowledge(1, "", delay=Delay(0.05, 0.15, 1.0))
    one = Outlook(base(), config, survey, motion, Area((0.0, 0.0), 2.88), None)
    one.servo_duty = CENTER
    one.update_coasting(coasting_mps2)
    return one


def settled(duty):
    return Hold(duty, 0, duty, (LEFT, RIGHT), 0.1, 0.05, 0), 10 * S


def allowed_mps(one):
    hold, now_ns = settled(CENTER)
    return one.allowed_mps(hold, False, now_ns)


@pytest.mark.parametrize("coasts_mps2", [0.1, 0.2])
@pytest.mark.parametrize("x_m", [-2.0, -1.0, 0.0])
def test_when_the_button_is_let_go_it_coasts_to_a_stop_inside(x_m, coasts_mps2):
    speed_mps, text = allowed_mps(outlook(Pose(x_m, 0.0, 0.0), coasting_mps2=coasts_mps2))
    assert text == "" and speed_mps > 0.4
    assert x_m + 0.43 + 0.15 * speed_mps + speed_mps ** 2 / (2 * coasts_mps2) < 3.0


def test_a_brake_that_is_known_does_not_brake_when_the_button_is_let_go():
    weak, strong = (outlook(Pose(0.0, 0.0, 0.0), braking_mps2=braking_mps2) for braking_mps2 in (0.2, 3.0))
    assert allowed_mps(strong)[0] == allowed_mps(weak)[0] < 1.0 < strong.cruise_mps(0.0)


def test_a_car_that_was_seen_to_coast_far_is_slower():
    speeds = [allowed_mps(outlook(Pose(0.0, 0.0, 0.0), coasting_mps2=least))[0] for least in (0.1, 0.15, math.inf)]
    assert speeds == sorted(speeds) and speeds[0] < speeds[2] - 0.1


def test_tight_turns_are_slower_than_wide_ones():
    one = outlook(ACROSS)
    assert one.cruise_mps(1.0) < one.cruise_mps(0.5) < one.cruise_mps(0.0)


def test_it_has_to_turn_before_the_edge_and_not_in_the_middle():
    hold, now_ns = settled(CENTER)
    assert not outlook(Pose(-1.5, 0.0, 0.0)).is_outside_soon(hold, now_ns)
    assert outlook(Pose(1.8, 0.0, 0.0)).is_outside_soon(hold, now_ns)


def test_a_car_that_coasts_far_turns_sooner():
    hold, now_ns = settled(CENTER)
    # Along the edge the turn alone would do later.
    along = Pose(1.2, 1.85, -0.2)
    assert not outlook(along, 0.4).is_outside_soon(hold, now_ns)
    assert outlook(along, 0.4, coasting_mps2=0.1).is_outside_soon(hold, now_ns)


def test_there_is_less_room_for_a_car_that_coasts_far_and_none_beyond_the_edge():
    rooms = [outlook(ACROSS, coasting_mps2=least).room_m(CENTER, 0.0, 1.0, 10.0) for least in (0.1, math.inf)]
    assert rooms[0] <= rooms[1] < 4.4
    assert outlook(Pose(2.5, 0.0, 0.0)).room_m(CENTER, 0.0, 1.0, 10.0) < 0.5


def test_the_path_is_the_positions_while_the_servo_is_on_its_way():
    one = outlook(ACROSS)
    hold = Hold(LEFT, 0, CENTER, (LEFT, RIGHT), 0.1, 0.05, 0)
    assert one.path_per_m(None, 0) == pytest.approx(0.0, abs=1e-6)
    assert one.path_per_m(hold, 0) > 0.3
    assert one.path_per_m(hold, 10 * S) == pytest.approx(0.0, abs=1e-6), "settled: as it is measured"


def test_a_servo_that_is_at_the_other_end_turns_later():
    one = outlook(ACROSS)
    from_right, from_left = (one.turns(duty, 1.0)[0].reaction_m for duty in (RIGHT, LEFT))
    assert from_right > from_left


@pytest.mark.parametrize("half_duty, lags", [(4600, 1.0), (3916, 3.9)], ids=("smooth", "steep_at_its_end"))
def test_a_linkage_that_turns_the_wheels_within_the_last_counts_turns_later(half_duty, lags):
    one = outlook(ACROSS)
    for duty, curvature_per_m in ((LEFT, 1.0), (half_duty, 0.6), (CENTER, 0.0)):
        one._survey.add(Measured(duty, 1, 1.0, curvature_per_m))
    reaction_m = one.turns(CENTER, 1.0)[0].reaction_m
    # A servo's lag of 0.15 s: after so many of them the wheels turn half as tightly as at the end.
    assert reaction_m == pytest.approx(0.17 + 0.15 * lags, abs=0.05)


def test_without_sonars_nothing_bounds_it():
    assert outlook(ACROSS).sonar_mps(0.0, 0) == math.inf
