"""From position to position: around what the sonars see, and with enough of each."""
import math

import pytest

from car_interface.throttle.obstacle_stop import Mount, ObstacleConfig
from car_interface.tools.calibration.drive.area import Area
from car_interface.tools.calibration.drive.calibration_drive import CalibrationDrive
from car_interface.tools.calibration.drive.config import CalibrationDriveConfig
from car_interface.tools.calibration.drive.outlook import Outlook
from car_interface.tools.calibration.drive.pilot import LostTurns
from car_interface.tools.calibration.drive.positions import Candidate, Positions
from car_interface.tools.calibration.drive.survey import AVOIDING, BLOCKED, MEASURING, TURNING
from tools.calibration.drive.light_car import LightCar, base, offer

pytestmark = pytest.mark.once
MOUNTS = {"front_right": Mount(0.4, -0.1, -0.52), "front_middle": Mount(0.42, 0.0, 0.0),
          "front_left": Mount(0.4, 0.1, 0.52)}


def car(ranges=None, fits=True, **options):
    config = CalibrationDriveConfig(obstacles=ObstacleConfig(MOUNTS), **options)
    one = LightCar(CalibrationDrive(base(), config), fits=fits)
    one.ranges = dict.fromkeys(MOUNTS, math.inf) if ranges is None else ranges
    return one


def test_a_free_view_does_not_slow_it_and_something_at_a_distance_does():
    free, seen = car(), car()
    seen.ranges["front_middle"] = 0.5
    for one in (free, seen):
        one.run(6)
    assert free.extent_m > 0.8 and not any(step.phase in (AVOIDING, BLOCKED) for step in free.steps)
    assert max(step.speed_mps for step in seen.steps) < max(step.speed_mps for step in free.steps)


def test_a_sonar_that_is_silent_lets_it_go_nowhere():
    one = car({"front_left": math.inf, "front_middle": math.inf})
    step = one.run(2)
    assert one.extent_m < 0.05 and step.steering is None
    assert step.text == "front_right was never heard, and the car doesn't drive blind"
    one.ranges["front_right"] = math.nan
    assert one.tick().text == "front_right measures nonsense, and the car doesn't drive blind"


def test_something_right_ahead_turns_it_away_then_stops_it_with_what_it_sees_until_the_view_is_free_again():
    one = car()
    one.run(2)
    before = len(one.steps)
    one.ranges = dict.fromkeys(MOUNTS, 0.1)
    step = one.run(6)
    found = {step.target_duty for step in one.steps[before:] if step.phase == AVOIDING}
    assert found and found <= {3900, 6400}
    assert step.phase == BLOCKED and step.speed_mps == 0.0
    assert "sees 0.10 m" in step.text and "move the car to where it is free" in step.text
    one.ranges = dict.fromkeys(MOUNTS, math.inf)
    assert one.run(2).speed_mps > 0.3


@pytest.mark.parametrize("from_side, lowest_duty", [(1, 4512), (-1, 4512 - 90)],
                         ids=("as_it_comes", "past_it_and_back"))
def test_a_position_is_come_to_from_the_side_that_is_asked_for(monkeypatch, from_side, lowest_duty):
    offer(monkeypatch, Candidate(4512, 1.0, from_side))
    one = car(fits=False, radius_m=20.0)
    one.run(3, until=lambda step: step.phase == MEASURING)
    asked = [base().teleop_duty(step.steering) for step in one.steps if step.target_duty == 4512]
    assert min(asked) == pytest.approx(lowest_duty, abs=1)


@pytest.mark.parametrize("free_sign", [1, -1], ids=("left", "right"))
def test_it_turns_away_to_the_side_where_the_sonars_see_more(monkeypatch, free_sign):
    one = car(fits=False)
    one.run(60, until=lambda step: step.phase == MEASURING and abs(step.steering) < 0.5)
    monkeypatch.setattr(Outlook, "sonar_mps", lambda self, curvature_per_m, now_ns: (
        1.0 if free_sign * curvature_per_m > 0.7 else 0.1))
    before = len(one.steps)
    one.run(0.1)
    found = [step for step in one.steps[before:] if step.phase == AVOIDING]
    assert found and all(free_sign * step.steering > 0.7 for step in found)


@pytest.mark.parametrize("has_room", [True, False])
def test_a_position_is_begun_where_there_is_room_even_if_it_turns_as_little_as_its_neighbour(monkeypatch, has_room):
    offer(monkeypatch, Candidate(4512, 1.0, 0))
    monkeypatch.setattr(Positions, "least_per_m", lambda self, duty: 0.05)
    monkeypatch.setattr(Outlook, "rooms_m", lambda self, duty, curvature_per_m, speed_mps, max_m: [
        max_m if has_room or curvature_per_m != 0.05 else 0.3] * 2)
    one = car()
    one.run(0.1)
    assert (one.steps[-1].target_duty == 4512) == has_room


@pytest.mark.parametrize("need, is_measured", [(1.2, True), (0.9, False)], ids=("missing", "known"))
def test_a_turn_measures_what_is_missing_though_it_turns_less_tightly(monkeypatch, need, is_measured):
    offer(monkeypatch, Candidate(5184, 9.0, 0), Candidate(4096, need, 0))
    one = car(fits=False)
    one.run(20, until=lambda step: step.target_duty == 4096)
    phases = [step.phase for step in one.steps if step.target_duty == 4096]
    assert (phases == [TURNING]) == is_measured


def test_a_turn_at_a_position_that_is_known_goes_over_to_what_is_missing_at_once(monkeypatch):
    offer(monkeypatch, Candidate(5184, 9.0, 0), Candidate(4096, 1.2, 0))
    one = car(fits=False)
    one.run(60, until=lambda step: step.target_duty == 5184 and step.phase == MEASURING)
    one.run(60, until=lambda step: step.target_duty == 3900)
    begun_s = one.seconds
    step = one.run(60, until=lambda step: step.target_duty != 3900)
    assert step.target_duty == 4096 and (one.seconds - begun_s) * one.speed_mps < 0.9


def test_a_turn_goes_on_at_what_was_measured_without_coming_to_it_anew():
    one = car()
    first = one.run(60, until=lambda step: step.phase == MEASURING)
    begun = len(one.steps)
    one.run(60, until=lambda step: step.phase == TURNING)
    one.run(0.5)
    assert first.target_duty in (3900, 6400)
    assert {(step.phase, step.target_duty, step.steering) for step in one.steps[begun:]} == {
        (MEASURING, first.target_duty, first.steering), (TURNING, first.target_duty, first.steering)}


def test_a_person_is_asked_to_place_it_where_no_way_leads_to_the_turns_that_are_missing(monkeypatch):
    offer(monkeypatch, Candidate(3900, 5.0, 0), Candidate(6160, 1.2, 0))
    monkeypatch.setattr(Outlook, "rooms_m", lambda self, duty, curvature_per_m, speed_mps, max_m: [-5.0, -5.0])
    one = car(fits=False, radius_m=2.8)
    step = one.run(90, until=lambda step: step.phase == BLOCKED)
    assert step.speed_mps == 0.0 and step.text.startswith("right turns are missing, and no way leads to one: place the")
    assert "is about 1.2 m to its right" in step.text
    assert one.run(2).text == step.text and one.speed_mps == 0.0
    one.holds = False
    one.run(1)
    one.holds = True
    assert one.run(1).phase == TURNING


@pytest.mark.parametrize("need, has_circle", [(0.9, True), (1.2, False)], ids=("nothing_is_missing", "none_fits"))
def test_nobody_is_asked_in_vain(monkeypatch, need, has_circle):
    offer(monkeypatch, Candidate(3900, 5.0, 0), Candidate(6160, need, 0))
    monkeypatch.setattr(Outlook, "rooms_m", lambda self, duty, curvature_per_m, speed_mps, max_m: [-5.0, -5.0])
    monkeypatch.setattr(Area, "has_circle", lambda self, curvature_per_m: has_circle)
    one = car(fits=False, radius_m=2.8)
    one.run(40)  # with something missing it asks after 31 s
    assert not any(step.phase == BLOCKED for step in one.steps)


def test_what_is_held_first_after_a_pause_is_not_counted():
    one = car(fits=False)
    one.run(10)
    one.holds = False
    one.run(1)
    counted = one.drive.progress().positions
    one.holds = True
    first = one.tick().target_duty
    one.run(30, until=lambda step: step.target_duty != first)
    assert one.drive.progress().positions == counted
    one.run(15)
    assert one.drive.progress().positions > counted


LEFT, RIGHT = 0, 1
TWO_RAD = 4 * math.pi


@pytest.mark.parametrize("driven, sign, lost", [(RIGHT, -1, LEFT), (LEFT, 1, RIGHT)], ids=("right", "left"))
def test_a_turn_is_sought_after_two_to_the_other_side_only_and_lost_after_one_more(driven, sign, lost):
    one = LostTurns()
    one.update_motion(sign * (TWO_RAD - 0.1))
    assert one.drive(driven) is None
    one.update_motion(sign * 5.0)
    assert one.drive(driven) == lost and one.asked is None
    assert one.seek(lost) == 0.0
    one.update_motion(sign * TWO_RAD / 4)
    assert one.seek(lost) == pytest.approx(0.5)
    one.update_motion(sign * (TWO_RAD / 4 + 0.01))
    assert one.seek(lost) == pytest.approx(1.0, abs=0.01) and one.asked == lost


def test_a_lost_turn_is_found_by_a_tight_one_to_that_side_only_and_sought_again_after_two_more():
    one = LostTurns()
    for _ in range(40):
        one.update_motion(-0.5)
        one.update_motion(0.3)  # on its way
    assert one.drive(RIGHT) == LEFT
    one.drive(LEFT)
    one.update_motion(-1.0)
    assert one.drive(RIGHT) is None
    one.update_motion(-TWO_RAD)
    assert one.drive(RIGHT) == LEFT and one.seek(LEFT) == 0.0
    one.update_motion(-TWO_RAD)
    assert one.seek(LEFT) > 1 and one.asked == LEFT and one.drive(RIGHT) is None
    one.update_motion(-TWO_RAD)
    assert one.drive(RIGHT) == LEFT and one.seek(LEFT) == 0.0
