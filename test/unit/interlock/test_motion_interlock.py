"""Whether the car may move at all: lock, deadman, and how what was lost comes back. Time is passed in."""
from __future__ import annotations

import re
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from car_interface.common.declared import read
from car_interface.common.params import Params
from car_interface.interlock.motion_interlock import InterlockConfig, MotionInterlock

CONFIG_FILES = Path(__file__).resolve().parents[3] / "config"
S = 1_000_000_000
MS = 1_000_000
NOW = 1000 * S
E_STOP, RUN = ("e_stop", True), ("e_stop", False)
PHONE_STOPS, PHONE_CLEARS = ("phone_e_stop", True), ("phone_e_stop", False)
HOLD, LET_GO = ("human", True), ("human", False)
SILENCE = ("silence", 600 * MS)  # longer than the deadman's timeout, shorter than the lock's
LONG_SILENCE = ("silence", 1100 * MS)  # longer than both
DROPPED = ("dropped", None)  # messages, before they got here
NOTHING_GRANTED = {"grant_at_start": False}
WAITS = (False, "starting", "this node has just started: it waits up to 1 s for e_stop")
TO_REARM = (False, "not re-armed", "this node has just started; let go once: publish false, then true")
UNLOCK = "it unlocks once somebody keeps publishing e_stop false"
E_STOP_UNKNOWN = (True, "e_stop silent", f"e_stop was not heard since messages were dropped; {UNLOCK}")
WERE_DROPPED = (False, "not re-armed", "messages were dropped; let go once: publish false, then true")
GAMEPAD = "the gamepad has 4 axes (0 to 3), but throttle_axis is 4"


def after(*events, explanation=None, awaits_phone=False, **changes):
    """The inhibit after a row of events, each 10 ms after the one before; ``None`` = the car may move."""
    interlock = MotionInterlock(InterlockConfig(**changes))
    if awaits_phone:
        interlock.await_phone_e_stop()
    now_ns = NOW
    interlock.inhibit(now_ns)  # the start
    for kind, value in events:
        now_ns += value if kind == "silence" else 10 * MS
        if explanation is not None:
            interlock.explain_human(*explanation, now_ns)
        if kind == "dropped":
            interlock.mark_stale(now_ns)
        elif kind != "silence":
            getattr(interlock, f"update_{kind}")(value, now_ns)
    return interlock.inhibit(now_ns)


ABSENT = (False, "human absent", "human_in_loop is false")
WAS_SILENT = (False, "not re-armed", "human_in_loop was silent; let go once: publish false, then true")
WAS_LOCKED = (False, "not re-armed", "the lock was on; let go once: publish false, then true")
LOCKED = (True, "e_stop", "e_stop is true")
NEVER_HEARD = (True, "e_stop never heard", "e_stop was never heard, and e_stop_required is true")
PAUSE = ("silence", 400 * MS)
LOCKED_BY_PHONE = (True, "e_stop", "phone/e_stop is true")
PHONE_UNLOCKS = "it unlocks once somebody keeps publishing phone/e_stop false"
PHONE_SILENT = (True, "e_stop silent", f"phone/e_stop silent for 1.13 s; {PHONE_UNLOCKS}")


@pytest.mark.parametrize("events, inhibit", [
    ([HOLD, PHONE_STOPS], LOCKED_BY_PHONE),
    ([HOLD, PHONE_STOPS, RUN, RUN, LET_GO, HOLD], LOCKED_BY_PHONE),
    ([HOLD, PHONE_STOPS, PHONE_CLEARS, HOLD], WAS_LOCKED),
    ([HOLD, PHONE_STOPS, PHONE_CLEARS, LET_GO, HOLD], None),
    ([HOLD, PHONE_STOPS, E_STOP, PHONE_CLEARS, LET_GO, HOLD], LOCKED),
    ([HOLD, E_STOP, PHONE_CLEARS, LET_GO, HOLD], LOCKED),
    ([HOLD, PHONE_CLEARS, LONG_SILENCE, RUN, LET_GO, HOLD], PHONE_SILENT),
    ([HOLD, PHONE_STOPS, PHONE_CLEARS, DROPPED, RUN, LET_GO, HOLD],
     (True, "e_stop silent", f"phone/e_stop was not heard since messages were dropped; {PHONE_UNLOCKS}")),
    ([HOLD, PHONE_STOPS, PHONE_CLEARS, DROPPED, RUN, PHONE_CLEARS, HOLD], WERE_DROPPED),
    ([HOLD, PHONE_CLEARS, DROPPED, LONG_SILENCE, PHONE_CLEARS, HOLD], WERE_DROPPED),
    ([HOLD, PHONE_CLEARS, DROPPED, LONG_SILENCE, HOLD, PHONE_CLEARS], WERE_DROPPED),
])
def test_phone_s_e_stop_is_ored_with_the_other_one_and_must_go_on_once_it_was_heard(events, inhibit):
    assert after(*events) == inhibit


def test_required_e_stop_is_not_replaced_by_the_phone_s():
    assert after(PHONE_CLEARS, LET_GO, HOLD, e_stop_required=True) == NEVER_HEARD


@pytest.mark.parametrize("events, inhibit", [
    ([HOLD], None),
    ([LET_GO, HOLD], None),
    ([HOLD, LET_GO, HOLD], None),
    ([RUN, HOLD], None),
    ([HOLD, SILENCE, LET_GO, HOLD], None),
    ([HOLD, E_STOP, HOLD, RUN, LET_GO, HOLD], None),
    ([RUN, HOLD, LONG_SILENCE, RUN, LET_GO, HOLD], None),
    ([], (False, "human never heard", "human_in_loop was never heard")),
    ([LET_GO], ABSENT),
    ([HOLD, SILENCE], (False, "human silent", "human_in_loop silent for 0.60 s")),
    ([HOLD, SILENCE, HOLD, HOLD], WAS_SILENT),
    ([HOLD, SILENCE, LET_GO], ABSENT),
    ([HOLD, LET_GO, SILENCE, HOLD], WAS_SILENT),
    ([E_STOP, HOLD], LOCKED),
    ([HOLD, E_STOP, LET_GO, HOLD], LOCKED),
    ([HOLD, E_STOP, RUN], WAS_LOCKED),
    ([HOLD, E_STOP, LET_GO, HOLD, RUN], WAS_LOCKED),
    ([RUN, HOLD, PAUSE, HOLD, PAUSE, HOLD, PAUSE], (True, "e_stop silent", f"e_stop silent for 1.23 s; {UNLOCK}")),
    ([RUN, LONG_SILENCE, RUN, HOLD], WAS_LOCKED),
], ids=str)
def test_car_may_move_by_a_deadman_that_is_held_and_was_let_go_since_the_last_loss(events, inhibit):
    assert after(*events) == inhibit


def test_lock_exactly_as_old_as_its_timeout_is_still_off():
    interlock = MotionInterlock(InterlockConfig(human_timeout_s=0.0))
    interlock.update_e_stop(False, NOW)
    interlock.update_human(True, NOW)
    assert interlock.inhibit(NOW + S) is None
    assert interlock.inhibit(NOW + S + 1).locked


@pytest.mark.parametrize("name", ["update_e_stop", "update_phone_e_stop"])
def test_loss_that_nobody_asked_about_while_it_lasted_is_a_loss_all_the_same(name):
    interlock = MotionInterlock(InterlockConfig(human_timeout_s=0.0))
    update = getattr(interlock, name)
    interlock.update_human(True, NOW)
    update(False, NOW)
    update(False, NOW + 3 * S)
    assert interlock.inhibit(NOW + 3 * S).cause == "not re-armed"


def test_lock_that_was_never_received_is_off_unless_it_is_required():
    assert after(HOLD) is None
    assert after(HOLD, e_stop_required=True) == NEVER_HEARD
    assert after(HOLD, RUN, e_stop_required=True) == WAS_LOCKED
    assert after(HOLD, RUN, LET_GO, HOLD, e_stop_required=True) is None
    assert after(RUN, ("silence", 3600 * S), HOLD, e_stop_timeout_s=0.0) is None


@pytest.mark.parametrize("events, inhibit", [
    ([LONG_SILENCE, LET_GO, HOLD], None),
    ([HOLD, LONG_SILENCE, HOLD, LET_GO, HOLD], None),
    ([RUN, LET_GO, HOLD], None),
    ([HOLD, RUN, LET_GO, HOLD], None),
    ([E_STOP, RUN, LET_GO, HOLD], None),
    ([], WAITS),
    ([LET_GO, HOLD], WAITS),
    ([HOLD, LONG_SILENCE, HOLD], WAS_SILENT),
    ([LONG_SILENCE], (False, "human never heard", "human_in_loop was never heard")),
    ([LONG_SILENCE, LET_GO], ABSENT),
    ([LONG_SILENCE, HOLD], TO_REARM),
    ([LET_GO, ("silence", 480 * MS), LET_GO, ("silence", 480 * MS), LET_GO, HOLD], TO_REARM),
    ([RUN, HOLD, HOLD], TO_REARM),
    ([LET_GO, RUN, HOLD], TO_REARM),
    ([E_STOP, LET_GO, HOLD], LOCKED),
    ([E_STOP, LET_GO, HOLD, RUN], WAS_LOCKED),
], ids=str)
def test_start_that_grants_nothing_takes_letting_go_once_e_stop_could_have_arrived(events, inhibit):
    assert after(*events, **NOTHING_GRANTED) == inhibit


@pytest.mark.parametrize("events, inhibit", [
    ([RUN, LET_GO, HOLD], "starting"),
    ([PHONE_CLEARS, LET_GO, HOLD], "starting"),
    ([RUN, LET_GO, PHONE_CLEARS, HOLD], "not re-armed"),
    ([RUN, LET_GO, PHONE_STOPS, HOLD], "e_stop"),
    ([RUN, PHONE_CLEARS, LET_GO, HOLD], None),
    ([RUN, ("silence", 900 * MS), RUN, LET_GO, HOLD, ("silence", 90 * MS), LET_GO, HOLD], None),
], ids=str)
def test_start_while_the_phone_s_stop_was_on_waits_for_that_one_too(events, inhibit):
    found = after(*events, awaits_phone=True, **NOTHING_GRANTED)
    assert (found and found.cause) == inhibit
    if inhibit == "starting":
        name = "e_stop" if PHONE_CLEARS in events else "phone/e_stop"
        assert found.reason == f"this node has just started: it waits up to 1 s for {name}"


def test_without_an_e_stop_timeout_there_is_nothing_to_wait_for():
    assert after(HOLD, e_stop_timeout_s=0.0, **NOTHING_GRANTED) == TO_REARM
    assert after(LET_GO, HOLD, e_stop_timeout_s=0.0, **NOTHING_GRANTED) is None
    assert after(HOLD, DROPPED, LET_GO, HOLD, e_stop_timeout_s=0.0) is None


@pytest.mark.parametrize("e_stop_timeout_s", [0.0, 1.0])
def test_start_with_a_required_e_stop_waits_for_it_however_long_that_takes(e_stop_timeout_s):
    settings = {"e_stop_timeout_s": e_stop_timeout_s, "e_stop_required": True, **NOTHING_GRANTED}
    assert after(("silence", 3600 * S), LET_GO, HOLD, **settings) == NEVER_HEARD
    assert after(("silence", 3600 * S), LET_GO, HOLD, RUN, **settings) == WAS_LOCKED
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


def test_parameters_have_defaults_and_are_read_by_name():
    assert read(Params({"input_timeout": 0.7}), InterlockConfig, same_as={"human_timeout": "input_timeout"}) == (
        InterlockConfig(0.7, 1.0, False, True))
    assert read(Params({"human_timeout": 0.2, "e_stop_timeout": 3, "e_stop_required": True, "grant_at_start": False}),
                InterlockConfig) == InterlockConfig(0.2, 3.0, True, False)


@pytest.mark.parametrize("name", ["turn_arb.yaml", "throttle.yaml"])
def test_shipped_configuration_grants_nothing_at_start(name):
    assert re.findall(r"(?m)^grant_at_start: *(\w+)", (CONFIG_FILES / name).read_text(encoding="utf-8")) == ["false"]


@pytest.mark.parametrize("before, since, inhibit", [
    ([RUN, HOLD], [], E_STOP_UNKNOWN),
    ([RUN, HOLD], [LET_GO, HOLD], E_STOP_UNKNOWN),
    ([RUN, HOLD], [RUN], (False, "human silent", "human_in_loop was not heard since messages were dropped")),
    ([RUN, HOLD], [RUN, HOLD], WERE_DROPPED),
    ([RUN, HOLD], [RUN, LET_GO, HOLD], None),
    ([HOLD], [HOLD], (False, "starting", "messages were dropped: it waits up to 1 s for e_stop")),
    ([HOLD], [LONG_SILENCE, HOLD], WERE_DROPPED),
    ([HOLD], [LONG_SILENCE, LET_GO, HOLD], None),
], ids=str)
@pytest.mark.parametrize("grant_at_start", [True, False])
def test_dropped_messages_are_a_loss_of_everything(before, since, inhibit, grant_at_start):
    armed = [RUN if RUN in before else LONG_SILENCE, LET_GO, *before]
    assert after(*armed, grant_at_start=grant_at_start) is None
    assert after(*armed, DROPPED, *since, grant_at_start=grant_at_start) == inhibit


@pytest.mark.parametrize("human, released", [
    (None, False), ((True, 0), False), ((False, 500), True), ((False, 501), False)])
def test_deadman_is_known_to_be_released_by_a_fresh_false(human, released):
    interlock = MotionInterlock(InterlockConfig())
    if human is not None:
        interlock.update_human(human[0], NOW - human[1] * MS)
    assert interlock.is_released(NOW) is released


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
       st.sampled_from([SILENCE, E_STOP, DROPPED]), st.booleans())
def test_after_a_loss_or_a_start_that_grants_nothing_nothing_but_letting_go_brings_control(events, loss, required):
    assert after(HOLD, loss, *events) is not None
    assert after(*events, e_stop_required=required, **NOTHING_GRANTED) is not None


@given(st.lists(st.sampled_from([E_STOP, RUN, HOLD, LET_GO, SILENCE, LONG_SILENCE]), max_size=12))
def test_start_that_grants_nothing_never_grants_what_the_other_one_refuses(events):
    if after(*events) is not None:
        assert after(*events, **NOTHING_GRANTED) is not None


@pytest.mark.parametrize("present, reason, age_ms, quoted", [
    (False, GAMEPAD, 500, f": {GAMEPAD}"),
    (False, GAMEPAD, 501, ""),  # a latched message outlives the node that sent it
    (True, "manual deadman held", 0, ""),
    (False, "a\n b", 0, ": a b"),
    (False, "x" * 301, 0, f": {'x' * 300}"),
])
def test_explanation_of_a_false_deadman_is_quoted_on_one_line_of_bounded_length(present, reason, age_ms, quoted):
    interlock = MotionInterlock(InterlockConfig())
    interlock.explain_human(present, reason, NOW - age_ms * MS)
    interlock.update_human(False, NOW)
    assert interlock.inhibit(NOW).reason == f"human_in_loop is false{quoted}"


@pytest.mark.once
@given(st.lists(st.sampled_from([HOLD, LET_GO, E_STOP, RUN, SILENCE, DROPPED]), max_size=12), st.booleans(), st.text())
def test_explanation_never_changes_what_is_permitted(events, present, text):
    plain, explained = after(*events), after(*events, explanation=(present, text))
    assert plain == explained or plain[:2] == explained[:2] == (False, "human absent")
