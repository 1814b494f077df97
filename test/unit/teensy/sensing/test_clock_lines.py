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


def test_bound_that_is_far_away_is_loosened_by_the_largest_bend_of_the_truth():
    """At an hour's 100 ppm: by 50 µs at 60 s, and by 200 µs at 120 s. The first pong leaves its tick, 1 ms, open.

    So a line may rise to 1.05 ms over it until 60 s, by as much again until 120 s, and the bound there is loosened.
    """
    lines, ns = ClockLines(pong(0, 0)), pong(0, 0).latest.ns
    assert lines.admit(None, Bound(60_000, ns + 60_000 * NS_PER_MS))
    assert not lines.admit(Bound(120_000, ns + 120_000 * NS_PER_MS + 1_320_000), None)
    assert lines.admit(Bound(120_000, ns + 120_000 * NS_PER_MS + 1_280_000), None)


def test_chosen_line_goes_through_the_lowest_times_and_with_a_gap_towards_the_centre():
    lines = lines_of(pong(0, NS_PER_MS), pong(60_000, NS_PER_MS))
    lines.choose(30_000, 0.0)
    low_ns, earliest_ns, latest_ns = lines.translate(30_000)
    lines.choose(30_000, 1e12)
    center_ns = lines.translate(30_000)[0]
    assert earliest_ns < low_ns < center_ns < latest_ns
