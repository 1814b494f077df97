"""The running car: nodes, parameters, steering and reports, as the doctor judges them."""
import os
import time
from types import SimpleNamespace

import pytest

from car_interface.common.sources import PLANNER
from car_interface.tools.doctor.car import (
    ABSENT,
    KILLED,
    NODE_ROLES,
    RUNNING,
    SILENT,
    Node,
    Report,
    check_battery,
    check_black_box,
    check_command_topics,
    check_diagnostics,
    check_nodes,
    check_several,
    check_steering,
    find_cars,
    reports_of,
)
from car_interface.tools.doctor.findings import BAD, OK, WARN, Finding

PARTS = ("turn_arb", "pca9685", "teensy_sensor_hub", "generic_value_converter")
TURN_ARB = Node("turn_arb", "/turn_arb", RUNNING, "/car_nodes")

# --- nodes ---

def nodes(namespace="", rest=RUNNING, process="", **states):
    """Those of a car in these states, the others as ``rest`` says."""
    return [Node(name, f"{namespace}/{name}", states.get(name, rest),
                 f"{namespace}/{process}" if process and name in PARTS else f"{namespace}/{name}")
            for name in (*NODE_ROLES, "car_sim")]


def test_nodes_that_all_answer_are_ok_and_told_with_their_process():
    names = "turn_arb, pca9685, teensy_sensor_hub, generic_value_converter"
    for found, words in ((check_nodes(nodes(car_sim=ABSENT), "/"), f"{names}, teleop_logi run in /"),
                         (check_nodes(nodes(process="car_nodes", namespace="/car1"), "/car1"), (
                             f"{names}, teleop_logi, car_sim run in /car1; {names} in one process, /car1/car_nodes"))):
        assert [(one.level, one.what) for one in found] == [(OK, words)]


@pytest.mark.parametrize("others, words", [
    ([], "none of this package's runs in /car1"),
    (["/", "/car2"], "none of this package's runs in /car1; there is one in / and /car2"),
], ids=["none", "elsewhere"])
def test_no_node_at_all_is_how_it_is_before_the_launch(others, words):
    found, = check_nodes(nodes(rest=ABSENT), "/car1", others)
    assert (found.level, found.what) == (OK, words)


def test_missing_node_is_a_warning_that_says_what_is_missing_with_it_and_what_launches_it():
    _, found = check_nodes(nodes(turn_arb=ABSENT, teleop_logi=ABSENT, car_sim=ABSENT), "/")
    assert found.level == WARN
    assert "turn_arb (nobody steers), teleop_logi (no gamepad, no deadman)" in found.what
    assert "roslaunch car_interface car.launch, or" in found.remedy
    _, found = check_nodes(nodes("/car1", turn_arb=ABSENT), "/car1")
    assert "roslaunch car_interface demo.launch ns:=/car1, or" in found.remedy, "the virtual car's"


def test_registered_process_that_does_not_answer_is_told_once_for_all_its_nodes():
    found = check_nodes(nodes(process="car_nodes", **dict.fromkeys(PARTS, SILENT)), "/")
    assert [finding.level for finding in found] == [OK, BAD]
    assert found[1].what.startswith("/car_nodes is registered, but doesn't answer: it hangs, or")
    assert [one.level for one in check_nodes(nodes(rest=SILENT), "/")] == [BAD] * 6


def test_killed_nodes_are_one_finding_and_not_said_to_hang():
    _, found = check_nodes(nodes(pca9685=KILLED, turn_arb=KILLED), "/")
    assert found.level == BAD
    assert found.what == ("/turn_arb, /pca9685: killed or crashed; the master still lists them, but nothing answers "
                          "there")
    assert found.remedy == ("Start the launch file again: roslaunch car_interface demo.launch. To clear the list: "
                            "rosnode cleanup")


def test_cars_are_found_by_the_names_of_their_nodes_and_of_several_none_is_looked_at():
    assert find_cars(["/rosout", "/car1/turn_arb", "/car1/pca9685", "/a/b/car_nodes", "/teleop_logi", "/joy"]) == [
        "/", "/a/b", "/car1"]
    assert find_cars(["/rosout"]) == []
    found, = check_several(["/car1", "/car2"])
    assert (found.level, found.what) == (WARN, "there are 2 cars, in /car1 and /car2: none was looked at")
    assert "doctor --ns /car1" in found.remedy


# --- steering ---

STATE = SimpleNamespace(source=PLANNER, reason="the planner asks", duty=4000)


def test_who_drives_and_why_is_told():
    found, = check_steering([STATE, STATE], TURN_ARB)
    assert (found.level, found.what) == (OK, "PLANNER: the planner asks; duty 4000")


@pytest.mark.parametrize("states", [[], [STATE]],
                         ids=["silent", "latched_by_a_node_that_hangs_now"])
def test_turn_arb_that_says_nothing_is_bad(states):
    found, = check_steering(states, TURN_ARB)
    assert found.level == BAD and "/turn_arb says nothing" in found.what
    assert found.remedy == "Stop the car, then rosnode kill /car_nodes: roslaunch starts it again"


# --- reports ---

STEERING = Report("turn_arb: steering", OK, "NEUTRAL: nobody steers")
BOARD = Report("pca9685: servo board", BAD, "nothing answers. Check power")
RAIL = Report("pca9685: supply", WARN, "5 V rail is low")
STALE = Report("pca9685: servo board", 3, "stale")
OTHER = Report("car1/pca9685: servo board", BAD, "nothing answers")


@pytest.mark.parametrize("reports, namespace, reporting, told, levels", [
    ([STEERING], "/", ["/turn_arb"], [], [OK]),
    ([STEERING, BOARD], "/", ["/turn_arb", "/pca9685"], [], [OK, BAD]),
    ([STEERING, STALE], "/", ["/turn_arb", "/pca9685"], [], [OK, BAD]),
    ([STEERING, BOARD, RAIL], "/", ["/turn_arb", "/pca9685"], [BOARD.about], [OK, WARN]),
    ([STEERING, OTHER], "/", ["/turn_arb"], [], [OK]),
    ([STEERING, OTHER], "/car1", ["/car1/pca9685"], [], [BAD]),
    ([STEERING], "/", ["/turn_arb", "/pca9685"], [], [OK, BAD]),
    ([], "/", ["/turn_arb"], [], [BAD]),
], ids=["good", "bad", "stale", "another_of_the_same_node", "another_cars", "own_namespace", "one_silent",
         "all_silent"])
def test_reports(reports, namespace, reporting, told, levels):
    assert [found.level for found in check_diagnostics(reports_of(reports, namespace), reporting, told)] == levels


def test_complaint_is_told_in_the_nodes_own_words_with_its_remedy():
    found, = check_diagnostics([BOARD], ["/pca9685"])
    assert found.what == "pca9685: servo board: nothing answers. Check power" and "rostopic echo" in found.remedy
    found, = check_diagnostics([BOARD._replace(remedy="Plug it in")], ["/pca9685"])
    assert found.remedy == "Plug it in"


def test_battery_is_a_line_of_its_own_and_the_other_car_s_is_left_out():
    battery = Report("throttle_arb: battery", OK, "7.82 V")
    low = battery._replace(level=WARN, message="low", remedy="Charge it")
    assert check_battery(reports_of([battery, low._replace(name="car1/throttle_arb: battery")], "/")) == [
        (OK, "battery", "7.82 V", "", False)]
    assert check_battery([low]) == [(WARN, "battery", "low", "Charge it", False)]
    assert not [one for one in check_diagnostics([low], []) if "battery" in one.what]


# --- command topics ---

TOPICS = Report("turn_arb: command topics", OK, "each has the publishers that it should have")
WRONG = Report("turn_arb: command topics", BAD, "/planner on car publishes std_msgs/Float64 on /av", "Have /planner")
SECOND = Report("turn_arb: command topics", WARN, "2 nodes publish on /human", "End all but one")


@pytest.mark.parametrize("reports, findings", [
    ([TOPICS, TOPICS._replace(name="pca9685: command topics"), STEERING], [(OK, "")]),
    ([STEERING], []),
    ([WRONG], [(BAD, f"{WRONG.message} (reported by turn_arb)")]),
    ([SECOND, SECOND._replace(name="generic_value_converter: command topics")],
     [(BAD, "2 nodes publish on /human (reported by turn_arb, generic_value_converter)")]),
    ([WRONG._replace(name="car1/turn_arb: command topics")], []),
], ids=["in_order", "no_report", "wrong_type", "reported_by_several_nodes", "another_cars"])
def test_faults_of_command_topics_are_bad_each_told_once_and_not_with_the_other_reports(reports, findings):
    found = check_command_topics(reports_of(reports, "/"))
    assert [(one.subject, one.level) for one in found] == [("topics", level) for level, _ in findings]
    for one, (level, what) in zip(found, findings):
        assert level == OK or (one.what, one.remedy) == (what, reports[0].remedy)
    assert [one.level for one in check_diagnostics(reports_of([STEERING, *reports], "/"), ["/turn_arb"])] == [OK]


# --- black box ---

def test_newest_recording_of_the_black_box_is_named_with_its_cause_its_age_and_the_command(tmp_path):
    path = tmp_path / "my car" / "2026-11-25_22-17-24_odometry_silent.bag"
    path.parent.mkdir()
    assert check_black_box(str(path.parent)) == []
    path.write_bytes(b"#ROSBAG")
    os.utime(path, (time.time() - 12.5 * 60,) * 2)
    assert check_black_box(str(path.parent)) == [
        Finding(OK, "black box", "the last stop that nobody asked for: odometry silent, 12 minutes ago: "
                                 f"rosrun car_interface bag_report '{path}'")]
