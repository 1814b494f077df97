"""One source at a time; silence; the others by name."""
import math

import pytest

from car_interface.common import causes
from car_interface.common.sources import SPEED
from car_interface.planner.messages import RATE, PlannerRequest, Refusal, from_ackermann, from_twist, sane_radius_m
from car_interface.planner.source_arbiter import SourceArbiter

MS, S = 1_000_000, 1_000_000_000
LEFT = PlannerRequest(2.0, 1.0)
DEGREES = Refusal(causes.REQUEST_REFUSED, "drive.steering_angle of 3 rad (degrees?): no wheel turns so far", True)
WHEELBASE_M = 0.3
TWENTIETH = 50 * MS


def received(command=LEFT, source="drive", at_ns=0):
    arbiter = SourceArbiter(source, 0.5)
    arbiter.update(command, at_ns)
    return arbiter


@pytest.mark.parametrize("command, source, radius_m, reason", [
    (LEFT, "drive", 2.0, "drive asks for 1.00 m/s, a radius of 2.00 m"),
    (PlannerRequest(math.inf, -1.0), "drive", math.inf, "drive asks for -1.00 m/s, straight on"),
    (PlannerRequest(-2.0, 0.0, gear="park"), "drive", -2.0, "drive asks for 0.00 m/s, a radius of -2.00 m, gear PARK"),
    (PlannerRequest(None, 1.0), SPEED, 0.0, "speed asks for 1.00 m/s"),
])
def test_newest_command_is_obeyed_and_the_reason_says_it_in_words(command, source, radius_m, reason):
    assert received(command, source).decide(MS) == (causes.PLANNER, reason, command, radius_m)


def test_silent_source_has_no_request_from_its_timeout_on_and_is_obeyed_at_once_when_it_comes_back():
    arbiter = received(at_ns=S)
    assert arbiter.silent_at_ns(S) == S + 500 * MS + 1
    assert arbiter.decide(S + 500 * MS).request == LEFT
    decision = arbiter.decide(arbiter.silent_at_ns(S + 100 * MS))
    assert decision == (causes.PLANNER_STALE, "drive silent for 0.50 s", None, 0.0)
    assert arbiter.silent_at_ns(S + 600 * MS) == math.inf
    arbiter.update(LEFT, 11 * S)
    assert arbiter.decide(11 * S).request == LEFT and arbiter.age_s(12 * S) == 1.0


def test_refusal_is_no_request_and_is_counted():
    arbiter = received()
    arbiter.update(Refusal(causes.REQUEST_REFUSED, "why"), MS)
    assert arbiter.decide(2 * MS) == (causes.REQUEST_REFUSED, "drive: why", None, 0.0)
    assert arbiter.refused == 1


@pytest.mark.parametrize("before, at_ns, radius_m", [
    ([LEFT], MS, 2.0),  # a car that brakes in a bend stays on its arc
    ([], 0, math.inf),
    ([LEFT], 10 * S, math.inf),
    ([LEFT, Refusal(causes.REQUEST_REFUSED, "why")], MS, math.inf),
])
def test_stop_that_says_nothing_about_the_steering_keeps_a_radius_that_is_fresh(before, at_ns, radius_m):
    arbiter = SourceArbiter("drive", 0.5)
    for command in before:
        arbiter.update(command, 0)
    arbiter.update(PlannerRequest(None, 0.0), at_ns)
    assert arbiter.decide(at_ns).radius_m == radius_m


def test_dropped_messages_make_it_silent_until_the_next():
    arbiter = received()
    arbiter.mark_stale()
    assert arbiter.decide(MS).reason == "drive was not heard since messages were dropped"
    assert arbiter.silent_at_ns(MS) == math.inf


def test_source_that_was_never_received_has_no_request_and_others_are_counted_and_named():
    arbiter = SourceArbiter("drive", 0.5)
    assert arbiter.others == "" and arbiter.decide(0) == (causes.NO_REQUEST, "drive was never heard", None, 0.0)
    for _ in range(3):
        arbiter.count_other("cmd_vel", "/move_base")
    arbiter.count_other("autoware", "")
    assert arbiter.others == ("autoware: 1 message, the last from an unknown node; "
                              "cmd_vel: 3 messages, the last from /move_base")
    assert arbiter.decide(0).reason == f"drive was never heard; not obeyed: {arbiter.others}"


def refused():
    arbiter = SourceArbiter("drive", 0.5, sane_radius_m(WHEELBASE_M))
    arbiter.update(DEGREES, 0)
    return arbiter


def sent(arbiter, command, begin_ns, end_ns):
    """The decisions after each of a source's messages, 20 times a second."""
    decisions = []
    for now_ns in range(begin_ns, end_ns + 1, TWENTIETH):
        arbiter.update(command, now_ns)
        decisions.append(arbiter.decide(now_ns))
    return decisions


def test_source_refused_for_an_angle_stays_refused_until_it_was_sane_for_2_s_and_says_for_how_long():
    arbiter = refused()
    assert arbiter.decide(0).reason == f"drive: {DEGREES.reason}; refused until it was sane for 2 s"
    decisions = sent(arbiter, LEFT, TWENTIETH, TWENTIETH + 2 * S)
    assert {decision[0] for decision in decisions[:-1]} == {causes.REQUEST_REFUSED}
    assert {decision[2:] for decision in decisions[:-1]} == {(None, 0.0)}
    assert decisions[14].reason == f"drive: {DEGREES.reason}; refused until it was sane for 2 s, 1.3 s more"
    assert (decisions[-1].cause, decisions[-1].request) == (causes.PLANNER, LEFT)
    assert arbiter.refused == len(decisions)  # and the angle in degrees
    arbiter.update(PlannerRequest(0.1, 1.0), 3 * S)
    assert arbiter.decide(3 * S).cause == causes.PLANNER


def test_without_a_tightest_turn_any_radius_is_sane():
    arbiter = SourceArbiter("drive", 0.5)
    arbiter.update(DEGREES, 0)
    assert sent(arbiter, PlannerRequest(0.1, 1.0), TWENTIETH, TWENTIETH + 2 * S)[-1].cause == causes.PLANNER


@pytest.mark.parametrize("command", [
    DEGREES,
    Refusal(causes.REQUEST_NOT_FINITE, "nan"),
    PlannerRequest(sane_radius_m(WHEELBASE_M), 1.0),
    PlannerRequest(-WHEELBASE_M / math.tan(1.2), 1.0),
])
def test_what_no_sane_planner_sends_begins_the_2_s_again(command):
    arbiter = refused()
    sent(arbiter, LEFT, TWENTIETH, 1900 * MS)
    arbiter.update(command, 1950 * MS)
    assert arbiter.decide(1950 * MS).request is None
    decisions = sent(arbiter, LEFT, 2 * S, 4 * S)
    assert [decision.cause for decision in decisions].count(causes.PLANNER) == 1
    assert decisions[-1].request == LEFT


@pytest.mark.parametrize("is_dropped", [False, True])
def test_neither_a_silence_nor_dropped_messages_are_sane(is_dropped):
    arbiter = refused()
    sent(arbiter, LEFT, TWENTIETH, S)
    begin_ns = S + TWENTIETH if is_dropped else 2 * S
    if is_dropped:
        arbiter.mark_stale()
    decisions = sent(arbiter, LEFT, begin_ns, begin_ns + 2 * S)
    assert [decision.cause for decision in decisions] == [causes.REQUEST_REFUSED] * 40 + [causes.PLANNER]


def test_an_angle_in_degrees_that_swings_from_side_to_side_is_never_obeyed():
    """±3 "rad", 20 times a second, each wave in 2 s: a third of the angles look like those of wheels."""
    arbiter = SourceArbiter("drive", 0.5, sane_radius_m(WHEELBASE_M))
    obeyed = []
    for tick in range(200):
        angle_rad, now_ns = 3.0 * math.cos(math.pi * tick / 20), tick * TWENTIETH
        arbiter.update(from_ackermann(angle_rad, 1.0, 0.0, 0.0, WHEELBASE_M), now_ns)
        obeyed.append(arbiter.decide(now_ns).request is not None)
    assert not any(obeyed)


def test_turn_on_the_spot_is_refused_by_itself_alone_and_a_steep_angle_of_a_sane_source_never():
    """A planner ends its path so, and teleop_twist_keyboard has keys for it: the next twist is obeyed."""
    arbiter = SourceArbiter("cmd_vel", 0.5, sane_radius_m(WHEELBASE_M))
    arbiter.update(from_twist(0.0, 1.0, RATE, WHEELBASE_M), 0)
    assert arbiter.decide(0).reason == "cmd_vel: angular.z is 1 rad/s at linear.x 0 m/s: a car can't turn on the spot"
    arbiter.update(from_twist(0.5, 0.1, RATE, WHEELBASE_M), TWENTIETH)
    assert arbiter.decide(TWENTIETH).request == PlannerRequest(5.0, 0.5)
    assert sent(arbiter, from_ackermann(1.2, 1.0, 0.0, 0.0, WHEELBASE_M), S, 2 * S)[-1].cause == causes.PLANNER
