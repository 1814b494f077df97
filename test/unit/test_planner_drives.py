"""Random planners on random cars: none tips over while the limits are on, and many do without them.

A sample; with CAR_INTERFACE_ALL 1,000 planners, each on one of 20 cars.
"""
from __future__ import annotations

import importlib
import os
import sys
from pathlib import Path

import pytest

sys.path.append(str(Path(__file__).resolve().parents[1]))
drives = importlib.import_module("planner_drives")

PLANNERS = 1000 if os.environ.get("CAR_INTERFACE_ALL") else 30


@pytest.mark.once
def test_no_car_tips_over():
    results = [drives.run_planner(planner) for planner in range(PLANNERS)]
    assert [result for result in results if result.rollovers] == []
    assert sum(result.turn_cuts for result in results) > len(results), "the planners are too tame"
    assert max(result.max_speed_mps for result in results) > 6


@pytest.mark.once
def test_without_limits_many_do():
    results = [drives.run(planner, car, limited=False) for planner, car in zip(range(20), range(20))]
    assert sum(result.rollovers > 0 for result in results) >= 5
