"""The polygon of lines that pings and pongs allow: ticks in ms, host times in ns."""

import pytest

from car_interface.teensy.sensing.clock import NS_PER_MS, Bound, ClockLines, PongBounds

HOST_NS = 7_000_000_000_000  # at tick 0 of a Teensy without skew


def pong(tick, delay_ns):
    """Sent and answered as its tick ended, and received so much later."""
    end_ns = HOST_NS + (tick + 1) * NS_PER_MS
    return PongBounds(Bound(tick + 1, end_ns), Bound(tick, end_ns + delay_ns))


def lines_of(*pongs):
    lines = ClockLines(pongs[0])
    assert all(lines.admit(*other) for other in pongs[1:])
    return lines


def test_one_pong_bounds_its_tick_by_the_delay_and_a_tick_to_either_side():
    middle_ns, earliest_ns, latest_ns = lines_of(pong(1000, 3 * NS_PER_MS)).translate(1000)
    assert earliest_ns <= HOST_NS + 1000.5 * NS_PER_MS <= latest_ns and earliest_ns <= middle_ns <= latest_ns
    assert latest_ns - earliest_ns == pytest.approx(5 * NS_PER_MS, abs=10_000)


def test_chosen_line_goes_through_the_lowest_times_and_with_a_gap_towards_the_centre():
    lines = lines_of(pong(0, NS_PER_MS), pong(60_000, NS_PER_MS))
    lines.choose(30_000, 0.0)
    low_ns, earliest_ns, latest_ns = lines.translate(30_000)
    lines.choose(30_000, 1e12)
    center_ns = lines.translate(30_000)[0]
    assert earliest_ns < low_ns < center_ns < latest_ns
