"""When the sonars should fire mostly ahead."""
from __future__ import annotations

import pytest

from car_interface.teensy.sensing.sonar_aim import SonarAim

S = 1_000_000_000


@pytest.mark.parametrize("speeds, is_ahead", [
    ([], False), ([(0.0, 0.1)], False), ([(0.0, 0.5)], True),
    ([(0.0, 0.5), (0.9, 0.0)], True), ([(0.0, 0.5), (1.1, 0.0)], False),  # stopped just now, for a second
    ([(0.0, 0.5), (0.1, -0.2)], False), ([(5.0, -0.2), (5.1, 0.05)], False),  # reverses
])
def test_it_follows_the_speed(speeds, is_ahead):
    aim = SonarAim()
    for at_s, speed_mps in speeds:
        aim.update(speed_mps, round(at_s * S))
    assert aim.is_ahead == is_ahead
