"""One stick: whether its axis counts, and whether it overrides the planner. Time is passed in."""
from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from car_interface.teleop.stick import HOLD_NS, Stick

MS = 1_000_000
DEADBAND = 0.1
MOVES = st.lists(st.tuples(st.floats(-1, 1), st.booleans(), st.booleans(), st.integers(1, 800)), min_size=1,
                 max_size=40)


def after(moves, brakes=True):
    """A stick after moves (deflection, planner's deadman, believable, lasts ms); with these and their times."""
    stick, now_ns, seen = Stick(DEADBAND, brakes), 0, []
    for deflection, is_planners, is_believable, lasts_ms in moves:
        stick.update(deflection, is_planners, is_believable, now_ns)
        seen.append((deflection, is_planners, now_ns))
        now_ns += lasts_ms * MS
    return stick, seen, now_ns


@pytest.mark.once
@given(MOVES, st.booleans())
@settings(max_examples=500)
def test_stick_beyond_its_dead_band_overrides_now_if_it_may_and_a_pull_always_does(moves, brakes):
    stick, seen, now_ns = after(moves, brakes)
    deflection, is_planners, _ = seen[-1]
    if is_planners and brakes and deflection < -DEADBAND:
        assert stick.overrides(now_ns) and stick.override() == deflection
    if stick.overrides(now_ns):
        assert is_planners
        assert stick.override() <= 0 or stick.counts and not stick.is_off_center


@pytest.mark.once
@given(MOVES)
@settings(max_examples=500)
def test_nothing_overrides_longer_than_the_hold_after_the_stick_came_to_rest(moves):
    stick, seen, _ = after([*moves, (0.0, True, True, 1)])
    assert not stick.overrides(seen[-1][2] + HOLD_NS)


@pytest.mark.once
@given(MOVES)
@settings(max_examples=500)
def test_axis_that_was_never_within_the_dead_band_does_not_count(moves):
    stick, seen, _ = after(moves)
    if all(abs(deflection) > DEADBAND for deflection, _, _ in seen):
        assert not stick.counts


@pytest.mark.parametrize("deflection", [-1.0, 1.0])
def test_steering_that_does_not_count_overrides_to_neither_side(deflection):
    stick, _, now_ns = after([(deflection, True, True, 500)] * 3, brakes=False)
    assert not stick.overrides(now_ns)


@pytest.mark.parametrize("moves, is_off_center", [
    ([(0.05, 1)], False),
    ([(0.051, 1)], True),
    ([(0.06, 499), (0.06, 1)], True),
    ([(0.06, 500), (0.06, 1)], False),
    ([(0.06, 300), (0.079, 300), (0.06, 1)], False),
    ([(0.06, 300), (0.081, 300), (0.06, 300), (0.081, 1)], True),
])
def test_stick_is_centered_within_half_its_dead_band_or_where_it_stays(moves, is_off_center):
    pressed = [(0.0, False, True, 200), (0.5, True, True, 100)]
    stick, _, _ = after([*pressed, *((deflection, True, True, lasts_ms) for deflection, lasts_ms in moves)])
    assert stick.is_off_center == is_off_center


def test_override_that_has_ended_does_not_come_back_within_the_dead_band():
    moves = [(0.0, 200), (0.5, 200), (0.0, 600), (0.0, 1), (0.09, 1)]
    stick, seen, _ = after([(deflection, True, True, lasts_ms) for deflection, lasts_ms in moves])
    assert not stick.overrides(seen[-1][2])
