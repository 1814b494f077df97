"""Who drove the throttle and why, and what the ESC was given."""
import re
from types import SimpleNamespace

import pytest

from car_interface.common.sources import NEUTRAL, NO_HUMAN, PLANNER, TELEOP
from car_interface.tools.report.downsample import Trace
from car_interface.tools.report.faults import ERROR, WARN, FaultLog
from car_interface.tools.report.page import page
from car_interface.tools.report.plots import _throttle
from car_interface.tools.report.states import TRACES, ThrottleWatch
from car_interface.tools.report.summary import summarize
from written_recordings import Written, drive, write_ros1

USUAL = {"source": TELEOP, "cause": "teleop", "reason": "tele_throt_req is 1.000, scaled by 0.3", "asked": 1.0,
         "granted": 0.3, "esc": "FORWARD", "esc_cause": "driving", "esc_reason": "0.30 is requested",
         "profile": "brake_then_reverse"}


def watched(*states, duration_s=10.0):
    """A watch that was given (time, changes of a state that drives by hand) each."""
    faults = FaultLog()
    watch = ThrottleWatch({name: Trace(duration_s) for name in TRACES}, faults, duration_s)
    for time_s, changes in states:
        watch.on_state(time_s, SimpleNamespace(**{**USUAL, **changes}))
    watch.finish()
    faults.finish()
    return watch, faults


def test_episode_ends_with_source_cause_or_an_unusual_state_of_the_esc():
    watch, _ = watched((0.0, {}), (1.0, {"esc": "NEUTRAL"}), (2.0, {"esc": "FORWARD", "reason": "another number"}),
                       (3.0, {"esc": "BRAKING", "esc_cause": "braking", "esc_reason": "it rolls forward"}),
                       (4.0, {"source": PLANNER, "cause": "planner"}))
    assert [(episode.start_s, episode.end_s, episode.source, episode.esc) for episode in watch.episodes] == [
        (0.0, 3.0, TELEOP, ""), (3.0, 4.0, TELEOP, "BRAKING"), (4.0, 10.0, PLANNER, "")]
    assert watch.episodes[1].reason == "tele_throt_req is 1.000, scaled by 0.3; BRAKING: it rolls forward"


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
    _, faults = watched((0.0, {}), (5.0, changes), (6.0, {}))
    assert [(fault.start_s, fault.end_s, fault.level, fault.where) for fault in faults.entries] == (
        [] if level is None else [(5.0, 6.0, level, "throttle_arb")])


@pytest.fixture(scope="module")
def seen(tmp_path_factory):
    """A drive whose throttle was recorded, from its bag."""
    states = [Written(step / 10, "/throttle_arb/state", "car_interface/ThrottleState", {
        **USUAL, "asked": 0.5, "granted": -0.5 if 20 < step < 30 else 0.15,
        **({"esc": "BRAKING", "esc_cause": "braking", "esc_reason": "it rolls forward"} if 20 < step < 30 else {})})
        for step in range(100)]
    messages = sorted([*drive(10.0), *states], key=lambda message: message.time_s)
    return summarize(str(write_ros1(tmp_path_factory.mktemp("throttle") / "a.bag", messages)))


def test_recording_s_throttle_is_summed_up(seen):
    assert seen.throttle.profile == "brake_then_reverse"
    assert (seen.traces["throttle granted"].minimum, seen.traces["throttle granted"].maximum) == (
        -0.5, pytest.approx(0.15))
    assert [episode.esc for episode in seen.throttle.episodes] == ["", "BRAKING", ""]


def test_page_shows_what_was_asked_granted_the_esc_s_state_and_why(seen):
    text = page(seen, {"throttle": "<svg/>"})
    section = re.search('<section id="throttle">.*?</section>', text, re.DOTALL).group()
    assert "Kind of the ESC: brake_then_reverse." in section
    assert "<td>BRAKING</td>" in section and "BRAKING: it rolls forward" in section
    assert "<svg/>" in section
    assert _throttle(seen) is not None
    assert text.index('<section id="who">') < text.index('<section id="throttle">')
