"""Who publishes on the topics that nodes obey: each fault is reported within 1.5 s, and logged if it lasts.

Wrong message types, second publishers, and channels of the servo board that nobody commands any more.
"""
from __future__ import annotations

import re

import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import Twist
from std_msgs.msg import Bool, Float64, Int32MultiArray

from car import Car
from car_interface.common import causes
from graph import NS_PER_S

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR
FINE = "each has the publishers that it should have"
HUMAN, VECTOR = "/teleop_logi/human_in_loop", "/servo/cmdVector"
WITHIN_S = 1.5  # the publishers are looked up once a second
LASTS_S = 5.0


def vector(channel: int, duty: int = 5100) -> Int32MultiArray:
    return Int32MultiArray(data=[duty if index == channel else -1 for index in range(16)])


@pytest.fixture
def car():
    car = Car().whole()
    car.graph.run(2.5)
    return car


def report(car, node):
    return car.graph.report(f"{node}: command topics")


WRONG = "publishes std_msgs/Float64 on /av_turnrad_req, which takes std_msgs/Float32: none of its messages is received"
EACH = "the newest message counts, so that each undoes what the other commands"
# By what is wrong: the node that reports it, what is published, and the report.
FAULTS = {
    "wrong_type": ("turn_arb", "/av_turnrad_req", Float64(2.0), ERROR, f"/rostopic_7 on 127.0.0.1 {WRONG}"),
    "second_deadman": ("turn_arb", HUMAN, Bool(False), WARN,
                       f"2 nodes publish on {HUMAN}, /rostopic_7 on 127.0.0.1 and /teleop_logi on 127.0.0.1: {EACH}"),
    "second_on_a_channel": ("pca9685", VECTOR, vector(0), WARN,
                            f"2 nodes command channel 0, /rostopic_7 on 127.0.0.1 and /turn_arb on 127.0.0.1: {EACH}")}


@pytest.mark.more
def test_planner_that_nobody_hears_is_named_with_the_launch_argument_where_one_looks_why_the_car_stands(car):
    graph = car.graph
    end = graph.repeat("/cmd_vel", Twist(), 10, sender="/move_base")
    graph.run_until(lambda: report(car, "turn_arb").level == ERROR, LASTS_S + WITHIN_S)
    found = report(car, "turn_arb")
    unheard = "/move_base publishes /cmd_vel, and nobody hears it: planner_interface doesn't run"
    remedy = "Start the launch file with planner:=cmd_vel"
    assert (found.message, found.values["remedy"], found.values["cause"]) == (unheard, remedy, causes.PLANNER_UNHEARD)
    car.pad(autonomous=True)
    graph.run_until(lambda: graph.newest("/turn_arb/state").cause == causes.NO_REQUEST, WITHIN_S)
    assert graph.newest("/turn_arb/state").reason == f"{unheard}. {remedy}"
    end()
    graph.unregister("/cmd_vel", "/move_base")
    graph.run_until(lambda: report(car, "turn_arb").message == FINE, WITHIN_S + 1.0)


@pytest.mark.parametrize("name", FAULTS)
def test_publisher_that_should_not_be_there_is_reported_with_its_remedy_until_it_goes(car, name):
    node, topic, message, level, text = FAULTS[name]
    cause, remedy = {
        ERROR: (causes.WRONG_TYPE, "Have /rostopic_7 publish std_msgs/Float32, or publish on another topic"),
        WARN: (causes.SECOND_PUBLISHER, "End all but the one that shall command: rosnode kill /rostopic_7")}[level]
    graph = car.graph
    end = graph.repeat(topic, message, 10, sender="/rostopic_7")
    graph.run_until(lambda: report(car, node).message != FINE and "unknown machine" not in report(car, node).message,
                    WITHIN_S)
    found = report(car, node)
    assert found == (level, text, found.values)
    assert (found.values["cause"], found.values["remedy"]) == (cause, remedy)
    assert "/rostopic_7 on 127.0.0.1" in found.values.get(topic, "")
    end()
    graph.unregister(topic, "/rostopic_7")
    graph.run_until(lambda: report(car, node).message == FINE, WITHIN_S + 1.0)
    assert level == ERROR or not [line for line in graph.lines() if text in line]


def test_healthy_car_has_nothing_to_report_and_two_nodes_on_two_channels_are_as_they_should_be(car):
    for node in ("turn_arb", "pca9685", "generic_value_converter", "teleop_logi", "throttle_arb"):
        assert report(car, node)[:2] == (OK, FINE)
    car.graph.repeat(VECTOR, vector(15), 10, sender="/rostopic_7")
    car.graph.run(WITHIN_S)
    found = report(car, "pca9685")
    assert found[:2] == (OK, FINE) and "/rostopic_7" in found.values[VECTOR]


@pytest.mark.once
def test_publisher_that_stays_is_an_error_after_five_seconds_and_is_logged_then_and_every_ten(car):
    began_ns = car.graph.now_ns
    car.graph.repeat("/e_stop", Bool(False), 10, sender="/rostopic_7")
    car.graph.run(19.0)
    logged_s = [(line.at_ns - began_ns) / NS_PER_S for line in car.graph.log
                if line.node == "/turn_arb" and "2 nodes publish on /e_stop" in line.text]
    assert len(logged_s) == 2 and LASTS_S < logged_s[0] < LASTS_S + 2.0 and 10 <= logged_s[1] - logged_s[0] < 11
    assert report(car, "turn_arb").level == ERROR


# --- a channel that nobody commands any more ---

def test_channel_that_nobody_commands_any_more_is_an_error_until_it_is_commanded_or_the_node_is_started_again():
    car = Car()
    car.pca9685(guard=True)
    graph, sender = car.graph, "/commander"

    def reports():
        return [graph.report(f"pca9685: {kind}") for kind in ("servo board", "command topics")]

    def assert_fine():
        assert [each.message for each in reports()] == ["running at 50.03 Hz", FINE]
    graph.hold(VECTOR, vector(3), sender=sender)
    graph.run(2.5)
    assert_fine()
    graph.silence(VECTOR, sender=sender)
    graph.unregister(VECTOR, sender)
    graph.run_until(lambda: reports()[0].level == ERROR, 0.3)  # at once, when it times out
    graph.run(2.0)
    for found in reports():
        assert found.level == ERROR and found.values["cause"] == causes.CHANNEL_TIMED_OUT
        assert re.search(r"channel timed out: channel 3, for \d+\.\d s; /commander, which commanded it last, is gone",
                         found.message)
        assert found.values["remedy"].startswith("Start /commander again; or, where nobody is to command channel 3 ")
    assert any(line.startswith("channel timed out: channel 3") for line in graph.lines("/pca9685"))
    graph.hold(VECTOR, vector(3), sender=sender)
    graph.run(2.5)
    assert_fine()
    graph.nodes["/pca9685"].kill()
    graph.silence(VECTOR, sender=sender)
    graph.nodes["/pca9685"].start()
    graph.run(3.0)
    assert_fine()
