"""Whether the car may move at all: lock, deadman, and how what was lost comes back. Time is passed in."""
from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from car_interface.permission import Permission, PermissionConfig

S = 1_000_000_000
MS = 1_000_000
NOW = 1000 * S
E_STOP, RUN = ("e_stop", True), ("e_stop", False)
HOLD, LET_GO = ("human", True), ("human", False)
SILENCE = ("silence", 600 * MS)  # longer than the deadman's timeout, shorter than the lock's
LONG_SILENCE = ("silence", 1100 * MS)  # longer than both


def after(*events, **changes):
    """The refusal after a row of events, each 10 ms after the one before; ``None`` = the car may move."""
    permission = Permission(PermissionConfig(**changes))
    now_ns = NOW
    for kind, value in events:
        if kind == "silence":
            now_ns += value
        else:
            now_ns += 10 * MS
            (permission.hear_human if kind == "human" else permission.hear_e_stop)(value, now_ns)
    return permission.refusal(now_ns)


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
                 "human_in_loop was silent: let go of the deadman, then hold it again", id="silent_and_back"),
    pytest.param([HOLD, SILENCE, HOLD, HOLD, HOLD], False, "not re-armed",
                 "human_in_loop was silent: let go of the deadman, then hold it again", id="holding_on_rearms_nothing"),
    pytest.param([HOLD, SILENCE, LET_GO], False, "human absent", "human_in_loop is false", id="let_go_after_silence"),
    pytest.param([HOLD, LET_GO, SILENCE, HOLD], False, "not re-armed",
                 "human_in_loop was silent: let go of the deadman, then hold it again", id="silent_while_let_go"),
    pytest.param([HOLD, E_STOP], True, "e_stop", "e_stop is true", id="locked"),
    pytest.param([E_STOP, HOLD], True, "e_stop", "e_stop is true", id="locked_before_the_deadman"),
    pytest.param([HOLD, E_STOP, LET_GO, HOLD], True, "e_stop", "e_stop is true", id="re-arming_opens_no_lock"),
    pytest.param([HOLD, E_STOP, RUN], False, "not re-armed",
                 "the lock was on: let go of the deadman, then hold it again", id="lock_off_with_the_deadman_held"),
    pytest.param([HOLD, E_STOP, LET_GO, HOLD, RUN], False, "not re-armed",
                 "the lock was on: let go of the deadman, then hold it again", id="re-armed_too_early"),
    pytest.param([RUN, HOLD, ("silence", 400 * MS), HOLD, ("silence", 400 * MS), HOLD, ("silence", 400 * MS)], True,
                 "e_stop silent", "e_stop silent for 1.23 s", id="lock_silent"),
    pytest.param([RUN, LONG_SILENCE, RUN, HOLD], False, "not re-armed",
                 "the lock was on: let go of the deadman, then hold it again", id="lock_was_silent_before_the_deadman"),
])
def test_control_is_refused_with_the_reason(events, locked, cause, reason):
    assert after(*events) == (locked, cause, reason)


def test_lock_exactly_as_old_as_its_timeout_is_still_off():
    permission = Permission(PermissionConfig(human_timeout_s=0.0))
    permission.hear_e_stop(False, NOW)
    permission.hear_human(True, NOW)
    assert permission.refusal(NOW + S) is None
    assert permission.refusal(NOW + S + 1).locked


def test_loss_that_nobody_asked_about_while_it_lasted_is_a_loss_all_the_same():
    permission = Permission(PermissionConfig(human_timeout_s=0.0))
    permission.hear_human(True, NOW)
    permission.hear_e_stop(False, NOW)
    permission.hear_e_stop(False, NOW + 3 * S)
    assert permission.refusal(NOW + 3 * S).cause == "not re-armed"


def test_lock_never_heard_is_off_unless_it_is_required():
    assert after(HOLD) is None
    assert after(HOLD, e_stop_required=True) == (
        True, "e_stop never heard", "e_stop was never heard, and e_stop_required is true")
    assert after(HOLD, RUN, e_stop_required=True).cause == "not re-armed"
    assert after(HOLD, RUN, LET_GO, HOLD, e_stop_required=True) is None


def test_lock_with_a_timeout_of_0_may_be_silent_for_ever():
    assert after(RUN, ("silence", 3600 * S), HOLD, e_stop_timeout_s=0.0) is None


def test_ages_are_told():
    permission = Permission(PermissionConfig())
    assert (permission.human_age_s(NOW), permission.e_stop_age_s(NOW)) == (math.inf, math.inf)
    permission.hear_human(True, NOW)
    permission.hear_e_stop(False, NOW + S // 4)
    assert (permission.human_age_s(NOW + S), permission.e_stop_age_s(NOW + S)) == (1.0, 0.75)


@given(st.lists(st.sampled_from([E_STOP, RUN, HOLD, LET_GO, SILENCE, LONG_SILENCE]), max_size=12))
def test_whatever_happened_the_car_moves_only_with_the_deadman_held_and_the_lock_not_on(events):
    if after(*events) is None:
        heard = [value for kind, value in events if kind == "human"]
        locks = [value for kind, value in events if kind == "e_stop"]
        assert heard[-1] is True
        assert not (locks and locks[-1])
        assert events[-1] not in (SILENCE, LONG_SILENCE)


@given(st.lists(st.sampled_from([E_STOP, RUN, HOLD, SILENCE, LONG_SILENCE]), max_size=12),
       st.sampled_from([SILENCE, E_STOP]))
def test_after_a_loss_nothing_but_letting_go_brings_control_back(events, loss):
    assert after(HOLD, loss, *events) is not None
