"""How long ago an input was timed. Time is a number that's passed in; nothing here waits."""
import math

import pytest

from car_interface.common.staleness import TimedInput

S = 1_000_000_000
AT = 1000 * S


def received_once(timeout_s, value="something"):
    timed = TimedInput("human_in_loop", timeout_s)
    timed.update(value, AT)
    return timed


@pytest.mark.parametrize("timeout_s, age_ns, stale", [
    (0.5, S // 2, False),
    (0.5, S // 2 + 1, True),
    (3600.0, 3600 * S, False),
    (0.0, 10 ** 9 * S, False),
    (1e-10, 1, True),
])
def test_input_is_stale_when_it_is_older_than_its_timeout(timeout_s, age_ns, stale):
    timed = received_once(timeout_s)
    assert timed.is_stale(AT + age_ns) is stale
    assert timed.fresh(AT + age_ns) == (None if stale else "something")


@pytest.mark.parametrize("timeout_s", [0.0, 0.5])
def test_input_that_was_never_received_is_stale_and_stays_so_when_it_is_marked_stale(timeout_s):
    timed = TimedInput("human_in_loop", timeout_s)
    assert timed.is_stale(AT) and not timed.is_marked_stale and timed.was_late_s == 0.0
    timed.mark_stale()
    assert timed.is_stale(AT) and not timed.was_received and not timed.is_marked_stale
    assert timed.age_s(AT) == math.inf
    assert timed.stale_reason(AT) == "human_in_loop was never heard"
    timed.update("new", AT)
    assert not timed.is_stale(AT) and timed.was_received and timed.value == "new"


def test_input_that_was_stale_for_a_while_says_so_until_it_is_received_again():
    timed = received_once(0.5, "old")
    assert timed.age_s(AT + 520_000_000) == pytest.approx(0.52)
    assert timed.stale_reason(AT + 520_000_000) == "human_in_loop silent for 0.52 s"
    assert timed.age_s(AT) == timed.age_s(AT - 1) == 0.0
    timed.update("new", AT + S)
    assert not timed.is_stale(AT + S + 1) and timed.value == "new"


@pytest.mark.parametrize("timeout_s", [0.0, 0.5])
def test_input_that_was_marked_stale_says_why_until_it_is_received_again_whatever_its_timeout(timeout_s):
    timed = received_once(timeout_s)
    for since, words in ((("the planner paused",), "the planner paused"), ((), "messages were dropped")):
        timed.mark_stale(*since)
        assert timed.is_stale(AT) and timed.was_received
        assert timed.stale_reason(AT) == f"human_in_loop was not heard since {words}"
    timed.update("new", AT)
    assert not timed.is_stale(AT) and not timed.is_marked_stale


def test_what_a_stamp_says_adds_to_the_age_and_a_stamp_in_the_future_takes_nothing_from_it():
    timed = TimedInput("odom", 0.5)
    timed.update(1.0, AT, age_ns=3 * S // 10)
    assert timed.age_s(AT + S // 10) == pytest.approx(0.4) and timed.silence_s(AT + S // 10) == pytest.approx(0.1)
    assert not timed.is_stale(AT + S // 5) and timed.is_stale(AT + S // 5 + 1)
    assert timed.stale_reason(AT + 3 * S // 10 - 1) == "odom is 0.60 s old by its stamp"
    assert timed.stale_reason(AT + 3 * S // 10) == "odom silent for 0.30 s"
    timed.update(1.0, AT + S, age_ns=-S)
    assert timed.age_s(AT + S) == timed.was_late_s == 0.0
