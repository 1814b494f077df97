"""Tuning while the car drives: what a request may change, and how fast. Time is passed in."""
import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from car_interface.common.live_parameters import Tuning, TuningSettings
from car_interface.steering.calibration import trimmed
from slash import SLASH

MS = 1_000_000
S = 1000 * MS
TICK = 10 * MS
MAX_OFFSET, RATE = 500, 500
NAMES = ("servo_left", "servo_center", "servo_right")


def values(left=3800, center=5100, right=6700):
    return dict(zip(NAMES, (left, center, right)))


def tuning(max_offset=MAX_OFFSET, rate=RATE, config=SLASH):
    start = {name: getattr(config, name) for name in NAMES}
    return Tuning(start, max_offset, rate, lambda wanted: trimmed(config, **wanted))


def settle(tuned, now_ns):
    """Ticks until it has arrived; all values that were in force on the way, the last one too."""
    seen = []
    while tuned.is_changing:
        now_ns += TICK
        assert tuned.advance(now_ns)
        seen.append(tuned.active)
        assert len(seen) < 10_000
    return seen


# --- what is accepted ---

def test_nothing_can_be_tuned_unless_the_parameters_allow_it():
    assert TuningSettings().max_offset == 0


@pytest.mark.parametrize("wanted, accepted, problem", [
    ({"servo_center": 5150}, values(center=5150), ""),
    (values(3850, 5150, 6750), values(3850, 5150, 6750), ""),
    ({"servo_channel": 7}, values(), ""),
    ({"servo_center": 5600}, values(center=5600), ""),
    ({"servo_center": 5601}, values(center=5600), "servo_center 5601 is beyond 4600 to 5600: clamped to 5600"),
    ({"servo_left": -1, "servo_right": 7201}, values(left=3300, right=7200),
     "servo_left -1 is beyond 3300 to 4300: clamped to 3300; servo_right 7201 is beyond 6200 to 7200: clamped to 7200"),
    ({"servo_left": 3700, "servo_center": 5100.5}, values(), "servo_center 5100.5 is no duty: refused"),
    ({"servo_center": math.nan}, values(), "servo_center nan is no duty: refused"),
    ({"servo_center": "5150"}, values(), "servo_center '5150' is no duty: refused"),
    ({"servo_center": True}, values(), "servo_center True is no duty: refused"),
])
def test_request_is_accepted_clamped_or_refused(wanted, accepted, problem):
    tuned = tuning()
    assert (tuned.request(wanted, 0), tuned.accepted) == (problem, accepted)


def test_center_beyond_an_end_is_refused_in_whole_and_changes_nothing():
    narrow = replace(SLASH, servo_left=5000)
    tuned = tuning(config=narrow)
    assert tuned.request({"servo_center": 4900, "servo_right": 6800}, 0) == (
        "servo_center is 4900; accepted: a duty between servo_left 5000 and servo_right 6800: refused")
    assert tuned.accepted == values(left=5000)
    assert not tuned.is_changing and tuned.changes == ""


def test_limits_are_those_around_the_values_at_start_as_far_as_there_are_duties():
    assert tuning(max_offset=0).request({"servo_center": 5101}, 0) == (
        "servo_center 5101 is beyond 5100 to 5100: clamped to 5100")
    ends = Tuning({"low": 100, "high": 65500}, 500, RATE, lambda wanted: None)
    assert (ends.low, ends.high) == ({"low": 0, "high": 65000}, {"low": 600, "high": 65535})
    tuned = tuning()
    for _ in range(3):
        tuned.request({"servo_center": 9999}, 0)
        settle(tuned, 0)
    assert tuned.active == values(center=5600)


def test_changes_are_reported_in_words_and_a_value_put_back_is_none():
    tuned = tuning()
    tuned.request({"servo_center": 5150, "servo_left": 3790}, 0)
    assert tuned.changes == "servo_left 3800 → 3790, servo_center 5100 → 5150"
    tuned.request(values(), S)
    assert tuned.changes == ""


# --- how it gets there ---

def test_accepted_values_are_reached_together_at_the_rate_and_no_faster():
    tuned = tuning()
    tuned.request({"servo_center": 5150}, 0)
    assert tuned.is_changing and tuned.active == values()
    seen = [step["servo_center"] for step in settle(tuned, 0)]
    assert seen == [5105, 5110, 5115, 5120, 5125, 5130, 5135, 5140, 5145, 5150]
    assert not tuned.advance(S)
    tuned = tuning()
    tuned.request(values(3900, 5200, 6300), 0)
    seen = settle(tuned, 0)
    assert len(seen) == 80 and seen[39] == values(3850, 5150, 6500) and seen[-1] == values(3900, 5200, 6300)


def test_change_takes_exactly_as_long_as_the_rate_says():
    tuned = tuning(rate=1_000_000)  # a duty in 1000 ns
    tuned.request({"servo_center": 5101}, S)
    for now_ns, is_changing in ((S + 999, True), (S + 999, True), (S + 1000, False)):
        tuned.advance(now_ns)
        assert tuned.is_changing == is_changing


@pytest.mark.parametrize("times_ns, center", [([3 * S], 5125), ([S, S - TICK], 5100)])
def test_node_that_was_held_up_does_not_jump_and_a_clock_that_stands_moves_nothing(times_ns, center):
    tuned = tuning()
    tuned.request({"servo_center": 5600}, 0 if len(times_ns) == 1 else S)
    for now_ns in times_ns:
        assert tuned.advance(now_ns)
    assert tuned.active["servo_center"] == center and tuned.is_changing


def test_request_on_the_way_starts_from_where_the_values_are_and_the_same_one_again_does_not_start_again():
    tuned = tuning()
    for tick in range(11):
        tuned.request({"servo_center": 5600}, tick * TICK)
        tuned.advance(tick * TICK)
    assert tuned.active["servo_center"] == 5150
    tuned.request({"servo_center": 5100}, 10 * TICK)
    assert tuned.active["servo_center"] == 5150
    assert [step["servo_center"] for step in settle(tuned, 10 * TICK)][:2] == [5145, 5140]


TRIPLES = st.tuples(st.integers(3000, 4600), st.integers(4300, 5900), st.integers(5900, 7500))


@pytest.mark.once
@given(st.lists(TRIPLES, min_size=1, max_size=4), st.integers(1, 60), st.sampled_from([1, 37, 500, 20_000]))
def test_whatever_is_asked_each_step_is_valid_and_within_the_rate(wanted, ticks, rate):
    tuned = tuning(rate=rate)
    now_ns, before = 0, tuned.active
    for request in wanted:
        tuned.request(values(*request), now_ns)
        for _ in range(ticks):
            now_ns += TICK
            tuned.advance(now_ns)
            trimmed(SLASH, **tuned.active)
            assert all(tuned.low[name] <= value <= tuned.high[name] for name, value in tuned.active.items())
            assert max(abs(tuned.active[name] - before[name]) for name in NAMES) <= rate * TICK / S + 1
            before = tuned.active
