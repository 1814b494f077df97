"""Who steers, and with what duty: the arbiter as a table of who wins, with time passed in."""

import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from car_interface.common import causes
from car_interface.common.sources import LOCKED, NEUTRAL, NO_HUMAN, PLANNER, SOURCE_NAMES, TELEOP, source_name
from car_interface.interlock.motion_interlock import InterlockConfig
from car_interface.steering.arbiter import SteeringArbiter, SteeringArbiterConfig
from car_interface.steering.limits import SourceLimits, SteeringLimits
from slash import CENTER, SLASH

S = 1_000_000_000
NOW = 1000 * S
FINITE_OR_NOT = st.floats(allow_nan=True, allow_infinity=True)
AGES_S = st.sampled_from([0.0, 0.3, 0.5, 0.51, 100.0])


def arbiter_with(human=None, teleop=None, planner=None, steering=None, odometry=None, calibration=SLASH,
                 human_timeout_s=None, **rules):
    """One that received each input once: (value, its age in seconds at NOW), or None = never."""
    if human_timeout_s is not None:
        rules["interlock"] = InterlockConfig(human_timeout_s=human_timeout_s)
    arbiter = SteeringArbiter(calibration, SteeringArbiterConfig(**rules))
    for update, received in ((arbiter.limiter.speed.update, odometry), (arbiter.update_human, human),
                             (arbiter.update_teleop, teleop), (arbiter.update_planner, planner),
                             (arbiter.update_planner_steering, steering)):
        if received is not None:
            value, age_s = received
            update(value, NOW - round(age_s * S))
    return arbiter


def decide(human=None, teleop=None, planner=None, **inputs):
    return arbiter_with(human, teleop, planner, **inputs).decide(NOW)


HELD, LET_GO = (True, 0.1), (False, 0.1)
STEERS, RESTS = (0.5, 0.1), (0.0, 0.1)  # a duty of 4450
ASKS, ASKS_NOTHING = (-10.0, 0.1), (0.0, 0.1)  # a duty of 6250
FRESH, STALE = 0.5, 0.500000001
NAN, INF = math.nan, math.inf


@pytest.mark.parametrize("human, teleop, planner, source, duty, reason", [
    (None, STEERS, ASKS, NO_HUMAN, CENTER, "human_in_loop was never heard"),
    (LET_GO, STEERS, ASKS, NO_HUMAN, CENTER, "human_in_loop is false"),
    ((True, STALE), STEERS, ASKS, NO_HUMAN, CENTER, "human_in_loop silent for 0.50 s"),
    ((True, FRESH), STEERS, ASKS, TELEOP, 4450, "tele_steer_req is 0.500"),
    (HELD, None, None, NEUTRAL, CENTER, "neither tele_steer_req nor av_turnrad_req asks for anything"),
    (HELD, (0.5, STALE), ASKS, NEUTRAL, CENTER, "tele_steer_req silent for 0.50 s"),
    (HELD, (0.0, STALE), ASKS, NEUTRAL, CENTER, "tele_steer_req silent for 0.50 s"),
    (HELD, (0.5, FRESH), ASKS, TELEOP, 4450, "tele_steer_req is 0.500"),
    (HELD, (NAN, 0.1), ASKS, NEUTRAL, CENTER, "tele_steer_req is nan, no number to act on"),
    (HELD, (-INF, 0.1), ASKS, NEUTRAL, CENTER, "tele_steer_req is -inf, no number to act on"),
    (HELD, None, ASKS, PLANNER, 6250, "av_turnrad_req is -10.000 m"),
    (HELD, RESTS, ASKS, PLANNER, 6250, "av_turnrad_req is -10.000 m"),
    (HELD, RESTS, None, NEUTRAL, CENTER, "neither tele_steer_req nor av_turnrad_req asks for anything"),
    (HELD, None, (-10.0, STALE), NEUTRAL, CENTER, "av_turnrad_req silent for 0.50 s"),
    (HELD, None, (-10.0, FRESH), PLANNER, 6250, "av_turnrad_req is -10.000 m"),
    (HELD, RESTS, ASKS_NOTHING, NEUTRAL, CENTER, "av_turnrad_req is 0, which asks for nothing"),
    (HELD, None, (NAN, 0.1), NEUTRAL, CENTER, "av_turnrad_req is nan"),
    (HELD, STEERS, (NAN, 0.1), TELEOP, 4450, "tele_steer_req is 0.500"),
    (HELD, None, (INF, 0.1), PLANNER, CENTER, "av_turnrad_req is inf: straight on"),
    (HELD, None, (-INF, 0.1), PLANNER, CENTER, "av_turnrad_req is -inf: straight on"),
])
def test_arbiter_with_these_inputs_picks_source_duty_and_reason(human, teleop, planner, source, duty, reason):
    decision = decide(human, teleop, planner)
    assert (SOURCE_NAMES[decision.source], decision.duty) == (SOURCE_NAMES[source], duty)
    assert decision.reason.startswith(reason)


def test_a_stick_that_was_never_heard_while_teleop_logi_runs_is_no_stick_at_rest():
    arbiter = arbiter_with(HELD, planner=(5.0, 0.0))
    assert arbiter.decide(NOW).source == PLANNER  # a teleop without a stick
    arbiter.explain_human(True, "", NOW)
    assert arbiter.decide(NOW)[:4] == (NEUTRAL, SLASH.servo_center, causes.TELEOP_STALE,
                                       "tele_steer_req was never heard, though teleop_logi runs")
    arbiter.update_teleop(0.0, NOW)
    assert arbiter.decide(NOW).source == PLANNER


@pytest.mark.parametrize("name, human, teleop, planner, source", [
    ("human_timeout_s", (True, 1e6), STEERS, ASKS, TELEOP),
    ("teleop_timeout_s", HELD, (0.5, 1e6), ASKS, TELEOP),
    ("planner_timeout_s", HELD, None, (-10.0, 1e6), PLANNER),
])
def test_timeout_of_0_never_makes_an_input_stale(name, human, teleop, planner, source):
    assert decide(human, teleop, planner).source != source
    assert decide(human, teleop, planner, **{name: 0.0}).source == source
    assert decide(None, teleop, planner, **{name: 0.0}).source == NO_HUMAN


def test_decision_carries_the_age_of_each_input():
    arbiter = arbiter_with((True, 0.0))
    arbiter.update_planner(5.0, NOW - 7 * S)
    assert arbiter.decide(NOW + S // 4)[4:8] == (INF, 0.25, INF, 7.25)
    arbiter.update_e_stop(False, NOW)
    assert arbiter.decide(NOW + S // 4).e_stop_age_s == 0.25


@pytest.mark.parametrize("neutral, deadband, request_, source", [
    (0.0, 0.001, 0.0, NEUTRAL), (0.0, 0.001, 0.0010000000474974513, NEUTRAL),  # as a float32 has its edge
    (0.0, 0.001, -0.001, NEUTRAL), (0.0, 0.001, 0.0011, TELEOP), (0.0, 0.001, -0.0011, TELEOP),
    (0.0, 0.001, 0.001 * (1 + 2 ** -23), NEUTRAL),  # by one step of a float32
    (0.5, 0.001, 0.4995, NEUTRAL), (0.5, 0.001, 0.0, TELEOP),  # the neutral of an old stack
    (0.0, 0.2, 0.15, NEUTRAL), (0.0, 0.0, 0.0, NEUTRAL), (0.0, 0.0, 1e-9, TELEOP),
])
def test_teleop_request_near_its_neutral_rests(neutral, deadband, request_, source):
    decision = decide(HELD, (request_, 0.1), tele_steer_neutral=neutral, tele_steer_deadband=deadband)
    assert SOURCE_NAMES[decision.source] == SOURCE_NAMES[source]


@pytest.mark.parametrize("radius_m, source, duty", [
    (1.25, PLANNER, 3808), (8.0, PLANNER, 3883), (-8.0, PLANNER, 6317),  # 3807.5, 3883.33, 6316.67
    (-1.5, PLANNER, 6675), (1e30, PLANNER, 5100), (-1e30, PLANNER, 5100),
    (0.0011, PLANNER, 3800), (0.001, NEUTRAL, 5100), (-0.0011, PLANNER, 6700), (-0.001, NEUTRAL, 5100),
    (0.0010000000474974513, NEUTRAL, 5100),  # as a float32 has it
    (0.001 * (1 + 2 ** -23), NEUTRAL, 5100), (0.001 * (1 + 2 ** -22), PLANNER, 3800),
])
def test_planner_s_radius_makes_the_duty_and_within_a_millimetre_of_0_it_is_no_request(radius_m, source, duty):
    decision = decide(HELD, None, (radius_m, 0.1))
    assert (SOURCE_NAMES[decision.source], decision.duty) == (SOURCE_NAMES[source], duty)


@pytest.mark.once
@given(human=st.none() | st.tuples(st.booleans(), AGES_S), teleop=st.none() | st.tuples(FINITE_OR_NOT, AGES_S),
       planner=st.none() | st.tuples(FINITE_OR_NOT, AGES_S))
def test_decision_on_anything_heard_stays_between_left_and_right_and_needs_a_fresh_human(human, teleop, planner):
    decision = decide(human, teleop, planner)
    assert 3800 <= decision.duty <= 6700
    assert decision.reason
    if decision.source in (TELEOP, PLANNER):
        assert human is not None and human[0] and human[1] <= 0.5
    else:
        assert decision.duty == CENTER and decision[8:] == ("", "", 0.0, 0.0)


def test_source_names_are_in_the_order_of_the_message_s_constants():
    assert SOURCE_NAMES == ("LOCKED", "NO_HUMAN", "NEUTRAL", "TELEOP", "PLANNER")
    assert (LOCKED, NO_HUMAN, NEUTRAL, TELEOP, PLANNER) == (0, 1, 2, 3, 4)
    assert [source_name(source) for source in (-1, 0, 4, 5)] == ["-1", "LOCKED", "PLANNER", "5"]


def test_slew_limit_moves_the_servo_no_faster_and_no_farther_than_what_is_asked_for():
    arbiter = arbiter_with((True, 0.0), slew_limit=1000.0)
    arbiter.decide(NOW)
    arbiter.update_teleop(1.0, NOW)
    duties = [arbiter.decide(NOW + tenth * S // 10).duty for tenth in range(5)]
    assert duties == [5100, 5000, 4900, 4800, 4700]
    arbiter.update_teleop(-1.0, NOW + 4 * S // 10)
    assert arbiter.decide(NOW + 5 * S // 10).duty == 4800
    by_planner = arbiter_with(HELD, slew_limit=1000.0, planner_timeout_s=0.0, human_timeout_s=0.0)
    by_planner.decide(NOW)
    by_planner.update_planner(1.0, NOW)  # 3800
    assert [by_planner.decide(NOW + s * S).duty for s in (1, 2, 3)] == [4100, 3800, 3800]


@pytest.mark.parametrize("update, value", [("update_human", False), ("update_e_stop", True), ("update_teleop", 0.0),
                                           ("update_teleop", NAN)])
def test_slew_limit_never_slows_the_way_back_to_neutral(update, value):
    arbiter, at_ns = arbiter_with((True, 0.0), slew_limit=1000.0), NOW + S // 2
    arbiter.decide(NOW)
    arbiter.update_teleop(1.0, NOW)
    assert arbiter.decide(at_ns).duty == 4600
    getattr(arbiter, update)(value, at_ns)
    assert arbiter.decide(at_ns).duty == CENTER


def test_slew_begins_again_at_neutral_however_long_that_lasted():
    arbiter = arbiter_with((True, 0.0), slew_limit=1000.0)
    arbiter.decide(NOW)
    arbiter.decide(NOW + S // 4)
    arbiter.update_teleop(1.0, NOW + S // 4)
    assert arbiter.decide(NOW + S // 4).duty == CENTER
    assert arbiter.decide(NOW).duty == CENTER  # a time that steps back changes nothing
    assert arbiter.decide(NOW + S // 4 + S // 10).duty == 5000


def arbiter_at_3_mps(teleop):
    """One in which a planner has just taken over, at 3 m/s, from a human whose stick was there."""
    arbiter = arbiter_with((True, 0.0), (teleop, 0.0), odometry=(3.0, 0.0))
    arbiter.decide(NOW)
    arbiter.update_teleop(0.0, NOW)
    arbiter.update_planner(3.0, NOW)
    return arbiter


@pytest.mark.parametrize("teleop, limit", [
    (1.0, ""), (0.931, causes.JERK_LIMITED), (0.0, causes.JERK_LIMITED)])  # 1 m, 10 m to the left, nobody
def test_planner_that_takes_over_turns_in_from_where_the_human_steered(teleop, limit):
    decision = arbiter_at_3_mps(teleop).decide(NOW + S // 1000)
    assert (decision.duty == 3840, decision.limit) == (not limit, limit)


def test_planner_that_took_over_turns_in_on_from_where_it_steered_itself():
    arbiter = arbiter_at_3_mps(0.931)
    limits = [arbiter.decide(NOW + tick * S // 50).limit for tick in range(1, 6)]
    assert (limits[0], limits[-1]) == (causes.JERK_LIMITED, "")


def test_reason_says_whether_the_gamepad_overrides_the_planner_while_that_is_fresh():
    arbiter = arbiter_with(HELD, STEERS, ASKS)
    for overrides, at_ns, words in ((True, NOW, ": it overrides the planner"), (False, NOW, ""),
                                    (True, NOW - S // 2 - 1, "")):
        arbiter.explain_human(True, "", at_ns)
        arbiter.overrides = overrides
        assert arbiter.decide(NOW).reason == f"tele_steer_req is 0.500{words}"


def test_reason_for_no_planner_is_quoted_until_one_was_received():
    arbiter = arbiter_with(HELD)
    arbiter.planner_explanation = "planner_interface: drive was never heard"
    assert arbiter.decide(NOW)[2:4] == (causes.NO_REQUEST, "planner_interface: drive was never heard")
    arbiter.update_planner(0.0, NOW)
    assert arbiter.decide(NOW).reason == "av_turnrad_req is 0, which asks for nothing"


def test_another_calibration_is_used_at_once():
    arbiter = arbiter_with(HELD, STEERS)
    assert arbiter.decide(NOW).duty == 4450
    arbiter.calibrate(replace(SLASH, servo_left=3700))
    assert arbiter.decide(NOW).duty == 4400


def test_decisions_differ_by_source_duty_cause_and_limit_and_are_logged_as_source_cause_or_limit_changes():
    decision = decide(HELD, STEERS)._replace(limit=causes.LIMITS_OFF)
    assert decision.differs_by == (TELEOP, 4450, causes.TELEOP, causes.LIMITS_OFF)
    assert decision.kind == (TELEOP, causes.TELEOP, causes.LIMITS_OFF)


def test_dropped_messages_make_every_input_stale():
    arbiter = arbiter_with(interlock=InterlockConfig(e_stop_timeout_s=0.0), planner_timeout_s=0.0, teleop_timeout_s=0.0)

    def rearm():
        arbiter.update_human(False, NOW)
        arbiter.update_human(True, NOW)

    inputs = {"human_in_loop": (NO_HUMAN, rearm),
              "tele_steer_req": (NEUTRAL, lambda: arbiter.update_teleop(0.0, NOW)),
              "av_turnrad_req": (NEUTRAL, lambda: arbiter.update_planner(1.0, NOW))}
    arbiter.limiter.speed.update(3.0, NOW)
    arbiter.update_planner_steering(0.5, NOW)
    for _, receive in inputs.values():
        receive()
    arbiter.mark_stale(NOW)
    for name, (source, receive) in inputs.items():
        decision = arbiter.decide(NOW)
        assert decision[:2] == (source, CENTER)
        assert decision.reason == f"{name} was not heard since messages were dropped"
        receive()
    decision = arbiter.decide(NOW)
    assert (decision.source, decision.reason) == (PLANNER, "av_turnrad_req is 1.000 m")
    assert decision.limit_reason.endswith("by the last speed, odom was not heard since messages were dropped")


@pytest.mark.parametrize("steering, teleop, planner, source, duty, cause, reason", [
    ((0.5, 0.1), None, None, PLANNER, 4450, causes.PLANNER, "av_steer_req is 0.500"),
    ((-0.5, 0.1), RESTS, None, PLANNER, 5900, causes.PLANNER, "av_steer_req is -0.500"),
    ((7.0, 0.1), None, None, PLANNER, 3800, causes.PLANNER, "av_steer_req is 7.000"),
    ((0.0, 0.1), None, None, PLANNER, CENTER, causes.PLANNER, "av_steer_req is 0.000"),
    ((0.5, 0.1), (-1.0, 0.1), None, TELEOP, 6700, causes.TELEOP, "tele_steer_req is -1.000"),
    ((NAN, 0.1), None, None, NEUTRAL, CENTER, causes.PLANNER_NOT_FINITE, "av_steer_req is nan, no number to act on"),
    ((-INF, 0.1), None, None, NEUTRAL, CENTER, causes.PLANNER_NOT_FINITE, "av_steer_req is -inf, no number to act on"),
    *(((0.5, 0.1), None, (radius_m, 0.1), NEUTRAL, CENTER, causes.TWO_REQUESTS,
       "av_turnrad_req and av_steer_req are both published: neither is obeyed") for radius_m in (-10.0, 0.0, NAN, INF)),
    ((0.5, 0.1), None, (-10.0, 0.6), PLANNER, 4450, causes.PLANNER, "av_steer_req is 0.500"),
    ((0.5, 0.6), None, (-10.0, 0.1), PLANNER, 6250, causes.PLANNER, "av_turnrad_req is -10.000 m"),
    ((0.5, 0.6), None, (-10.0, 0.7), NEUTRAL, CENTER, causes.PLANNER_STALE, "av_steer_req silent for 0.60 s"),
])
def test_av_steer_req_is_scaled_like_the_gamepad_s_in_the_planner_s_place(steering, teleop, planner, source, duty,
                                                                          cause, reason):
    decision = decide(HELD, teleop, planner, steering=steering)
    assert decision[:4] == (source, duty, cause, reason)
    assert decision.planner_age_s == pytest.approx(min(age_s for _, age_s in filter(None, (steering, planner))))


WRONG = "asks for 0.17 m, this car turns on 1.00 m to the left: rad? rad/s? wheelbase?"
UNLIMITED = SteeringLimits(planner=SourceLimits())
FASTER_IS_WIDER = replace(SLASH, understeer=0.0078)
# To the right the wheels are at their stop from 1.6 m on: the table has its duty for tighter turns, too.
STOPS_AT_1_6 = replace(SLASH, radius_axis_m=(1.2, 1.6, *SLASH.radius_axis_m[2:]),
                       right_duties=(6700, 6700, 6690, *SLASH.right_duties[3:]))


def asked_for(speed_mps=1.0, planner=None, **inputs):
    """An arbiter whose planner asks for a radius, and its decision."""
    odometry = None if speed_mps is None else (speed_mps, 0.0)
    arbiter = arbiter_with((True, 0.0), planner=planner and (planner, 0.0), odometry=odometry, **inputs)
    arbiter.decide(NOW)
    return arbiter, arbiter.decide(NOW + S // 10)  # it has turned in


@pytest.mark.parametrize("speed_mps, limits", [(None, SteeringLimits()), (0.0, UNLIMITED), (1.0, SteeringLimits())])
def test_a_request_tighter_than_the_car_is_cut_and_reported(speed_mps, limits):
    arbiter, decision = asked_for(speed_mps, 0.17, limits=limits)
    assert decision[:3] == (PLANNER, 3800, causes.PLANNER)
    assert (decision.limit, decision.limit_reason, decision.asked_radius_m) == (causes.TOO_TIGHT, WRONG, 0.17)
    assert arbiter.turn_radius_m(decision.duty) == 1.0
    assert (arbiter.limiter.cuts, arbiter.limiter.too_tight.fresh(NOW + 2 * S)) == (1, WRONG)


@pytest.mark.parametrize("radius_m, calibration, limit, max_speed_mps", [
    (0.17, SLASH, causes.TOO_TIGHT, 2.0),
    (1.0, SLASH, "", 2.0),
    (1.2, STOPS_AT_1_6, "", math.sqrt(4.0 * 1.2)),
    (-1.2, STOPS_AT_1_6, causes.TOO_TIGHT, math.sqrt(4.0 * 1.6)),
    (-1.45, STOPS_AT_1_6, "", math.sqrt(4.0 * 1.6)),
])
def test_each_side_goes_by_what_it_can_turn_and_so_does_its_max_speed(radius_m, calibration, limit, max_speed_mps):
    _, decision = asked_for(1.0, radius_m, calibration=calibration)
    assert (decision.limit, decision.asked_radius_m) == (limit, radius_m)
    assert decision.max_speed_mps == pytest.approx(max_speed_mps)


def test_a_car_whose_turns_widen_is_judged_by_what_it_turns_at_its_speed():
    _, decision = asked_for(4.0, 1.5, calibration=FASTER_IS_WIDER, limits=UNLIMITED)
    assert decision.limit_reason == ("asks for 1.50 m, this car turns on 2.18 m to the left at 4.0 m/s, as its turns "
                                     "widen with speed")
    assert asked_for(1.0, 1.5, calibration=FASTER_IS_WIDER, limits=UNLIMITED)[1].limit == ""
    assert asked_for(None, calibration=FASTER_IS_WIDER)[0].turn_radius_m(3800) == 1.0  # as it turns slowly


def test_a_turn_that_is_limited_gets_the_duty_of_the_granted_radius():
    _, decision = asked_for(4.0, 2.0, limits=SteeringLimits(planner=SourceLimits(4.0)))
    assert (decision.limit, decision.duty) == (causes.LATERAL_LIMITED, 3850)  # 16 / 4 = 4 m to the left
    for age_s in (FRESH, STALE):
        decision = arbiter_with((True, 0.0), planner=(2.0, 0.0), odometry=(4.0, age_s)).decide(NOW)
        assert ("by the last speed" in decision.limit_reason) == (age_s == STALE)


@pytest.mark.parametrize("inputs, source", [({"teleop": (1.0, 0.0)}, TELEOP), ({"steering": (1.0, 0.0)}, PLANNER)])
def test_a_stick_at_full_lock_and_a_planner_s_steering_ask_for_no_radius(inputs, source):
    _, decision = asked_for(1.0, limits=SteeringLimits(human=SourceLimits(4.0)), **inputs)
    assert (decision.source, decision.limit) == (source, "")


@pytest.mark.parametrize("teleop, planner, steering, source", [
    (0.5, (0.17, 0.0), None, TELEOP), (None, (0.17, 0.6), (0.5, 0.0), PLANNER)])
def test_who_steers_is_not_limited_by_a_radius_that_is_not_obeyed(teleop, planner, steering, source):
    arbiter = arbiter_with((True, 0.0), teleop and (teleop, 0.0), planner, steering, (1.0, 0.0),
                           limits=SteeringLimits(human=SourceLimits(4.0)))
    decision = arbiter.decide(NOW)
    assert (decision.source, decision.limit) == (source, "")
    assert decision.asked_radius_m == arbiter.turn_radius_m(4450) > 10.0
