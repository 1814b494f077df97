"""Parameters that are declared as fields: how they are read, and how they are shown."""
from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Sequence

import pytest

from car_interface.common import declared
from car_interface.common.declared import REQUIRED, Row, check, parameter_of, read, read_all, rows
from car_interface.common.errors import ConfigError
from car_interface.common.params import Params


@dataclass(frozen=True)
class Limits:
    speed_mps: float = declared.number("max_speed", 0.0, "limit of the [speed](limits.md); 0 = none", "m/s", low=0.0,
                                       high=20)
    timeout_s: float = declared.timeout("timeout", 0.5, "age")


@dataclass(frozen=True)
class Config:
    channel: int = declared.channel("channel", REQUIRED, "of the board", search_parents=True)
    human: Limits = declared.group(Limits(), "human/", same_as={"timeout": "all_timeouts"})
    planner: Limits = declared.group(Limits(3.0), "planner/")
    duties: Sequence[int] = declared.duty_of_each("duty", (0,) * 16, "of each channel")
    sonars: Sequence[str] = declared.choice("sonars/", ("used",) * 2, "each", family=("left", "right"),
                                            choices=("used", "absent"))
    prefix: str = declared.text("prefix", "", "before names", may_be_empty=True)
    length_m: float = declared.number("length", 1.5, "of the car", "m", above=0, same_as="wheels/length")
    chip: str | None = declared.path("chip", None, "its socket", default_text="by user")
    doubled_m: float = 0.0

    SHARED = ("wheels",)

    def completed(self, params) -> Config:
        return replace(self, doubled_m=2 * self.length_m)


def test_each_field_is_read_by_its_declaration_in_the_parents_too_if_that_says_so_and_groups_in_their_namespace():
    config = read_all(Params({"channel": 3, "human": {"max_speed": 1}, "duty": 7, "sonars": {"right": "absent"},
                              "prefix": "car1/", "chip": "/tmp/chip"}), Config)
    assert config == Config(3, Limits(1.0), Limits(3.0), (7,) * 16, ("used", "absent"), "car1/", 1.5, "/tmp/chip", 3.0)
    config = read(Params({}, {"channel": 5, "prefix": "no"}.get), Config, is_complete=False)
    assert (config.channel, config.prefix, config.doubled_m) == (5, "", 0.0)  # the last needs more than parameters


def test_default_may_be_another_parameter_s_value_or_one_of_another_configuration():
    values = {"channel": 3, "all_timeouts": 2.0, "wheels": {"length": 4, "width": 1}}
    config = read_all(Params(values), Config)
    assert (config.human.timeout_s, config.planner.timeout_s, config.length_m, config.doubled_m) == (2.0, 0.5, 4.0, 8.0)
    assert read(Params({**values, "length": 1, "human": {"timeout": 0}}), Config).human.timeout_s == 0.0
    assert read(Params({}), Limits, default=Limits(9.0, 1.0)) == Limits(9.0, 1.0)
    with pytest.raises(ConfigError, match=r"^wheels/length is -4; accepted: a number above 0$"):
        read(Params({"channel": 3, "wheels": {"length": -4}}), Config)


@pytest.mark.parametrize("values, message", [
    ({}, "^channel is missing; accepted: an integer from 0 to 15$"),
    ({"channel": 3, "planner": {"max_speed": 21}}, "^planner/max_speed is 21; accepted: a number from 0.0 to 20$"),
    ({"channel": 3, "sonars": {"left": "no"}}, "^sonars/left is 'no'; accepted: one of used, absent$"),
    ({"channel": 3, "max_speed": 1}, "^unknown parameter max_speed is 1; accepted: only all_timeouts, channel, "),
])
def test_refusal_names_the_parameter_with_its_namespace(values, message):
    with pytest.raises(ConfigError, match=message):
        read_all(Params(values), Config)


def test_configuration_that_is_made_by_hand_can_be_checked():
    check(Limits(20.0, 0.0))
    with pytest.raises(ConfigError, match=r"^max_speed is 21.0; accepted: a number from 0.0 to 20$"):
        check(Limits(21.0))


def test_rows_show_each_parameter_once_with_default_range_and_meaning():
    assert rows(Config) == [
        Row("`channel`", "required", "0..15", "of the board"),
        Row("`human/max_speed`", "0", "m/s, 0..20", "limit of the [speed](limits.md); 0 = none"),
        Row("`human/timeout`", "`all_timeouts`, else 0.5", "s", "age"),
        Row("`planner/max_speed`", "3", "m/s, 0..20", "limit of the [speed](limits.md); 0 = none"),
        Row("`planner/timeout`", "0.5", "s", "age"),
        Row("`duty`", "0", "duty, 0..65535, one or 16", "of each channel"),
        Row("`sonars/left` … `sonars/right`", "`used`", "`used`, `absent`", "each"),
        Row("`prefix`", "none", "text", "before names"),
        Row("`length`", "`wheels/length`, else 1.5", "m, above 0", "of the car"),
        Row("`chip`", "by user", "absolute path", "its socket")]


def test_declaration_of_a_field_is_found_by_the_field():
    declaration = parameter_of(Limits, "speed_mps")
    assert (declaration.name, declaration.accepted) == ("max_speed", {"low": 0.0, "high": 20})
