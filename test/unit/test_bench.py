"""The benchmark's arithmetic, table and JSON (test/bench has the measurements; nothing is timed here)."""
from __future__ import annotations

import importlib
import os
import subprocess
import sys
from pathlib import Path

import pytest

sys.path.append(str(Path(__file__).resolve().parents[1]))
rows = importlib.import_module("bench.rows")
meters = importlib.import_module("bench.meters")
capture = importlib.import_module("bench.capture")
Row, Summary, Target = rows.Row, rows.Summary, rows.Target


SHOWN = (Target(),)


def row(values=(1.0,), targets=SHOWN, **others):
    return Row("group", "thing", "ms", Summary.of(values), targets, **others)


@pytest.mark.parametrize("target, value, met", [
    (Target(high=2.0), 2.0, True),
    (Target(high=2.0), 2.1, False),
    (Target(low=25.0), 24.9, False),
    (Target(low=25.0), 50.0, True),
    (Target(low=99.95, high=100.05), 99.9, False),
    (Target(low=99.95, high=100.05), 100.06, False),
    (Target(high=0.0), 0.0, True),
    (Target(high=0.0), 1.0, False),
], ids=str)
def test_target_judges_its_bounds(target, value, met):
    assert target.met_by(value) is met


@pytest.mark.parametrize("target, value, floor, met", [
    (Target(max_ratio=1.3), 1.3, 1.0, True),
    (Target(max_ratio=1.3), 1.31, 1.0, False),
    (Target(max_ratio=1.3), 0.2, 1.0, True),
    (Target(max_ratio=1.3), 13.0, 10.0, True),  # whatever the machine's speed
    (Target(max_ratio=1.3), 0.1, 0.0, False),  # of nothing there is no ratio
    (Target(max_ratio=1.3), 0.0, 0.0, True),
    (Target(max_ratio=1.3), 0.1, None, False),
    (Target(high=2.0, max_ratio=1.3), 1.0, 0.5, False),
    (Target(high=2.0, max_ratio=1.3), 2.1, 2.0, False),
    (Target(high=2.0, max_ratio=1.3), 1.0, 1.0, True),
], ids=str)
def test_target_judges_the_ratio_to_bare_rospy(target, value, floor, met):
    assert target.met_by(value, floor) is met


def test_summary_is_by_nearest_rank_and_its_bad_end_is_the_low_one_where_more_is_better():
    assert Summary.of(range(100, 0, -1)) == Summary(100, 50, 99, 100)
    assert Summary.of([1, 2, 3, 40]).p99 == 40
    assert Summary.of(range(1, 101), more_is_better=True) == Summary(100, 51, 2, 1)


def test_row_judges_each_statistic_by_itself():
    measured = row([1.0] * 98 + [5.0, 9.0], (Target("median", high=2.0), Target("p99", high=4.0), Target("max")))
    assert measured.missed() == ("p99 5 ms",)
    assert [cells[4] for cells in measured.lines()] == ["yes", "no", ""]


def test_row_that_is_void_meets_nothing_however_good():
    measured = row([0.1], (Target(high=2.0),), void="frames were lost")
    assert measured.missed() == ("0.100 ms",)
    assert measured.as_json()["targets"][0]["met"] is False


def test_row_that_was_not_measured_meets_nothing():
    missing = Row("group", "thing", "ms", None, (Target(high=2.0),), note="there is none")
    assert missing.missed() == ("not measured",)
    assert "not measured" in missing.lines()[0]
    assert missing.as_json()["figure"] is None


def test_verdict_counts_bounds_and_names_what_is_missed_and_by_how_much():
    good, bad = row([1.0], (Target(high=2.0), Target("max"))), row([3.25], (Target(high=2.0),))
    slower = Row("group", "slower", "ms", Summary.of([3.0, 3.0]), (Target(max_ratio=1.3),), Summary.of([2.0, 2.0]))
    assert rows.verdict([good, bad, slower]) == (
        "1 of 3 targets met; missed: thing (3.25 ms); slower (median 1.50 ×)")
    assert rows.verdict([good]) == "1 of 1 targets met"


def test_verdict_tells_apart_what_bare_rospy_misses_too():
    targets = (Target(high=2.0), Target("p99", high=5.0))
    slow = Row("thing", "slow", "ms", Summary.of([6.5]), targets, Summary.of([3.0]))
    assert (slow.missed(by_floor=True), slow.missed(by_floor=False)) == (("median 6.50 ms",), ("p99 6.50 ms",))
    assert rows.verdict([slow, row([1.0], (Target(high=2.0),))]) == (
        "1 of 3 targets met; missed: slow (p99 6.50 ms); missed by bare rospy as well: slow (median 6.50 ms)")


@pytest.fixture
def sleeper():
    """Start programs that sleep, with an argument each."""
    processes = []

    def start(argument):
        process = subprocess.Popen([sys.executable, "-c", "print(flush=True); import time; time.sleep(60)", argument],
                                   stdout=subprocess.PIPE)
        processes.append(process)
        process.stdout.readline()  # Popen may return before /proc has the command line
        return process.pid
    yield start
    for process in processes:
        process.kill()
        process.communicate()


def test_the_guard_counts_with_its_node_and_the_virtual_chip_does_not(sleeper):
    sleeper("car_interface.sim.chip_server")
    guard = sleeper("car_interface.ros.pca9685_guard")
    assert meters.with_guard(os.getpid()) == [os.getpid(), guard]
    assert meters.with_guard(guard) == [guard]


def test_captured_frames_are_whole_and_of_the_commands_that_were_asked_for():
    frames = list(capture.captured(capture.WHEELS, capture.SONAR))
    assert {(frame[:1], frame[-1:]) for frame in frames} == {(b"~", b"~")}
    assert {frame[3] for frame in frames} == {capture.WHEELS, capture.SONAR}
    assert len(frames) == sum(len(list(capture.captured(command))) for command in (capture.WHEELS, capture.SONAR)) > 100
