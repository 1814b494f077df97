"""Groups, clock and versions, as the doctor judges them."""
from __future__ import annotations

import pytest

from car_interface.common.device_access import Membership
from car_interface.doctor.checks.computer import (
    ClockReading,
    Library,
    Need,
    check_clock,
    check_groups,
    check_versions,
)
from car_interface.doctor.checks.findings import BAD, OK, WARN

# --- groups ---

PORT, BUS, PAD = Need("dialout", "the port", BAD), Need("i2c", "the bus", BAD), Need("input", "the gamepad", WARN)


def member(process=(), user=(), existing=("dialout", "i2c", "input"), is_root=False):
    return Membership("ann", is_root, frozenset(process), frozenset(user), frozenset(existing))


def test_user_in_all_groups_is_ok():
    found, = check_groups(member(["dialout", "i2c"], ["dialout", "i2c"]), [PORT, BUS])
    assert (found.level, found.what) == (OK, "ann is in dialout, i2c")


def test_root_needs_no_group():
    found, = check_groups(member(is_root=True), [PORT, BUS])
    assert found.level == OK


def test_virtual_devices_need_no_group():
    found, = check_groups(member(), [])
    assert found.level == OK


def test_group_that_counts_from_the_next_log_in_is_told_apart():
    fine, late = check_groups(member(["i2c"], ["dialout", "i2c"]), [PORT, BUS])
    assert (fine.level, late.level) == (OK, BAD)
    assert "after this log-in" in late.what and "Log in anew" in late.remedy


def test_user_outside_a_group_is_sent_to_the_set_up():
    found, = check_groups(member(), [PORT])
    assert (found.level, found.what) == (BAD, "ann is not in dialout (the port)")
    assert "setup_hardware" in found.remedy


def test_group_that_does_not_exist_is_told_apart():
    found, = check_groups(member(existing=["dialout"]), [BUS])
    assert found.level == BAD and "there is no group i2c" in found.what and "setup_hardware" in found.remedy


def test_being_outside_is_as_bad_as_the_need_says():
    found, = check_groups(member(), [PAD])
    assert found.level == WARN


# --- clock ---


def clock(year=2026, synchronised=True, wall_s=1.0, monotonic_s=1.0, uses_sim_time=False):
    return ClockReading(year, synchronised, wall_s, monotonic_s, uses_sim_time)


@pytest.mark.parametrize(
    ("reading", "level", "words"),
    [
        (clock(), OK, "synchronised, and goes as"),
        (clock(synchronised=None), OK, "doesn't say"),
        (clock(synchronised=False), WARN, "not synchronised"),
        (clock(year=1970), BAD, "the year 1970"),
        (clock(year=2150, synchronised=False), BAD, "the year 2150"),
        (clock(wall_s=1.04), OK, "synchronised"),
        (clock(wall_s=3601.0), WARN, "jumped by +3600.00 s"),
        (clock(wall_s=-3599.0), WARN, "jumped by -3600.00 s"),
        (clock(uses_sim_time=True), WARN, "/use_sim_time"),
    ],
    ids=["fine", "unknown", "unsynchronised", "epoch", "far_future", "slewed", "stepped_on", "stepped_back",
         "simulated"],
)
def test_clock(reading, level, words):
    found, = check_clock(reading)
    assert (found.level, bool(found.remedy)) == (level, level != OK)
    assert words in found.what


def test_each_trouble_of_the_clock_is_told():
    assert len(check_clock(clock(synchronised=False, wall_s=9.0, uses_sim_time=True))) == 3


# --- versions ---


def library(version, oldest=(3, 3)):
    return Library("serial", version, oldest, "install it")


@pytest.mark.parametrize(
    ("version", "good"),
    [("3.5", True), ("3.3", True), ("3.10b1", True), ("4", True), ("", True), ("3.2.9", False), ("2", False)])
def test_version_is_compared_number_by_number(version, good):
    findings = check_versions((3, 8, 10), [library(version)])
    assert [finding.level for finding in findings] == ([OK] if good else [OK, BAD])


def test_missing_library_is_bad_and_its_cure_is_what_installs_it():
    fine, missing = check_versions((3, 11, 2), [library(None)])
    assert (fine.level, fine.what) == (OK, "Python 3.11.2")
    assert (missing.level, missing.what, missing.remedy) == (BAD, "serial can't be imported", "install it")


def test_old_python_is_bad():
    found, = check_versions((3, 7, 16), [])
    assert found.level == BAD and "Python 3.7.16" in found.what and "3.8" in found.remedy
