"""What could be held next, and what that is worth from here."""
from __future__ import annotations

import pytest

from calibration.drive.light_car import base
from car_interface.calibration.drive.area import Area, Pose
from car_interface.calibration.drive.choices import Choices, wanted_length_m
from car_interface.calibration.drive.config import DriveConfig
from car_interface.calibration.drive.motion import Motion
from car_interface.calibration.drive.outlook import Outlook
from car_interface.calibration.drive.positions import Candidate, Positions
from car_interface.calibration.drive.survey import Survey

START = Pose(0.0, 0.0, 0.0)


def choices(pose=START):
    """Those of a car at a pose that held nothing yet."""
    motion, survey = Motion(), Survey(base(), 300.0)
    motion.update(pose, 0.8, 0)
    return Choices(base(), survey, Outlook(base(), DriveConfig(), survey, motion, Area((0.0, 0.0), 2.88), None))


def offer(monkeypatch, *duties):
    monkeypatch.setattr(Positions, "candidates", lambda self, accepts=lambda duty: True: [
        Candidate(duty, 1.0, 0) for duty in duties if accepts(duty)])


def test_what_a_tight_turn_would_show_is_the_greatest_need_on_the_way_to_its_end(monkeypatch):
    monkeypatch.setattr(Positions, "candidates", lambda self, accepts=lambda duty: True: [
        candidate for candidate in (Candidate(5184, 4.0, 0), Candidate(4032, 0.9, 0), Candidate(6400, 0.2, 0))
        if accepts(candidate.duty)])
    assert choices().turns_needs() == [0.9, 0.2]


@pytest.mark.parametrize("duty, room_m, is_enough", [(3900, 0.65, True), (3900, 0.55, False), (5184, 0.85, False)],
                         ids=("bend", "too_short_a_bend", "straight_on"))
def test_a_bend_is_worth_a_shorter_way(monkeypatch, duty, room_m, is_enough):
    offer(monkeypatch, duty)
    one = choices()
    monkeypatch.setattr(Outlook, "room_m", lambda self, duty, curvature_per_m, speed_mps, max_m: (
        max_m - wanted_length_m(curvature_per_m) + room_m))  # what it takes until it is settled, and that
    choice, = one.all(0)
    assert (choice.score > 0) == is_enough


def test_what_can_not_be_the_best_any_more_is_not_looked_at(monkeypatch):
    monkeypatch.setattr(Positions, "candidates", lambda self, accepts=lambda duty: True: [
        Candidate(5184, 0.1, 0), Candidate(5200, 4.0, 0)])
    monkeypatch.setattr(Outlook, "room_m", lambda self, duty, curvature_per_m, speed_mps, max_m: max_m)
    assert [choice.hold.duty for choice in choices().all(0)] == [5200]


@pytest.mark.parametrize("curvature, length_m", [(0.0, 2.2), (0.05, 2.2), (-1.0, 0.9)])
def test_wide_turns_are_measured_for_longer_than_tight_ones(curvature, length_m):
    assert wanted_length_m(curvature) == pytest.approx(length_m)
