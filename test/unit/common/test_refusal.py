"""How often refused parameters are read again, and when that is logged."""
from __future__ import annotations

from car_interface.common.refusal import RefusedParameters
from car_interface.common.units import NS_PER_S

BAD = "servo_left is 'x'; accepted: an integer from 0 to 65535"


def pauses_and_lines(refused, text, count, now_ns=0):
    found = []
    for _ in range(count):
        line = refused.update(text, now_ns)
        found.append(((refused.due_ns - now_ns) / NS_PER_S, line))
        now_ns = refused.due_ns
    return found, now_ns


def test_pauses_grow_from_one_second_to_thirty():
    found, _ = pauses_and_lines(RefusedParameters(), BAD, 8)
    assert [pause for pause, _ in found] == [1, 2, 4, 8, 16, 30, 30, 30]


def test_line_names_the_parameter_and_says_what_happens_next():
    found, _ = pauses_and_lines(RefusedParameters(), BAD, 1)
    assert found[0][1] == f"{BAD}. This node waits, and reads its parameters again in 1 s, later every 30 s"


def test_same_line_is_not_repeated_for_five_minutes():
    found, _ = pauses_and_lines(RefusedParameters(), BAD, 16)
    logged = [line for _, line in found]
    assert logged[1:14] == [""] * 13
    assert logged[14:] == [f"{BAD}. This node waits, and reads its parameters again in 30 s", ""]


def test_new_reason_is_logged_at_once_and_the_pauses_begin_anew():
    refused = RefusedParameters()
    _, now_ns = pauses_and_lines(refused, BAD, 5)
    found, _ = pauses_and_lines(refused, "servo_right is missing; accepted: an integer", 2, now_ns)
    assert [pause for pause, _ in found] == [1, 2]
    assert found[0][1].startswith("servo_right is missing") and found[1][1] == ""
