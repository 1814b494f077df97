"""The polygon of lines that pings and pongs allow: ticks in ms, host times in ns."""
from __future__ import annotations

import pytest

from car_interface.teensy.sensing.clock_lines import NS_PER_MS, Bound, ClockLines, PongBounds, rise_ns

HOST_NS = 7_000_000_000_000  # at tick 0 of a Teensy without skew
MAX_SKEW_PPM = 500.0


def host_ns(tick, skew_ns_per_ms=0.0):
    return HOST_NS + round(tick * (NS_PER_MS + skew_ns_per_ms))


def pong(tick, delay_ns=0, skew_ns_per_ms=0.0):
    """Sent and answered as its tick ended, and received so much later."""
    end_ns = host_ns(tick + 1, skew_ns_per_ms)
    return PongBounds(Bound(tick + 1, end_ns), Bound(tick, end_ns + delay_ns))


def lines_of(*pongs, wander_ppm_per_h=100.0):
    lines = ClockLines(pongs[0], MAX_SKEW_PPM, wander_ppm_per_h)
    assert all(lines.admit(*other) for other in pongs[1:])
    return lines


def test_one_pong_bounds_its_tick_by_the_delay_and_a_tick_to_either_side():
    middle_ns, earliest_ns, latest_ns = lines_of(pong(1000, 3 * NS_PER_MS)).translate(1000)
    assert earliest_ns <= host_ns(1000.5) <= latest_ns and earliest_ns <= middle_ns <= latest_ns
    assert latest_ns - earliest_ns == pytest.approx(5 * NS_PER_MS, abs=10_000)


@pytest.mark.parametrize("skew", [-200.0, 0.0, 60.0], ids=["slow", "even", "fast"])
def test_pongs_over_a_minute_tell_skew_and_offset(skew):
    lines = lines_of(*(pong(tick, 500_000, skew) for tick in range(0, 60_000, 1000)))
    lines.choose(30_000, 0.0)
    assert lines.slope - NS_PER_MS == pytest.approx(skew, abs=20)
    assert lines.skew_ppm() == pytest.approx(-skew, abs=20)
    assert lines.offset_ns() == pytest.approx(HOST_NS, abs=NS_PER_MS)
    assert lines.tick_at(lines.translate(12_345)[0]) == pytest.approx(12_345.5, abs=1e-3)


def test_chosen_line_goes_through_the_lowest_times_and_with_a_gap_towards_the_centre():
    lines = lines_of(pong(0, NS_PER_MS), pong(60_000, NS_PER_MS))
    lines.choose(30_000, 0.0)
    low_ns, earliest_ns, latest_ns = lines.translate(30_000)
    lines.choose(30_000, 1e12)
    center_ns = lines.translate(30_000)[0]
    assert earliest_ns < low_ns < center_ns < latest_ns


@pytest.mark.parametrize("earliest, latest", [
    (Bound(2000, host_ns(2000) + 500 * NS_PER_MS), None), (None, Bound(2000, host_ns(2000) - 500 * NS_PER_MS)),
], ids=["later_than_all", "sooner_than_all"])
def test_bound_that_contradicts_all_lines_is_refused_and_changes_nothing(earliest, latest):
    lines = lines_of(pong(1000, 3 * NS_PER_MS))
    before = lines.translate(1500)
    assert not lines.admit(earliest, latest)
    assert lines.translate(1500) == before
    assert lines.admit(None, Bound(1000, host_ns(1000) + 900 * NS_PER_MS)) and lines.admit(None, None)
    assert lines.translate(1500) == before  # those forbid nothing


def test_old_bounds_fade_with_the_wander_of_the_crystals():
    def width_ns(wander_ppm_per_h):
        _, earliest_ns, latest_ns = lines_of(*(pong(tick) for tick in range(0, 5000, 1000)),
                                             wander_ppm_per_h=wander_ppm_per_h).translate(600_000)
        return latest_ns - earliest_ns
    assert width_ns(1000.0) > width_ns(100.0) > width_ns(1e-6)


def test_rise_is_how_far_one_bound_lies_over_the_line_through_another():
    assert rise_ns(Bound(0, 0), Bound(2, 2 * NS_PER_MS + 7), NS_PER_MS) == 7
    assert rise_ns(Bound(0, 0), Bound(2, 2 * NS_PER_MS + 7), NS_PER_MS + 10) == -13
