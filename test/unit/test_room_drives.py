"""Cars that drive blindly in random rooms with obstacle_stop: none runs fast into what its sonars see on its arc.

A sample; with CAR_INTERFACE_ALL 1,000 rooms.
"""
from __future__ import annotations

import importlib
import os
import sys
from pathlib import Path

import pytest

sys.path.append(str(Path(__file__).resolve().parents[1]))
rooms = importlib.import_module("room_drives")

ROOMS = 1000 if os.environ.get("CAR_INTERFACE_ALL") else 25


@pytest.mark.once
def test_no_car_runs_fast_into_what_it_sees():
    results = [rooms.run(seed) for seed in range(ROOMS)]
    fast = [result for result in results if result.speed_mps > rooms.FAST_MPS]
    assert [result for result in fast if result.was_seen] == []
    assert len(fast) < ROOMS / 10, "what comes into the way sideways is rare"
    assert sum(result.distance_m for result in results) > 2 * ROOMS, "they hardly drive"


@pytest.mark.once
def test_without_it_all_do():
    results = [rooms.run(seed, stops=False) for seed in range(10)]
    assert sum(result.speed_mps > rooms.FAST_MPS for result in results) >= 8
