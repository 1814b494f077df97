"""A short run of the noise measurement (accuracy/noise.py has the long one), and the calculation that it is held to."""
import os

import pytest
from accuracy import noise

FRAMES = 1_000_000 if os.environ.get("CAR_INTERFACE_ALL") else 20_000


@pytest.fixture(scope="module", params=noise.RATES, ids=str)
def result(request):
    return noise.measure(FRAMES, request.param)


def test_no_more_wrong_frames_get_past_than_an_8_bit_sum_must_let_past_and_none_moves_a_wheel_by_10_cm(result):
    assert result.failures() == []
    assert result.frames >= FRAMES
    assert result.made_sense <= result.summed_up <= result.lost
    assert max(result.harm_m, result.error_m) <= noise.MOST_HARM_M  # of a wheel, and what is left of it


def test_without_noise_nothing_is_lost_and_the_way_is_the_firmware_s():
    clean = noise.measure(2000, 0.0)
    assert (clean.lost, clean.summed_up, clean.harm_m, clean.error_m) == (0, 0, 0.0, 0.0)
    # The capture begins with a sonar's report: its tick alone is no proof of a reboot, what follows is.
    assert clean.refused == clean.frames // 795 - 1
