"""The periodic timer. Time is passed in."""
import pytest

from car_interface.common.rate_timer import RateTimer

MS = 1_000_000
NOW = 1000 * MS


@pytest.mark.parametrize("polls_ms, ticks_ms", [
    (range(35), [0, 10, 20, 30]),
    ([0, 13, 20], [0, 13, 20]),  # one that is late doesn't shift the others
    ([0, 55, 56, 64, 65], [0, 55, 65]),  # after a stall nothing is caught up
    ([0, 20, 21], [0, 20]),
])
def test_ticks_are_due_at_once_and_a_period_apart(polls_ms, ticks_ms):
    timer = RateTimer(100, NOW)
    assert [poll for poll in polls_ms if timer.is_due(NOW + poll * MS)] == ticks_ms
    assert timer.due_ns == NOW + (ticks_ms[-1] + 10) * MS


@pytest.mark.parametrize("rate_hz, period_ns", [(1, 1_000_000_000), (50, 20 * MS), (3, 333_333_333)])
def test_period_is_the_inverse_of_the_rate(rate_hz, period_ns):
    assert RateTimer(rate_hz, NOW).period_ns == period_ns
