"""How often refused parameters are read again, and when that is logged."""
import pytest

pytest.importorskip("rospy")

from car_interface.common.units import NS_PER_S
from car_interface.ros.runtime import RefusedParameters

BAD = "servo_left is 'x'; accepted: an integer from 0 to 65535"


def pauses_and_lines(refused, text, count, now_ns=0):
    found = []
    for _ in range(count):
        line = refused.update(text, now_ns)
        found.append(((refused.due_ns - now_ns) / NS_PER_S, line))
        now_ns = refused.due_ns
    return found, now_ns


def test_pauses_grow_from_one_second_to_thirty_and_the_line_that_says_so_comes_at_once_and_after_five_minutes():
    found, _ = pauses_and_lines(RefusedParameters(), BAD, 16)
    assert [pause for pause, _ in found[:8]] == [1, 2, 4, 8, 16, 30, 30, 30]
    assert [line for _, line in found] == [
        f"{BAD}. This node waits, and reads its parameters again in 1 s, later every 30 s", *[""] * 13,
        f"{BAD}. This node waits, and reads its parameters again in 30 s", ""]


def test_new_reason_is_logged_at_once_and_the_pauses_begin_again():
    refused = RefusedParameters()
    _, now_ns = pauses_and_lines(refused, BAD, 5)
    found, _ = pauses_and_lines(refused, "servo_right is missing; accepted: an integer", 2, now_ns)
    assert [pause for pause, _ in found] == [1, 2]
    assert found[0][1].startswith("servo_right is missing") and found[1][1] == ""
