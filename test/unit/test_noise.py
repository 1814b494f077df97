"""A short run of the noise measurement (accuracy/noise.py has the long one), and the calculation that it is held to."""
from __future__ import annotations

import importlib
import itertools
import os
import sys
from pathlib import Path

import pytest

sys.path.append(str(Path(__file__).resolve().parents[1]))
noise = importlib.import_module("accuracy.noise")

FRAMES = 1_000_000 if os.environ.get("CAR_INTERFACE_ALL") else 20_000


@pytest.fixture(scope="module", params=noise.RATES, ids=str)
def result(request):
    return noise.measure(FRAMES, request.param)


def test_no_more_wrong_frames_get_past_than_an_8_bit_sum_must_let_past(result):
    assert result.failures() == []
    assert result.frames >= FRAMES
    assert result.made_sense <= result.summed_up <= result.lost


def test_no_wrong_frame_moves_a_wheel_by_10_cm_and_nothing_is_left_of_it(result):
    assert result.harm_m <= noise.MOST_HARM_M
    assert result.error_m <= noise.MOST_HARM_M


def test_without_noise_nothing_is_lost_and_the_way_is_the_firmware_s():
    clean = noise.measure(2000, 0.0)
    assert (clean.lost, clean.summed_up, clean.harm_m, clean.error_m, clean.ungated_m) == (0, 0, 0.0, 0.0, 0.0)
    # The capture begins with a sonar's report: its tick alone is no proof of a reboot, what follows is.
    assert clean.refused == clean.frames // 795 - 1


def test_noise_that_gets_past_is_told_and_without_gates_the_way_is_lost():
    noisy = noise.measure(FRAMES, 1e-3)
    assert noisy.made_sense > 0 and noisy.ungated_m > 10
    noisy.must_sum_up = noisy.must_make_sense = 0.0
    noisy.summed_up, noisy.made_sense, noisy.harm_m, noisy.adds_up = 100, 100, 0.2, False
    assert [failure.split()[-1] for failure in noisy.failures()] == ["must", "must", "cm", "up"]


def sums_up(data):
    return int.from_bytes(data, "little") % 255 == 0


@pytest.mark.parametrize("wire", [bytes.fromhex(text) for text in ("0102060000050000f1", "c13e", "ff00ff00")])
def test_calculation_is_what_counting_all_flips_of_a_short_frame_gives(wire):
    for rate in (1e-3, 0.1):
        size = 8 * len(wire)
        most_flips = 3 if size > 32 else 5
        counted = 0.0
        for flips in range(1, most_flips + 1):
            for places in itertools.combinations(range(size), flips):
                changed = bytearray(wire)
                for place in places:
                    changed[place >> 3] ^= 1 << (place & 7)
                counted += sums_up(changed) * rate ** flips * (1 - rate) ** (size - flips)
        assert sums_up(wire)
        if rate < 0.01:
            assert noise.passing(wire, rate) == pytest.approx(counted, rel=0.02)
        else:
            assert noise.passing(wire, rate) >= counted
