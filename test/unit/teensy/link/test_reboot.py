"""Reboots of the Teensy, from its own clock; 60 ms lie between two sonar reports."""

import pytest

from car_interface.teensy.link.reboot import RebootDetector, reached_tick

MS, S = 1_000_000, 1_000_000_000
NOW = 100 * S
WRAP = 2 ** 32


def run(detector, ticks, now_ns=NOW, step_ms=60):
    """Feed ticks, so far apart on the host's clock; the reboots that were found."""
    found = []
    for tick in ticks:
        found.append(detector.update(tick % WRAP, now_ns))
        now_ns += step_ms * MS
    return [reboot for reboot in found if reboot]


def sonars(first, count=5):
    return [first + 60 * index for index in range(count)]


@pytest.mark.parametrize("ticks", [
    sonars(WRAP - 150),
    [*sonars(WRAP - 200), WRAP - 100, WRAP + 110, WRAP - 5, WRAP + 170],  # pongs overtook sonars
    [*sonars(10_000), 3, 10_360, 123, 10_480], [*sonars(10_000), 3, 4_000_000_000, 10_420],  # noise
    [10_000, *sonars(60_000)], [10_000, *sonars(300_000_000)],  # this computer was suspended, for a minute, for days
    [WRAP - 10_000, *sonars(WRAP + 60_000)],
], ids=["wrapping", "overtaken", "noise", "noise_in_a_row", "minute_ahead", "days_ahead", "ahead_over_a_wrap"])
def test_clock_that_goes_on_is_no_reboot(ticks):
    detector = RebootDetector()
    assert run(detector, ticks) == []


def test_clock_read_late_or_heard_again_after_days_is_no_reboot():
    detector = RebootDetector()
    assert run(detector, sonars(10_000, 50), step_ms=2000) == []
    assert run(detector, sonars(1000 + 3 * 86_400_000), NOW + 3 * 86_400 * S) == []


@pytest.mark.parametrize("before", [2_000, 2 ** 31 + 5, WRAP - 100_000_000])
def test_clock_that_begins_anew_is_a_reboot_told_once(before):
    detector = RebootDetector()
    assert run(detector, [*sonars(before), *sonars(12)]) == [
        f"its clock went from {(before + 240) / 1000:.1f} s back to 0.1 s"]


def test_clock_that_begins_anew_again_also_while_the_port_was_away_is_another_reboot():
    detector = RebootDetector()
    assert len(run(detector, [*sonars(50_000), *sonars(12, 60), *sonars(12)])) == 2
    run(detector, sonars(1_000_000))
    assert len(run(detector, sonars(2_000), NOW + 30 * S)) == 1


@pytest.mark.parametrize("ticks, step_ms, reboots", [
    ([50_000, 49_500, 49_500], 0, 0), ([50_000, 49_499, 49_499], 0, 1),  # back
    # Of a tick ahead that fits, what goes on from before it is a reboot.
    ([50_000, 50_501, 50_000, 50_000], 0, 0), ([50_000, 50_500, 49_999, 49_999], 0, 1),
    ([50_000, 150_601, 150_100, 150_100], 100_000, 0), ([50_000, 150_599, 150_098, 150_098], 100_000, 1),
    ([WRAP - 10_000, 86_390_000, 86_390_000], 0, 0), ([WRAP - 10_000, 86_390_001, 86_390_001], 0, 1),  # a day ahead
])
def test_tick_fits_from_half_a_second_back_to_half_a_second_and_a_thousandth_ahead(ticks, step_ms, reboots):
    assert len(run(RebootDetector(), ticks, step_ms=step_ms)) == reboots


def test_clock_that_goes_on_has_reached_its_tick_and_the_time_since_less_its_drift_modulo_32_bits():
    assert reached_tick(1000, NOW, NOW + 1000 * S) == 1000 + 999_000
    assert reached_tick(WRAP - 1000, NOW, NOW + 10 * S) == 8990


def test_reboot_that_sonars_have_shown_is_not_shown_again_by_pongs():
    detector = RebootDetector()
    assert detector.update(100_000, NOW, NOW - 5 * MS) is None
    assert len(run(detector, sonars(12), NOW + 60 * MS)) == 1
    for number in range(4):
        at_ns = NOW + 400 * MS + number * 60 * MS
        assert detector.update(352 + 60 * number, at_ns, at_ns - 5 * MS) is None


@pytest.mark.parametrize("lag_ms, reboots", [(2000, 0), (2001, 1)])
def test_pongs_that_lag_by_more_than_two_seconds_show_a_reboot(lag_ms, reboots):
    detector = RebootDetector()
    assert detector.update(100_000, NOW, NOW) is None
    ticks = [reached_tick(100_000, NOW, NOW + 10 * S + number * S // 20) - lag_ms for number in range(2)]
    found = [detector.update(tick, NOW + 10 * S + number * S // 20, NOW + 10 * S + number * S // 20)
             for number, tick in enumerate(ticks)]
    assert len([each for each in found if each]) == reboots
