"""Many virtual cars: under random planners, and calibrating their own steering.

Samples; with CAR_INTERFACE_ALL 1,000 planners on 20 cars, and 20 calibration drives of 20 s each, of which
test/graph/test_calibration_drive.py has one.
"""
import os
import random

import planner_drives as planners
import pytest
from accuracy import calibration_drive as calibration
from accuracy import calibration_picture as picture

IS_ALL = bool(os.environ.get("CAR_INTERFACE_ALL"))
PLANNERS = 1000 if IS_ALL else 18


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


@pytest.mark.once
def test_moving_picture_of_a_calibration_is_drawn(tmp_path, monkeypatch):
    monkeypatch.setattr(picture, "MOVING_S", 0.3)
    recorder = picture.Recorder()
    bench = calibration.Bench(picture.SEED, recorder, person=picture.PatientPerson(random.Random(picture.SEED)))
    bench.run(max_s=12.0)
    with picture.matplotlib.rc_context():  # the picture's style is for the whole process
        picture.save(picture.images(picture.Picture(bench), recorder.moments), str(tmp_path / "made.gif"))
    with picture.Image.open(tmp_path / "made.gif") as made:
        assert (made.n_frames, made.size) == (3, (800, 430))
