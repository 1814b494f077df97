"""The polygon of lines that pings and pongs allow: ticks in ms, host times in ns."""

import pytest

from car_interface.teensy.sensing.clock_lines import NS_PER_MS, Bound, ClockLines, PongBounds

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
