"""What is counted whenever the button of a calibration drive is let go for good (accuracy/releases.py)."""
from __future__ import annotations

import importlib
import sys
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[1]))
releases = importlib.import_module("accuracy.releases")
drives = importlib.import_module("accuracy.calibration_drive")


def release(extent_m=2.0, hit_mps=None, distance_m=0.5):
    return releases.Release(1.0, 0.8, distance_m, extent_m, extent_m, hit_mps, 1.5)


def test_the_line_counts_the_cars_that_left_the_circle_and_those_that_hit_a_wall():
    one = releases.Releases(2.0, 3.0)
    one.found = [release(), release(3.0), release(3.25, distance_m=1.75), release(3.1, 0.4), release(2.9, 0.125)]
    assert one.text() == ("let go 5 times: 2 leave 3 m, by 0.25 m at most (3.25 m along x or y); "
                          "2 hit a wall, at 0.40 m/s at most; rolls 1.75 m, 1.5 s at most")


def test_a_car_that_is_let_go_stops_in_a_copy_and_drives_on_by_itself():
    car = drives.Bench(5)
    while car.vehicle.speed_mps < 0.5:
        car._advance()
    at_ns, speed_mps, travel_m = car.vehicle.time_ns, car.vehicle.speed_mps, car.vehicle.travel_m
    found = car.let_go()
    assert found.speed_mps == speed_mps and 0.1 < found.distance_m < 2.0 and found.took_s < releases.ROLLS_S
    assert (car.vehicle.time_ns, car.vehicle.travel_m) == (at_ns, travel_m)
    for _ in range(100):
        car._advance()
    assert car.vehicle.speed_mps > 0.4
