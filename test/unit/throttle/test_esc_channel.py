"""Whether the ESC gets the converted value or neutral, as a table of what hinders it. Time is passed in."""
from __future__ import annotations

import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from car_interface.common.errors import ConfigError
from car_interface.interlock.motion_interlock import InterlockConfig
from car_interface.steering.arbiter import LOCKED, NEUTRAL, NO_HUMAN, PLANNER, TELEOP
from car_interface.throttle.converter import Conversion, ConversionConfig, Converter
from car_interface.throttle.esc_channel import Throttle, ThrottleConfig, trimmed
from car_interface.throttle.value_map import ValueMap

S = 1_000_000_000
NOW = 1000 * S
NEUTRAL_DUTY = 4915
HALF_THROTTLE = Conversion(1.5)
MAP = ValueMap([-5.0, 3.0], [0.0, 10.0], [[-5.0, -5.0], [3.0, 3.0]])


def config(**changes):
    settings = {"channel": 1, "value_axis": [-5.0, 0.0, 3.0], "duty_table": [3277, 4915, 6554],
                "neutral": NEUTRAL_DUTY}
    if "human_timeout_s" in changes:
        changes["interlock"] = InterlockConfig(human_timeout_s=changes.pop("human_timeout_s"))
    settings.update(changes)
    return ThrottleConfig(**settings)


def decide(human=(True, 0.1), steering=(TELEOP, 0.1), command=(HALF_THROTTLE, 0.1), odometry=(0.0, 0.1),
           value_map=MAP, **changes):
    """The decision at NOW after each was heard once: (value, its age in seconds), or None = never."""
    converter = Converter(ConversionConfig(), value_map)
    throttle = Throttle(config(**changes), converter)
    for hear, heard in ((throttle.update_human, human), (throttle.update_steering, steering),
                        (throttle.update_conversion, command), (converter.update_odometry, odometry)):
        if heard is not None:
            value, age_s = heard
            hear(value, NOW - round(age_s * S))
    return throttle.decide(NOW)


@pytest.mark.parametrize("value, duty", [
    pytest.param(-5.0, 3277, id="full_brake"),
    pytest.param(0.0, 4915, id="neither"),
    pytest.param(1.5, 5735, id="half_throttle_rounded_up"),  # 5734.5
    pytest.param(3.0, 6554, id="full_throttle"),
    pytest.param(-9.0, 3277, id="below_the_axis_saturates"),
    pytest.param(9.0, 6554, id="above_the_axis_saturates"),
])
def test_value_with_nothing_in_the_way_makes_duty(value, duty):
    assert decide(command=(Conversion(value), 0.1)) == (duty, True, "driving", f"the value is {value:.3f}")


@pytest.mark.parametrize("source", [NEUTRAL, TELEOP, PLANNER])
def test_esc_is_driven_whoever_steers(source):
    assert decide(steering=(source, 0.1)).driving


@pytest.mark.parametrize("hindrance, cause, reason", [
    pytest.param({"human": None}, "human never heard", "human_in_loop was never heard", id="human_never_heard"),
    pytest.param({"human": (True, 0.51)}, "human silent", "human_in_loop silent for 0.51 s", id="human_silent"),
    pytest.param({"human": (False, 0.0)}, "human absent", "human_in_loop is false", id="human_lets_go"),
    pytest.param({"steering": None}, "steering silent", "turn_arb's state was never heard", id="turn_arb_never_heard"),
    pytest.param({"steering": (TELEOP, 0.26)}, "steering silent", "turn_arb's state silent for 0.26 s",
                 id="turn_arb_silent"),
    pytest.param({"steering": (NO_HUMAN, 0.0)}, "steering stopped", "turn_arb says NO_HUMAN",
                 id="turn_arb_without_human"),
    pytest.param({"steering": (LOCKED, 0.0)}, "steering stopped", "turn_arb says LOCKED", id="turn_arb_locked"),
    pytest.param({"steering": (7, 0.0)}, "steering stopped", "turn_arb says 7", id="turn_arb_says_what_nobody_knows"),
    pytest.param({"command": None}, "command silent", "control_cmd was never heard", id="command_never_heard"),
    pytest.param({"command": (HALF_THROTTLE, 0.51)}, "command silent", "control_cmd silent for 0.51 s",
                 id="command_silent"),
    pytest.param({"command": (Conversion(None, "command not finite", "the commanded acceleration is nan"), 0.1)},
                 "command not finite", "the commanded acceleration is nan", id="command_without_a_value"),
    pytest.param({"odometry": (0.0, 0.51)}, "odometry silent", "odometry silent for 0.51 s", id="odometry_silent"),
    pytest.param({"odometry": None}, "odometry silent", "odometry was never heard", id="odometry_never_heard"),
    pytest.param({"odometry": (math.nan, 0.1)}, "odometry not finite", "the velocity in the odometry is nan",
                 id="odometry_not_finite"),
])
def test_esc_goes_to_neutral_and_says_why(hindrance, cause, reason):
    assert decide(**hindrance) == (NEUTRAL_DUTY, False, cause, reason)


def test_inputs_exactly_as_old_as_their_timeouts_still_drive():
    assert decide(human=(True, 0.5), steering=(TELEOP, 0.25), command=(HALF_THROTTLE, 0.5),
                  odometry=(0.0, 0.5)).driving


def test_esc_needs_odometry_also_where_accelerations_pass_through_without_a_map():
    assert decide(value_map=None).driving
    assert decide(odometry=None, value_map=None).cause == "odometry silent"


@pytest.mark.parametrize("name, hindrance", [
    ("human_timeout_s", {"human": (True, 1e6)}),
    ("steering_timeout_s", {"steering": (TELEOP, 1e6)}),
    ("command_timeout_s", {"command": (HALF_THROTTLE, 1e6)}),
])
def test_timeout_of_0_never_makes_an_input_silent(name, hindrance):
    assert not decide(**hindrance).driving
    assert decide(**hindrance, **{name: 0.0}).driving


def test_esc_released_and_held_again_drives_again():
    converter = Converter(ConversionConfig(), None)
    throttle = Throttle(config(), converter)
    converter.update_odometry(0.0, NOW)
    throttle.update_steering(PLANNER, NOW)
    throttle.update_conversion(Conversion(3.0), NOW)
    throttle.update_human(True, NOW)
    assert throttle.decide(NOW).duty == 6554
    throttle.update_human(False, NOW + 1)
    assert throttle.decide(NOW + 1).duty == NEUTRAL_DUTY
    throttle.update_human(True, NOW + 2)
    assert throttle.decide(NOW + 2).duty == 6554


OPTIONAL_AGE = st.none() | st.sampled_from([0.0, 0.2, 0.3, 0.5, 0.6])


@given(st.booleans(), OPTIONAL_AGE, st.sampled_from([LOCKED, NO_HUMAN, NEUTRAL, TELEOP, PLANNER]), OPTIONAL_AGE,
       OPTIONAL_AGE, OPTIONAL_AGE)
def test_esc_is_driven_only_with_human_lock_turn_arb_command_and_odometry_all_well(
        present, human_s, source, steering_s, command_s, odometry_s):
    def heard(value, age_s):
        return None if age_s is None else (value, age_s)

    decision = decide(heard(present, human_s), heard(source, steering_s), heard(Conversion(3.0), command_s),
                      heard(0.0, odometry_s))

    def fresh(age_s, timeout_s):
        return age_s is not None and age_s <= timeout_s

    well = (present and fresh(human_s, 0.5) and source in (NEUTRAL, TELEOP, PLANNER) and fresh(steering_s, 0.25)
            and fresh(command_s, 0.5) and fresh(odometry_s, 0.5))
    assert decision.driving == well
    assert decision.duty == (6554 if well else NEUTRAL_DUTY)


def test_duty_table_beyond_what_a_duty_can_be_is_clamped():
    assert decide(duty_table=[-100, 4915, 70000], command=(Conversion(3.0), 0.1)).duty == 65535
    assert decide(duty_table=[-100, 4915, 70000], command=(Conversion(-5.0), 0.1)).duty == 0


@pytest.mark.parametrize("changes, message", [
    pytest.param({"neutral": 3276}, "servo/neutral is 3276; accepted: a duty within the range of servo/duty_table",
                 id="neutral_below_the_table"),
    pytest.param({"neutral": 6555}, "servo/neutral is 6555; accepted: a duty within", id="neutral_above_the_table"),
    pytest.param({"value_axis": [0.0]}, r"servo/value_axis is \[0.0\]; accepted: at least two", id="axis_too_short"),
    pytest.param({"value_axis": [0.0, 3.0, 2.0]}, r"servo/value_axis\[2\] is 2.0; accepted: more than",
                 id="axis_that_falls"),
    pytest.param({"duty_table": [3277, 6554]}, r"servo/duty_table is \[3277, 6554\]; accepted: 3 numbers",
                 id="table_too_short"),
    pytest.param({"duty_table": []}, r"servo/duty_table is \[\]; accepted: 3 numbers", id="table_empty"),
])
def test_calibration_with_a_fault_is_refused_naming_the_parameter(changes, message):
    with pytest.raises(ConfigError, match=message):
        Throttle(config(**changes), Converter(ConversionConfig(), None))


@pytest.mark.parametrize("neutral", [3277, 6554], ids=["lowest", "highest"])
def test_neutral_at_an_end_of_the_table_is_accepted(neutral):
    assert decide(human=None, neutral=neutral).duty == neutral


def test_config_names_the_channel():
    assert config().channel == 1


def test_lock_stops_the_esc_above_everything():
    converter = Converter(ConversionConfig(), None)
    throttle = Throttle(config(), converter)
    converter.update_odometry(0.0, NOW)
    throttle.update_steering(PLANNER, NOW)
    throttle.update_conversion(Conversion(3.0), NOW)
    throttle.update_human(True, NOW)
    assert throttle.decide(NOW).driving
    throttle.update_e_stop(True, NOW)
    assert throttle.decide(NOW) == (NEUTRAL_DUTY, False, "e_stop", "e_stop is true")


@pytest.mark.parametrize("again, reason", [
    pytest.param([], "human_in_loop was not heard since messages were dropped", id="human_lost"),
    pytest.param(["human"], "turn_arb's state was not heard since messages were dropped", id="steering_lost"),
    pytest.param(["human", "steering"], "control_cmd was not heard since messages were dropped", id="command_lost"),
    pytest.param(["human", "steering", "command"], "odometry was not heard since messages were dropped",
                 id="odometry_lost"),
    pytest.param(["human", "steering", "command", "odometry"], "the value is 3.000", id="all_heard_again"),
])
def test_dropped_messages_make_every_input_stale(again, reason):
    converter = Converter(ConversionConfig(), None)
    throttle = Throttle(config(interlock=InterlockConfig(e_stop_timeout_s=0.0)), converter)
    inputs = {"human": lambda: (throttle.update_human(False, NOW), throttle.update_human(True, NOW)),
              "steering": lambda: throttle.update_steering(PLANNER, NOW),
              "command": lambda: throttle.update_conversion(Conversion(3.0), NOW),
              "odometry": lambda: converter.update_odometry(0.0, NOW)}
    for hear in inputs.values():
        hear()
    assert throttle.decide(NOW).driving
    throttle.mark_stale(NOW)
    converter.mark_stale()
    for name in again:
        inputs[name]()
    assert throttle.decide(NOW).reason == reason
    assert throttle.decide(NOW).driving == (len(again) == 4)


def test_esc_table_moves_along_with_its_neutral():
    moved = trimmed(config(), 4950)
    assert (moved.neutral, moved.duty_table) == (4950, [3312, 4950, 6589])


def test_esc_table_ends_where_duties_do():
    assert trimmed(replace(config(), duty_table=[10, 4915, 65530]), 4895).duty_table == [0, 4895, 65510]
    assert trimmed(replace(config(), duty_table=[10, 4915, 65530]), 4935).duty_table == [30, 4935, 65535]
