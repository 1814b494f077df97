"""One stick: whether its axis counts, and whether it overrides the planner. Time is passed in."""
import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from car_interface.teleop.stick import HOLD_NS, Stick

MS = 1_000_000
DEADBAND = 0.1
MOVES = st.lists(st.tuples(st.floats(-1, 1), st.booleans(), st.booleans(), st.integers(1, 800)), min_size=1,
                 max_size=40)


def after(moves, brakes=True):
    """A stick after moves (deflection, planner's deadman, believable, lasts ms); and the time of the last move."""
    stick, now_ns = Stick(DEADBAND, brakes), 0
    for deflection, is_planners, is_believable, lasts_ms in moves:
        stick.update(deflection, is_planners, is_believable, now_ns)
        last_ns, now_ns = now_ns, now_ns + lasts_ms * MS
    return stick, last_ns, now_ns


@pytest.mark.once
@given(MOVES, st.booleans())
@settings(max_examples=300)
def test_stick_overrides_beyond_its_dead_band_if_it_was_seen_within_it_and_a_pull_always_does(moves, brakes):
    stick, _, now_ns = after(moves, brakes)
    deflection, is_planners = moves[-1][:2]
    if is_planners and brakes and deflection < -DEADBAND:
        assert stick.overrides(now_ns) and stick.override() == deflection
    if stick.overrides(now_ns):
        assert is_planners
        assert stick.override() <= 0 or stick.counts and not stick.is_off_center
    stick.update(0.0, True, True, now_ns)
    assert not stick.overrides(now_ns + HOLD_NS), "it came to rest"

    never_at_rest = [(math.copysign(max(abs(each[0]), 1.01 * DEADBAND), each[0]), *each[1:]) for each in moves]
    assert not after(never_at_rest)[0].counts


@pytest.mark.parametrize("deflection", [-1.0, 1.0])
def test_steering_that_does_not_count_overrides_to_neither_side(deflection):
    stick, _, now_ns = after([(deflection, True, True, 500)] * 3, brakes=False)
    assert not stick.overrides(now_ns)


@pytest.mark.parametrize("moves, is_off_center", [
    ([(0.05, 1)], False),
    ([(0.051, 1)], True),
    ([(0.06, 499), (0.06, 1)], True),
    ([(0.06, 500), (0.06, 1)], False),
    ([(0.1, 500), (0.1, 1)], False),
    ([(0.06, 300), (0.079, 300), (0.06, 1)], False),
    ([(0.06, 300), (0.081, 300), (0.06, 300), (0.081, 1)], True),
])
def test_stick_is_centered_within_half_its_dead_band_or_where_it_stays(moves, is_off_center):
    pressed = [(0.0, False, True, 200), (0.5, True, True, 100)]
    stick, _, _ = after([*pressed, *((deflection, True, True, lasts_ms) for deflection, lasts_ms in moves)])
    assert stick.is_off_center == is_off_center


@pytest.mark.parametrize("deflection, is_over", [(0.02, True), (0.021, False)])
def test_override_is_over_half_a_second_after_the_stick_came_to_rest_within_0_02(deflection, is_over):
    stick = Stick(0.03, brakes=False)
    for value, at_ms in ((0.0, 0), (0.5, 100), (0.0, 200), (deflection, 500)):
        stick.update(value, True, True, at_ms * MS)
    assert stick.overrides(700 * MS) == (not is_over)


def test_override_that_has_ended_does_not_come_back_within_the_dead_band():
    moves = [(0.0, 200), (0.5, 200), (0.0, 600), (0.0, 1), (0.09, 1)]
    stick, last_ns, _ = after([(deflection, True, True, lasts_ms) for deflection, lasts_ms in moves])
    assert not stick.overrides(last_ns)
