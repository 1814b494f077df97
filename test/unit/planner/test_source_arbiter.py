"""One source at a time; silence; the others by name."""
from __future__ import annotations

import math

import pytest

from car_interface.common import causes
from car_interface.planner.request import PlannerRequest, Refusal
from car_interface.planner.source_arbiter import SPEED, SourceArbiter

MS, S = 1_000_000, 1_000_000_000
LEFT = PlannerRequest(2.0, 1.0)


def heard(command=LEFT, source="drive", at_ns=0):
    arbiter = SourceArbiter(source, 0.5)
    arbiter.update(command, at_ns)
    return arbiter


def test_newest_command_is_obeyed():
    decision = heard().decide(MS)
    assert (decision.cause, decision.request, decision.radius_m) == (causes.PLANNER, LEFT, 2.0)
    assert decision.reason == "drive asks for 1.00 m/s, a radius of 2.00 m"


@pytest.mark.parametrize("command, reason", [
    (PlannerRequest(math.inf, -1.0), "drive asks for -1.00 m/s, straight on"),
    (PlannerRequest(-2.0, 0.0, gear="park"), "drive asks for 0.00 m/s, a radius of -2.00 m, gear PARK"),
])
def test_reason_is_in_words(command, reason):
    assert heard(command).decide(0).reason == reason


def test_source_that_was_never_received_has_no_request():
    decision = SourceArbiter("cmd_vel", 0.5).decide(0)
    assert decision == (causes.NO_REQUEST, "cmd_vel was never heard", None, 0.0)


def test_silent_source_has_no_request_from_its_timeout_on():
    arbiter = heard(at_ns=S)
    assert arbiter.silent_at_ns(S) == S + 500 * MS + 1
    assert arbiter.decide(S + 500 * MS).request == LEFT
    decision = arbiter.decide(arbiter.silent_at_ns(S + 100 * MS))
    assert decision == (causes.PLANNER_STALE, "drive silent for 0.50 s", None, 0.0)
    assert arbiter.silent_at_ns(S + 600 * MS) == math.inf


def test_source_that_comes_back_is_obeyed_at_once():
    arbiter = heard()
    assert arbiter.decide(10 * S).request is None
    arbiter.update(LEFT, 11 * S)
    assert arbiter.decide(11 * S).request == LEFT


@pytest.mark.parametrize("period_ms", [5, 200])
def test_sources_of_200_and_5_hz_stay_fresh(period_ms):
    arbiter = heard()
    for at_ms in range(0, 3000, period_ms):
        assert arbiter.decide(at_ms * MS).request == LEFT
        arbiter.update(LEFT, at_ms * MS)


def test_refusal_is_no_request_and_is_counted():
    arbiter = heard()
    arbiter.update(Refusal(causes.REQUEST_REFUSED, "why"), MS)
    assert arbiter.decide(2 * MS) == (causes.REQUEST_REFUSED, "drive: why", None, 0.0)
    assert arbiter.refused == 1


def test_stop_that_says_nothing_about_the_steering_keeps_the_radius():
    """A car that brakes in a bend stays on its arc."""
    arbiter = heard()
    arbiter.update(PlannerRequest(None, 0.0), MS)
    assert arbiter.decide(MS).radius_m == 2.0


def test_such_a_stop_at_first_or_after_a_silence_is_straight_on():
    assert heard(PlannerRequest(None, 0.0)).decide(0).radius_m == math.inf
    arbiter = heard()
    arbiter.update(PlannerRequest(None, 0.0), 10 * S)
    assert arbiter.decide(10 * S).radius_m == math.inf


def test_radius_from_before_a_refusal_does_not_come_back():
    arbiter = heard()
    arbiter.update(Refusal(causes.REQUEST_REFUSED, "why"), MS)
    arbiter.update(PlannerRequest(None, 0.0), 2 * MS)
    assert arbiter.decide(2 * MS).radius_m == math.inf


def test_source_of_speeds_alone_asks_nothing_of_the_steering():
    decision = heard(PlannerRequest(None, 1.0), SPEED).decide(0)
    assert (decision.radius_m, decision.reason) == (0.0, "speed asks for 1.00 m/s")


def test_dropped_messages_make_it_silent_until_the_next():
    arbiter = heard()
    arbiter.mark_stale()
    assert arbiter.decide(MS).reason == "drive was not heard since messages were dropped"
    assert arbiter.silent_at_ns(MS) == math.inf


def test_other_sources_are_counted_and_named():
    arbiter = SourceArbiter("drive", 0.5)
    assert arbiter.others == ""
    for _ in range(3):
        arbiter.count_other("cmd_vel", "/move_base")
    arbiter.count_other("autoware", "")
    assert arbiter.others == ("autoware: 1 message, the last from an unknown node; "
                              "cmd_vel: 3 messages, the last from /move_base")
    assert arbiter.decide(0).reason == f"drive was never heard; not obeyed: {arbiter.others}"
