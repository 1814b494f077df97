"""Virtual cars that calibrate their own steering: they stay inside, hit nothing, and write a table that holds.

Twenty cars with CAR_INTERFACE_ALL, 20 s each; otherwise the one of test/graph/test_calibration_drive.py is the
sample. All have to write, within what is asked of a person's drive: see docs/calibrate.md.
"""
from __future__ import annotations

import importlib
import os
import sys
from pathlib import Path

import pytest

sys.path.append(str(Path(__file__).resolve().parents[1]))
drives = importlib.import_module("accuracy.calibration_drive")


@pytest.mark.parametrize("seed", range(20) if os.environ.get("CAR_INTERFACE_ALL") else ())
def test_a_car_calibrates_itself(seed):
    result, errors = drives.judge(seed)
    assert result.held_s <= 300.1 and result.max_m <= drives.HALF_M and result.collisions == 0
    assert errors is not None, result.conclusion.refusal
    assert drives.is_good(result, errors), drives.row(result, errors)
