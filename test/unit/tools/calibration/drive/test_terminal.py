"""What a person reads in the terminal while the car calibrates itself, line by line."""
import math

import pytest

from car_interface.tools.calibration.drive import terminal
from car_interface.tools.calibration.drive.knowledge import Knowledge
from car_interface.tools.calibration.drive.survey import (
    BLOCKED,
    DONE,
    MEASURING,
    PAUSED,
    SETTLING,
    Progress,
    Step,
    steering_text,
)
from car_interface.tools.calibration.steering.calibrate import DRIVEN, UNKNOWN, Breakpoint
from car_interface.tools.calibration.steering.smooth import BAND

NAN, INF = math.nan, math.inf


def point(radius_m=1.0, error=0.01):
    return Breakpoint(radius_m, 4000.0, 2.0, error * radius_m / BAND, 7, 14.0, DRIVEN if error < 0.08 else UNKNOWN)


def progress(fraction=0.24, points=None, missing=(), center=NAN, left_s=130.0):
    known = Knowledge(points=points or {}, missing=tuple(missing), center_duty=center, center_error=12.0)
    return Progress(fraction, known, 42.0, left_s, 9)


def test_picture_of_a_drive():
    points = {"left": [point(0.9), point(1.5, 0.12), point(300.0, INF)], "right": [point(1.1)]}
    made = terminal.drive_lines(
        Step(0.4, 1.0, MEASURING, "it measures 40% left, duty 4020: 0.8 of 1.3 m", 4020),
        progress(points=points, missing=["no data for right turns tighter than 1 m: drive three slow right circles"],
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


def test_picture_says_how_much_is_missing_and_when_it_can_be_ended_and_is_over():
    step, over = Step(0.4, 1.0, SETTLING, "to 40% left, duty 4020"), "ended by hand after 42 s"
    made = terminal.drive_lines(step, progress(missing=["a: drive three", "b", "c", "d", "e"])._replace(positions=1))
    assert made[0] == "it steers to 40% left, duty 4020" and made[1].endswith(" left, 1 position")
    assert made[-4:] == ["missing: a", "missing: b", "missing: c", "missing: … and 2 more"]
    assert terminal.missing_lines(["a: drive three", "b", "c", "d"]) == [f"missing: {name}" for name in "abcd"]
    known = progress(points={"left": [point()]})
    made = terminal.drive_lines(step, known)
    assert made[-2:] == ["nothing is missing; it goes on to know it better: F finishes now",
                         "# known   + not well enough   . not yet"]
    for made in (terminal.drive_lines(Step(None, 0.0, DONE, over), known),
                 terminal.drive_lines(Step(0.0, 0.0, DONE, over, held=0.1), known)):
        assert made[0].startswith("[#####") and made[-2] == "nothing is missing"
    assert terminal.plain_line(PAUSED, "hold the button", progress()) == (
        " 24%, 0:42 driven, about 2:10 left; paused: hold the button")


def test_instruction_that_is_longer_than_the_terminal_is_wrapped_and_whole():
    text = ("it stands 2.9 m from where it began, with no room to turn: move it towards the middle by hand or by the "
            "manual deadman, then hold the button again")
    made = terminal.wrapped(terminal.drive_lines(Step(0.0, 0.0, BLOCKED, text), progress()), 60)
    assert max(map(len, made)) < 60
    assert f"blocked: {text}" in " ".join(" ".join(made).split())


@pytest.mark.parametrize(("fraction", "bar", "percent"), [
    (0.0, "[....]", "  0%"), (0.49, "[#...]", " 49%"), (0.5, "[##..]", " 50%"), (0.999, "[###.]", " 99%"),
    (1.0, "[####]", "100%")])
def test_bar_is_full_only_when_all_is_done(fraction, bar, percent):
    assert (terminal.progress_bar(fraction, 4), terminal.percent(fraction)) == (bar, percent)


def test_steering_and_seconds_in_words():
    assert [steering_text(steering) for steering in (0.4, -1.0, 0.0, 0.004, NAN)] == [
        "40% left", "100% right", "the middle", "the middle", "?"]
    assert [terminal.clock_text(seconds) for seconds in (0.0, 59.4, 59.6, 125.0)] == [
        "0:00", "0:59", "1:00", "2:05"]


def test_stick_is_shown_beside_the_place_to_hold_it():
    guidance = Step(0.4, 0.0, MEASURING, "hold 40% left", 4020, 0.1)
    assert terminal.drive_lines(guidance, progress())[:3] == [
        "hold 40% left",
        "left |-----------V----o-+------------------| right  V hold here, o the stick",
        "     hold at 40% left; it is at 10% left"]


@pytest.mark.parametrize(("target", "held", "expected"), [
    (1.0, -1.0, "V---+---o"), (-1.0, -0.98, "----+---X"), (0.0, 0.5, "--o-V----"), (0.25, NAN, "---V+----"),
    (3.0, -3.0, "V---+---o")])
def test_bar_of_the_stick(target, held, expected):
    line = terminal.stick_bar(Step(target, 0.0, SETTLING, "", held=held), 9)[0]
    assert line.startswith(f"left |{expected}| right")


def test_radii_of_a_side_name_the_one_that_is_known_least():
    left, right = ([point(*one) for one in table] for table in (
        ((0.9,), (1.4, 0.11), (2.0, 0.99)), ((5.0, INF), (10.0, 1.0))))
    assert terminal.radius_marks(left) == "0.9 m #++ 2 m: 1 of 3, 2 m to ±99%"
    assert terminal.radius_marks(right) == "5 m .. 10 m: 0 of 2, 5 m isn't known"
    assert terminal.radius_marks([]) == "nothing known yet"
    whole_table = [point(0.96, INF), *29 * [point(300.0, INF)]]  # fits a terminal of 80 columns
    assert terminal.radius_marks(whole_table) == f"0.96 m {'.' * 30} 300 m: 0 of 30, 0.96 m isn't known"
