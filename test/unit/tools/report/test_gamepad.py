"""What a report says about the gamepad: the text that its owner reads."""
import re
from html import unescape
from types import SimpleNamespace

import pytest

from car_interface.common import causes
from car_interface.tools.report.faults import ERROR, WARN, Fault, FaultLog
from car_interface.tools.report.page import page
from car_interface.tools.report.states import GamepadWatch
from car_interface.tools.report.summary import summarize
from written_recordings import NO_HUMAN, TELEOP, Written, odometry, stamp, write_ros1

WRONG_MODE = "the gamepad has 4 axes (0 to 3), but throttle_axis is 4"
REARM = "the gamepad was silent; let go of the deadman, then hold it again"


def state(time_s, cause, reason, human=False, **sticks):
    """teleop_logi's, of one moment."""
    return Written(time_s, "/teleop_logi/state", "car_interface/TeleopState", {
        "stamp": stamp(time_s), "human_in_loop": human, "cause": cause, "reason": reason, **sticks})


def steering(time_s, drives):
    """turn_arb's, of one moment."""
    source, cause, reason = (TELEOP, causes.TELEOP, "tele_steer_req is 0.100") if drives else \
        (NO_HUMAN, causes.HUMAN_ABSENT, "human_in_loop is false")
    return Written(time_s, "/turn_arb/state", "car_interface/SteeringState", {
        "stamp": stamp(time_s), "source": source, "cause": cause, "reason": reason, "duty": 5100})


def drive(*failures, others=()):
    """Driven by gamepad from 2 s to 10 s, where one thing after another is wrong: (time in s, cause, reason)."""
    ticks = [step / 10 for step in range(200)]
    messages = [message for time_s in ticks for message in (odometry(time_s), steering(time_s, 2.0 <= time_s < 10.0))]
    for time_s in ticks:
        began = [failure for failure in failures if failure[0] <= time_s + 0.01]
        if began:
            messages.append(state(max(time_s, began[-1][0]), *began[-1][1:]))
        elif 2.0 <= time_s < 10.0:
            messages.append(state(time_s, causes.MANUAL, "manual deadman held", True))
        else:
            messages.append(state(time_s, causes.NO_DEADMAN, "no deadman is held"))
    return sorted([*messages, *others], key=lambda message: message.time_s)


def report(tmp_path, messages):
    """The summary, and the page's text without its tags."""
    seen = summarize(str(write_ros1(tmp_path / "a.bag", messages)))
    return seen, " ".join(unescape(re.sub("<[^>]*>", " ", page(seen, {}))).split())


def test_silence_with_the_button_held_on_is_why_the_car_stopped(tmp_path):
    seen, text = report(tmp_path, drive((10.0, causes.JOY_STALE, "joy silent for 0.26 s"),
                                        (10.02, causes.NOT_REARMED, REARM)))
    assert "The car was stopped once because something was lost or locked: joy silent." in text
    assert "human_in_loop is false: joy silent for 0.26 s" in text
    assert [(fault.where, fault.level, fault.what) for fault in seen.faults.entries] == [
        ("teleop_logi", WARN, "joy silent for 0.26 s"), ("teleop_logi", WARN, REARM)]


@pytest.mark.parametrize("cause, reason", [
    pytest.param(causes.JOY_INCOMPLETE, WRONG_MODE, id="wrong_mode"),
    pytest.param(causes.JOY_NOT_FINITE, "the gamepad's throttle_axis 4 is nan, no number to act on", id="nan"),
])
def test_gamepad_that_is_unusable_is_an_error_with_its_reason(cause, reason, tmp_path):
    seen, text = report(tmp_path, drive((10.0, cause, reason)))
    assert f"The car was stopped once because something was lost or locked: {cause}." in text
    assert "1 fault needs somebody to look" in text
    (fault,) = seen.faults.entries
    assert (fault.where, fault.level, fault.what, fault.start_s) == ("teleop_logi", ERROR, reason, pytest.approx(10.0))


def test_axis_that_was_not_seen_at_its_rest_is_a_fault_while_it_lasts(tmp_path):
    why = "no deadman is held; the gamepad's throttle_axis 4 is 1.00 and was not seen at its rest: it doesn't count"
    odd = [state(time_s, causes.NO_DEADMAN, why, throttle_stick=causes.NOT_AT_REST) for time_s in (12.02, 13.02)]
    seen, _ = report(tmp_path, drive(others=odd))
    assert [(fault.where, fault.level, fault.what) for fault in seen.faults.entries] == [("teleop_logi", WARN, why)] * 2


def test_deadman_that_is_let_go_is_no_loss(tmp_path):
    seen, text = report(tmp_path, drive())
    assert "The car was stopped" not in text and seen.faults.entries == []
    assert "Went neutral once: human absent" in " ".join(text.split())


def test_what_diagnostics_and_log_say_of_the_gamepad_is_not_listed_twice(tmp_path):
    others = [
        Written(10.1, "/diagnostics", "diagnostic_msgs/DiagnosticArray", {"header": {"stamp": stamp(10.1)}, "status": [
            {"name": "teleop_logi: gamepad", "level": 2, "message": WRONG_MODE}]}),
        Written(10.1, "/rosout", "rosgraph_msgs/Log", {
            "header": {"stamp": stamp(10.1)}, "level": 4, "name": "/teleop_logi",
            "msg": f"human in loop: False ({WRONG_MODE})"}),
        Written(10.2, "/rosout", "rosgraph_msgs/Log", {
            "header": {"stamp": stamp(10.2)}, "level": 4, "name": "/teleop_logi", "msg": "something else"})]
    seen, _ = report(tmp_path, drive((10.0, causes.JOY_INCOMPLETE, WRONG_MODE), others=others))
    assert [fault.what for fault in seen.faults.entries] == [WRONG_MODE, "something else"]


def states(*steps):
    """A watch, its losses as faults, after (time in s, cause, reason)."""
    faults = FaultLog()
    watch = GamepadWatch(faults, 60.0)
    for time_s, cause, reason in steps:
        watch.on_state(time_s, SimpleNamespace(
            cause=cause, reason=reason, human_in_loop=cause in (causes.MANUAL, causes.AUTONOMOUS),
            steering_stick="", throttle_stick=""))
    return watch, faults


def test_gamepad_that_is_missing_from_the_start_on_is_a_warning_unless_it_comes_a_moment_after_its_node():
    never = (0.0, causes.JOY_NEVER_RECEIVED, "joy was never heard")
    for steps, expected in (([never], [Fault(0.0, 60.0, WARN, "teleop_logi", "joy was never heard")]),
                            ([never, (1.0, causes.NO_DEADMAN, "")], [])):
        watch, faults = states(*steps)
        watch.finish()
        assert faults.entries == expected


@pytest.mark.parametrize("time_s, cause", [
    pytest.param(8.9, None, id="before"),
    pytest.param(9.5, causes.JOY_STALE, id="recorded_before_it_by_a_busy_computer"),
    pytest.param(10.02, causes.JOY_STALE, id="recorded_after_it_while_the_next_lasts"),
    pytest.param(11.5, causes.NOT_REARMED, id="while_the_next_lasts"),
    pytest.param(14.0, None, id="after"),
    pytest.param(20.0, None, id="let_go_and_switched_off_at_once"),
    pytest.param(22.0, causes.JOY_STALE, id="while_it_is_off"),
])
def test_loss_is_found_by_its_time(time_s, cause):
    watch, _ = states((0.0, causes.MANUAL, ""), (10.0, causes.JOY_STALE, ""), (10.01, causes.NOT_REARMED, ""),
                      (12.0, causes.NO_DEADMAN, ""), (15.0, causes.MANUAL, ""), (20.0, causes.NO_DEADMAN, ""),
                      (20.3, causes.JOY_STALE, ""))
    found = watch.loss_at(time_s)
    assert (found and found.cause) == cause
