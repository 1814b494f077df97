"""The periodic timer. Time is passed in."""
from __future__ import annotations

import pytest

from car_interface.common.rate_timer import RateTimer

MS = 1_000_000
NOW = 1000 * MS


def ticks(timer, times_ns):
    return [now_ns - NOW for now_ns in times_ns if timer.is_due(now_ns)]


def test_first_tick_is_due_at_once_and_the_others_a_period_apart():
    assert ticks(RateTimer(100, NOW), range(NOW, NOW + 35 * MS, MS)) == [0, 10 * MS, 20 * MS, 30 * MS]


def test_late_poll_does_not_shift_the_grid():
    timer = RateTimer(100, NOW)
    assert ticks(timer, [NOW, NOW + 13 * MS, NOW + 20 * MS]) == [0, 13 * MS, 20 * MS]
    assert timer.due_ns == NOW + 30 * MS


def test_after_a_stall_it_continues_from_now_without_catching_up():
    timer = RateTimer(100, NOW)
    assert ticks(timer, [NOW, NOW + 55 * MS, NOW + 56 * MS, NOW + 64 * MS, NOW + 65 * MS]) == [0, 55 * MS, 65 * MS]


@pytest.mark.parametrize("rate_hz, period_ns", [(1, 1_000_000_000), (50, 20 * MS), (3, 333_333_333)])
def test_period_is_the_inverse_of_the_rate(rate_hz, period_ns):
    assert RateTimer(rate_hz, NOW).period_ns == period_ns
