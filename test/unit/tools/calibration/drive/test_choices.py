"""What could be held next, and what that is worth from here."""
import pytest

from car_interface.throttle.obstacle_stop import ObstacleConfig, ObstacleStop
from car_interface.tools.calibration.drive.area import Area, Pose
from car_interface.tools.calibration.drive.config import CalibrationDriveConfig
from car_interface.tools.calibration.drive.outlook import Outlook
from car_interface.tools.calibration.drive.pilot import Choices, wanted_length_m
from car_interface.tools.calibration.drive.positions import Candidate
from car_interface.tools.calibration.drive.stops import Stops
from car_interface.tools.calibration.drive.survey import Survey
from tools.calibration.drive.light_car import base, offer

START = Pose(0.0, 0.0, 0.0)


def choices(pose=START):
    """Those of a car at a pose that held nothing yet."""
    survey = Survey(base(), CalibrationDriveConfig())
    survey.motion.update(pose, 0.8, 0)
    return Choices(survey, Outlook(survey, Area((0.0, 0.0), 2.88), ObstacleStop(ObstacleConfig()), Stops()))


def give_room(monkeypatch, lengths_m):
    """So much to be measured before the turn to the left, and before that to the right."""
    monkeypatch.setattr(Outlook, "rooms_m", lambda self, duty, curvature_per_m, speed_mps, max_m: [
        min(max_m, max_m - wanted_length_m(curvature_per_m) + length_m) for length_m in lengths_m(curvature_per_m)])


def test_what_a_tight_turn_would_show_is_the_greatest_need_on_the_way_to_its_end(monkeypatch):
    offer(monkeypatch, Candidate(5184, 4.0, 0), Candidate(4032, 0.9, 0), Candidate(6400, 0.2, 0))
    assert choices().turns_needs() == [0.9, 0.2]


@pytest.mark.parametrize("duty, room_m, is_enough", [(3900, 0.65, True), (3900, 0.55, False), (5184, 0.85, False)],
                         ids=("bend", "too_short_a_bend", "straight_on"))
def test_a_bend_is_worth_a_shorter_way(monkeypatch, duty, room_m, is_enough):
    offer(monkeypatch, Candidate(duty, 1.0, 0))
    one = choices()
    give_room(monkeypatch, lambda curvature_per_m: (room_m, room_m))
    choice, = one.all(0)
    assert (choice.score > 0) == is_enough


def test_what_can_not_be_the_best_any_more_is_not_looked_at(monkeypatch):
    offer(monkeypatch, Candidate(5184, 0.1, 0), Candidate(5200, 4.0, 0))
    give_room(monkeypatch, lambda curvature_per_m: (9.0, 9.0))
    assert [choice.hold.duty for choice in choices().all(0)] == [5200]


@pytest.mark.parametrize("needs, side", [((4.0, 0.5), 0), ((0.5, 4.0), 1)], ids=("left", "right"))
def test_a_way_across_ends_with_the_turn_about_which_less_is_known(monkeypatch, needs, side):
    offer(monkeypatch, Candidate(3900, needs[0], 0), Candidate(6400, needs[1], 0), Candidate(5184, 1.0, 0))
    # That turn only stays inside for a shorter way.
    give_room(monkeypatch, lambda curvature_per_m: (0.0, 0.0) if abs(curvature_per_m) > 0.5 else (
        (1.2, 2.2) if side == 0 else (2.2, 1.2)))
    best = max(choices().all(0), key=lambda choice: choice.score)
    assert (best.hold.duty, best.length_m) == (5184, pytest.approx(1.2))


@pytest.mark.parametrize("rooms_m, is_enough", [((1.2, 1.8), True), ((0.2, 0.5), False)],
                         ids=("more_room", "no_room_for_any"))
def test_a_way_across_ends_with_the_turn_that_leaves_more_room_where_neither_is_missing(monkeypatch, rooms_m,
                                                                                        is_enough):
    offer(monkeypatch, Candidate(5184, 1.0, 0))
    give_room(monkeypatch, lambda curvature_per_m: rooms_m)
    choice, = choices().all(0)
    assert (choice.score > 0) == is_enough
    assert choice.length_m == pytest.approx(rooms_m[1])


@pytest.mark.parametrize("curvature, length_m", [(0.0, 2.2), (0.05, 2.2), (-1.0, 0.9)])
def test_wide_turns_are_measured_for_longer_than_tight_ones(curvature, length_m):
    assert wanted_length_m(curvature) == pytest.approx(length_m)
