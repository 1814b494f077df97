"""When a pull at the stick means reverse."""

import math

import pytest

from car_interface.throttle.esc_intention import AUTO, DRIVE, Pulls, Request

STOP = "stop"


def means_reverse(values, **changes):
    pulls = Pulls(0.1, 0.08)
    for now_ns, value in enumerate(values):
        pulls.update(Request(0.0, is_human=True, is_stop=True) if value is STOP else
                     Request(value, **{"gear": AUTO, "is_human": True, **changes}), now_ns)
    return pulls.means_reverse


@pytest.mark.parametrize("values, expected", [
    pytest.param([-0.5], False, id="first_pull"),
    pytest.param([0.0, -0.5], False, id="first_pull_from_the_center"),
    pytest.param([-0.5, -0.2, -0.9], False, id="one_pull_of_changing_strength"),
    pytest.param([-0.5, 0.0, -0.5], True, id="second_pull"),
    pytest.param([-0.5, 0.0, -0.5, 0.0, -0.5], True, id="third_pull"),
    pytest.param([-0.5, 0.0, -0.5, 0.0], False, id="center"),
    pytest.param([-0.5, 0.0, 0.5, 0.0, -0.5], False, id="pull_after_forward"),
    pytest.param([-0.5, 0.0, 0.04, 0.0, -0.5], False, id="pull_after_a_push_by_which_the_esc_does_not_drive"),
    pytest.param([-0.5, 0.039, -0.5], True, id="stick_that_springs_past_its_center"),
    pytest.param([-0.08, 0.0, -0.08], True, id="second_weakest_pull"),
    pytest.param([-0.5, -0.04, -0.5], False, id="stick_that_was_half_way_back"),
    pytest.param([-0.5, -0.039, -0.5], True, id="second_pull_from_farther_back"),
    pytest.param([-0.5, 0.0, STOP, -0.5], False, id="stop_in_between"),
    pytest.param([-0.5, STOP, -0.5, STOP, -0.5], False, id="stick_held_back_while_the_deadman_flaps"),
    pytest.param([-0.5, -0.079, -0.081, -0.079, -0.081], False, id="stick_that_trembles_at_the_dead_band"),
    pytest.param([-0.5, math.nan, -0.5], False, id="number_that_is_none_in_between"),
])
def test_second_pull_means_reverse(values, expected):
    assert means_reverse(values) == expected


def test_request_of_nothing_is_a_stick_s_at_0_and_claims_neither_person_nor_stop_nor_release():
    assert Request() == Request(value=0.0, gear=AUTO, is_human=False, is_stop=False, is_centered=False,
                                is_released=False, cruise_mps=0.0)


@pytest.mark.parametrize("push, expected", [(0.02, False), (0.019, True)])
def test_push_by_which_the_esc_drives_is_one_however_small(push, expected):
    pulls = Pulls(0.02, 0.3)
    for now_ns, value in enumerate((-0.5, 0.0, push, -0.5)):
        pulls.update(Request(value, is_human=True), now_ns)
    assert pulls.means_reverse == expected


def test_planner_and_gear_have_no_second_pull():
    assert not means_reverse([-0.5, 0.0, -0.5], is_human=False)
    assert not means_reverse([-0.5, 0.0, -0.5], gear=DRIVE)


def test_pull_that_became_a_brake_means_no_reverse_but_the_next_does():
    pulls = Pulls(0.1, 0.08)
    for now_ns, value in enumerate((-0.5, 0.0, -0.5)):
        pulls.update(Request(value, is_human=True), now_ns)
    pulls.mark_brake()
    pulls.update(Request(-0.6, is_human=True), 3)
    assert not pulls.means_reverse and pulls.began_ns == 2
    for now_ns, value in enumerate((0.0, -0.5), start=4):
        pulls.update(Request(value, is_human=True), now_ns)
    assert pulls.means_reverse and pulls.began_ns == 5
