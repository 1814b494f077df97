"""What went wrong, when, and for how long."""
import copy
import math
import re
from types import SimpleNamespace

import pytest

from car_interface.tools.report.faults import ERROR, OK, WARN, Fault, FaultLog
from car_interface.tools.report.page import page
from written_recordings import HOSTILE


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


def test_error_in_a_nodes_log_is_a_fault_its_other_lines_are_not_and_turn_arb_s_diagnostics_are_listed_once(seen):
    assert [fault.what for fault in faults_of(seen, "pca9685")] == ["nothing answers, 25 times", HOSTILE]
    assert all("told by turn_arb/state" not in fault.what for fault in seen.faults.entries)


def test_flood_of_faults_is_kept_to_a_bound_and_counted(seen):
    flooded = copy.copy(seen)
    flooded.faults = FaultLog()
    for step in range(6000):
        flooded.faults.update_condition(0.01 * step, "key", step % 2, "node", "again")
    flooded.faults.finish()
    assert len(flooded.faults.entries) == 2000 and flooded.faults.dropped == 1000
    assert "1000 more are not kept" in page(flooded, {})


def test_condition_lasts_until_it_is_ok_another_one_or_the_end_and_a_repeated_moment_has_a_count():
    log = FaultLog()
    for time_s, level, what in ((1.0, WARN, "late by 1 s"), (2.0, ERROR, "late by 2 s"), (3.0, WARN, "late by 3 s"),
                                (4.0, OK, "on time"), (5.0, WARN, "late by -1.5e-3 s"), (6.0, WARN, "gone")):
        log.update_condition(time_s, "key", level, "node", what)
    log.finish()
    assert log.entries[:2] == [Fault(1.0, ERROR, "node", "late by 1 s", 4.0),
                               Fault(5.0, WARN, "node", "late by -1.5e-3 s", 6.0)]
    assert log.entries[2].what == "gone" and math.isnan(log.entries[2].end_s)
    log = FaultLog()
    for index in range(3):
        log.add_repeated(float(index), WARN, "node", f"retry {index}")
    assert [(fault.start_s, fault.what, fault.times) for fault in log.entries] == [(0.0, "retry 0", 3)]


# --- a node's start ---

LOW = "the battery has 6.90 V after it fell below warn_below, 7 V: low until it has 7.75 V"


@pytest.mark.parametrize("present, listed", [
    pytest.param(["/diagnostics", "/rosout"], [LOW], id="once"),
    pytest.param(["/rosout"], [f"battery: {LOW}"], id="from_the_log_alone")])
def test_low_battery_that_is_reported_and_logged_is_listed_once(present, listed):
    faults = FaultLog(present)
    if "/diagnostics" in present:
        faults.on_diagnostics(1.0, SimpleNamespace(
            status=[SimpleNamespace(name="throttle_arb: battery", level=WARN, message=LOW)]))
    faults.on_log(1.0, SimpleNamespace(name="/throttle_arb", level=4, msg=f"battery: {LOW}"))
    faults.finish()
    assert [fault.what for fault in faults.entries] == listed


def reported(*reports, driven_from_s=20.0):
    """What of (time, level, text) of one key is a fault."""
    log = FaultLog()
    for time_s, level, what in reports:
        log.update_condition(time_s, "pca9685: servo board", level, "pca9685", what)
    log.finish(driven_from_s)
    return [(fault.start_s, fault.what) for fault in log.entries]


@pytest.mark.parametrize("reports", [
    [(0.2, WARN, "waiting"), (1.2, OK, "fine")],
    [(0.2, WARN, "waiting"), (1.2, WARN, "too few pings"), (6.2, OK, "fine")],
    [(12.0, WARN, "waiting"), (14.0, OK, "fine")]], ids=["warning", "one_after_the_other", "started_later"])
def test_what_a_node_reports_of_its_start_before_anybody_drives_is_no_fault(reports):
    assert reported(*reports) == []


@pytest.mark.parametrize("reports, driven_from_s", [
    ([(0.2, WARN, "cut"), (9.0, OK, "fine")], 20.0),
    ([(0.2, ERROR, "cut"), (1.2, OK, "fine")], 20.0),
    ([(0.2, WARN, "cut"), (3.2, OK, "fine")], 3.0),
    ([(0.0, OK, "fine"), (0.2, WARN, "cut"), (3.2, OK, "fine")], 20.0),
    ([(0.2, WARN, "cut")], 20.0)], ids=["too_long", "error", "while_somebody_drives", "not_the_first", "to_the_end"])
def test_first_report_is_a_fault_where_it_is_more_than_a_start(reports, driven_from_s):
    assert reported(*reports, driven_from_s=driven_from_s) == [(0.2, "cut")]
