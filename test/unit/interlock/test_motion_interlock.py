"""Whether the car may move at all: lock, deadman, and how what was lost comes back. Time is passed in."""
from __future__ import annotations

import math
import re
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from car_interface.common.params import Params
from car_interface.interlock.motion_interlock import InterlockConfig, MotionInterlock, read_interlock

CONFIG_FILES = Path(__file__).resolve().parents[3] / "config"
S = 1_000_000_000
MS = 1_000_000
NOW = 1000 * S
E_STOP, RUN = ("e_stop", True), ("e_stop", False)
HOLD, LET_GO = ("human", True), ("human", False)
SILENCE = ("silence", 600 * MS)  # longer than the deadman's timeout, shorter than the lock's
LONG_SILENCE = ("silence", 1100 * MS)  # longer than both
DROPPED = ("dropped", None)  # messages, before they got here
NOTHING_GRANTED = {"grant_at_start": False}


def after(*events, **changes):
    """The inhibit after a row of events, each 10 ms after the one before; ``None`` = the car may move."""
    interlock = MotionInterlock(InterlockConfig(**changes))
    now_ns = NOW
    interlock.inhibit(now_ns)  # the start
    for kind, value in events:
        if kind == "silence":
            now_ns += value
        else:
            now_ns += 10 * MS
        if kind == "dropped":
            interlock.mark_stale(now_ns)
        elif kind != "silence":
            (interlock.update_human if kind == "human" else interlock.update_e_stop)(value, now_ns)
    return interlock.inhibit(now_ns)


@pytest.mark.parametrize("events", [
    pytest.param([HOLD], id="first_true_after_start"),
    pytest.param([LET_GO, HOLD], id="held_after_it_was_not"),
    pytest.param([HOLD, LET_GO, HOLD], id="let_go_and_held_again"),
    pytest.param([RUN, HOLD], id="lock_heard_and_off"),
    pytest.param([HOLD, SILENCE, LET_GO, HOLD], id="silent_then_let_go_and_held_again"),
    pytest.param([E_STOP, RUN, LET_GO, HOLD], id="lock_on_and_off_then_let_go_and_held_again"),
    pytest.param([HOLD, E_STOP, HOLD, RUN, LET_GO, HOLD], id="held_all_through_the_lock_then_let_go_and_held_again"),
    pytest.param([RUN, HOLD, LONG_SILENCE, RUN, LET_GO, HOLD], id="both_silent_then_all_back"),
])
def test_control_is_granted(events):
    assert after(*events) is None


@pytest.mark.parametrize("events, locked, cause, reason", [
    pytest.param([], False, "human never heard", "human_in_loop was never heard", id="at_start"),
    pytest.param([LET_GO], False, "human absent", "human_in_loop is false", id="not_held"),
    pytest.param([HOLD, SILENCE], False, "human silent", "human_in_loop silent for 0.60 s", id="silent"),
    pytest.param([HOLD, SILENCE, HOLD], False, "not re-armed",
                 "human_in_loop was silent; let go once: publish false, then true", id="silent_and_back"),
    pytest.param([HOLD, SILENCE, HOLD, HOLD, HOLD], False, "not re-armed",
                 "human_in_loop was silent; let go once: publish false, then true", id="holding_on_rearms_nothing"),
    pytest.param([HOLD, SILENCE, LET_GO], False, "human absent", "human_in_loop is false", id="let_go_after_silence"),
    pytest.param([HOLD, LET_GO, SILENCE, HOLD], False, "not re-armed",
                 "human_in_loop was silent; let go once: publish false, then true", id="silent_while_let_go"),
    pytest.param([HOLD, E_STOP], True, "e_stop", "e_stop is true", id="locked"),
    pytest.param([E_STOP, HOLD], True, "e_stop", "e_stop is true", id="locked_before_the_deadman"),
    pytest.param([HOLD, E_STOP, LET_GO, HOLD], True, "e_stop", "e_stop is true", id="re-arming_opens_no_lock"),
    pytest.param([HOLD, E_STOP, RUN], False, "not re-armed",
                 "the lock was on; let go once: publish false, then true", id="lock_off_with_the_deadman_held"),
    pytest.param([HOLD, E_STOP, LET_GO, HOLD, RUN], False, "not re-armed",
                 "the lock was on; let go once: publish false, then true", id="re-armed_too_early"),
    pytest.param([RUN, HOLD, ("silence", 400 * MS), HOLD, ("silence", 400 * MS), HOLD, ("silence", 400 * MS)], True,
                 "e_stop silent", "e_stop silent for 1.23 s", id="lock_silent"),
    pytest.param([RUN, LONG_SILENCE, RUN, HOLD], False, "not re-armed",
                 "the lock was on; let go once: publish false, then true", id="lock_was_silent_before_the_deadman"),
])
def test_control_is_refused_with_the_reason(events, locked, cause, reason):
    assert after(*events) == (locked, cause, reason)


def test_lock_exactly_as_old_as_its_timeout_is_still_off():
    interlock = MotionInterlock(InterlockConfig(human_timeout_s=0.0))
    interlock.update_e_stop(False, NOW)
    interlock.update_human(True, NOW)
    assert interlock.inhibit(NOW + S) is None
    assert interlock.inhibit(NOW + S + 1).locked


def test_loss_that_nobody_asked_about_while_it_lasted_is_a_loss_all_the_same():
    interlock = MotionInterlock(InterlockConfig(human_timeout_s=0.0))
    interlock.update_human(True, NOW)
    interlock.update_e_stop(False, NOW)
    interlock.update_e_stop(False, NOW + 3 * S)
    assert interlock.inhibit(NOW + 3 * S).cause == "not re-armed"


def test_lock_never_heard_is_off_unless_it_is_required():
    assert after(HOLD) is None
    assert after(HOLD, e_stop_required=True) == (
        True, "e_stop never heard", "e_stop was never heard, and e_stop_required is true")
    assert after(HOLD, RUN, e_stop_required=True).cause == "not re-armed"
    assert after(HOLD, RUN, LET_GO, HOLD, e_stop_required=True) is None


def test_lock_with_a_timeout_of_0_may_be_silent_for_ever():
    assert after(RUN, ("silence", 3600 * S), HOLD, e_stop_timeout_s=0.0) is None


@pytest.mark.parametrize("events", [
    pytest.param([LONG_SILENCE, LET_GO, HOLD], id="no_e_stop_within_its_timeout_then_let_go_and_held"),
    pytest.param([HOLD, LONG_SILENCE, HOLD, LET_GO, HOLD], id="held_at_the_start_then_let_go_and_held_again"),
    pytest.param([RUN, LET_GO, HOLD], id="e_stop_heard_and_off_then_let_go_and_held"),
    pytest.param([HOLD, RUN, LET_GO, HOLD], id="held_at_the_start_e_stop_off_then_let_go_and_held_again"),
    pytest.param([E_STOP, RUN, LET_GO, HOLD], id="e_stop_on_and_off_then_let_go_and_held"),
])
def test_after_a_start_that_grants_nothing_letting_go_and_holding_grants(events):
    assert after(*events, **NOTHING_GRANTED) is None


WAITS = (False, "starting", "this node has just started: it waits up to 1 s for e_stop")
TO_REARM = (False, "not re-armed", "this node has just started; let go once: publish false, then true")


@pytest.mark.parametrize("events, inhibit", [
    pytest.param([], WAITS, id="at_once"),
    pytest.param([HOLD], WAITS, id="held"),
    pytest.param([LET_GO, HOLD], WAITS, id="let_go_and_held_before_e_stop_could_be_heard"),
    pytest.param([HOLD, LONG_SILENCE, HOLD], (False, "not re-armed",
                                              "human_in_loop was silent; let go once: publish false, then true"),
                 id="held_then_silent_then_held"),
    pytest.param([LONG_SILENCE], (False, "human never heard", "human_in_loop was never heard"), id="nobody_there"),
    pytest.param([LONG_SILENCE, LET_GO], (False, "human absent", "human_in_loop is false"), id="let_go"),
    pytest.param([LONG_SILENCE, HOLD], TO_REARM, id="held_when_e_stop_s_timeout_had_passed"),
    pytest.param([LET_GO, ("silence", 480 * MS), LET_GO, ("silence", 480 * MS), LET_GO, HOLD], TO_REARM,
                 id="let_go_while_e_stop_could_not_be_known_counts_for_nothing"),
    pytest.param([RUN, HOLD, HOLD], TO_REARM, id="held_with_e_stop_off"),
    pytest.param([LET_GO, RUN, HOLD], TO_REARM, id="let_go_before_e_stop_was_heard"),
    pytest.param([E_STOP, LET_GO, HOLD], (True, "e_stop", "e_stop is true"), id="e_stop_is_on"),
    pytest.param([E_STOP, LET_GO, HOLD, RUN], (False, "not re-armed",
                                               "the lock was on; let go once: publish false, then true"),
                 id="let_go_while_e_stop_was_on"),
])
def test_start_that_grants_nothing_refuses_with_the_reason(events, inhibit):
    assert after(*events, **NOTHING_GRANTED) == inhibit


def test_start_without_an_e_stop_timeout_has_nothing_to_wait_for():
    assert after(HOLD, e_stop_timeout_s=0.0, **NOTHING_GRANTED) == TO_REARM
    assert after(LET_GO, HOLD, e_stop_timeout_s=0.0, **NOTHING_GRANTED) is None


@pytest.mark.parametrize("e_stop_timeout_s", [0.0, 1.0])
def test_start_with_a_required_e_stop_waits_for_it_however_long_that_takes(e_stop_timeout_s):
    settings = {"e_stop_timeout_s": e_stop_timeout_s, "e_stop_required": True, **NOTHING_GRANTED}
    never_heard = (True, "e_stop never heard", "e_stop was never heard, and e_stop_required is true")
    assert after(("silence", 3600 * S), LET_GO, HOLD, **settings) == never_heard
    assert after(("silence", 3600 * S), LET_GO, HOLD, RUN, **settings).cause == "not re-armed"
    assert after(("silence", 3600 * S), RUN, LET_GO, HOLD, **settings) is None


def test_start_is_the_first_time_that_anything_is_passed_in():
    interlock = MotionInterlock(InterlockConfig(human_timeout_s=0.0, **NOTHING_GRANTED))
    interlock.update_human(True, NOW)
    assert interlock.inhibit(NOW + S - 1) == WAITS
    interlock.update_human(True, NOW + S)
    assert interlock.inhibit(NOW + S) == TO_REARM
    interlock.update_human(False, NOW + S)
    interlock.update_human(True, NOW + S)
    assert interlock.inhibit(NOW + S) is None


def test_parameter_grant_at_start_is_true_unless_given():
    assert read_interlock(Params({})).grant_at_start
    assert not read_interlock(Params({"grant_at_start": False})).grant_at_start


@pytest.mark.parametrize("name", ["turn_arb.yaml", "throttle.yaml"])
def test_shipped_configuration_grants_nothing_at_start(name):
    assert re.findall(r"(?m)^grant_at_start: *(\w+)", (CONFIG_FILES / name).read_text(encoding="utf-8")) == ["false"]


E_STOP_UNKNOWN = (True, "e_stop silent", "e_stop was not heard since messages were dropped")


@pytest.mark.parametrize("events, inhibit", [
    pytest.param([RUN, HOLD, DROPPED], E_STOP_UNKNOWN, id="nothing_heard_since"),
    pytest.param([RUN, HOLD, DROPPED, LET_GO, HOLD], E_STOP_UNKNOWN, id="e_stop_not_heard_since"),
    pytest.param([RUN, HOLD, DROPPED, RUN], (False, "human silent",
                                             "human_in_loop was not heard since messages were dropped"),
                 id="deadman_not_heard_since"),
    pytest.param([RUN, HOLD, DROPPED, RUN, HOLD], (False, "not re-armed",
                                                   "messages were dropped; let go once: publish false, then true"),
                 id="deadman_held_on"),
    pytest.param([HOLD, DROPPED, HOLD], (False, "starting", "messages were dropped: it waits up to 1 s for e_stop"),
                 id="the_first_of_e_stop_may_be_among_them"),
    pytest.param([HOLD, DROPPED, LONG_SILENCE, HOLD], (False, "not re-armed",
                                                       "messages were dropped; let go once: publish false, then true"),
                 id="deadman_held_on_without_an_e_stop"),
])
@pytest.mark.parametrize("grant_at_start", [True, False])
def test_dropped_messages_are_a_loss_of_everything(events, inhibit, grant_at_start):
    armed = [RUN, LET_GO] if events[0] == RUN else [LONG_SILENCE, LET_GO]
    assert after(*armed, *events[:2 if events[0] == RUN else 1], grant_at_start=grant_at_start) is None
    assert after(*armed, *events, grant_at_start=grant_at_start) == inhibit


def test_after_dropped_messages_letting_go_and_holding_grants_again():
    assert after(RUN, HOLD, DROPPED, RUN, LET_GO, HOLD) is None
    assert after(HOLD, DROPPED, LONG_SILENCE, LET_GO, HOLD) is None
    assert after(HOLD, DROPPED, LET_GO, HOLD, e_stop_timeout_s=0.0) is None


def test_ages_are_told():
    interlock = MotionInterlock(InterlockConfig())
    assert (interlock.human_age_s(NOW), interlock.e_stop_age_s(NOW)) == (math.inf, math.inf)
    interlock.update_human(True, NOW)
    interlock.update_e_stop(False, NOW + S // 4)
    assert (interlock.human_age_s(NOW + S), interlock.e_stop_age_s(NOW + S)) == (1.0, 0.75)


@pytest.mark.once
@given(st.lists(st.sampled_from([E_STOP, RUN, HOLD, LET_GO, SILENCE, LONG_SILENCE]), max_size=12))
def test_whatever_happened_the_car_moves_only_with_the_deadman_held_and_the_lock_not_on(events):
    if after(*events) is None:
        heard = [value for kind, value in events if kind == "human"]
        locks = [value for kind, value in events if kind == "e_stop"]
        assert heard[-1] is True
        assert not (locks and locks[-1])
        assert events[-1] not in (SILENCE, LONG_SILENCE)


@given(st.lists(st.sampled_from([E_STOP, RUN, HOLD, SILENCE, LONG_SILENCE, DROPPED]), max_size=12),
       st.sampled_from([SILENCE, E_STOP, DROPPED]))
def test_after_a_loss_nothing_but_letting_go_brings_control_back(events, loss):
    assert after(HOLD, loss, *events) is not None


@given(st.lists(st.sampled_from([E_STOP, RUN, HOLD, SILENCE, LONG_SILENCE]), max_size=12), st.booleans())
def test_after_a_start_that_grants_nothing_nothing_but_letting_go_brings_control(events, required):
    assert after(*events, e_stop_required=required, **NOTHING_GRANTED) is not None


@given(st.lists(st.sampled_from([E_STOP, RUN, HOLD, LET_GO, SILENCE, LONG_SILENCE]), max_size=12))
def test_start_that_grants_nothing_never_grants_what_the_other_one_refuses(events):
    if after(*events) is not None:
        assert after(*events, **NOTHING_GRANTED) is not None


# --- why the deadman isn't held, by who watches it ---

GAMEPAD = "the gamepad has 4 axes (0 to 3), but throttle_axis is 4"


def absent(present=False, reason=GAMEPAD, age_ns=0):
    """The reason of a deadman that is false, with an explanation so old."""
    interlock = MotionInterlock(InterlockConfig())
    interlock.explain_human(present, reason, NOW - age_ns)
    interlock.update_human(False, NOW)
    return interlock.inhibit(NOW).reason


def test_explanation_is_quoted_while_the_deadman_is_false():
    assert absent() == f"human_in_loop is false: {GAMEPAD}"


@pytest.mark.parametrize("age_ms, is_quoted", [(500, True), (501, False)])
def test_explanation_that_is_old_is_not_quoted(age_ms, is_quoted):
    """A latched message outlives the node that sent it."""
    assert (GAMEPAD in absent(age_ns=age_ms * MS)) is is_quoted


def test_without_an_explanation_the_reason_is_as_it_was():
    assert after(LET_GO).reason == "human_in_loop is false"


def test_explanation_that_contradicts_the_deadman_is_not_quoted():
    assert absent(present=True, reason="manual deadman held") == "human_in_loop is false"


def test_explanation_of_anything_becomes_one_line_of_bounded_length():
    assert absent(reason="a\n b") == "human_in_loop is false: a b"
    assert len(absent(reason="x" * 10_000)) == len("human_in_loop is false: ") + 300


@pytest.mark.once
@given(st.lists(st.tuples(st.sampled_from([HOLD, LET_GO, E_STOP, RUN, SILENCE, DROPPED]), st.booleans(), st.text()),
                max_size=12))
def test_explanation_never_changes_what_is_permitted(steps):
    plain, explained = MotionInterlock(InterlockConfig()), MotionInterlock(InterlockConfig())
    now_ns = NOW
    for (kind, value), present, text in steps:
        now_ns += value if kind == "silence" else 10 * MS
        explained.explain_human(present, text, now_ns)
        for interlock in (plain, explained):
            if kind == "dropped":
                interlock.mark_stale(now_ns)
            elif kind != "silence":
                (interlock.update_human if kind == "human" else interlock.update_e_stop)(value, now_ns)
        inhibits = [interlock.inhibit(now_ns) for interlock in (plain, explained)]
        assert inhibits[0] == inhibits[1] or [inhibit[:2] for inhibit in inhibits] == [(False, "human absent")] * 2
