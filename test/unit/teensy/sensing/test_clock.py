"""The Teensy's ticks as host time: what bounds them, what is taken, how sure that is, and what can't shake it.

The truth is made here, in ns and by hand: a crystal that is off by so many ppm, a way out and a way back.
"""

import math
import random
from collections import Counter

import pytest
from accuracy import clock as clock_accuracy
from hypothesis import given
from hypothesis import strategies as st

from car_interface.teensy.sensing import clock as reasons
from car_interface.teensy.sensing.clock import CONVERGED_PONGS, ONE_WAY_UNCERTAINTY_NS, UNKNOWN_NS, Clock

S, MS, US = 1_000_000_000, 1_000_000, 1_000
UINT32 = 2 ** 32
NOW = 1_000 * S
BYTE_NS = S * 10 / 115200
PING_BYTES, PONG_BYTES = 15, 14


def at(number):
    """When the pings of one a second are sent, at other phases of the tick each time."""
    return NOW + number * S + number * 618 * US


class Teensy:
    """A crystal of its own, so much too fast and after an hour faster still, and the way to it and back."""

    def __init__(self, start_ms=50_000, skew_ppm=0.0, ramp_ppm_per_h=0.0, seed=1):
        self.start_ms = start_ms  # at NOW
        self._skew_ppm = skew_ppm
        self._ramp_ppm_per_h = ramp_ppm_per_h
        self._random = random.Random(seed)
        self.reasons = Counter()  # of its pongs that weren't used or were notable

    def device_ms(self, host_ns):
        """Its clock, not cut to whole ms."""
        elapsed_ms = (host_ns - NOW) / MS
        hours = elapsed_ms / 3_600_000
        return self.start_ms + elapsed_ms * (1 + (self._skew_ppm + self._ramp_ppm_per_h * hours / 2) * 1e-6)

    def tick(self, host_ns):
        """What it would send."""
        return math.floor(self.device_ms(host_ns)) % UINT32

    def answer(self, clock, sent_ns, out_ms=0.05, back_ms=0.3, tick_error=0, sent_bytes=PING_BYTES):
        """One ping there and its pong back; what the clock makes of it."""
        read_ns = sent_ns + round(sent_bytes * BYTE_NS + out_ms * MS)
        received_ns = read_ns + round(PONG_BYTES * BYTE_NS + back_ms * MS)
        tick = (self.tick(read_ns) + tick_error) % UINT32
        sync = clock.pong(tick, sent_ns, sent_bytes, received_ns, PONG_BYTES)
        self.reasons.update(filter(None, [sync.reason]))
        return sync

    def keep_answering(self, clock, from_s, to_s, period_s=1.0, back_ms=0.3):
        """Pings with a dithered phase; the last one's outcome."""
        at_s, outcome = from_s, None
        while at_s < to_s:
            sent_ns = NOW + round((at_s + self._random.uniform(0, 0.01)) * S)
            outcome = self.answer(clock, sent_ns, self._random.uniform(0, 0.2), back_ms * self._random.random())
            at_s += period_s
        return outcome


def converged(teensy=None, seconds=60, **how):
    clock = Clock()
    (teensy or Teensy()).keep_answering(clock, 0, seconds, **how)
    assert clock.converged
    return clock


def error_ns(clock, teensy, at_s):
    """Of the stamp of what happens then; and whether its uncertainty admits it."""
    true_ns = NOW + round(at_s * S)
    stamp = clock.translate(teensy.tick(true_ns))
    assert abs(stamp.time_ns - true_ns) <= stamp.uncertainty_ns
    return stamp.time_ns - true_ns


def test_before_anything_is_known_a_tick_was_at_the_latest_when_it_was_received():
    assert Clock().translate(77, NOW) == (NOW, UNKNOWN_NS)
    assert UNKNOWN_NS > 100 * 365 * 86_400 * S, "more than any computer has run"
    assert Clock().translate(77, NOW, 14) == (NOW - round(14 * BYTE_NS), UNKNOWN_NS)


def test_before_it_has_converged_a_tick_goes_by_the_newest_one_less_its_time_on_the_wire():
    clock = Clock()
    clock.update_tick(5000, NOW, 14)
    newest_ns = NOW - round(14 * BYTE_NS)
    assert not clock.converged
    assert clock.translate(5000, NOW, 14).time_ns == newest_ns
    assert clock.translate(4900).time_ns == newest_ns - 100 * MS
    assert clock.tick_at(newest_ns) == 5000.5
    fast = Clock(1_000_000)
    fast.update_tick(5000, NOW, 100)
    assert fast.translate(5000, NOW, 100).time_ns == NOW - MS


def test_before_it_has_converged_a_tick_is_as_unsure_as_the_teensy_s_buffers_are_deep_and_more_far_off_or_cut_short():
    sync = Teensy().answer(Clock(), NOW, out_ms=1, back_ms=200)
    assert (sync.converged, sync.used, sync.reason, sync.skew_ppm) == (False, True, "", 0.0)
    assert sync.uncertainty_ns >= ONE_WAY_UNCERTAINTY_NS
    assert sync.round_trip_ns == 201 * MS + round(PING_BYTES * BYTE_NS) + round(PONG_BYTES * BYTE_NS)
    clock = Clock()
    clock.update_tick(7_200_000, NOW, 0)
    at_once, an_hour_before = (clock.translate(tick).uncertainty_ns for tick in (7_200_000, 3_600_000))
    assert an_hour_before - at_once == 3600 * 500 * US  # at 500 ppm
    free, cut = clock.translate(7_200_300), clock.translate(7_200_300, NOW + 100 * MS)
    assert (free.time_ns - cut.time_ns, cut.uncertainty_ns - free.uncertainty_ns) == (200 * MS, 200 * MS)


@pytest.mark.parametrize("gap_ms, count, converged", [(1000, CONVERGED_PONGS - 1, False), (300, CONVERGED_PONGS, True),
                                                      (205, 5, False), (205, 6, True), (20, 25, False),
                                                      (224, 5, False), (225, 5, True)])
def test_it_has_converged_after_five_pongs_over_about_a_second(gap_ms, count, converged):
    clock, teensy = Clock(), Teensy()
    for number in range(count):
        teensy.answer(clock, NOW + number * gap_ms * MS)
    assert clock.converged == converged


@pytest.mark.parametrize("sent_bytes", [15, 15 + 39], ids=["ping", "behind_the_filler"])
def test_time_on_the_wire_is_accounted_for_whatever_was_written_with_the_ping(sent_bytes):
    clock, teensy = Clock(), Teensy()
    for number in range(100):
        teensy.answer(clock, NOW + number * 601_618 * US, 0, 5, sent_bytes=sent_bytes)
    assert abs(error_ns(clock, teensy, 60.1234)) < 0.7 * MS


def test_sonars_ticks_bound_the_line_from_above_while_pongs_queue():
    teensy = Teensy()
    clock = converged(teensy, back_ms=0)
    congested = Clock()
    for number in range(60):
        teensy.answer(congested, at(number), 0.1, 8)
    before_ns = congested.translate(teensy.tick(NOW + 60 * S)).uncertainty_ns
    for number in range(300):
        at_ns = NOW + 55 * S + number * 20_034 * US
        congested.update_tick(teensy.tick(at_ns), at_ns + round(14 * BYTE_NS) + 50 * US, 14)
    after_ns = congested.translate(teensy.tick(NOW + 60 * S)).uncertainty_ns
    assert clock.translate(teensy.tick(NOW + 60 * S)).uncertainty_ns < after_ns + MS // 2
    assert before_ns > 6 * MS and after_ns < 1.2 * MS
    for number in range(62, 67):
        teensy.answer(congested, at(number), 0.1, 8)
    assert congested.translate(teensy.tick(NOW + 67 * S)).uncertainty_ns < 1.2 * MS


def test_of_many_pongs_the_tightest_count_wherever_they_come_among_the_others():
    """One in thirty finds the way out free, another one the way back; the rest waits 3 ms there and 20 ms back."""
    teensy = Teensy(skew_ppm=40)
    clock = Clock()
    for number in range(1500):
        free_there, free_back = number % 30 == 11, number % 30 == 17
        teensy.answer(clock, NOW + number * 20 * MS + number * 618 % 1000 * US,
                      0 if free_there else 3, 0 if free_back else 20)
    assert clock.translate(teensy.tick(NOW + 30 * S)).uncertainty_ns < 1.5 * MS
    assert abs(error_ns(clock, teensy, 30)) < 0.9 * MS


@pytest.mark.once
@given(skew_ppm=st.floats(-200, 200), seed=st.integers(0, 1000), back_ms=st.sampled_from([0.0, 1.0, 10.0, 100.0]),
       seconds=st.sampled_from([5, 30, 90]), later_s=st.floats(-30, 300))
def test_truth_lies_within_the_uncertainty_and_that_in_turn_is_no_more_than_the_bounds_leave(
        skew_ppm, seed, back_ms, seconds, later_s):
    teensy = Teensy(skew_ppm=skew_ppm, ramp_ppm_per_h=20, seed=seed)
    clock = converged(teensy, seconds, back_ms=back_ms)
    error_ns(clock, teensy, seconds + later_s)
    assert clock.translate(teensy.tick(NOW + seconds * S)).uncertainty_ns < (back_ms + 6) * MS


@pytest.mark.parametrize("skew_ppm, back_ms", [(-200, 0.3), (40, 60)], ids=["idle", "queueing"])
def test_skew_is_found_to_a_few_ppm_within_a_minute(skew_ppm, back_ms):
    teensy = Teensy(skew_ppm=skew_ppm)
    sync = teensy.keep_answering(clock := Clock(), 0, 60, back_ms=back_ms)
    assert sync.skew_ppm == pytest.approx(skew_ppm, abs=8 if back_ms < 1 else 25)
    assert sync.offset_ns == pytest.approx(NOW - round(50 * S / (1 + skew_ppm * 1e-6)), abs=3 * MS)
    assert [round(error_ns(clock, teensy, 60 + part / 7) / MS, 1) for part in range(7)] == [
        pytest.approx(0, abs=0.8 if back_ms < 1 else 1.0)] * 7


@pytest.mark.once
def test_errors_are_half_a_tick_and_neither_early_nor_late_on_average():
    errors_us = []
    for seed in range(40):
        teensy = Teensy(skew_ppm=5 * seed - 100, seed=seed)
        clock = converged(teensy, 40)
        errors_us += [error_ns(clock, teensy, 40 + part / 997) / US for part in range(100)]
    assert abs(sum(errors_us) / len(errors_us)) < 40
    assert 240 < sum(map(abs, errors_us)) / len(errors_us) < 290


@pytest.mark.once
def test_temperature_that_bends_the_line_is_followed():
    teensy = Teensy(ramp_ppm_per_h=40)
    clock = Clock()
    for minute in range(30):
        sync = teensy.keep_answering(clock, 60 * minute, 60 * minute + 60)
        assert abs(error_ns(clock, teensy, 60 * minute + 60)) < 0.9 * MS
        assert sync.used
    assert sync.skew_ppm == pytest.approx(20, abs=8)
    assert not teensy.reasons


CONVERGED = converged(Teensy(skew_ppm=50), back_ms=5)
UNCONVERGED = Clock()
UNCONVERGED.update_tick(110_000, NOW + 60 * S, 14)
ticks = st.integers(0, 300_000)
apart = st.one_of(st.integers(0, 3), st.integers(0, 300_000))
lateness_ns = st.one_of(st.integers(-3 * MS, 8 * MS), st.integers(-400 * S, 400 * S))
clocks = st.sampled_from([CONVERGED, UNCONVERGED])


@pytest.mark.once
@given(clocks, ticks, apart, lateness_ns, st.integers(0, 100))
def test_later_ticks_are_never_earlier_and_none_is_after_its_receipt_less_the_time_on_the_wire(
        clock, tick, apart_ms, late_ns, received_bytes):
    assert clock.translate(tick).time_ns < clock.translate(tick + 1 + apart_ms).time_ns
    received_ns = clock.translate(tick).time_ns + late_ns
    earlier, later = (clock.translate(one, received_ns, received_bytes).time_ns for one in (tick, tick + apart_ms))
    assert earlier <= later <= received_ns - round(received_bytes * BYTE_NS)


@pytest.mark.once
@given(clocks, ticks)
def test_tick_at_is_the_inverse_of_translate_in_the_middle_of_the_tick(clock, tick):
    assert clock.tick_at(clock.translate(tick).time_ns) == pytest.approx(tick + 0.5, abs=1e-5)


def test_uncertainty_grows_when_pings_stop_and_shrinks_when_they_come_again():
    teensy = Teensy(skew_ppm=30)
    clock = converged(teensy)
    grown_ns = [clock.translate(teensy.tick(NOW + at_s * S)).uncertainty_ns for at_s in (60, 120, 600, 3600)]
    assert grown_ns == sorted(grown_ns)
    assert grown_ns[0] < MS and grown_ns[3] > 50 * MS
    teensy.answer(clock, NOW + 3600 * S)
    assert clock.converged
    assert abs(error_ns(clock, teensy, 3600)) < 2 * MS


@pytest.mark.once
@given(start=st.integers(0, UINT32 - 1), steps=st.lists(st.integers(-20_000, 2 ** 31 - 1), max_size=20))
def test_unwrap_goes_on_from_the_tick_heard_last(start, steps):
    clock = Clock()
    true = start
    clock.update_tick(true, NOW, 14)
    for step in steps:
        true += step
        assert clock.unwrap(true % UINT32) == true
        clock.update_tick(true % UINT32, NOW, 14)


@pytest.mark.parametrize("tick_error, out_ms, reason", [
    *((error, 0.05, reasons.CONTRADICTION) for error in (-128, -4, 4, 1999)),
    pytest.param(0, -1.0, reasons.TOO_SOON, id="pong_that_comes_too_soon")])
def test_wrong_tick_that_noise_made_of_a_pong_or_a_sonar_is_not_used(tick_error, out_ms, reason):
    teensy = Teensy()
    clock = converged(teensy)
    before = clock.translate(teensy.tick(NOW + 61 * S))
    sync = teensy.answer(clock, NOW + 60 * S, out_ms, tick_error=tick_error)
    assert (sync.used, sync.reason, sync.converged) == (False, reason, True)
    clock.update_tick(teensy.tick(NOW + 60 * S) + 128, NOW + 60 * S + 2 * MS, 14)
    assert clock.translate(teensy.tick(NOW + 61 * S)) == before


@pytest.mark.parametrize("tick_error", [-128, 8])
@pytest.mark.parametrize("which", [0, 1, 3])
def test_wrong_tick_among_the_first_pongs_does_not_lock_the_right_ones_out(tick_error, which):
    teensy = Teensy(skew_ppm=40)
    clock = Clock()
    for number in range(15):
        teensy.answer(clock, NOW + round((number + 0.0061803 * number % 0.01) * S),
                      tick_error=tick_error if number == which else 0)
    assert clock.converged
    assert abs(error_ns(clock, teensy, 15)) < 1.2 * MS


def test_wrong_first_pong_is_overruled_by_the_next_two_even_in_the_same_half_second():
    clock, teensy = Clock(), Teensy()
    syncs = [teensy.answer(clock, NOW + number * 240 * MS, tick_error=-64 if number == 0 else 0)
             for number in range(6)]
    assert [sync.reason for sync in syncs] == ["", reasons.CONTRADICTION, reasons.ONE_WAS_WRONG, "", "", ""]
    assert [sync.converged for sync in syncs] == [False] * 5 + [True]


@pytest.mark.parametrize("wrong_ones", [(18,), (14, 18)], ids=["one", "two"])
@pytest.mark.parametrize("tick_error", [1, -2, -8])
def test_wrong_tick_that_a_queue_can_explain_is_thrown_out_without_the_rest_when_three_pongs_say_so(
        tick_error, wrong_ones):
    """While all pongs queue the bounds leave 9 ms; then the line is free, and what they leave shows what was wrong."""
    teensy = Teensy(skew_ppm=-40)
    clock = Clock()
    for number in range(20):
        wrong = tick_error if number in wrong_ones else 0
        teensy.answer(clock, at(number), 0.1, 9, tick_error=wrong)
    used = [teensy.answer(clock, at(number), 0.1, 0.1) for number in range(20, 40)]
    assert abs(error_ns(clock, teensy, 40)) < MS
    assert all(sync.converged for sync in used)
    assert set(teensy.reasons) <= {reasons.CONTRADICTION, reasons.ONE_WAS_WRONG}
    assert teensy.reasons[reasons.CONTRADICTION] <= 3 * len(wrong_ones)


def test_teensy_on_usb_which_has_no_baud_rate_is_known_all_the_same():
    clock, teensy = Clock(), Teensy()
    found = []
    for number in range(20):
        at_ns = at(number)
        tick = teensy.tick(at_ns + 100 * US)
        found.append(clock.pong(tick, at_ns, PING_BYTES, at_ns + 300 * US, PONG_BYTES).reason)
    assert found == [reasons.TOO_SOON, reasons.TOO_SOON, reasons.FASTER_LINE] + 17 * [""]
    assert clock.converged
    assert abs(error_ns(clock, teensy, 21)) < 1.2 * MS


def test_without_a_baud_rate_bytes_take_no_time_at_all():
    clock, teensy = Clock(), Teensy()
    found = [clock.pong(teensy.tick(at(number)), at(number), PING_BYTES, at(number), PONG_BYTES).reason
             for number in range(4)]
    assert found == [reasons.TOO_SOON, reasons.TOO_SOON, reasons.FASTER_LINE, ""]


@pytest.mark.parametrize("later_ns, reason", [(-1, reasons.TOO_SOON), (0, "")])
def test_a_pong_may_come_as_soon_as_the_line_allows(later_ns, reason):
    received_ns = NOW + round(PING_BYTES * BYTE_NS) + round(PONG_BYTES * BYTE_NS) + later_ns
    assert Clock().pong(50_000, NOW, PING_BYTES, received_ns, PONG_BYTES).reason == reason


def test_three_pongs_that_contradict_each_other_overrule_nothing():
    teensy = Teensy()
    clock = converged(teensy)
    found = [teensy.answer(clock, at(60 + number), tick_error=tick_error).reason
             for number, tick_error in enumerate((1000, -1000, 3000, 0))]
    assert found == [reasons.CONTRADICTION] * 3 + [""]


@pytest.mark.parametrize("gap_ms", [20, 36_000_000], ids=["20_ms", "10_h"])
@pytest.mark.parametrize("ahead", [True, False], ids=["host_was_suspended", "teensy_stood_still"])
def test_three_pongs_that_agree_begin_anew_after_a_clock_stood_still(gap_ms, ahead):
    teensy = Teensy(skew_ppm=40)
    clock = converged(teensy)
    teensy.start_ms += gap_ms if ahead else -gap_ms
    found = [teensy.answer(clock, at(60 + number)).reason for number in range(10)]
    assert found == [reasons.CONTRADICTION, reasons.CONTRADICTION, reasons.BEGUN_ANEW] + 7 * [""]
    assert clock.converged
    assert abs(error_ns(clock, teensy, 70)) < 1.2 * MS


@pytest.mark.once
def test_pings_a_hundred_times_a_second_cost_no_more_memory():
    clock = converged(seconds=70, period_s=0.01)
    assert len(vars(clock)["_buckets"]) <= 121


def test_after_a_long_pause_the_newest_five_half_seconds_with_pongs_are_left_of_all_before():
    teensy = Teensy()
    clock = converged(teensy, seconds=9)
    teensy.answer(clock, at(600))
    assert len(vars(clock)["_buckets"]) == 5 + 1


@pytest.mark.once
@pytest.mark.parametrize("disturbance", [{"clock_start_ms": UINT32 - 12_000, "bit_errors": 1e-4}, {"reboot_s": 2}])
def test_stamps_of_a_saturated_virtual_teensy_are_within_a_millisecond_and_honest(disturbance):
    score = clock_accuracy.run(clock_accuracy.Scenario(
        "short", saturated=True, drift_ppm=40, ramp_ppm_per_h=20, seconds=14, **disturbance))
    assert len(score.clock) > 100 and score.failures() == []
    assert score.converged_s < 2.5 and score.bytes_per_s > 8000
