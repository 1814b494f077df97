"""What a person reads in the terminal while the car calibrates itself, line by line."""
from __future__ import annotations

import math

import pytest

from car_interface.calibration.drive import terminal
from car_interface.calibration.drive.step import (
    BLOCKED,
    DONE,
    MEASURING,
    PAUSED,
    SETTLING,
    Guidance,
    Progress,
    Row,
    Step,
)

NAN, INF = math.nan, math.inf


def row(side="left", radius_m=1.0, error=0.01):
    return Row(side, radius_m, 4000.0, 3.0, error, error < 0.08)


def progress(fraction=0.24, rows=(), missing=(), center=NAN, left_s=130.0):
    return Progress(fraction, tuple(rows), tuple(missing), 42.0, left_s, 9, center, 12.0)


def test_picture_of_a_drive():
    rows = [row("left", 0.9), row("left", 1.5, 0.12), row("left", 300.0, INF), row("right", 1.1)]
    made = terminal.drive_lines(
        Step(0.4, 1.0, MEASURING, "it measures 40% left, duty 4020: 0.8 of 1.3 m", 4020),
        progress(rows=rows, missing=["no data for right turns tighter than 1 m: drive three slow right circles"],
                 center=4900.4))
    assert made == [
        "it measures 40% left, duty 4020: 0.8 of 1.3 m",
        "[#####...................]  24%   0:42 driven, about 2:10 left, 9 positions",
        "left   0.9 m #+. 300 m: 1 of 3, 300 m isn't known",
        "right  1.1 m # 1.1 m: 1 of 1",
        "straight on: duty 4900 ± 12",
        "missing: no data for right turns tighter than 1 m",
        "# known   + not well enough   . not yet",
    ]


def test_picture_where_nothing_is_missing_says_that_it_can_be_ended():
    made = terminal.drive_lines(Step(0.4, 1.0, MEASURING, "it measures"), progress(rows=[row()]))
    assert made[-2:] == ["nothing is missing; it goes on to know it better: F finishes now",
                         "# known   + not well enough   . not yet"]


def test_last_picture_has_neither_a_headline_nor_an_instruction_any_more():
    over = "ended by hand after 42 s"
    for made in (terminal.drive_lines(Step(None, 0.0, DONE, over), progress(rows=[row()])),
                 terminal.stick_lines(Guidance(0.0, 0.1, 0.0, DONE, over), progress(rows=[row()]))):
        assert made[0].startswith("[#####") and made[-2] == "nothing is missing"


def test_one_position_is_one():
    one = progress()._replace(positions=1)
    assert terminal.drive_lines(Step(0.4, 1.0, MEASURING, "it measures"), one)[1].endswith(" left, 1 position")


def test_line_of_a_side_fits_a_terminal_of_80_columns_with_all_the_radii_of_a_table():
    rows = [row("right", 0.96, INF), *(row("right", 10.0, INF) for _ in range(28)), row("right", 300.0, INF)]
    made = terminal.drive_lines(Step(0.4, 1.0, MEASURING, "it measures"), progress(rows=rows))
    assert f"right  0.96 m {'.' * 30} 300 m: 0 of 30, 0.96 m isn't known" in made


def test_picture_while_it_steers_to_a_position():
    assert terminal.drive_lines(Step(0.4, 1.0, SETTLING, "to 40% left, duty 4020"), progress())[0] == (
        "it steers to 40% left, duty 4020")


def test_picture_before_the_first_fit_has_no_legend_and_no_center():
    text = "no deadman is held; hold the autonomous deadman and it goes on"
    made = terminal.drive_lines(Step(None, 0.0, PAUSED, text), progress(fraction=0.0, left_s=200.0))
    assert made == [
        "paused: no deadman is held; hold the autonomous deadman and it goes on",
        "[........................]   0%   0:42 driven, about 3:20 left, 9 positions",
        "left   nothing known yet",
        "right  nothing known yet",
    ]


def test_instruction_that_is_longer_than_the_terminal_is_wrapped_and_whole():
    text = ("it stands 2.9 m from where it began, with no room to turn: move it towards the middle by hand or by the "
            "manual deadman, then hold the button again")
    made = terminal.drive_lines(Step(0.0, 0.0, BLOCKED, text), progress(), width=60)
    assert max(map(len, made)) < 60
    assert f"blocked: {text}" in " ".join(" ".join(made).split())


def test_wrapped_line_goes_on_two_columns_to_the_right_of_where_it_began():
    made = terminal.wrapped(["  the servo follows after 0.01 s", "a"], 25)
    assert made == ["  the servo follows", "    after 0.01 s", "a"]


def test_many_things_that_are_missing_are_cut_to_three_and_a_count():
    made = terminal.drive_lines(Step(0.0, 1.0, SETTLING, "to 40% left"), progress(missing=["a", "b", "c", "d", "e"]))
    assert [line for line in made if line.startswith("missing")] == [
        "missing: a", "missing: b", "missing: c", "missing: … and 2 more"]


def test_what_is_missing_at_the_end_is_listed_whole_and_without_advice_for_another_kind_of_drive():
    assert terminal.missing_lines(["no data for left turns: drive three", "no center"]) == [
        "missing: no data for left turns", "missing: no center"]


@pytest.mark.parametrize(("fraction", "expected"), [
    (0.0, "[....]"), (0.49, "[#...]"), (0.5, "[##..]"), (0.999, "[###.]"), (1.0, "[####]"), (7.0, "[####]"),
    (-1.0, "[....]"), (NAN, "[....]")])
def test_bar_is_full_only_when_all_is_done(fraction, expected):
    assert terminal.progress_bar(fraction, 4) == expected


@pytest.mark.parametrize(("fraction", "expected"), [
    (0.0, "  0%"), (0.249, " 24%"), (0.997, " 99%"), (1.0, "100%"), (NAN, "  ?%")])
def test_percent_is_100_only_when_all_is_done(fraction, expected):
    assert terminal.percent(fraction) == expected


@pytest.mark.parametrize(("seconds", "expected"), [
    (0.0, "0:00"), (59.4, "0:59"), (59.6, "1:00"), (125.0, "2:05"), (-3.0, "0:00"), (INF, "?"), (NAN, "?")])
def test_clock(seconds, expected):
    assert terminal.clock_text(seconds) == expected


@pytest.mark.parametrize(("steering", "expected"), [
    (0.4, "40% left"), (-1.0, "100% right"), (0.0, "the middle"), (0.004, "the middle"), (NAN, "?")])
def test_steering_in_words(steering, expected):
    assert terminal.steering_text(steering) == expected


def test_stick_is_shown_beside_the_place_to_hold_it():
    guidance = Guidance(0.4, 0.1, 1.4, MEASURING, "hold 40% left", 4020)
    assert terminal.stick_lines(guidance, progress())[:3] == [
        "hold 40% left",
        "left |-----------V----o-+------------------| right  V hold here, o the stick",
        "     hold at 40% left; it is at 10% left"]


@pytest.mark.parametrize(("target", "held", "expected"), [
    (1.0, -1.0, "V---+---o"), (-1.0, -0.98, "----+---X"), (0.0, 0.5, "--o-V----"), (0.25, NAN, "---V+----"),
    (3.0, -3.0, "V---+---o")])
def test_bar_of_the_stick(target, held, expected):
    line = terminal.stick_bar(Guidance(target, held, 0.0, SETTLING, "", 0), 9)[0]
    assert line.startswith(f"left |{expected}| right")


def test_radii_of_a_side_name_the_one_that_is_known_least():
    rows = [row(radius_m=0.9), row(radius_m=1.4, error=0.11), row(radius_m=2.0, error=0.99),
            *(row("right", radius_m, error) for radius_m, error in ((5.0, INF), (10.0, 1.0)))]
    assert terminal.radius_marks(rows, "left") == "0.9 m #++ 2 m: 1 of 3, 2 m to ±99%"
    assert terminal.radius_marks(rows, "right") == "5 m .. 10 m: 0 of 2, 5 m isn't known"
    assert terminal.radius_marks([], "left") == "nothing known yet"


def test_line_for_a_log():
    assert terminal.plain_line(PAUSED, "hold the button", progress()) == (
        " 24%, 0:42 driven, about 2:10 left; paused: hold the button")


def test_introduction_says_how_much_room_it_takes():
    assert terminal.introduction(False, 3.0) == (
        "The car drives by itself while you hold the autonomous deadman, within 3 m of\n"
        "  where it stands when you first hold it: 6 x 6 m have to be free. Let go, and\n"
        "  it stops.")
    assert terminal.introduction(True, 3.0).startswith("You drive, holding the manual deadman: slowly")
