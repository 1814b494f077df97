"""Groups, clock and versions, as the doctor judges them."""
from __future__ import annotations

import pytest

from car_interface.common.device_access import Membership
from car_interface.tools.doctor.checks import computer
from car_interface.tools.doctor.checks.findings import BAD, OK, WARN

# --- groups ---

PORT, BUS = computer.Need("dialout", "the port", BAD), computer.Need("i2c", "the bus", BAD)
PAD = computer.Need("input", "the gamepad", WARN)


def member(process=(), user=(), existing=("dialout", "i2c", "input"), is_root=False):
    return Membership("ann", is_root, frozenset(process), frozenset(user), frozenset(existing))


@pytest.mark.parametrize("one, needs, level, what, remedy", [
    (member(["dialout", "i2c"], ["dialout", "i2c"]), [PORT, BUS], OK, "ann is in dialout, i2c", ""),
    (member(is_root=True), [PORT, BUS], OK, "", ""),
    (member(), [], OK, "", ""),
    (member([], ["i2c"]), [BUS], BAD, "after this log-in", "Log in anew"),
    (member(), [PORT], BAD, "ann is not in dialout (the port)", "setup_hardware"),
    (member(existing=["dialout"]), [BUS], BAD, "there is no group i2c", "setup_hardware"),
    (member(), [PAD], WARN, "ann is not in input", ""),
], ids=["in_all", "root", "virtual_devices", "from_the_next_log_in", "outside", "no_such_group", "as_bad_as_it_says"])
def test_user_is_in_the_groups_that_are_needed_or_told_why_not(one, needs, level, what, remedy):
    found, = computer.check_groups(one, needs)
    assert found.level == level and what in found.what and remedy in found.remedy


# --- clock ---

def clock(year=2026, synchronised=True, uses_sim_time=False):
    return computer.ClockReading(year, synchronised, uses_sim_time)


@pytest.mark.parametrize("reading, level, words", [
    (clock(), OK, "synchronised"),
    (clock(synchronised=None), OK, "doesn't say"),
    (clock(synchronised=False), WARN, "not synchronised"),
    (clock(year=1970), BAD, "the year 1970"),
    (clock(year=2150, synchronised=False), BAD, "the year 2150"),
    (clock(uses_sim_time=True), WARN, "/use_sim_time"),
], ids=["fine", "unknown", "unsynchronised", "epoch", "far_future", "simulated"])
def test_clock(reading, level, words):
    found, = computer.check_clock(reading)
    assert (found.level, bool(found.remedy)) == (level, level != OK)
    assert words in found.what


def test_each_trouble_of_the_clock_is_told():
    assert len(computer.check_clock(clock(synchronised=False, uses_sim_time=True))) == 2


# --- packages ---

@pytest.mark.parametrize("missing, environment, level, words", [
    ([], "", OK, ""),
    (["rosbags"], "~/car_tools/bin/car-interface", OK,
     "the tools for recordings are in ~/car_tools/bin/car-interface"),
    (["rosbags"], "", WARN, "rosbags is missing for bag_report, check_map and the calibration; driving needs none"),
    (["matplotlib", "rosbags"], "", WARN, "matplotlib, rosbags are missing for bag_report"),
], ids=["none", "in_a_virtual_environment", "one", "two"])
def test_libraries_that_the_tools_lack_are_a_warning_that_names_them(missing, environment, level, words):
    found, = computer.check_tools(missing, environment)
    assert found.level == level and found.what.startswith(words)
    assert found.remedy == ("" if level == OK else "rosdep install, or on Debian a virtual environment: "
                            "docs/recordings.md, Install the tools")


@pytest.mark.parametrize("is_installed, is_published, distribution, level, remedy", [
    (True, False, "noetic", OK, ""),
    (False, True, "debian", OK, ""),
    (False, False, "noetic", WARN, "sudo apt install ros-noetic-joy"),
    (False, False, "debian", OK, ""),
], ids=["installed", "from_another_computer", "missing_on_ubuntu", "not_needed_on_debian"])
def test_joy_is_missing_only_if_nobody_publishes_it(is_installed, is_published, distribution, level, remedy):
    found, = computer.check_joy(is_installed, is_published, distribution)
    assert found.level == level and remedy in found.remedy
    assert level == OK or found.what.startswith("the ROS package joy, whose joy_node reads the gamepad, is missing")
