"""Who drives, as tables of inputs and what is decided. Time is passed in."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from car_interface.common import causes
from car_interface.common.causes import AUTONOMOUS, HUMAN_STEERING, HUMAN_THROTTLE, MANUAL, MODES
from car_interface.common.sources import LOCKED, NEUTRAL, NO_HUMAN, PLANNER, TELEOP
from car_interface.interlock.motion_interlock import InterlockConfig
from car_interface.throttle.arbiter import ThrottleArbiter, ThrottleArbiterConfig
from car_interface.throttle.battery import BatteryConfig
from car_interface.throttle.board_watch import BoardConfig, Trouble
from car_interface.throttle.stick import StickConfig

S = 1_000_000_000
NOW = 1000 * S
LINEAR = StickConfig(deadband=0.05, expo=0.0, human_scale=0.3, brake_scale=0.8)
FORWARD, REST, BRAKE = 0.525, 0.02, -0.525  # of the stick: half, in the dead band, half
NAN, INF = math.nan, math.inf
AGE = st.none() | st.sampled_from([0.0, 0.2, 0.3, 0.5, 0.6])
STICK = st.sampled_from([0.0, 0.04, 0.5, -0.5, 3.0, NAN, INF])
NO_REQUEST = Trouble("planner silent", "drive silent for 0.50 s")
RELEASED = "released"  # instead of a mode: nobody holds a deadman, and the mode is the human's


def arbiter_with(human=(True, 0.1), steering=(TELEOP, 0.1), teleop=None, mode=None, planner=None, odometry=(1.0, 0.1),
                 no_value=None, **config):
    """An arbiter that received each input once: (value, its age in seconds), or None = never."""
    arbiter = ThrottleArbiter(ThrottleArbiterConfig(**{"stick": LINEAR, **config}))
    for update, received in ((arbiter.update_human, human),
                             (lambda source, at_ns: arbiter.update_steering(source, "", at_ns), steering),
                             (arbiter.update_teleop, teleop), (arbiter.update_mode, mode),
                             (lambda request, at_ns: arbiter.update_planner(3 * request, request, at_ns), planner),
                             (arbiter.update_odometry, odometry)):
        if received is not None:
            value, age_s = received
            update(value, NOW - round(age_s * S))
    arbiter.update_converter(no_value)
    return arbiter


def decide(**inputs):
    return arbiter_with(**inputs).decide(NOW)


def fresh(value):
    return None if value is None else (value, 0.1)


def rearm(arbiter, now_ns=NOW):
    arbiter.update_human(False, now_ns)
    arbiter.update_human(True, now_ns)


@pytest.mark.parametrize("mode, stick, planner, source, asked", [
    (None, None, None, NEUTRAL, 0.0),
    (None, REST, None, NEUTRAL, 0.0),
    (None, FORWARD, None, TELEOP, 0.5),
    (None, None, 0.7, PLANNER, 0.7),
    (None, REST, 0.7, PLANNER, 0.7),
    (None, BRAKE, 0.7, TELEOP, -0.5),
    (MANUAL, REST, 0.7, TELEOP, 0.0),
    (MANUAL, FORWARD, 0.7, TELEOP, 0.5),
    (HUMAN_THROTTLE, REST, 0.7, TELEOP, 0.0),
    (AUTONOMOUS, REST, 0.7, PLANNER, 0.7),
    (AUTONOMOUS, None, 0.7, PLANNER, 0.7),
    (AUTONOMOUS, BRAKE, 0.7, TELEOP, -0.5),
    (AUTONOMOUS, REST, None, NEUTRAL, 0.0),
    (HUMAN_STEERING, REST, 0.7, PLANNER, 0.7),
])
def test_source_by_mode_stick_and_planner(mode, stick, planner, source, asked):
    arbiter = arbiter_with(mode=fresh(mode), teleop=fresh(stick), planner=fresh(planner))
    decision = arbiter.decide(NOW)
    assert (decision.source, decision.asked) == (source, pytest.approx(asked))
    assert not decision.is_stop and arbiter.mode == (mode or "")


def test_nobody_who_asks_is_no_stop():
    """A car that nobody drives may be pushed by hand."""
    assert decide() == (NEUTRAL, "no request", "neither tele_throt_req nor a planner's value asks for anything",
                        0.0, 0.0, 0.0, False, "auto", 0.0)


@pytest.mark.parametrize("inputs, source, cause, reason", [
    ({"human": None}, NO_HUMAN, "human never heard", "human_in_loop was never heard"),
    ({"human": (True, 0.51)}, NO_HUMAN, "human silent", "human_in_loop silent for 0.51 s"),
    ({"steering": None}, NEUTRAL, "steering silent", "turn_arb's state was never heard"),
    ({"steering": (TELEOP, 0.26)}, NEUTRAL, "steering silent", "turn_arb's state silent for 0.26 s"),
    ({"steering": (NO_HUMAN, 0.0)}, NEUTRAL, "steering stopped", "turn_arb says NO_HUMAN"),
    ({"steering": (LOCKED, 0.0)}, NEUTRAL, "steering stopped", "turn_arb says LOCKED"),
    ({"steering": (7, 0.0)}, NEUTRAL, "steering stopped", "turn_arb says 7"),
    ({"mode": (MANUAL, 0.51), "teleop": (REST, 0.1)}, NEUTRAL, "mode silent", "mode silent for 0.51 s"),
    ({"mode": ("sport", 0.1)}, NEUTRAL, "mode unknown",
     "mode is 'sport', which is none of manual, autonomous, human_throttle, human_steering"),
    ({"teleop": (REST, 0.51)}, NEUTRAL, "teleop silent", "tele_throt_req silent for 0.51 s"),
    ({"teleop": (NAN, 0.1)}, NEUTRAL, "teleop not finite", "tele_throt_req is nan, no number to act on"),
    ({"mode": (MANUAL, 0.1)}, NEUTRAL, "teleop silent", "tele_throt_req was never heard"),
    ({"planner": (0.7, 0.51)}, NEUTRAL, "command silent", "the planner's value silent for 0.51 s"),
    ({"planner": (NAN, 0.1)}, NEUTRAL, "command not finite", "the planner's value is nan, no number to act on"),
    ({"no_value": Trouble("command not finite", "the acceleration is nan")}, NEUTRAL, "command not finite",
     "the acceleration is nan"),
    ({"odometry": None}, NEUTRAL, "odometry silent", "odometry was never heard"),
    ({"odometry": (1.0, 0.51)}, NEUTRAL, "odometry silent", "odometry silent for 0.51 s"),
    ({"odometry": (NAN, 0.1)}, NEUTRAL, "odometry not finite", "the velocity in the odometry is nan"),
    ({"odometry": (-100.1, 0.1)}, NEUTRAL, "odometry not finite", "the velocity in the odometry is -inf"),
], ids=str)
def test_planner_is_stopped_with_cause_and_reason(inputs, source, cause, reason):
    assert decide(**{"planner": (0.7, 0.1), **inputs}) == (source, cause, reason, 0.0, 0.0, 0.0, True, "auto", 0.0)


@pytest.mark.parametrize("trouble", [{}, {"steering": (NO_HUMAN, 0.0)}, {"mode": ("", 0.0)}, {"teleop": (INF, 0.0)}])
def test_human_is_stopped_by_turn_arb_mode_and_stick_but_not_by_planner_and_odometry(trouble):
    decision = decide(**{"teleop": (FORWARD, 0.1), "mode": (MANUAL, 0.1), "planner": (NAN, 0.1), "odometry": None,
                         "no_value": Trouble("odometry silent", "odometry silent for 0.52 s"), **trouble})
    assert (decision.is_stop, decision.drive != 0.0) == (bool(trouble), not trouble)


def test_reasons_of_turn_arb_and_teleop_logi_are_quoted():
    arbiter = arbiter_with(teleop=(NAN, 0.1), mode=(MANUAL, 0.1))
    arbiter.explain_human(True, "manual deadman held, but throttle_axis is -1", NOW)
    assert arbiter.decide(NOW).reason == ("tele_throt_req is nan, no number to act on: "
                                          "manual deadman held, but throttle_axis is -1")
    arbiter.update_steering(NO_HUMAN, "its deadman is false", NOW)
    assert arbiter.decide(NOW).reason == "turn_arb says NO_HUMAN: its deadman is false"
    arbiter.update_human(False, NOW)
    arbiter.explain_human(False, "no deadman is held", NOW)
    assert arbiter.decide(NOW).reason == "human_in_loop is false: no deadman is held"


@pytest.mark.parametrize("inputs, cause, name", [
    ({"teleop": (FORWARD, 0.1)}, "mode silent", "mode"), ({"teleop": (REST, 0.1)}, "mode silent", "mode"),
    ({"mode": (AUTONOMOUS, 0.1)}, "teleop silent", "tele_throt_req")], ids=["stick", "planner", "planner_s_mode"])
def test_nobody_drives_before_mode_and_stick_were_heard_once_teleop_logi_is_known_to_run(inputs, cause, name):
    arbiter = arbiter_with(planner=(0.7, 0.1), **inputs)
    assert not arbiter.decide(NOW).is_stop
    arbiter.explain_human(True, "", NOW)
    assert arbiter.decide(NOW) == (NEUTRAL, cause, f"{name} was never heard, though teleop_logi runs", 0.0, 0.0, 0.0,
                                   True, "auto", 0.0)


@pytest.mark.parametrize("speed_mps", [-100.0, 100.0])
def test_speed_that_a_car_can_just_have_is_one(speed_mps):
    assert decide(planner=(0.7, 0.1), odometry=(speed_mps, 0.1)).source == PLANNER


def test_empty_battery_stops_the_planner_and_no_human():
    arbiter = arbiter_with(planner=(0.7, 0.0), battery=BatteryConfig(stop_below_v=6.0))
    for at_ns in (NOW - 2 * S, NOW):
        arbiter.battery.update(5.9, at_ns)
    decision = arbiter.decide(NOW)
    assert (decision[:2], decision.is_stop) == ((NEUTRAL, causes.BATTERY_EMPTY), True)
    assert decision.reason == arbiter.battery.status(NOW).text
    arbiter.update_teleop(FORWARD, NOW)
    assert arbiter.decide(NOW).source == TELEOP


def test_servo_board_that_does_not_hold_what_turn_arb_commands_stops_whoever_drives():
    arbiter, now_ns = ThrottleArbiter(ThrottleArbiterConfig(stick=LINEAR, board=BoardConfig())), NOW

    def drive(held):
        nonlocal now_ns
        for _ in range(60):
            now_ns += S // 50
            for update, value in ((arbiter.update_human, True), (arbiter.update_teleop, FORWARD)):
                update(value, now_ns)
            arbiter.update_steering(TELEOP, "", now_ns)
            arbiter.update_steering_command(0, 5000, now_ns)
            if held is not None:
                arbiter.update_output([held, *[-1] * 15], now_ns)
            decision = arbiter.decide(now_ns)
        return decision.source, decision.cause, decision.is_stop

    assert drive(None) == (NEUTRAL, causes.BOARD_NEVER_RECEIVED, True)
    assert drive(5000) == (TELEOP, causes.TELEOP, False)
    assert drive(6000) == (NEUTRAL, causes.STEERING_NOT_HELD, True)
    assert drive(5000) == (TELEOP, causes.TELEOP, False)
    arbiter.mark_stale(now_ns)
    arbiter.update_e_stop(False, now_ns)
    rearm(arbiter, now_ns)
    arbiter.update_steering(TELEOP, "", now_ns)
    assert arbiter.decide(now_ns).cause == causes.BOARD_STALE


@pytest.mark.parametrize("steers", [NEUTRAL, TELEOP, PLANNER])
def test_inputs_exactly_as_old_as_their_timeouts_still_count_whoever_steers(steers):
    assert decide(human=(True, 0.5), steering=(steers, 0.25), mode=(AUTONOMOUS, 0.5), teleop=(REST, 0.5),
                  planner=(0.7, 0.5), odometry=(1.0, 0.5)).source == PLANNER


@pytest.mark.parametrize("name, inputs", [
    ("steering_timeout_s", {"steering": (TELEOP, 900.0)}),
    ("teleop_timeout_s", {"teleop": (REST, 900.0)}),
    ("mode_timeout_s", {"mode": (AUTONOMOUS, 900.0)}),
    ("command_timeout_s", {"planner": (0.7, 900.0)}),
    ("odometry_timeout_s", {"odometry": (1.0, 900.0)}),
    ("interlock", {"human": (True, 900.0)}),
])
def test_timeout_of_0_never_makes_an_input_stale(name, inputs):
    never = InterlockConfig(human_timeout_s=0.0) if name == "interlock" else 0.0
    assert decide(**{"planner": (0.7, 0.1), **inputs}).is_stop
    assert decide(**{"planner": (0.7, 0.1), **inputs}, **{name: never}).source == PLANNER


def test_e_stop_is_above_everything():
    arbiter = arbiter_with(teleop=(FORWARD, 0.1), mode=(MANUAL, 0.1), planner=(0.7, 0.1))
    arbiter.update_e_stop(True, NOW)
    assert arbiter.decide(NOW) == (LOCKED, "e_stop", "e_stop is true", 0.0, 0.0, 0.0, True, "auto", 0.0)


def test_dropped_messages_make_every_input_stale():
    arbiter = ThrottleArbiter(ThrottleArbiterConfig(stick=LINEAR, interlock=InterlockConfig(e_stop_timeout_s=0.0)))
    inputs = {"human_in_loop": lambda: rearm(arbiter),
              "turn_arb's state": lambda: arbiter.update_steering(PLANNER, "", NOW),
              "mode": lambda: arbiter.update_mode(AUTONOMOUS, NOW),
              "tele_throt_req": lambda: arbiter.update_teleop(0.0, NOW),
              "the planner's value": lambda: arbiter.update_planner(2.1, 0.7, NOW),
              "odometry": lambda: arbiter.update_odometry(1.0, NOW)}
    for receive in inputs.values():
        receive()
    arbiter.mark_stale(NOW)
    for name, receive in inputs.items():
        decision = arbiter.decide(NOW)
        assert (decision.is_stop, decision.reason) == (True, f"{name} was not heard since messages were dropped")
        receive()
    assert arbiter.decide(NOW).reason == "the planner's value is 2.100"


@pytest.mark.parametrize("inputs, drive, brake", [
    ({"teleop": (-1.0, 0.1)}, -0.3, -0.8), ({"teleop": (0.525, 0.1)}, 0.15, 0.4), ({"teleop": (5.0, 0.1)}, 0.3, 0.8),
    ({"planner": (-0.8, 0.1)}, -0.8, -0.8)], ids=str)
def test_human_drives_by_human_scale_and_brakes_by_brake_scale_and_a_planner_is_not_scaled(inputs, drive, brake):
    decision = decide(**inputs)
    assert (decision.drive, decision.brake) == (pytest.approx(drive), pytest.approx(brake))


@pytest.mark.parametrize("teleop, centered", [
    (None, True), ((REST, 0.1), True), ((FORWARD, 0.1), False), ((BRAKE, 0.1), False), ((REST, 0.51), False),
    ((NAN, 0.1), False)])
def test_stick_is_centered_in_its_dead_band_or_where_there_is_none(teleop, centered):
    assert arbiter_with(teleop=teleop).is_centered(NOW) == centered


def test_speed_and_ages_are_those_of_the_last_messages_and_a_speed_counts_while_it_is_fresh():
    arbiter = arbiter_with(teleop=(REST, 0.2), odometry=(2.0, 0.3))
    assert arbiter.ages_s(NOW) == {
        "e_stop": INF, "human_in_loop": 0.1, "turn_arb's state": 0.1, "tele_throt_req": 0.2, "mode": INF,
        "the planner's value": INF, "odometry": 0.3, "/servo/output": INF}
    arbiter.update_e_stop(False, NOW)
    assert arbiter.ages_s(NOW + S // 2)["e_stop"] == 0.5
    assert arbiter.speed_mps(NOW) == 2.0
    assert math.isnan(arbiter.speed_mps(NOW + S)) and math.isnan(arbiter_with(odometry=None).speed_mps(NOW))


@pytest.mark.once
@given(present=st.booleans(), human=AGE, source=st.sampled_from([LOCKED, NO_HUMAN, NEUTRAL, TELEOP, PLANNER, 9]),
       steering=AGE, mode=st.sampled_from([*MODES, "x"]), mode_age=AGE, stick=STICK, stick_age=AGE, planner=AGE,
       odometry=AGE)
def test_nothing_is_asked_of_the_esc_without_human_turn_arb_and_a_fresh_source(
        present, human, source, steering, mode, mode_age, stick, stick_age, planner, odometry):
    def received(value, age_s):
        return None if age_s is None else (value, age_s)

    def is_fresh(age_s, timeout_s=0.5):
        return age_s is not None and age_s <= timeout_s

    decision = decide(human=received(present, human), steering=received(source, steering),
                      mode=received(mode, mode_age), teleop=received(stick, stick_age),
                      planner=received(0.7, planner), odometry=received(1.0, odometry))
    may_move = (present and is_fresh(human) and source in (NEUTRAL, TELEOP, PLANNER) and is_fresh(steering, 0.25)
                and (mode_age is None or is_fresh(mode_age) and mode in MODES)
                and (stick_age is None or is_fresh(stick_age) and math.isfinite(stick)))
    if decision.source == TELEOP:
        assert may_move and stick_age is not None
    elif decision.source == PLANNER:
        assert may_move and is_fresh(planner) and is_fresh(odometry)
        assert stick_age is None or abs(stick) <= 0.05
        assert mode_age is None or mode in (AUTONOMOUS, HUMAN_STEERING)
    else:
        assert decision.asked == decision.drive == decision.brake == 0.0
    assert -1 <= decision.asked <= 1 and abs(decision.drive) <= 1 and abs(decision.brake) <= 1
    assert decision.is_stop == (decision.source not in (TELEOP, PLANNER) and decision.cause != "no request")


def planned(gear="drive", no_request=None, age_s=0.1, value=0.7):
    arbiter = arbiter_with(planner=(value, 0.1))
    arbiter.update_planner_state(gear, no_request, NOW - round(age_s * S))
    return arbiter


@pytest.mark.parametrize("gear, asked, esc_gear, reason", [
    ("drive", -0.7, "drive", "the planner's value is -2.100"),
    ("reverse", -0.7, "reverse", "the planner's value is -2.100"),
    ("neutral", 0.0, "drive", "the planner's gear is neutral: the car coasts"),
    ("what nobody knows", -0.7, "drive", "the planner's value is -2.100"),
])
def test_planner_s_gear_says_whether_it_reverses(gear, asked, esc_gear, reason):
    decision = planned(gear, value=-0.7).decide(NOW)
    assert decision == (PLANNER, "planner", reason, asked, asked, asked, False, esc_gear, 0.0)


def resumed():
    """One whose planner has just asked again after a pause: the state is there, and not yet a value."""
    arbiter = planned(no_request=NO_REQUEST)
    arbiter.update_planner_state("drive", None, NOW)
    return arbiter


def test_planner_that_asks_again_is_awaited_as_no_loss_and_drives_by_its_next_value():
    arbiter = resumed()
    decision = arbiter.decide(NOW + S // 10)
    assert decision[:3] == (NEUTRAL, causes.COMMAND_AWAITED, "the planner asks again: its first value is awaited")
    assert decision.is_stop and decision.cause not in causes.LOSSES
    arbiter.update_planner(0.9, 0.3, NOW)
    assert arbiter.decide(NOW).asked == 0.3


def test_dropped_messages_are_a_loss_also_just_after_the_planner_asked_again():
    arbiter = resumed()
    arbiter.mark_stale(NOW)
    arbiter.update_e_stop(False, NOW)
    rearm(arbiter)
    arbiter.update_steering(PLANNER, "", NOW)
    arbiter.update_planner_state("drive", None, NOW)
    assert arbiter.decide(NOW)[1:3] == (
        causes.COMMAND_STALE, "the planner's value was not heard since messages were dropped")


@pytest.mark.parametrize("speed_mps, age_s, cruise_mps", [
    (0.3, 0.1, 0.3), (-0.3, 0.1, -0.3), (NAN, 0.1, 0.0), (INF, 0.1, 0.0), (0.3, 0.6, 0.0)])
def test_speed_that_the_planner_wants_is_known_while_its_state_is_fresh(speed_mps, age_s, cruise_mps):
    arbiter = arbiter_with(planner=(0.7, 0.1))
    arbiter.update_planner_state("drive", None, NOW - round(age_s * S), speed_mps)
    assert arbiter.decide(NOW).cruise_mps == cruise_mps


def test_value_that_does_not_come_although_the_planner_asks_is_a_loss_with_its_reason():
    arbiter, decision = resumed(), None
    for at_ns in (NOW + S // 4, NOW + S // 2, NOW + S // 2 + 1):
        assert decision is None or decision.cause == causes.COMMAND_AWAITED
        arbiter.update_human(True, at_ns)
        arbiter.update_steering(PLANNER, "", at_ns)
        arbiter.update_planner_state("drive", None, at_ns)
        decision = arbiter.decide(at_ns)
    assert decision[1:3] == (causes.COMMAND_STALE, "the planner's value was not heard since the planner paused")


@pytest.mark.parametrize("no_request", [None, NO_REQUEST])
def test_planner_interface_that_is_gone_reverses_no_more_and_hinders_nobody(no_request):
    arbiter = planned("reverse", no_request, age_s=0.6)
    arbiter.update_planner(0.9, 0.3, NOW)
    decision = arbiter.decide(NOW)
    assert (decision.source, decision.gear) == (PLANNER, "auto")


class Driven:
    """An arbiter whose planner asks for 0.7, and whose inputs are all repeated 50 times a second."""

    def __init__(self, mode, *stick):
        self.arbiter = ThrottleArbiter(ThrottleArbiterConfig(stick=LINEAR))
        self.now_ns = NOW
        self.decisions = []
        self.go_on(mode, (0.0, 0.02), *stick)

    def go_on(self, mode, *stick):
        """Drive on with what the stick does, (value, for seconds), and return the last decision."""
        for value, seconds in stick:
            for _ in range(round(seconds * 50)):
                self.now_ns += S // 50
                self.arbiter.update_human(mode != RELEASED, self.now_ns)
                self.arbiter.update_steering(TELEOP, "", self.now_ns)
                self.arbiter.update_planner(2.1, 0.7, self.now_ns)
                self.arbiter.update_odometry(1.0, self.now_ns)
                self.arbiter.update_mode(MANUAL if mode == RELEASED else mode, self.now_ns)
                self.arbiter.update_teleop(value, self.now_ns)
                self.decisions.append(self.decide())
        return self.decisions[-1]

    def decide(self):
        return self.arbiter.decide(self.now_ns)


@pytest.mark.parametrize("mode", [AUTONOMOUS, HUMAN_STEERING])
@pytest.mark.parametrize("stick, drive, brake, scaled", [(FORWARD, 0.15, 0.4, "0.3"), (BRAKE, -0.4, -0.4, "0.8")])
def test_override_s_pull_has_the_brake_s_scale_in_a_gear_that_never_reverses(mode, stick, drive, brake, scaled):
    decision = Driven(mode, (REST, 0.1), (stick, 0.1)).decide()
    reason = f"tele_throt_req is {stick:.3f}, scaled by {scaled}: it overrides the planner"
    assert decision == (TELEOP, "override", reason, pytest.approx(math.copysign(0.5, stick)), pytest.approx(drive),
                        pytest.approx(brake), False, "drive", 0.0)


def test_planner_gets_the_throttle_back_half_a_second_after_the_stick_was_centered():
    car = Driven(AUTONOMOUS, (BRAKE, 0.1), (REST, 0.02))
    reason = "the throttle stick overrode the planner, which waits until it was centered for 0.5 s"
    for decision in (car.decide(), car.go_on(AUTONOMOUS, (REST, 0.46))):
        assert decision == (TELEOP, "override", reason, 0.0, 0.0, 0.0, False, "drive", 0.0)
    assert car.go_on(AUTONOMOUS, (REST, 0.02)).source == PLANNER


@pytest.mark.parametrize("between", [
    lambda arbiter, now_ns: [arbiter.update_mode(mode, now_ns) for mode in (MANUAL, AUTONOMOUS)], rearm])
def test_what_an_override_holds_ends_where_the_human_takes_over_or_with_the_deadman(between):
    car = Driven(AUTONOMOUS, (FORWARD, 0.3), (REST, 0.1))
    assert car.decide().source == TELEOP
    between(car.arbiter, car.now_ns)
    assert car.decide().source == PLANNER
    assert Driven(MANUAL, (FORWARD, 0.3)).go_on(AUTONOMOUS, (0.0, 0.02)).source == PLANNER


@pytest.mark.parametrize("planners, mode", [(AUTONOMOUS, MANUAL), (HUMAN_STEERING, HUMAN_THROTTLE)])
def test_pull_that_is_held_from_the_planner_s_deadman_on_only_brakes_and_the_reason_says_so(planners, mode):
    decision = Driven(planners, (BRAKE, 0.2)).go_on(mode, (BRAKE, 5.0))
    assert (decision.cause, decision.gear, decision.is_stop) == ("teleop", "drive", False)
    assert decision.drive == decision.brake == pytest.approx(-0.4)
    assert decision.reason == ("tele_throt_req is -0.525, scaled by 0.8: it only brakes until the stick was centered, "
                               "since the planner drove before")


@pytest.mark.parametrize("stick, asked, drive", [(REST, 0.0, 0.0), (FORWARD, 0.5, 0.15)])
def test_push_of_a_human_who_takes_over_drives_as_ever(stick, asked, drive):
    decision = Driven(AUTONOMOUS, (BRAKE, 0.2)).go_on(MANUAL, (stick, 0.1))
    assert (decision.gear, decision.asked, decision.drive) == ("drive", pytest.approx(asked), pytest.approx(drive))
    assert decision.reason == f"tele_throt_req is {stick:.3f}, scaled by 0.3"


@pytest.mark.parametrize("steps, gear", [
    # A stick that was let go sooner than half a second after the planner's mode may have been so under its deadman.
    ([(MANUAL, BRAKE, 0.48), (MANUAL, REST, 0.02), (MANUAL, BRAKE, 0.1)], "drive"),
    ([(MANUAL, BRAKE, 0.48), (MANUAL, FORWARD, 0.02), (MANUAL, BRAKE, 0.1)], "drive"),
    ([(MANUAL, BRAKE, 0.5), (MANUAL, REST, 0.02), (MANUAL, BRAKE, 0.1)], "auto"),
    ([(MANUAL, BRAKE, 0.5), (MANUAL, FORWARD, 0.02), (MANUAL, BRAKE, 0.1)], "auto"),
    ([("sport", BRAKE, 0.02), (MANUAL, BRAKE, 1.0)], "drive"),
    # Without a deadman a teleop sends 0, before human_in_loop says so, and after it says otherwise.
    ([(RELEASED, 0.0, 0.02), (MANUAL, BRAKE, 1.0)], "drive"),
    ([(MANUAL, 0.0, 0.4), (RELEASED, BRAKE, 0.4), (MANUAL, BRAKE, 1.0)], "drive"),
    ([(MANUAL, 0.0, 0.4), (RELEASED, 0.0, 2.6), (RELEASED, BRAKE, 0.4), (MANUAL, BRAKE, 1.0)], "drive"),
    ([(RELEASED, 0.0, 3.0), (MANUAL, 0.0, 0.3), (MANUAL, BRAKE, 1.0)], "drive"),
    ([(RELEASED, 0.0, 3.0), (MANUAL, BRAKE, 1.0), (MANUAL, REST, 0.02), (MANUAL, BRAKE, 0.02)], "auto"),
], ids=str)
def test_stick_is_the_human_s_once_it_was_let_go_half_a_second_after_the_planner_s_mode(steps, gear):
    car = Driven(AUTONOMOUS, (BRAKE, 0.2))
    for mode, stick, seconds in steps:
        car.decisions.clear()
        car.go_on(mode, (stick, seconds))
    assert {decision.gear for decision in car.decisions} == {gear}


@pytest.mark.parametrize("mode, gear", [(MANUAL, "drive"), (None, "auto")])
def test_planner_s_mode_may_be_among_dropped_messages_of_a_teleop_that_sends_modes(mode, gear):
    arbiter = arbiter_with(mode=fresh(mode), teleop=(REST, 0.1))
    arbiter.mark_stale(NOW)
    arbiter.update_e_stop(False, NOW)
    rearm(arbiter)
    arbiter.update_steering(TELEOP, "", NOW)
    if mode:
        arbiter.update_mode(mode, NOW)
    arbiter.update_teleop(BRAKE, NOW)
    assert arbiter.decide(NOW).gear == gear


def test_half_a_second_counts_from_the_mode_that_ended_the_planner_s_not_from_its_last_message():
    car = Driven(AUTONOMOUS, (BRAKE, 0.2))
    car.now_ns += 4 * S // 10
    assert car.go_on(MANUAL, (BRAKE, 0.2), (REST, 0.02), (BRAKE, 0.1)).gear == "drive"
