"""The running car: nodes, parameters, steering and reports, as the doctor judges them."""
from __future__ import annotations

import pytest

from car_interface.doctor.checks.car import (
    NODE_ROLES,
    Node,
    Reading,
    Report,
    Steering,
    check_diagnostics,
    check_nodes,
    check_parameters,
    check_steering,
)
from car_interface.doctor.checks.findings import BAD, OK, WARN

# --- nodes ---


def nodes(silent=(), missing=(), namespace=""):
    return [Node(name, f"{namespace}/{name}", name not in missing, name not in (*silent, *missing))
            for name in (*NODE_ROLES, "car_sim")]


def test_nodes_that_all_answer_are_ok():
    found, = check_nodes(nodes(), "/")
    assert found.level == OK and "turn_arb, pca9685" in found.what


def test_no_node_at_all_is_how_it_is_before_the_launch():
    found, = check_nodes(nodes(missing=(*NODE_ROLES, "car_sim")), "/car1")
    assert (found.level, found.what) == (OK, "none of this package's runs in /car1")


def test_missing_node_is_a_warning_that_says_what_is_missing_with_it():
    _, found = check_nodes(nodes(missing=["turn_arb", "teleop_logi"]), "/")
    assert found.level == WARN
    assert "turn_arb (nobody steers), teleop_logi (no gamepad, no deadman)" in found.what


def test_car_without_simulator_misses_nothing():
    assert [found.level for found in check_nodes(nodes(missing=["car_sim"]), "/")] == [OK]


def test_registered_node_that_does_not_answer_is_bad():
    _, found = check_nodes(nodes(silent=["pca9685"], namespace="/car1"), "/car1")
    assert found.level == BAD and "/car1/pca9685 is registered, but doesn't answer" in found.what


def test_nodes_of_which_none_answers_are_told_one_by_one():
    assert [found.level for found in check_nodes(nodes(silent=(*NODE_ROLES, "car_sim")), "/")] == [BAD] * 6


# --- steering ---


def test_who_drives_and_why_is_told():
    found, = check_steering(Steering("PLANNER", "the planner asks", 4000, True), "/turn_arb")
    assert (found.level, found.what) == (OK, "PLANNER: the planner asks; duty 4000")


@pytest.mark.parametrize("steering", [None, Steering("PLANNER", "the planner asks", 4000, False)],
                         ids=["silent", "latched_by_a_node_that_hangs_now"])
def test_turn_arb_that_says_nothing_is_bad(steering):
    found, = check_steering(steering, "/turn_arb")
    assert found.level == BAD and "/turn_arb" in found.what and found.remedy


# --- reports ---

STEERING = Report("turn_arb: steering", OK, "NEUTRAL: nobody steers")
BOARD = Report("pca9685: servo board", BAD, "nothing answers. Check power")
RAIL = Report("pca9685: supply", WARN, "5 V rail is low")
STALE = Report("pca9685: servo board", 3, "stale")
OTHER = Report("car1/pca9685: servo board", BAD, "nothing answers")


@pytest.mark.parametrize(
    ("reports", "namespace", "reporting", "told", "levels"),
    [
        ([STEERING], "/", ["/turn_arb"], [], [OK]),
        ([STEERING, BOARD], "/", ["/turn_arb", "/pca9685"], [], [OK, BAD]),
        ([STEERING, STALE], "/", ["/turn_arb", "/pca9685"], [], [OK, BAD]),
        ([STEERING, BOARD], "/", ["/turn_arb", "/pca9685"], [BOARD.name], [OK]),
        ([STEERING, BOARD, RAIL], "/", ["/turn_arb", "/pca9685"], [BOARD.name], [OK, WARN]),
        ([STEERING, OTHER], "/", ["/turn_arb"], [], [OK]),
        ([STEERING, OTHER], "/car1", ["/car1/pca9685"], [], [BAD]),
        ([STEERING], "/", ["/turn_arb", "/pca9685"], [], [OK, BAD]),
        ([], "/", ["/turn_arb"], [], [BAD]),
    ],
    ids=["good", "bad", "stale", "told_elsewhere", "another_of_the_same_node", "another_cars", "own_namespace",
         "one_silent", "all_silent"],
)
def test_reports(reports, namespace, reporting, told, levels):
    assert [found.level for found in check_diagnostics(reports, namespace, reporting, told)] == levels


def test_complaint_is_told_in_the_nodes_own_words():
    found, = check_diagnostics([BOARD], "/", ["/pca9685"])
    assert found.what == "pca9685: servo board: nothing answers. Check power" and "rostopic echo" in found.remedy


# --- parameters ---


def test_good_parameters_are_one_line():
    found, = check_parameters([Reading("/turn_arb", "", True), Reading("/pca9685", "", False)])
    assert (found.level, found.what) == (OK, "those of /turn_arb, /pca9685 are good")


def test_no_parameters_is_how_it_is_before_the_launch():
    found, = check_parameters([])
    assert found.level == OK


@pytest.mark.parametrize(("runs", "words"), [(True, "it will not start again"), (False, "it can't start")])
def test_bad_parameter_is_told_in_the_nodes_own_words(runs, words):
    good, found = check_parameters([Reading("/pca9685", "", True), Reading("/turn_arb", "servo_left is 99999", runs)])
    assert (good.level, found.level) == (OK, BAD)
    assert words in found.what and "servo_left is 99999" in found.what
