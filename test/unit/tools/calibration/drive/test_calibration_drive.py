"""The drive as a whole, with a car that does what it is asked for: it waits, pauses, stays inside, and ends."""
import math

import numpy as np
import pytest

from car_interface.tools.calibration.drive.area import Area, Pose, moved
from car_interface.tools.calibration.drive.calibration_drive import CalibrationDrive
from car_interface.tools.calibration.drive.config import CalibrationDriveConfig
from car_interface.tools.calibration.drive.positions import Candidate
from car_interface.tools.calibration.drive.survey import BLOCKED, DONE, MEASURING, PAUSED, SETTLING, TURNING, WAITING
from tools.calibration.drive.light_car import CURVE, LightCar, S, base, offer

pytestmark = pytest.mark.once


def car(**options):
    config = {name: options.pop(name) for name in ("max_time_s", "radius_m") if name in options}
    return LightCar(CalibrationDrive(base(), CalibrationDriveConfig(**config)), **options)


def test_without_inputs_it_waits_and_says_for_what():
    drive = CalibrationDrive(base(), CalibrationDriveConfig())
    assert drive.step(S, "").phase == WAITING and "odom was never heard" in drive.step(S, "").text
    drive.update_odometry(0.0, 0.0, 0.0, 0.0, S, S)
    assert "/servo/output was never heard" in drive.step(S, "").text


def test_without_the_button_it_asks_for_nothing_and_quotes_the_reason_until_it_begins_or_is_ended_by_hand():
    one = car()
    one.holds = False
    step = one.tick()
    assert (step.phase, step.steering, step.speed_mps) == (WAITING, None, 0.0)
    assert step.text == "human_in_loop is false; hold the autonomous deadman and it begins"
    assert one.drive.picture() == (None, [])
    one.holds = True
    one.tick()
    assert one.drive.picture()[0] == pytest.approx((0.142, 0.0)), "the area is around the car's middle where it began"
    one.run(5)
    _, path = one.drive.picture()
    assert math.dist(path[0], one.pose[:2]) < 0.1 and len(path) == 21
    one.drive.finish()
    step = one.tick()
    assert (step.phase, step.steering, step.text) == (DONE, None, "ended by hand after 5 s")


def test_letting_go_pauses_at_once_and_holding_goes_on():
    one = car()
    one.run(10)
    one.holds = False
    step = one.tick()
    assert (step.phase, step.steering, step.speed_mps) == (PAUSED, None, 0.0)
    assert step.text == "human_in_loop is false; hold the autonomous deadman and it goes on"
    driven_s, samples, start = one.drive.driven_s, len(one.drive.samples.drive().t_s), one.drive.picture()[0]
    one.run(5)
    assert one.drive.driven_s == driven_s and one.drive.picture()[0] == start
    assert len(one.drive.samples.drive().t_s) <= samples + 1, "a car that is pushed shows nothing about its steering"
    one.holds = True
    assert one.run(2).phase in (SETTLING, MEASURING, TURNING)


@pytest.mark.parametrize("silent", ["odom", "/servo/output"])
def test_an_input_that_falls_silent_pauses(silent):
    one = car()
    one.run(2)
    at_ns = one.now_ns
    for _ in range(150):
        at_ns += 20_000_000
        if silent != "odom":
            one.drive.update_odometry(*one.pose, 0.0, at_ns, at_ns)
        if silent != "/servo/output":
            one.drive.update_duty(5184, at_ns)
        step = one.drive.step(at_ns, "")
    assert step.steering is None and step.phase == PAUSED and step.text.startswith(f"{silent} silent for")


def test_a_whole_drive_of_a_car_that_only_coasts_stays_inside_and_ends_after_its_time_with_all_known():
    coasts_mps2 = 0.15
    one, area, extents_m, stops_m = car(slows_mps2=coasts_mps2, max_time_s=100.0), Area((0.142, 0.0), 3.0), [], []
    while one.seconds < 110 and (not one.steps or one.steps[-1].phase != DONE):
        one.tick()
        stop_m = 0.25 * one.speed_mps + one.speed_mps ** 2 / (2 * coasts_mps2)
        extents_m.append(area.extent_m(one.pose))
        stops_m.append(area.extent_m(moved(one.pose, stop_m, 0.0)))
    assert 2.8 < max(stops_m) < 3.0, "whenever the button is let go"
    assert 2.7 < max(extents_m) < 2.93, "some of the area is kept for what is not known"
    progress, known = one.drive.progress(), one.drive.progress().known
    assert one.steps[-1].phase == DONE and 100 <= one.seconds <= 101 and progress.left_s == 0.0
    assert progress.positions > 20 and known.center_duty == pytest.approx(5200, abs=10) and known.missing == ()
    assert known.points and all(one.is_known for side in known.points.values() for one in side)
    held = [step.target_duty for step in one.steps if step.phase in (MEASURING, TURNING)]
    assert {3900, 6400, 5184} <= set(held), "both ends and the center"
    assert all(-1.0 <= step.steering <= 1.0 and 0.0 <= step.speed_mps <= 1.6 for step in one.steps[:-1])


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


def test_by_how_it_was_seen_to_stop_it_is_slower_from_then_on(monkeypatch):
    offer(monkeypatch, Candidate(5184, 1.0, 0))  # all do the same
    speeds_mps = []
    for mps2 in (0.1, 0.2):
        one = car(fits=False)
        one.run(1)
        for yaw_rad in (0.0, 1.5, 3.0, 4.5):
            let_go(one, mps2, yaw_rad)
        one.pose, one.holds, before = Pose(0.0, 0.0, 0.0), True, len(one.steps)
        one.run(12)
        speeds_mps.append(np.mean([step.speed_mps for step in one.steps[before:]]))
    assert np.diff(speeds_mps).min() > 0.03


def test_while_it_does_not_stop_by_itself_nothing_is_learned_of_how_it_stops():
    for by_itself in (False, True):
        one = car()
        one.run(3)
        one.holds = False
        one.drive.is_slowed = not by_itself
        for _ in range(100):
            one.tick(speed_mps=0.0)
        assert (one.drive._stops.least_mps2 == math.inf) is not by_itself


def test_the_radius_is_a_setting():
    one = car(radius_m=4.0, fits=False)
    one.run(30)
    assert 3.1 < one.extent_m < 4.0


@pytest.mark.parametrize("how, said", [
    ({"curve": (CURVE[0], (0.35, 0.0, -0.35))}, "no room to turn: move it towards the middle"),
    ({"accelerates_mps2": 0.0}, "it doesn't move")], ids=["turns_wide", "does_not_move"])
def test_a_car_that_turns_wide_or_does_not_move_is_blocked_and_told_why(how, said):
    one = car(fits=False, **how)
    step = one.run(40, until=lambda step: step.phase == BLOCKED)
    assert step.phase == BLOCKED and said in step.text
    assert one.extent_m < 3.3


def test_a_servo_that_turns_the_other_way_ends_or_stops_inside():
    one = car(curve=(CURVE[0], (-1.0, 0.0, 0.95)))
    step = one.run(20, until=lambda step: step.phase == DONE)
    assert step.phase in (DONE, BLOCKED) and one.extent_m < 3.0
