"""Many virtual cars: in random rooms, under random planners, and calibrating their own steering.

Samples; with CAR_INTERFACE_ALL 1,000 rooms, 1,000 planners on 20 cars, and 20 calibration drives of 20 s each, of which
test/graph/test_calibration_drive.py has one.
"""
from __future__ import annotations

import os

import planner_drives as planners
import pytest
import room_drives as rooms
from accuracy import calibration_drive as calibration

IS_ALL = bool(os.environ.get("CAR_INTERFACE_ALL"))
ROOMS, PLANNERS = (1000, 1000) if IS_ALL else (15, 18)


@pytest.mark.once
def test_no_car_with_obstacle_stop_runs_fast_into_what_its_sonars_see_on_its_arc_and_most_do_without():
    results = [rooms.run(seed) for seed in range(ROOMS)]
    fast = [result for result in results if result.speed_mps > rooms.FAST_MPS]
    assert [result for result in fast if result.was_seen] == []
    assert len(fast) < ROOMS / 10, "what comes into the way sideways is rare"
    assert sum(result.distance_m for result in results) > 2 * ROOMS, "they hardly drive"
    results = [rooms.run(seed, stops=False) for seed in range(5)]
    assert sum(result.speed_mps > rooms.FAST_MPS for result in results) >= 4


@pytest.mark.once
def test_no_car_tips_over_while_the_limits_are_on_and_many_do_without():
    results = [planners.run_planner(planner) for planner in range(PLANNERS)]
    assert [result for result in results if result.rollovers] == []
    assert sum(result.turn_cuts for result in results) > len(results), "the planners are too tame"
    assert max(result.max_speed_mps for result in results) > 6
    results = [planners.run(planner, car, limited=False) for planner, car in zip(range(10), range(10))]
    assert sum(result.rollovers > 0 for result in results) >= 3


@pytest.mark.parametrize("seed", range(20) if IS_ALL else ())
def test_car_that_calibrates_its_steering_stays_inside_hits_nothing_and_writes_a_table_that_holds(seed):
    """Within what is asked of a person's drive: see docs/calibrate.md."""
    result, errors = calibration.judge(seed)
    assert calibration.is_good(result, errors), calibration.row(result, errors)
