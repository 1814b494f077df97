"""One source at a time; silence; the others by name."""
from __future__ import annotations

import math

import pytest

from car_interface.common import causes
from car_interface.planner.ackermann import from_ackermann
from car_interface.planner.request import PlannerRequest, Refusal, sane_radius_m
from car_interface.planner.source_arbiter import SPEED, SourceArbiter
from car_interface.planner.twist import RATE, from_twist

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


# --- a source that was refused for an angle ---

DEGREES = Refusal(causes.REQUEST_REFUSED, "drive.steering_angle of 3 rad (degrees?): no wheel turns so far", True)
WHEELBASE_M = 0.3
TWENTIETH = 50 * MS


def refused(at_ns=0):
    """One whose source has just sent an angle in degrees."""
    arbiter = SourceArbiter("drive", 0.5, sane_radius_m(WHEELBASE_M))
    arbiter.update(DEGREES, at_ns)
    return arbiter


def sent(arbiter, command, begin_ns, end_ns, period_ns=TWENTIETH):
    """The decisions after each of a source's messages, from ``begin_ns`` to ``end_ns``."""
    decisions = []
    for now_ns in range(begin_ns, end_ns + 1, period_ns):
        arbiter.update(command, now_ns)
        decisions.append(arbiter.decide(now_ns))
    return decisions


def test_source_refused_for_an_angle_stays_refused_until_it_was_sane_for_2_s():
    arbiter = refused()
    decisions = sent(arbiter, LEFT, TWENTIETH, TWENTIETH + 2 * S)
    assert {decision.cause for decision in decisions[:-1]} == {causes.REQUEST_REFUSED}
    assert all(decision.request is None and decision.radius_m == 0.0 for decision in decisions[:-1])
    assert (decisions[-1].cause, decisions[-1].request) == (causes.PLANNER, LEFT)
    assert arbiter.refused == len(decisions)  # and the angle in degrees


def test_it_says_for_how_long():
    arbiter = refused()
    assert arbiter.decide(0).reason == f"drive: {DEGREES.reason}; refused until it was sane for 2 s"
    decision = sent(arbiter, LEFT, TWENTIETH, TWENTIETH + 700 * MS)[-1]
    assert decision.reason == f"drive: {DEGREES.reason}; refused until it was sane for 2 s, 1.3 s more"


def test_another_angle_in_degrees_begins_the_2_s_anew():
    arbiter = refused()
    sent(arbiter, LEFT, TWENTIETH, 1900 * MS)
    arbiter.update(DEGREES, 1950 * MS)
    decisions = sent(arbiter, LEFT, 2 * S, 4 * S)
    assert [decision.cause for decision in decisions].count(causes.PLANNER) == 1
    assert decisions[-1].request == LEFT


@pytest.mark.parametrize("command", [
    pytest.param(Refusal(causes.REQUEST_NOT_FINITE, "nan"), id="one_that_is_not_finite"),
    pytest.param(PlannerRequest(WHEELBASE_M / math.tan(1.2), 1.0), id="an_angle_of_1.2_rad_to_the_left"),
    pytest.param(PlannerRequest(-WHEELBASE_M / math.tan(1.2), 1.0), id="an_angle_of_1.2_rad_to_the_right"),
])
def test_so_does_what_no_sane_planner_sends(command):
    arbiter = refused()
    sent(arbiter, LEFT, TWENTIETH, 1900 * MS)
    arbiter.update(command, 1950 * MS)
    assert arbiter.decide(1950 * MS).request is None
    decisions = sent(arbiter, LEFT, 2 * S, 4 * S)
    assert [decision.cause for decision in decisions].count(causes.PLANNER) == 1


def test_a_silence_is_not_sane():
    arbiter = refused()
    arbiter.update(LEFT, TWENTIETH)
    assert arbiter.decide(S).cause == causes.PLANNER_STALE
    decisions = sent(arbiter, LEFT, 10 * S, 12 * S)
    assert {decision.cause for decision in decisions[:-1]} == {causes.REQUEST_REFUSED}
    assert decisions[-1].request == LEFT


def test_nor_are_messages_that_were_dropped():
    arbiter = refused()
    sent(arbiter, LEFT, TWENTIETH, S)
    arbiter.mark_stale()
    assert sent(arbiter, LEFT, S + TWENTIETH, 3 * S)[-1].request is None


def test_an_angle_in_degrees_that_swings_from_side_to_side_is_never_obeyed():
    """±3 "rad", 20 times a second, each wave in 2 s: a third of the angles look like those of wheels."""
    arbiter = SourceArbiter("drive", 0.5, sane_radius_m(WHEELBASE_M))
    obeyed = []
    for tick in range(200):
        angle_rad, now_ns = 3.0 * math.cos(math.pi * tick / 20), tick * TWENTIETH
        arbiter.update(from_ackermann(angle_rad, 1.0, 0.0, 0.0, WHEELBASE_M), now_ns)
        obeyed.append(arbiter.decide(now_ns).request is not None)
    assert not any(obeyed)


def test_turn_on_the_spot_is_refused_by_itself_alone():
    """A planner ends its path so, and teleop_twist_keyboard has keys for it: the next twist is obeyed."""
    arbiter = SourceArbiter("cmd_vel", 0.5, sane_radius_m(WHEELBASE_M))
    arbiter.update(from_twist(0.0, 1.0, RATE, WHEELBASE_M), 0)
    assert arbiter.decide(0).reason == "cmd_vel: angular.z is 1 rad/s at linear.x 0 m/s: a car can't turn on the spot"
    arbiter.update(from_twist(0.5, 0.1, RATE, WHEELBASE_M), TWENTIETH)
    assert arbiter.decide(TWENTIETH).request == PlannerRequest(5.0, 0.5)


def test_sane_source_is_never_refused_for_a_steep_angle():
    arbiter = SourceArbiter("drive", 0.5, sane_radius_m(WHEELBASE_M))
    assert sent(arbiter, from_ackermann(1.2, 1.0, 0.0, 0.0, WHEELBASE_M), 0, S)[-1].cause == causes.PLANNER
