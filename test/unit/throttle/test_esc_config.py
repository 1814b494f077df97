"""The parameters esc/…: defaults, ranges, and what the owner reads where one is impossible."""
from __future__ import annotations

import math
from dataclasses import fields

import pytest

from car_interface.common.declared import parameter_of, read
from car_interface.common.errors import ConfigError
from car_interface.common.params import Params
from car_interface.throttle.esc_config import PROFILES, EscConfig


def test_defaults_name_no_profile_and_coast_no_longer_than_a_stop_from_10_mps():
    assert read(Params({}), EscConfig) == EscConfig()
    assert (EscConfig().profile, EscConfig().stop_brake_time_s) == ("unverified", 3.0)


@pytest.mark.parametrize("profile", PROFILES)
def test_profile_is_read_with_whether_it_was_measured(profile):
    is_measured = profile != "unverified"
    config = read(Params({"esc": {"profile": profile, "profile_measured": is_measured}}), EscConfig)
    assert (config.profile, config.profile_measured) == (profile, is_measured)


def test_unknown_profile_is_refused_with_those_that_there_are():
    text = ("esc/profile is 'xl5'; accepted: one of brake_then_reverse, brake_becomes_reverse, direct_reverse, "
            "forward_only, unverified")
    with pytest.raises(ConfigError, match=text):
        read(Params({"esc": {"profile": "xl5"}}), EscConfig)
    with pytest.raises(ConfigError, match=text):
        EscConfig(profile="xl5")


RANGES = {
    "arming_time": (0.1, 10.0), "dwell": (0.1, 0.5), "dead_band_forward": (0.02, 0.3), "dead_band_reverse": (0.02, 0.3),
    "reverse_after_neutral": (0.0, 60.0), "stop_brake": (0.0, 1.0), "stop_brake_time": (0.1, 10.0),
    "brake_deceleration": (0.5, 15.0), "drag_deceleration": (0.05, 5.0), "brake_margin": (0.3, 3.0),
    "speed_timeout": (0.05, 0.5), "motion_speed": (0.1, 1.0), "motion_time": (0.05, 0.3)}


@pytest.mark.parametrize("name", RANGES)
def test_number_is_accepted_up_to_the_ends_of_its_range_and_refused_beyond(name):
    low, high = RANGES[name]
    field = next(each.name for each in fields(EscConfig) if parameter_of(EscConfig, each.name).name == f"esc/{name}")
    message = rf"^esc/{name} is .*; accepted: a number from {low} to {high}$"
    for value in (low, high):
        assert getattr(read(Params({"esc": {"stop_brake": 0.0, name: value}}), EscConfig), field) == value
    for value in (low - 0.01, high + 0.01, math.nan, "much", True):
        with pytest.raises(ConfigError, match=message):
            EscConfig(**{field: value})
        with pytest.raises(ConfigError, match=message):
            read(Params({"esc": {name: value}}), EscConfig)


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
