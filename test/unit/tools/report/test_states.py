"""What the nodes' states tell: who drove the throttle, what stopped planner and gamepad, which requests were cut."""
import re
from html import unescape
from types import SimpleNamespace

import pytest

from car_interface.common import causes
from car_interface.common.sources import NEUTRAL, NO_HUMAN, PLANNER, TELEOP
from car_interface.tools.report import states
from car_interface.tools.report.downsample import Traces
from car_interface.tools.report.faults import ERROR, WARN, Fault, FaultLog
from car_interface.tools.report.page import page
from car_interface.tools.report.plots import _throttle
from tools.report.summaries import summarized
from written_recordings import Written, drive, odometry, stamp

END_S = 10.0


def watched(make, usual, *changes):
    """A watch, its faults and its traces, after (time in s, changes of the usual state) each."""
    faults, traces = FaultLog(), Traces(END_S)
    watch = make(traces, faults)
    for time_s, changed in changes:
        watch.on_state(time_s, SimpleNamespace(**{**usual, **changed}))
    watch.finish()
    faults.finish()
    return watch, faults.entries, traces


def drive_with(tmp_path, kind, fields):
    """The summary of a drive of 10 s with a node's states ten times a second: their fields by step."""
    node = {"ThrottleState": "throttle_arb", "PlannerState": "planner_interface"}[kind]
    return summarized(tmp_path, [*drive(END_S), *(Written(
        step / 10, f"/{node}/state", f"car_interface/{kind}", fields(step)) for step in range(100))])


def section(text, name):
    return re.search(f'<section id="{name}">.*?</section>', text, re.DOTALL).group()


# --- the throttle ---

BY_HAND = {"source": TELEOP, "cause": "teleop", "reason": "tele_throt_req is 1.000, scaled by 0.3", "asked": 1.0,
           "granted": 0.3, "esc": "FORWARD", "esc_cause": "driving", "esc_reason": "0.30 is requested",
           "profile": "brake_then_reverse"}
BRAKES = {"esc": "BRAKING", "esc_cause": "braking", "esc_reason": "it rolls forward"}


def test_episode_ends_with_source_cause_or_an_unusual_state_of_the_esc():
    watch, _, _ = watched(
        states.ThrottleWatch, BY_HAND, (0.0, {}), (1.0, {"esc": "NEUTRAL"}), (2.0, {"reason": "another number"}),
        (3.0, BRAKES), (4.0, {"source": PLANNER, "cause": "planner"}))
    assert [(episode.start_s, episode.end_s, episode.source, episode.esc) for episode in watch.episodes] == [
        (0.0, 3.0, TELEOP, ""), (3.0, 4.0, TELEOP, "BRAKING"), (4.0, 10.0, PLANNER, "")]
    assert watch.episodes[1].reason == "tele_throt_req is 1.000, scaled by 0.3; BRAKING: it rolls forward"


def test_driver_that_no_version_has_is_not_known():
    watch, _, _ = watched(states.ThrottleWatch, BY_HAND, (0.0, {"source": 99}))
    assert [episode.source for episode in watch.episodes] == [states.UNKNOWN_DRIVER]


@pytest.mark.parametrize("changes, level", [
    pytest.param({"source": NEUTRAL, "cause": "command silent", "reason": "the planner's value silent for 0.52 s"},
                 WARN, id="a_planner_that_falls_silent"),
    pytest.param({"esc": "ARMING", "esc_cause": "esc motion", "esc_reason": "it rolled backward at 1.0 m/s"}, ERROR,
                 id="motion_against_the_esc_s_state"),
    pytest.param({"source": NO_HUMAN, "cause": "human silent", "reason": "human_in_loop silent for 0.51 s"}, None,
                 id="what_turn_arb_says_too"),
    pytest.param({"source": NO_HUMAN, "cause": "human absent", "reason": "human_in_loop is false"}, None,
                 id="letting_go"),
    pytest.param({"esc": "ARMING", "esc_cause": "esc arming", "esc_reason": "let go of the deadman"}, None,
                 id="arming"),
])
def test_losses_are_faults_unless_turn_arb_reports_them(changes, level):
    _, faults, _ = watched(states.ThrottleWatch, BY_HAND, (0.0, {}), (5.0, changes), (6.0, {}))
    assert [(fault.start_s, fault.end_s, fault.level, fault.where) for fault in faults] == (
        [] if level is None else [(5.0, 6.0, level, "throttle_arb")])


def test_page_shows_what_was_asked_granted_the_esc_s_state_and_why(tmp_path):
    seen = drive_with(tmp_path, "ThrottleState", lambda step: {
        **BY_HAND, "asked": 0.5, "granted": -0.5 if 20 < step < 30 else 0.15, **(BRAKES if 20 < step < 30 else {})})
    granted = seen.traces["throttle granted"]
    assert (granted.minimum, granted.maximum) == (-0.5, pytest.approx(0.15))
    assert [episode.esc for episode in seen.throttle.episodes] == ["", "BRAKING", ""]
    text = page(seen, {"throttle": "<svg/>"})
    for shown in ("Kind of the ESC: brake_then_reverse.", "<td>BRAKING</td>", "BRAKING: it rolls forward", "<svg/>"):
        assert shown in section(text, "throttle")
    assert _throttle(seen) is not None
    assert text.index('<section id="who">') < text.index('<section id="throttle">')


def test_flood_of_states_is_kept_to_a_bound_and_counted(tmp_path):
    states = [Written(step / 500, "/throttle_arb/state", "car_interface/ThrottleState",
                      {**BY_HAND, "source": (TELEOP, PLANNER)[step % 2]}) for step in range(2102)]
    seen = summarized(tmp_path, [odometry(0.0), *states])
    assert len(seen.throttle.episodes) == 2000 and seen.faults.dropped == 102


# --- the planner ---

OBEYED = {"source": "drive", "others": "", "cause": "planner", "reason": "drive asks for 1.00 m/s, straight on",
          "speed": 1.0, "reference_speed": 0.5}


@pytest.mark.parametrize("cause, is_told", [
    ("planner silent", True), ("request refused", True), ("request not finite", True), ("odometry silent", True),
    ("no request", False),
])
def test_what_stopped_the_planner_is_a_fault_with_its_duration(cause, is_told):
    _, faults, _ = watched(states.PlannerWatch, OBEYED, (0.0, {}), (5.0, {"cause": cause, "reason": "why"}),
                           (5.5, {"cause": cause}), (6.0, {}))
    assert faults == ([Fault(5.0, WARN, "planner_interface", "why", 6.0)] if is_told else [])


def test_planner_s_speeds_are_those_of_the_times_in_which_it_was_obeyed():
    _, _, traces = watched(states.PlannerWatch, OBEYED, (0.0, {}), (5.0, {"cause": "planner silent", "speed": 0.0}))
    assert (traces["planner's speed"].count, traces["planner's speed"].minimum) == (1, 1.0)
    assert traces["reference speed"].maximum == 0.5


def test_page_names_the_source_and_the_others(tmp_path):
    others = "cmd_vel: 3 messages, the last from /move_base"
    text = page(drive_with(tmp_path, "PlannerState", lambda step: {**OBEYED, "others": others}), {})
    assert f"The planner that was obeyed: drive; not obeyed: {others}." in text


# --- limits ---

def cut(*changes):
    """A watch that was given (time, node, limit, cuts) each."""
    watch = states.LimitsWatch()
    for time_s, node, limit, cuts in changes:
        watch.on_state(time_s, SimpleNamespace(limit=limit, limit_reason=f"why {limit}", cuts=cuts), node)
    watch.finish()
    return watch


def test_cut_lasts_until_another_cause_or_half_a_second_without_one():
    watch = cut((0.0, "turn_arb", "", 0), (1.0, "turn_arb", "lateral acceleration", 1),
                (1.05, "throttle_arb", "slowed for the turn", 1), (1.2, "turn_arb", "", 1),
                (1.4, "turn_arb", "lateral acceleration", 2), (1.5, "turn_arb", "lateral jerk", 2),
                (5.0, "turn_arb", "lateral jerk", 3))
    assert [episode[:4] for episode in watch.episodes] == [
        (1.0, 1.4, "turn_arb", "lateral acceleration"), (1.05, 1.05, "throttle_arb", "slowed for the turn"),
        (1.5, 1.5, "turn_arb", "lateral jerk"), (5.0, 5.0, "turn_arb", "lateral jerk")]
    assert watch.episodes[0].reason == "why lateral acceleration"
    assert watch.counts == {"turn_arb": 3, "throttle_arb": 0}
    restarted = cut((0.0, "turn_arb", "", 5), (1.0, "turn_arb", "", 7), (2.0, "turn_arb", "", 1))
    assert restarted.counts == {"turn_arb": 3}


def test_page_shows_each_cut_and_their_count(tmp_path):
    reason = "4 m/s² sideways: at 4.0 m/s no tighter than 4.00 m, 1.00 m was asked for"
    shown = section(page(drive_with(tmp_path, "ThrottleState", lambda step: {
        "source": PLANNER, "cause": "planner", "esc": "FORWARD", "cuts": int(step > 50),
        **({"limit": "slowed for the turn", "limit_reason": reason} if 50 < step < 60 else {})}), {}), "limits")
    assert "Requests cut: throttle_arb once." in shown
    assert "<td>slowed for the turn</td>" in shown and reason in shown


def test_page_of_a_drive_without_cuts_says_so_unless_its_recording_can_not_tell(tmp_path):
    assert "None was cut." in section(page(summarized(tmp_path, drive(10.0)), {}), "limits")
    text = page(summarized(tmp_path, [odometry(0.0)]), {})
    assert "None was cut." not in text and "Not recorded: turn_arb/state, throttle_arb/state, " in text


# --- the gamepad ---

WRONG_MODE = "the gamepad has 4 axes (0 to 3), but throttle_axis is 4"
REARM = "the gamepad was silent; let go of the deadman, then hold it again"


def teleop_state(time_s, cause, reason, human=False, **sticks):
    return Written(time_s, "/teleop_logi/state", "car_interface/TeleopState", {
        "stamp": stamp(time_s), "human_in_loop": human, "cause": cause, "reason": reason, **sticks})


def steering(time_s, drives):
    """turn_arb's, of one moment."""
    source, cause, reason = (TELEOP, causes.TELEOP, "tele_steer_req is 0.100") if drives else \
        (NO_HUMAN, causes.HUMAN_ABSENT, "human_in_loop is false")
    return Written(time_s, "/turn_arb/state", "car_interface/SteeringState", {
        "stamp": stamp(time_s), "source": source, "cause": cause, "reason": reason, "duty": 5100})


def report(tmp_path, *failures, others=()):
    """Faults of a drive by gamepad from 2 s to 10 s, and its page's text without its tags.

    Args:
        failures: what is wrong one after another: (time in s, cause, reason).
    """
    ticks = [step / 10 for step in range(200)]
    messages = [message for time_s in ticks for message in (odometry(time_s), steering(time_s, 2.0 <= time_s < 10.0))]
    for time_s in ticks:
        began = [failure for failure in failures if failure[0] <= time_s + 0.01]
        if began:
            messages.append(teleop_state(max(time_s, began[-1][0]), *began[-1][1:]))
        elif 2.0 <= time_s < 10.0:
            messages.append(teleop_state(time_s, causes.MANUAL, "manual deadman held", True))
        else:
            messages.append(teleop_state(time_s, causes.NO_DEADMAN, "no deadman is held"))
    seen = summarized(tmp_path, [*messages, *others])
    faults = [(round(fault.start_s, 1), fault.where, fault.level, fault.what) for fault in seen.faults.entries]
    return faults, " ".join(unescape(re.sub("<[^>]*>", " ", page(seen, {}))).split())


def test_silence_with_the_button_held_on_is_why_the_car_stopped(tmp_path):
    faults, text = report(tmp_path, (10.0, causes.JOY_STALE, "joy silent for 0.26 s"),
                          (10.02, causes.NOT_REARMED, REARM))
    assert "The car was stopped once because something was lost or locked: joy silent." in text
    assert "human_in_loop is false: joy silent for 0.26 s" in text
    assert faults == [(10.0, "teleop_logi", WARN, "joy silent for 0.26 s"), (10.1, "teleop_logi", WARN, REARM)]


@pytest.mark.parametrize("cause, reason", [
    pytest.param(causes.JOY_INCOMPLETE, WRONG_MODE, id="wrong_mode"),
    pytest.param(causes.JOY_NOT_FINITE, "the gamepad's throttle_axis 4 is nan, no number to act on", id="nan"),
])
def test_gamepad_that_is_unusable_is_an_error_with_its_reason(cause, reason, tmp_path):
    faults, text = report(tmp_path, (10.0, cause, reason))
    assert f"The car was stopped once because something was lost or locked: {cause}." in text
    assert "1 fault needs somebody to look" in text and faults == [(10.0, "teleop_logi", ERROR, reason)]


def test_axis_that_was_not_seen_at_its_rest_is_a_fault_while_it_lasts(tmp_path):
    why = "no deadman is held; the gamepad's throttle_axis 4 is 1.00 and was not seen at its rest: it doesn't count"
    odd = [teleop_state(time_s, causes.NO_DEADMAN, why, throttle_stick=causes.NOT_AT_REST) for time_s in (12.02, 13.02)]
    assert report(tmp_path, others=odd)[0] == [(start_s, "teleop_logi", WARN, why) for start_s in (12.0, 13.0)]


def test_axis_that_is_never_seen_at_its_rest_is_a_fault_to_the_end():
    state = {"cause": causes.NO_DEADMAN, "reason": "why", "human_in_loop": False, "steering_stick": causes.NOT_AT_REST,
             "throttle_stick": ""}
    _, faults, _ = watched(states.GamepadWatch, state, (1.0, {}), (2.0, {}))
    assert faults == [Fault(1.0, WARN, "teleop_logi", "why", END_S)]


def test_deadman_that_is_let_go_is_no_loss(tmp_path):
    faults, text = report(tmp_path)
    assert "The car was stopped" not in text and faults == []
    assert "Went neutral once: human absent" in text


def test_what_diagnostics_and_log_say_of_the_gamepad_is_not_listed_twice(tmp_path):
    others = [
        Written(10.1, "/diagnostics", "diagnostic_msgs/DiagnosticArray", {"header": {"stamp": stamp(10.1)}, "status": [
            {"name": "teleop_logi: gamepad", "level": 2, "message": WRONG_MODE}]}),
        *(Written(time_s, "/rosout", "rosgraph_msgs/Log", {
            "header": {"stamp": stamp(time_s)}, "level": 4, "name": "/teleop_logi", "msg": text})
          for time_s, text in ((10.1, f"human in loop: False ({WRONG_MODE})"), (10.2, "something else")))]
    faults, _ = report(tmp_path, (10.0, causes.JOY_INCOMPLETE, WRONG_MODE), others=others)
    assert [what for *_, what in faults] == [WRONG_MODE, "something else"]


def gamepad(*steps):
    """A watch, its losses as faults, after (time in s, cause) each."""
    faults = FaultLog()
    watch = states.GamepadWatch(Traces(60.0), faults)
    for time_s, cause in steps:
        watch.on_state(time_s, SimpleNamespace(
            cause=cause, reason=f"why {cause}", human_in_loop=cause in (causes.MANUAL, causes.AUTONOMOUS),
            steering_stick="", throttle_stick=""))
    return watch, faults


def test_gamepad_that_is_missing_from_the_start_on_is_a_warning_unless_it_comes_a_moment_after_its_node():
    never = (0.0, causes.JOY_NEVER_RECEIVED)
    for steps, expected in (([never], [Fault(0.0, WARN, "teleop_logi", f"why {never[1]}", 60.0)]),
                            ([never, (1.0, causes.NO_DEADMAN)], [])):
        watch, faults = gamepad(*steps)
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
    watch, _ = gamepad((0.0, causes.MANUAL), (10.0, causes.JOY_STALE), (10.01, causes.NOT_REARMED),
                       (12.0, causes.NO_DEADMAN), (15.0, causes.MANUAL), (20.0, causes.NO_DEADMAN),
                       (20.3, causes.JOY_STALE))
    found = watch.loss_at(time_s)
    assert (found and found.cause) == cause
