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


def test_tick_a_second_after_the_only_pong_is_known_as_well_as_clocks_that_differ_by_500_ppm_allow():
    """The pong's tick ended when it was received: 998 ms before the later tick begins, 1000 ms before that ends.

    For it began a tick before its end at the latest. In a second 100 ppm an hour bend a line by 14 ns.
    """
    lines, ns = lines_of(pong(1000, 0)), pong(1000, 0).latest.ns
    _, earliest_ns, latest_ns = lines.translate(1999)
    assert earliest_ns == pytest.approx(ns + 998 * (NS_PER_MS - 500) - 14, abs=1)
    assert latest_ns == pytest.approx(ns + 1000 * (NS_PER_MS + 500) + 14, abs=1)


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
    lines.choose(30_000, 100_000)
    assert lines.translate(30_000)[0] - low_ns == pytest.approx(100_000, abs=10)
    lines.choose(30_000, 1e12)
    center_ns = lines.translate(30_000)[0]
    assert earliest_ns < low_ns < low_ns + 100_000 < center_ns < latest_ns


def test_centre_is_that_of_the_polygon_s_area():
    """Offsets of 1 ms are open. At the upper one skews from −50 to 0 ppm are, at the lower one from −66.7 to 16.7.

    So the polygon is a trapezoid with sides as 3 to 5, whose centre is 11/24 of its height above the longer one.
    """
    lines, ns = ClockLines(pong(0, 0)), pong(0, 0).latest.ns
    assert lines.admit(None, Bound(60_000, ns + 60_000 * NS_PER_MS - 50_000))  # loosened by 50 µs
    assert lines.admit(None, Bound(-60_000, ns - 60_000 * NS_PER_MS + 3_000_000 - 50_000))
    lines.choose(0, 1e12)
    offset_ns, skew_ppm = lines.offset_and_skew()
    assert offset_ns - ns == pytest.approx(-13 / 24 * NS_PER_MS, abs=100)
    assert skew_ppm == pytest.approx(25, abs=0.01), "the Teensy's clock is fast if the line's slope is less"


def test_bound_that_comes_later_moves_the_centre_at_once():
    lines, end_ns = lines_of(pong(1000, 3 * NS_PER_MS)), pong(1000, 0).latest.ns
    lines.choose(1000, 1e12)
    assert lines.translate(1000)[0] == pytest.approx(end_ns + 1.5 * NS_PER_MS, abs=1000)
    assert lines.admit(None, pong(1000, 1 * NS_PER_MS).latest)
    assert lines.translate(1000)[0] == pytest.approx(end_ns + 0.5 * NS_PER_MS, abs=1000)


@pytest.mark.parametrize("gap_ns", [0.0, 1000.0])
def test_when_a_tick_began_may_be_known_to_the_nanosecond_and_how_fast_the_clock_is_not_at_all(gap_ns):
    lines, ns = ClockLines(pong(1000, 0)), pong(1000, 0).latest.ns
    assert lines.admit(Bound(1000, ns), None)
    lines.choose(1000, gap_ns)
    assert lines.translate(1000) == (ns + NS_PER_MS // 2, ns - 1, ns + NS_PER_MS + 501)  # rounded away from the middle
    assert lines.offset_and_skew() == (ns - 1000 * NS_PER_MS, 0.0)
