"""What a recording can't tell, and that the report says so instead of that nothing went wrong."""
from __future__ import annotations

import math

import pytest

from car_interface.report.coverage import Gap
from car_interface.report.page import page
from car_interface.report.summary import summarize
from written_recordings import Written, drive, odometry, write_ros1

DURATION_S = 30
ALL_IS_WELL = "Nothing went wrong that this recording shows."
REPORTS = ("turn_arb: steering", "teensy_sensor_hub: Teensy link", "pca9685: servo board",
           "teleop_logi: gamepad", "generic_value_converter: converter")


def log(time_s=1.0):
    return Written(time_s, "/rosout", "rosgraph_msgs/Log", {"level": 2, "name": "/pca9685", "msg": "fine"})


def state(time_s, below=""):
    return Written(time_s, f"{below}/turn_arb/state", "car_interface/SteeringState",
                   {"source": 3, "cause": "teleop", "reason": "tele_steer_req is 0.1", "turn_radius": math.inf})


def link(time_s, below=""):
    return Written(time_s, f"{below}/teensy_sensor_hub/link", "car_interface/LinkStatus",
                   {"open": True, "state": "fine", "frames": int(90 * time_s)})


def diagnostics(time_s, reports=REPORTS, below=""):
    return Written(time_s, "/diagnostics", "diagnostic_msgs/DiagnosticArray", {
        "status": [{"name": f"{below.lstrip('/') + '/' if below else ''}{report}", "level": 0, "message": "fine"}
                   for report in reports]})


def healthy_drive(below=""):
    """Everything that the nodes report on a drive on which nothing went wrong."""
    messages = [log(), *wheels(DURATION_S, below)]
    for second in range(DURATION_S + 1):
        messages += [state(second, below), link(second, below), diagnostics(second, below=below)]
    return messages


def wheels(duration_s, below=""):
    return [odometry(step / 5, 0.3 * step, speed_mps=1.5, topic=f"{below}/odom") for step in range(5 * duration_s + 1)]


def without(messages, *topics):
    return [message for message in messages if message.topic not in topics]


def verdict(tmp_path, messages, namespace="/"):
    """The first paragraph of the page, as its reader sees it."""
    bag = str(write_ros1(tmp_path / "a.bag", sorted(messages, key=lambda message: message.time_s)))
    text = page(summarize(bag, namespace), {})
    return text[text.index('<p class="verdict">'):text.index("</p>")]


@pytest.mark.parametrize("below", ["", "/car1"], ids=["alone", "in_a_namespace"])
def test_recording_that_has_everything_and_no_fault_says_so(below, tmp_path):
    words = verdict(tmp_path, healthy_drive(below), below or "/")
    assert ALL_IS_WELL in words and "can't tell" not in words


def test_recording_of_odometry_alone_can_tell_nothing(tmp_path):
    words = verdict(tmp_path, wheels(10))
    assert "Nothing went wrong" not in words and "no fault" not in words
    assert ("What this recording can't tell: no /turn_arb/state (who drove, and why the car stopped); "
            "no /teensy_sensor_hub/link (errors of the Teensy's link); "
            "no /diagnostics of pca9685 (errors of the servo board); "
            "no /teleop_logi/state (why the gamepad released the deadman); "
            "no /throttle_arb/state (why the throttle stopped); "
            "no /rosout (warnings in the nodes' logs).") in words


@pytest.mark.parametrize(("topics", "lacking"), [
    pytest.param(["/turn_arb/state"], "no /turn_arb/state (who drove, and why the car stopped).", id="who_drove"),
    pytest.param(["/rosout"], "no /rosout (warnings in the nodes' logs).", id="logs"),
    pytest.param(["/diagnostics"], "no /diagnostics of pca9685 (errors of the servo board); "
                 "no /teleop_logi/state (why the gamepad released the deadman); "
                 "no /throttle_arb/state (why the throttle stopped).", id="diagnostics"),
    pytest.param(["/teensy_sensor_hub/link", "/diagnostics"],
                 "no /teensy_sensor_hub/link (errors of the Teensy's link); no /diagnostics of pca9685", id="link"),
])
def test_question_whose_topic_is_missing_is_named_and_the_rest_shows_no_fault(topics, lacking, tmp_path):
    words = verdict(tmp_path, without(healthy_drive(), *topics))
    assert f"What was recorded shows no fault. <span class=\"warn\">What this recording can't tell: {lacking}" in words


def test_link_s_report_on_diagnostics_answers_for_its_topic(tmp_path):
    assert ALL_IS_WELL in verdict(tmp_path, without(healthy_drive(), "/teensy_sensor_hub/link"))


def test_diagnostics_of_other_nodes_answer_nothing(tmp_path):
    messages = without(healthy_drive(), "/diagnostics") + [diagnostics(second, ["camera: driver"])
                                                            for second in range(DURATION_S)]
    assert "no /diagnostics of pca9685 (errors of the servo board)" in verdict(tmp_path, messages)


def test_names_are_those_of_the_car_s_namespace(tmp_path):
    words = verdict(tmp_path, without(healthy_drive("/car1"), "/car1/turn_arb/state", "/diagnostics"), "/car1")
    assert "no /car1/turn_arb/state (" in words and "no /diagnostics of car1/pca9685 (" in words


def test_hole_in_a_recording_is_named_with_its_time(tmp_path):
    messages = [message for message in healthy_drive()
                if message.topic != "/turn_arb/state" or not 10 < message.time_s < 20]
    words = verdict(tmp_path, messages)
    assert "can't tell: no /turn_arb/state from 10.00 s to 20.00 s (who drove, and why the car stopped)." in words


def test_node_whose_messages_end_before_the_recording_is_named_with_the_time(tmp_path):
    messages = [message for message in healthy_drive() if message.topic != "/turn_arb/state" or message.time_s < 12]
    assert "no /turn_arb/state from 11.00 s to 30.00 s (" in verdict(tmp_path, messages)


def test_recording_that_began_before_the_nodes_were_started_is_complete(tmp_path):
    messages = [message._replace(time_s=message.time_s + 20) for message in healthy_drive()]
    words = verdict(tmp_path, [log(0.0), *messages])
    assert ALL_IS_WELL in words


def test_faults_are_counted_as_before_and_what_can_t_be_told_stands_behind_them(tmp_path):
    words = verdict(tmp_path, without(drive(), "/diagnostics"))
    assert "2 faults need somebody to look" in words
    assert words.index("2 faults") < words.index("can't tell: no /diagnostics of pca9685 (errors of the servo board)")


def test_table_of_faults_does_not_say_none_where_nothing_could_tell(tmp_path):
    bag = str(write_ros1(tmp_path / "a.bag", wheels(10)))
    text = page(summarize(bag), {})
    faults = text[text.index('id="faults"'):text.index('id="steering"')]
    assert "<p>None.</p>" not in faults and "can't tell: no /turn_arb/state" in faults
    assert "<b>unknown</b><span>faults and timeouts</span>" in text


def test_gaps_of_an_empty_recording_are_all_questions(tmp_path):
    seen = summarize(str(write_ros1(tmp_path / "a.bag", [odometry(0.0)])))
    gaps = seen.coverage.gaps()
    assert len(gaps) == 6 and all(math.isnan(gap.start_s) for gap in gaps)
    assert gaps[0]._replace(start_s=0.0, end_s=0.0) == Gap(
        "who drove, and why the car stopped", "/turn_arb/state", 0.0, 0.0)
