"""What went wrong, when, and for how long."""
from __future__ import annotations

import math
import re
from types import SimpleNamespace

import pytest

from car_interface.common import causes
from car_interface.report.faults import ERROR, OK, WARN, Fault, FaultLog, NodeReports, without_numbers
from car_interface.report.page import page
from car_interface.report.summary import summarize
from written_recordings import HOSTILE, Written, odometry, stamp, write_ros1


def faults_of(seen, where):
    return [fault for fault in seen.faults.entries if fault.where == where]


@pytest.mark.parametrize("where, start_s, end_s, level, what", [
    pytest.param("pca9685", 25.0, 28.0, ERROR, "nothing answers, 25 times", id="diagnostics_until_they_are_ok"),
    pytest.param("computer", 30.0, None, WARN, r"its clock was set by \+0.250 s", id="clock_that_was_set"),
    pytest.param("turn_arb", 40.0, 59.98, WARN, "av_turnrad_req silent", id="timeout"),
    pytest.param("Teensy", 50.0, 52.0, ERROR, "silent: nothing comes. look at its power", id="link"),
    pytest.param("Teensy", 52.0, None, WARN, "the Teensy started anew", id="reboot"),
])
def test_fault_has_its_time(where, start_s, end_s, level, what, seen):
    (fault,) = [fault for fault in faults_of(seen, where) if re.match(what, fault.what)]
    assert fault.start_s == pytest.approx(start_s, abs=0.01) and fault.level == level
    assert math.isnan(fault.end_s) if end_s is None else fault.end_s == pytest.approx(end_s, abs=0.01)


def test_error_in_a_nodes_log_is_a_fault_and_its_other_lines_are_not(seen):
    assert [fault.what for fault in faults_of(seen, "pca9685")] == ["nothing answers, 25 times", HOSTILE]


def test_turn_arbs_diagnostics_are_listed_once_by_its_state(seen):
    assert all("told by turn_arb/state" not in fault.what for fault in seen.faults.entries)


def test_flood_of_faults_is_kept_to_a_bound_and_counted(tmp_path):
    messages = [odometry(0.0)]
    for step in range(6000):
        messages.append(Written(0.01 * step, "/diagnostics", "diagnostic_msgs/DiagnosticArray", {
            "header": {"stamp": stamp(0.01 * step)},
            "status": [{"name": "a: b", "level": step % 2, "message": "again"}]}))
    seen = summarize(str(write_ros1(tmp_path / "a.bag", messages)))
    assert len(seen.faults.entries) == 2000 and seen.faults.dropped == 1000
    assert "1000 more are not kept" in page(seen, {})


def test_condition_lasts_until_it_is_ok_with_its_worst_level():
    log = FaultLog()
    for time_s, level, what in ((1.0, WARN, "late by 1 s"), (2.0, ERROR, "late by 2 s"), (3.0, WARN, "late by 3 s"),
                                (4.0, OK, "on time")):
        log.update_condition(time_s, "key", level, "node", what)
    log.finish()
    assert log.entries == [Fault(1.0, 4.0, ERROR, "node", "late by 1 s")]


def test_condition_with_another_text_is_another_one_and_may_last_until_the_end():
    log = FaultLog()
    log.update_condition(1.0, "key", WARN, "node", "late")
    log.update_condition(2.0, "key", WARN, "node", "gone")
    log.finish()
    assert log.entries[0] == Fault(1.0, 2.0, WARN, "node", "late")
    assert log.entries[1].what == "gone" and math.isnan(log.entries[1].end_s)


def test_repeated_moment_is_one_fault_with_a_count():
    log = FaultLog()
    for index in range(3):
        log.add_repeated(float(index), WARN, "node", f"retry {index}")
    assert [(fault.start_s, fault.what, fault.times) for fault in log.entries] == [(0.0, "retry 0", 3)]


def test_texts_are_compared_without_numbers():
    assert without_numbers("off by -1.5e-3 m, inf s") == "off by # m, # s"


def test_channel_that_timed_out_is_a_fault_of_the_board_from_then_until_it_is_commanded_again():
    faults = FaultLog()
    reason = f"{causes.CHANNEL_TIMED_OUT}: channel 0, for {{}} s; /turn_arb, which commanded it last, is gone"
    reports = NodeReports(faults, (), "rosgraph_msgs/msg/Log")
    for time_s, level, message in (
            (1.0, OK, "running at 50.03 Hz"),
            (2.0, ERROR, reason.format(0.3)), (3.0, ERROR, reason.format(1.3)), (4.0, OK, "running at 50.03 Hz")):
        status = SimpleNamespace(name="pca9685: servo board", level=level, message=message)
        reports.on_diagnostics(time_s, SimpleNamespace(status=[status]))
    faults.finish()
    fault, = faults.entries
    assert (fault.start_s, fault.end_s, fault.level, fault.where) == (2.0, 4.0, ERROR, "pca9685")
    assert fault.what.startswith("channel timed out: channel 0")
