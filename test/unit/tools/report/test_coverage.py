"""What a recording can't tell, and that the report says so instead of that nothing went wrong."""
import math
from html import unescape

import pytest

from car_interface.tools.report.page import page
from tools.report.summaries import summarized
from written_recordings import Written, odometry

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


def first_paragraph(text):
    return " ".join(unescape(text[text.index('<p class="verdict">'):text.index("</p>")]).split())


def verdict(tmp_path, messages, namespace="/"):
    return first_paragraph(page(summarized(tmp_path, messages, namespace), {}))


@pytest.mark.parametrize("below", ["", "/car1"], ids=["alone", "in_a_namespace"])
def test_recording_that_has_everything_and_no_fault_says_so(below, tmp_path):
    words = verdict(tmp_path, healthy_drive(below), below or "/")
    assert ALL_IS_WELL in words and "can't tell" not in words


def test_recording_of_odometry_alone_can_tell_nothing_and_has_no_table_of_faults(tmp_path):
    text = page(summarized(tmp_path, wheels(10)), {})
    words = first_paragraph(text)
    assert "Nothing went wrong" not in words and "no fault" not in words
    assert ("What this recording can't tell: no /turn_arb/state (who drove, and why the car stopped); "
            "no /teensy_sensor_hub/link (errors of the Teensy's link); "
            "no /diagnostics of pca9685 (errors of the servo board); "
            "no /teleop_logi/state (why the gamepad released the deadman); "
            "no /throttle_arb/state (why the throttle stopped); "
            "no /rosout (warnings in the nodes' logs).") in words
    assert 'id="faults"' not in text
    assert "<b>unknown</b><span>faults and timeouts</span>" in text


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


def test_link_s_report_on_diagnostics_answers_for_its_topic_and_those_of_other_nodes_for_nothing(tmp_path):
    assert ALL_IS_WELL in verdict(tmp_path, without(healthy_drive(), "/teensy_sensor_hub/link"))
    messages = without(healthy_drive(), "/diagnostics") + [diagnostics(second, ["camera: driver"])
                                                            for second in range(DURATION_S)]
    assert "no /diagnostics of pca9685 (errors of the servo board)" in verdict(tmp_path, messages)


@pytest.mark.parametrize("end_s, begin_s, times", [
    (10, 20, "from 10.00 s to 20.00 s"), (11, 99, "from 11.00 s to 30.00 s")], ids=["hole", "until_the_end"])
def test_hole_in_a_recording_is_named_with_its_time(tmp_path, end_s, begin_s, times):
    messages = [message for message in healthy_drive()
                if message.topic != "/turn_arb/state" or not end_s < message.time_s < begin_s]
    words = verdict(tmp_path, messages)
    assert f"can't tell: no /turn_arb/state {times} (who drove, and why the car stopped)." in words


def test_recording_that_began_before_the_nodes_were_started_is_complete(tmp_path):
    messages = [message._replace(time_s=message.time_s + 20) for message in healthy_drive()]
    words = verdict(tmp_path, [log(0.0), *messages])
    assert ALL_IS_WELL in words
