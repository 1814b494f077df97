"""Whether a window can be shown, and why not."""
import socket

import pytest

from car_interface.ros.screen import screen_problem


@pytest.mark.parametrize("display", [":7", ":7.0", "unix:7"])
def test_display_that_nobody_serves_is_named(display, tmp_path):
    assert screen_problem({"DISPLAY": display}, str(tmp_path)) == (
        f"the screen that DISPLAY names, {display}, can't be reached (No such file or directory)")


@pytest.mark.parametrize("abstract", [False, True], ids=["a_file", "an_abstract_name"])
def test_display_that_is_served_has_no_problem(abstract, tmp_path):
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(("\0" if abstract else "") + str(tmp_path / "X7"))
        server.listen(1)
        assert screen_problem({"DISPLAY": ":7"}, str(tmp_path)) == ""


@pytest.mark.parametrize("environment, problem", [
    ({}, "there is no screen (DISPLAY isn't set)"), ({"DISPLAY": ""}, "there is no screen (DISPLAY isn't set)"),
    ({"QT_QPA_PLATFORM": "offscreen"}, ""), ({"DISPLAY": "something/else"}, "")])
def test_no_display_is_no_screen_and_what_only_the_libraries_know_is_left_to_them(environment, problem):
    assert screen_problem(environment) == problem
