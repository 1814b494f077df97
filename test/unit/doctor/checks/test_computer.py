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
    check_joy,
    check_tools,
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


def clock(year=2026, synchronised=True, uses_sim_time=False):
    return ClockReading(year, synchronised, uses_sim_time)


@pytest.mark.parametrize(
    ("reading", "level", "words"),
    [
        (clock(), OK, "synchronised"),
        (clock(synchronised=None), OK, "doesn't say"),
        (clock(synchronised=False), WARN, "not synchronised"),
        (clock(year=1970), BAD, "the year 1970"),
        (clock(year=2150, synchronised=False), BAD, "the year 2150"),
        (clock(uses_sim_time=True), WARN, "/use_sim_time"),
    ],
    ids=["fine", "unknown", "unsynchronised", "epoch", "far_future", "simulated"],
)
def test_clock(reading, level, words):
    found, = check_clock(reading)
    assert (found.level, bool(found.remedy)) == (level, level != OK)
    assert words in found.what


def test_each_trouble_of_the_clock_is_told():
    assert len(check_clock(clock(synchronised=False, uses_sim_time=True))) == 2


# --- versions ---


def test_versions_of_python_and_of_all_libraries_are_one_line():
    found, = check_versions("3.8.10", [Library("serial", "3.5", "install it"), Library("smbus2", "", "install it")])
    assert (found.level, found.what) == (OK, "Python 3.8.10, serial 3.5, smbus2")


def test_missing_library_is_bad_and_its_remedy_is_what_installs_it():
    fine, missing = check_versions("3.11.2", [Library("serial", None, "install it")])
    assert (fine.level, fine.what) == (OK, "Python 3.11.2")
    assert (missing.level, missing.what, missing.remedy) == (BAD, "serial can't be imported", "install it")


# --- packages ---


def test_tools_that_have_their_libraries_are_ok():
    found, = check_tools([], "")
    assert (found.level, found.subject) == (OK, "packages")


@pytest.mark.parametrize("missing, words", [
    (["rosbags"], "rosbags is missing for bag_report, check_map and the calibration; driving needs none of it"),
    (["matplotlib", "rosbags"], "matplotlib, rosbags are missing for bag_report"),
], ids=["one", "two"])
def test_libraries_that_the_tools_lack_are_a_warning_that_names_them(missing, words):
    found, = check_tools(missing, "")
    assert found.level == WARN and found.what.startswith(words)
    assert found.remedy == "rosdep install, or on Debian a virtual environment: docs/recordings.md, Install the tools"


def test_tools_in_a_virtual_environment_lack_nothing():
    found, = check_tools(["rosbags"], "~/car_tools/bin/car-interface")
    assert (found.level, found.what) == (OK, "the tools for recordings are in ~/car_tools/bin/car-interface")


@pytest.mark.parametrize("is_installed, is_published, distribution, level, remedy", [
    (True, False, "noetic", OK, ""),
    (False, True, "debian", OK, ""),
    (False, False, "noetic", WARN, "sudo apt install ros-noetic-joy"),
    (False, False, "debian", OK, ""),
], ids=["installed", "from_another_computer", "missing_on_ubuntu", "not_needed_on_debian"])
def test_joy_is_missing_only_if_nobody_publishes_it(is_installed, is_published, distribution, level, remedy):
    found, = check_joy(is_installed, is_published, distribution)
    assert found.level == level and remedy in found.remedy
    assert level == OK or found.what.startswith("the ROS package joy, whose joy_node reads the gamepad, is missing")
