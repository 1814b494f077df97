"""Parameters of the pca9685 node: defaults, ranges, and the neutrals of those who command the channels."""

import pytest

from car_interface.common.declared import read_all
from car_interface.common.errors import ConfigError
from car_interface.common.params import Params
from car_interface.pca9685.channels import ChannelConfig
from car_interface.pca9685.config import Pca9685Config

STEERING = {"steering": {"servo_channel": 3, "servo_center": 5100}}
ESC = {"esc": {"servo": {"channel": 5, "neutral": 4915}}}


def read(**parameters):
    return read_all(Params(parameters), Pca9685Config)


def test_node_without_parameters_drives_the_first_bus_s_chip_at_50_hz_with_a_guard():
    config = read()
    assert (config.device, config.address, config.prescale, config.oscillator_hz) == ("/dev/i2c-1", 0x40, 121, 25e6)
    assert config.channels == (
        ChannelConfig(timeout_ms=250, timeout_value=0, pwm_min=0, pwm_max=65535, live_range=0),) * 16
    assert (config.required, config.virtual_chip, config.virtual_log) == (False, None, None)
    assert (config.guard, config.guard_off_after_ns) == (True, 10_000_000_000)
    assert config.channels[0] == ChannelConfig()


@pytest.mark.parametrize("parameters, expected", [
    ({"device": 7}, {"device": "/dev/i2c-7"}),
    ({"device": "auto"}, {"device": "auto"}),
    ({"device": "auto", "auto_device": "/dev/i2c-7"}, {"device": "/dev/i2c-7"}),
    ({"device": "/dev/i2c-servo"}, {"device": "/dev/i2c-servo", "virtual_chip": None, "virtual_log": None}),
    ({"device": "virtual", "virtual_chip": "/a", "virtual_log": "/b"},
     {"device": "virtual", "virtual_chip": "/a", "virtual_log": "/b"}),
    ({"frequency": 200}, {"prescale": 30}), ({"oscillator_hz": 27e6}, {"prescale": 131, "oscillator_hz": 27e6}),
    ({"prescale": 122, "frequency": 200}, {"prescale": 122}),
    ({"required": True, "guard": False, "guard_off_after": 0.5},
     {"required": True, "guard": False, "guard_off_after_ns": 500_000_000}),
], ids=str)
def test_parameter_becomes_what_the_node_uses(parameters, expected):
    config = read(**parameters)
    assert {name: getattr(config, name) for name in expected} == expected


@pytest.mark.parametrize("parameters, message", [
    ({"frequency": 0.0}, "frequency is 0.0; accepted: a number above 0"),
    ({"speed": 1}, "unknown parameter speed"), ({"virtual_chip": "/a"}, "unknown parameter virtual_chip"),
    ({"steering": {"servo_channel": 5, "servo_center": 5100}, **ESC},
     "esc/servo/channel is 5; accepted: a channel other than steering/servo_channel"),
], ids=["frequency", "unknown", "only_virtual", "channel"])
def test_parameter_that_cannot_be_is_refused_by_name(parameters, message):
    with pytest.raises(ConfigError, match=message):
        read(**parameters)


@pytest.mark.parametrize("parameters, neutrals", [
    (STEERING, {3: (5100, 500)}), (ESC, {5: (4915, 100)}),
    ({**STEERING, **ESC, "live_range": 7, "throttle_live_range": 9}, {3: (5100, 7), 5: (4915, 9)}),
    ({"steering": {"servo_center": 5100}, "esc": {"servo": {"channel": -1, "neutral": 4915}}}, {}),
    ({"steering": {"servo_channel": 3}, "esc": {"servo": {"channel": 3}}}, {}),
    ({"steering": {"servo_channel": 3, "servo_center": 5100}, "esc": {"servo": {"channel": 3}}}, {3: (5100, 500)}),
    ({"steering": {"servo_channel": 0, "servo_center": 0}}, {0: (0, 500)}),
], ids=["steering", "esc", "both", "no_channel", "no_neutral", "no_neutral_of_the_esc", "first_channel"])
def test_channels_of_steering_and_esc_rest_and_follow_at_their_neutrals(parameters, neutrals):
    found = [(config.timeout_value, config.live_range) for config in read(**parameters).channels]
    assert found == [neutrals.get(channel, (0, 0)) for channel in range(16)]


@pytest.mark.parametrize("esc, pulls", [
    ({"duty_table": [3277, 4915, 6554]}, -1), ({"duty_table": [6554, 4915, 3277]}, 1), ({}, 0),
    ({"duty_table": [3277, 4915, 6554], "channel": -1}, 0)])
@pytest.mark.parametrize("profile", ["brake_becomes_reverse", "direct_reverse", "forward_only", "unverified", None])
def test_pulls_of_an_esc_that_may_reverse_are_held_for_80_ms_on_the_side_where_the_table_begins(esc, pulls, profile):
    servo = {**ESC["esc"]["servo"], **esc}
    config = read(esc={"servo": servo, "esc": {"profile": profile} if profile else {}})
    assert [each.pulls for each in config.channels] == [pulls if channel == 5 else 0 for channel in range(16)]


def test_first_pull_of_an_esc_that_is_known_to_brake_first_is_held_as_long_as_any_command():
    servo = {**ESC["esc"]["servo"], "duty_table": [3277, 4915, 6554]}
    for is_measured in (True, False):  # one that nobody has measured may be of another kind
        esc = {"profile": "brake_then_reverse", "profile_measured": is_measured}
        channel = read(esc={"servo": servo, "esc": {**esc, "reverse_after_neutral": 1.5}}).channels[5]
        assert (channel.pulls, channel.brakes_first, channel.forgets_ms) == (-1, is_measured, 1500)


def test_settings_of_each_channel_are_its_own():
    numbers = list(range(16))
    configs = read(timeout=numbers, timeout_value=numbers, pwm_min=numbers, pwm_max=[100 + each for each in numbers])
    assert configs.channels[9] == ChannelConfig(timeout_ms=9, timeout_value=9, pwm_min=9, pwm_max=109)


def test_esc_of_which_nothing_else_is_known_brakes_at_once_and_never_forgets():
    servo = {**ESC["esc"]["servo"], "duty_table": [3277, 4915, 6554]}
    channel = read(esc={"servo": servo, "esc": {"profile": "brake_then_reverse"}}).channels[5]
    assert (channel.brakes_first, channel.forgets_ms) == (False, 0)


def test_limits_that_no_duty_meets_are_refused():
    with pytest.raises(ConfigError):
        read(pwm_min=[5000] * 16, pwm_max=[4000] * 16)
