"""Who drove and why, and which channel is the servo's."""
from __future__ import annotations

import pytest

from written_recordings import NEUTRAL, NO_HUMAN, PLANNER, TELEOP


def test_who_drove_when_and_why_is_listed_once_for_each_cause(seen):
    assert [(episode.source, round(episode.start_s, 2)) for episode in seen.steering.episodes] == [
        (NO_HUMAN, 0.0), (TELEOP, 5.0), (PLANNER, 20.0), (NEUTRAL, 40.0)]
    assert seen.steering.episodes[-1].reason == "av_turnrad_req silent for 0.50 s"
    assert seen.steering.source_s[PLANNER] == pytest.approx(20.0)


def test_servo_is_found_by_its_output_whatever_its_channel(seen):
    assert seen.steering.steering_channel == 3 and sorted(seen.steering.duties) == [2, 3]
