"""Virtual cars that calibrate their own steering: they stay inside, hit nothing, and write a table that holds.

A sample, a car in a room; with CAR_INTERFACE_ALL twenty cars. All have to write, within what is asked of a person's
drive: see docs/calibrate.md.
"""
from __future__ import annotations

import importlib
import os
import sys
from pathlib import Path

import pytest

sys.path.append(str(Path(__file__).resolve().parents[1]))
drives = importlib.import_module("accuracy.calibration_drive")

SEEDS = range(20) if os.environ.get("CAR_INTERFACE_ALL") else (5,)


@pytest.mark.once
@pytest.mark.parametrize("seed", SEEDS)
def test_a_car_calibrates_itself(seed):
    result, errors = drives.judge(seed)
    assert result.held_s <= 300.1 and result.max_m <= drives.HALF_M and result.collisions == 0
    assert errors is not None, result.conclusion.refusal
    assert drives.is_good(result, errors), drives.row(result, errors)
