"""The drive as a whole, with a car that does what it is asked for: it waits, pauses, stays inside, and ends."""
from __future__ import annotations

import math

import numpy as np
import pytest

from calibration.drive.light_car import CURVE, LightCar, S, base, offer
from car_interface.calibration.drive.area import Area, Pose, moved
from car_interface.calibration.drive.calibration_drive import CalibrationDrive
from car_interface.calibration.drive.config import DriveConfig
from car_interface.calibration.drive.positions import Candidate
from car_interface.calibration.drive.step import BLOCKED, DONE, MEASURING, PAUSED, SETTLING, TURNING, WAITING

pytestmark = pytest.mark.once


def car(**options):
    config = {name: options.pop(name) for name in ("max_time_s", "radius_m") if name in options}
    return LightCar(CalibrationDrive(base(), DriveConfig(**config)), **options)


def test_without_inputs_it_waits_and_says_for_what():
    drive = CalibrationDrive(base())
    assert drive.step(S).phase == WAITING and "odom was never heard" in drive.step(S).text
    drive.update_odometry(0.0, 0.0, 0.0, 0.0, S, S)
    assert "/servo/output was never heard" in drive.step(S).text


def test_without_the_button_it_asks_for_nothing_and_quotes_the_reason():
    one = car()
    one.holds = False
    step = one.tick()
    assert (step.phase, step.steering, step.speed_mps) == (WAITING, None, 0.0)
    assert step.text == "human_in_loop is false; hold the autonomous deadman and it begins"
    assert one.drive.start is None


def test_the_area_is_around_the_cars_middle_where_it_began():
    one = car()
    one.tick()
    assert one.drive.start == pytest.approx((0.142, 0.0))


def test_the_first_positions_are_both_ends_and_the_center():
    one = car()
    one.run(100)
    held = {step.target_duty for step in one.steps if step.phase in (MEASURING, TURNING)}
    assert {3900, 6400, 5184} <= held


def test_letting_go_pauses_at_once_and_holding_goes_on():
    one = car()
    one.run(10)
    one.holds = False
    step = one.tick()
    assert (step.phase, step.steering, step.speed_mps) == (PAUSED, None, 0.0)
    assert step.text == "human_in_loop is false; hold the autonomous deadman and it goes on"
    driven_s, samples, start = one.drive.driven_s, len(one.drive.samples), one.drive.start
    one.run(5)
    assert one.drive.driven_s == driven_s and one.drive.start == start
    assert len(one.drive.samples) <= samples + 1, "a car that is pushed shows nothing about its steering"
    one.holds = True
    assert one.run(2).phase in (SETTLING, MEASURING, TURNING)


@pytest.mark.parametrize("silent", ["odom", "/servo/output", "the arbiters' state"])
def test_an_input_that_falls_silent_pauses(silent):
    one = car()
    one.run(5)
    at_ns = one.now_ns
    for _ in range(1, 50):
        at_ns += 20_000_000
        if silent != "odom":
            one.drive.update_odometry(*one.pose, 0.0, at_ns, at_ns)
        if silent != "/servo/output":
            one.drive.update_duty(5184, at_ns)
        if silent != "the arbiters' state":
            one.drive.update_grant(True, "", at_ns)
        step = one.drive.step(at_ns)
    assert step.steering is None and step.phase == PAUSED and step.text.startswith(f"{silent} silent for")


def test_it_stays_within_the_area_and_ends_with_enough_or_after_its_time():
    one = car(max_time_s=100.0)
    step = one.run(120, until=lambda step: step.phase == DONE)
    assert step.phase == DONE and one.seconds <= 101
    assert one.extent_m < 3.0
    assert one.drive.progress(one.now_ns).positions > 20
    progress = one.drive.progress(one.now_ns)
    assert progress.center_duty == pytest.approx(5200, abs=20) and progress.left_s == 0.0
    assert len([row for row in progress.rows if row.is_known]) > len(progress.rows) / 2


def test_some_of_the_area_is_kept_for_what_is_not_known():
    one, middle, farthest_m = car(radius_m=2.5), (0.142, 0.0), 0.0
    for _ in range(50 * 60):
        one.tick()
        farthest_m = max(farthest_m, Area(middle, 2.5).extent_m(one.pose))
    assert 2.2 < farthest_m < 2.44, "of a car that does exactly what is expected"


def test_whenever_the_button_is_let_go_a_car_that_only_coasts_stops_inside():
    coasts_mps2 = 0.15
    one, area, farthest_m = car(slows_mps2=coasts_mps2), Area((0.142, 0.0), 3.0), 0.0
    for _ in range(50 * 100):
        one.tick()
        stop_m = 0.25 * one.speed_mps + one.speed_mps ** 2 / (2 * coasts_mps2)
        farthest_m = max(farthest_m, area.extent_m(moved(one.pose, stop_m, 0.0)))
    assert 2.8 < farthest_m < 3.0


def let_go(one, mps2, yaw_rad):
    """It is carried to the middle and driven in a direction; then the button is let go until it stands."""
    one.holds = False
    one.run(0.5)
    one.pose, one.speed_mps = Pose(0.0, 0.0, yaw_rad), 0.8
    one.run(0.5)
    one.holds, one.pose, one.speed_mps = True, Pose(0.0, 0.0, yaw_rad), 0.8
    for _ in range(3):
        one.tick(speed_mps=0.8)
    one.holds = False
    while one.speed_mps > 0:
        one.tick(speed_mps=max(0.0, one.speed_mps - 0.02 * mps2))
    one.run(0.2)


@pytest.mark.parametrize(("seen_mps2", "faster"), [(0.1, -1), (0.8, 1)])
def test_by_how_it_was_seen_to_stop_it_is_slower_or_faster_from_then_on(monkeypatch, seen_mps2, faster):
    offer(monkeypatch, Candidate(5184, 1.0, 0))  # all do the same
    speeds = []
    for mps2 in (0.2, seen_mps2):
        one = car()
        one.run(1)
        for yaw_rad in (0.0, 1.5, 3.0, 4.5):
            let_go(one, mps2, yaw_rad)
        one.pose, one.holds, before = Pose(0.0, 0.0, 0.0), True, len(one.steps)
        one.run(15)
        speeds.append(np.mean([step.speed_mps for step in one.steps[before:]]))
    assert faster * (speeds[1] - speeds[0]) > 0.03


def test_while_it_does_not_stop_by_itself_nothing_is_learned_of_how_it_stops():
    for by_itself in (False, True):
        one = car()
        one.run(3)
        one.holds = False
        one.drive.update_stopping(by_itself)
        for _ in range(100):
            one.tick(speed_mps=0.0)
        assert (one.drive._stops.least_mps2 == math.inf) is not by_itself


@pytest.mark.parametrize("radius_m", [2.8, 4.0])
def test_the_radius_is_a_setting(radius_m):
    one = car(radius_m=radius_m)
    one.run(40)
    assert one.extent_m < radius_m


def test_a_car_that_turns_wide_is_told_that_it_has_no_room():
    one = car(curve=(CURVE[0], (0.35, 0.0, -0.35)))
    step = one.run(40, until=lambda step: step.phase == BLOCKED)
    assert step.phase == BLOCKED and "no room to turn: move it towards the middle" in step.text
    assert one.extent_m < 3.3


def test_a_servo_that_turns_the_other_way_ends_or_stops_inside():
    one = car(curve=(CURVE[0], (-1.0, 0.0, 0.95)))
    step = one.run(20, until=lambda step: step.phase == DONE)
    assert step.phase in (DONE, BLOCKED) and one.extent_m < 3.0


def test_a_car_that_does_not_move_is_blocked():
    one = car(accelerates_mps2=0.0)
    step = one.run(5)
    assert step.phase == BLOCKED and "it doesn't move" in step.text


def test_it_can_be_ended_by_hand():
    one = car()
    one.run(3)
    one.drive.finish()
    step = one.tick()
    assert (step.phase, step.steering) == (DONE, None) and step.text == "ended by hand after 3 s"


def test_the_expected_path_begins_at_the_car():
    one = car()
    assert one.drive.expected_path() == []
    one.run(5)
    path = one.drive.expected_path()
    assert math.dist(path[0], one.pose[:2]) < 0.1 and len(path) == 21
