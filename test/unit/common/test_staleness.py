"""How long ago an input was heard. Time is a number that's passed in; nothing here waits."""
from __future__ import annotations

import math

import pytest

from car_interface.common.staleness import TimedInput

S = 1_000_000_000
AT = 1000 * S


def heard_once(timeout_s, value="something"):
    heard = TimedInput("human_in_loop", timeout_s)
    heard.update(value, AT)
    return heard


@pytest.mark.parametrize("timeout_s, age_ns, silent", [
    pytest.param(0.5, 0, False, id="just_heard_is_fresh"),
    pytest.param(0.5, S // 2, False, id="exactly_as_old_as_its_timeout_is_fresh"),
    pytest.param(0.5, S // 2 + 1, True, id="a_nanosecond_older_than_its_timeout_is_silent"),
    pytest.param(3600.0, 3600 * S, False, id="an_hour_old_is_fresh_with_a_timeout_of_an_hour"),
    pytest.param(3600.0, 3600 * S + 1, True, id="a_nanosecond_more_is_silent"),
    pytest.param(0.0, 10 ** 9 * S, False, id="timeout_0_is_never_silent_once_heard"),
    pytest.param(1e-10, 1, True, id="a_timeout_of_next_to_nothing_is_not_taken_for_never"),
])
def test_input_of_an_age_is_silent_or_not(timeout_s, age_ns, silent):
    assert heard_once(timeout_s).is_stale(AT + age_ns) is silent


@pytest.mark.parametrize("timeout_s", [0.0, 0.5])
def test_input_never_heard_is_silent_whatever_its_timeout(timeout_s):
    heard = TimedInput("human_in_loop", timeout_s)
    assert heard.is_stale(AT)
    assert not heard.was_received
    assert heard.age_s(AT) == math.inf
    assert heard.stale_reason(AT) == "human_in_loop was never heard"


def test_input_heard_again_is_fresh_with_the_newest_value():
    heard = heard_once(0.5, "old")
    assert heard.is_stale(AT + S)
    heard.update("new", AT + S)
    assert not heard.is_stale(AT + S + 1)
    assert heard.value == "new" and heard.was_received


def test_input_silent_for_a_while_says_so_in_words_and_seconds():
    heard = heard_once(0.5)
    assert heard.age_s(AT + 520_000_000) == pytest.approx(0.52)
    assert heard.stale_reason(AT + 520_000_000) == "human_in_loop silent for 0.52 s"


@pytest.mark.parametrize("timeout_s", [0.0, 0.5])
def test_input_marked_stale_is_silent_until_it_is_heard_again_whatever_its_timeout(timeout_s):
    heard = heard_once(timeout_s)
    heard.mark_stale()
    assert heard.is_stale(AT) and heard.was_received
    assert heard.stale_reason(AT) == "human_in_loop was not heard since messages were dropped"
    heard.update("new", AT)
    assert not heard.is_stale(AT)


def test_input_marked_stale_for_another_reason_says_that_one():
    heard = heard_once(0.5)
    heard.mark_stale("the planner paused")
    assert heard.stale_reason(AT) == "human_in_loop was not heard since the planner paused"
    heard.mark_stale()
    assert heard.stale_reason(AT) == "human_in_loop was not heard since messages were dropped"


def test_input_never_heard_stays_so_when_it_is_marked_stale():
    heard = TimedInput("human_in_loop", 0.5)
    heard.mark_stale()
    assert heard.stale_reason(AT) == "human_in_loop was never heard"
    heard.update("new", AT)
    assert not heard.is_stale(AT)
