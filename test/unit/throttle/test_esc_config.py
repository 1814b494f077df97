"""The parameters esc/…: defaults, ranges, and what the owner reads where one is impossible."""
from __future__ import annotations

import math

import pytest

from car_interface.common.errors import ConfigError
from car_interface.common.params import Params
from car_interface.throttle.esc_config import NUMBERS, PROFILES, EscConfig, read_esc


def test_defaults_name_no_profile_and_lie_within_their_ranges():
    assert read_esc(Params({})) == EscConfig() and EscConfig().profile == "unverified"


def test_all_parameters_are_read_by_their_names():
    values = {name: low for name, low, _ in NUMBERS.values()}
    values.update(profile="brake_then_reverse", profile_measured=True, stop_brake=0.5, reverse_after_neutral=3)
    params = Params({"esc": values})
    config = read_esc(params)
    params.finish()
    assert (config.profile, config.profile_measured, config.dwell_s, config.reverse_after_neutral_s) == (
        "brake_then_reverse", True, 0.1, 3.0)


@pytest.mark.parametrize("profile", PROFILES)
def test_each_profile_is_accepted(profile):
    assert read_esc(Params({"esc": {"profile": profile}})).profile == profile


def test_unknown_profile_is_refused_with_those_that_there_are():
    text = ("esc/profile is 'xl5'; accepted: one of brake_then_reverse, brake_becomes_reverse, direct_reverse, "
            "forward_only, unverified")
    with pytest.raises(ConfigError, match=text):
        read_esc(Params({"esc": {"profile": "xl5"}}))
    with pytest.raises(ConfigError, match=text):
        EscConfig(profile="xl5")


@pytest.mark.parametrize("field", NUMBERS)
def test_number_out_of_its_range_is_refused(field):
    name, low, high = NUMBERS[field]
    for value in (low - 0.01, high + 0.01, math.nan, "much", True):
        with pytest.raises(ConfigError, match=rf"^esc/{name} is .*; accepted: a number from {low} to {high}$"):
            EscConfig(**{field: value})
        with pytest.raises(ConfigError, match=rf"^esc/{name} is .*; accepted: a number from {low} to {high}$"):
            read_esc(Params({"esc": {name: value}}))


def test_dwell_of_0_is_refused():
    with pytest.raises(ConfigError, match=r"esc/dwell is 0; accepted: a number from 0.1 to 0.5"):
        read_esc(Params({"esc": {"dwell": 0}}))


@pytest.mark.parametrize("changes, text", [
    ({"profile_measured": "yes"}, "esc/profile_measured is 'yes'; accepted: true or false"),
    ({"calibration_drive": 1}, "esc/calibration_drive is 1; accepted: true or false"),
    ({"profile_measured": True}, "esc/profile_measured is True; accepted: false, while esc/profile is unverified"),
    ({"calibration_drive": True, "profile": "forward_only"},
     "esc/calibration_drive is True; accepted: false, or esc/profile unverified"),
    ({"stop_brake": 0.05},
     "esc/stop_brake is 0.05; accepted: 0 .a stop coasts., or at least esc/dead_band_reverse 0.08"),
    ({"reverse_after_neutral_s": 0.3}, "esc/reverse_after_neutral is 0.3; accepted: 0 .never., or at least esc/dwell"),
])
def test_contradiction_is_refused(changes, text):
    with pytest.raises(ConfigError, match=text):
        EscConfig(**changes)
