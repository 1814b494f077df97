"""What a reboot in mid-drive costs: the heading stays to a pulse or two, and the covariance says what isn't known.

test/accuracy/reboot.py measures it over many drives on the virtual Teensy; a few of them are here, with the rules.
"""

import math
import os

import pytest
from accuracy import reboot as reboot_accuracy

from car_interface.teensy.sensing.pose import HEADING_VARIANCE, HeadingFilter
from car_interface.teensy.sensing.restart import LEFT, RIGHT, RestartBridge
from car_interface.teensy.sensing.wheel_filter import WheelFilter

TRACK_M, PULSE_M = reboot_accuracy.TRACK_M, reboot_accuracy.PULSE_M
BEFORE_MS = 10_000.0
MPS2 = 1.34e-4  # 2 m/s², in pulses/ms²
REBOOTS = 200 if os.environ.get("CAR_INTERFACE_ALL") else 8


@pytest.mark.once
def test_heading_stays_right_whatever_the_car_does_meanwhile_and_odometry_is_silent_for_less_than_a_second():
    outcomes = [reboot_accuracy.run(40_000 + index) for index in range(REBOOTS)]
    assert [outcome for outcome in outcomes if outcome.heading_sigmas > 3 or outcome.gap_s >= 1.0] == []
    steady = [outcome for outcome in outcomes if outcome.plan.kind in reboot_accuracy.STEADY]
    assert len(steady) > REBOOTS / 4
    assert sum(abs(outcome.heading_deg) > 6 for outcome in steady) <= 0.01 * len(steady), "two pulses"


@pytest.mark.once
@pytest.mark.parametrize("fault, seed", [
    (reboot_accuracy.OFF, 40083), (reboot_accuracy.OFF, 40193), (reboot_accuracy.BOTH, 1063),
    (reboot_accuracy.BOTH, 150068), (reboot_accuracy.BOTH, 350160), (reboot_accuracy.HIDDEN, 1001),
    (reboot_accuracy.HIDDEN, 1002), (reboot_accuracy.OFF, 440125), (reboot_accuracy.OFF, 440129),
    (reboot_accuracy.BOTH, 450171), (reboot_accuracy.UNPLUGGED, 470109), (reboot_accuracy.HIDDEN, 470103),
    (reboot_accuracy.BOTH, 470045),
], ids=["stopped_and_turned_unseen", "reverses_as_it_is_seen_again", "slalom", "reversed_after_the_boot",
        "had_started_before_the_boot", "on_for_as_long_as_before", "on_for_as_long_as_before_and_standing",
        "slow_slalom_without_power", "circle_after_a_manoeuvre_without_power", "reversed_before_the_boot_and_after",
        "fast_slalom_without_a_cable", "slalom_that_is_taken_for_circles",
        "circle_after_reversals_after_the_boot"])
def test_manoeuvre_that_nobody_saw_is_within_three_sigma(fault, seed):
    assert reboot_accuracy.run(seed, fault).inside >= 0.99


@pytest.mark.once
@pytest.mark.parametrize("fault, seed", [(reboot_accuracy.OFF, 700), (reboot_accuracy.OFF, 701),
                                         (reboot_accuracy.BOTH, 701)])
def test_car_that_never_moved_and_starts_unseen_is_within_three_sigma(fault, seed):
    assert reboot_accuracy.run(seed, fault, is_parked=True).inside >= 0.99


class Bridge(RestartBridge):
    """That of a car which rolled at so many pulses a ms, 0.066 is 1 m/s, each wheel half-way between two magnets.

    Its pulses are counted again after ``blind_ms``; ``places`` is where the wheels are then, if it rolls on.
    """

    def __init__(self, speed=0.066, curvature=0.0, blind_ms=310, has_known_boot=False, positions=(100.5, 100.5)):
        self.speeds = [speed * (1 + sign * curvature * TRACK_M / 2) for sign in (-1, 1)]
        wheels, heading = (WheelFilter(), WheelFilter()), HeadingFilter()
        for wheel, one, position in zip(wheels, self.speeds, positions):
            wheel.count, wheel.position, wheel.speed = 100, position, one
        heading.begin(0.0, HEADING_VARIANCE, 0.01)
        heading.curvature_per_m = curvature
        super().__init__(BEFORE_MS, wheels, heading, TRACK_M, BEFORE_MS + blind_ms if has_known_boot else None)
        self.begin_ms, self.places = BEFORE_MS + blind_ms, [100.5 + one * blind_ms for one in self.speeds]
        self.report(self.begin_ms)

    def roll(self, lasts_ms=400, speeds=None, places=None):
        """Roll on, the first two pulses of each wheel unproven, until the outcome is ready."""
        speeds, times = speeds or self.speeds, []
        forward = speeds[LEFT] > 0
        for speed, place in zip(speeds, places or self.places):
            first, step = int(place) + forward - place, 1 if forward else -1
            times.append([round(self.begin_ms + (first + step * number) / speed) for number in range(1000)])
        return self.take(times, step, lasts_ms)

    def speed_up(self, rest_ms=0.0):
        """Speed up by 2 m/s², at first after a rest; return the outcome and the first magnet whose pulse is counted."""
        speed = self.speeds[LEFT]
        times = {place: BEFORE_MS + rest_ms + (math.sqrt(speed ** 2 + 2 * MPS2 * (place - 100.5)) - speed) / MPS2
                 for place in range(101, 300)}
        counted = {place: at_ms for place, at_ms in times.items() if at_ms > self.begin_ms}
        return self.take([list(counted.values())] * 2, 1), min(counted)

    def take(self, times, step, lasts_ms=400):
        """Take each wheel's pulses at these times, the first two unproven, until the outcome is ready."""
        for at_ms, side, number in sorted((at_ms, side, number) for side, each in enumerate(times)
                                          for number, at_ms in enumerate(each) if at_ms <= self.begin_ms + lasts_ms):
            self.report(at_ms)
            self.add(side, *((1, 0) if number < 2 else (0, step)), at_ms)
            if self.is_ready(at_ms):
                return self.solve(at_ms)
        raise AssertionError("never ready")


@pytest.mark.parametrize("speed", [0.066, -0.066], ids=["forward", "backward"])
def test_pulses_that_nobody_counted_are_made_up_for_to_the_magnet(speed):
    some = Bridge(speed)
    outcome = some.roll(290)
    first = int(some.places[LEFT]) + (speed > 0)
    assert [wheel.place for wheel in outcome.wheels] == [first, first]
    assert outcome.was_rolling and outcome.wheels[LEFT].forward == (speed > 0)
    assert outcome.difference_variance == pytest.approx(1 / 9), "a whole pulse is three sigma"
    # On a straight it is sure to 0.05 1/m, and to the turn that a driver can steer within a part of 1.5 s.
    assert outcome.curvature_per_m == 0.0
    assert outcome.curvature_variance == pytest.approx(0.05 ** 2 + ((310 / 1500) ** 2 / 3) ** 2)


@pytest.mark.parametrize("speed", [0.033, 0.066])
def test_car_that_speeds_up_on_the_way_is_placed_to_the_magnet(speed):
    outcome, place = Bridge(speed).speed_up()
    assert [wheel.place for wheel in outcome.wheels] == [place] * 2


def test_parked_car_that_starts_unseen_is_placed_by_its_acceleration_and_turns_on_no_more_than_that():
    outcome, place = Bridge(0.0, blind_ms=1500).speed_up(rest_ms=1200)
    assert place == 107, "2 m/s² for 0.3 s are 6 pulses"
    assert [wheel.place for wheel in outcome.wheels] == [place] * 2
    # It may have gone and come back with 2 m/s², and have turned by 1 1/m as three sigma on that.
    farther = MPS2 * 1500 ** 2 / 12
    assert math.sqrt(outcome.difference_variance) < 1.1 * TRACK_M * math.hypot(1 / 3, 0.05) * math.hypot(farther, 7)


def test_wheels_in_a_curve_are_placed_each_by_its_own_distance():
    some = Bridge(curvature=0.8)
    assert [wheel.place for wheel in some.roll(290).wheels] == [int(place) + 1 for place in some.places]


def test_car_that_stood_goes_on_from_where_it_stood_once_a_direction_is_proven():
    some = Bridge(speed=0.0)
    some.add(LEFT, 1, 0, BEFORE_MS + 5000)
    some.add(RIGHT, 1, 0, BEFORE_MS + 5050)
    assert not some.is_ready(BEFORE_MS + 5050)
    some.add(LEFT, 1, 0, BEFORE_MS + 5090)
    some.add(RIGHT, 1, 0, BEFORE_MS + 5130)
    assert not some.is_ready(BEFORE_MS + 5130) and some.pending(LEFT) == 2
    some.add(LEFT, 0, -1, BEFORE_MS + 5160)
    some.add(RIGHT, 0, -1, BEFORE_MS + 5190)
    assert some.is_ready(BEFORE_MS + 5190)
    outcome = some.solve(BEFORE_MS + 5190)
    assert [(wheel.place, wheel.forward) for wheel in outcome.wheels] == [(100, False), (100, False)]
    assert not outcome.was_rolling


def test_wheels_that_stood_go_on_from_their_next_magnets_wherever_they_were_before_them():
    some = Bridge(speed=0.0, positions=(100.05, 100.95))
    for side in (LEFT, RIGHT):
        some.add(side, 2, 1, BEFORE_MS + 5000)
    outcome = some.solve(BEFORE_MS + 5000)
    assert [wheel.place for wheel in outcome.wheels] == [103, 103], "each pulse since 100 was counted"
    assert outcome.difference_variance == 0.0


@pytest.mark.parametrize("interval_ms, was_rolling", [(199, True), (200, False)])
def test_car_that_is_slower_than_5_pulses_a_second_after_the_restart_is_taken_to_have_started_only_then(
        interval_ms, was_rolling):
    some = Bridge()
    for side in (LEFT, RIGHT):
        some.add(side, 1, 0, some.begin_ms + 1)
        some.add(side, 0, 1, some.begin_ms + 1 + interval_ms)
    assert some.solve(some.begin_ms + 251).was_rolling == was_rolling


def test_car_that_started_only_later_keeps_the_curvature_from_before():
    some = Bridge(speed=0.0, curvature=0.5, blind_ms=750)
    for side in (LEFT, RIGHT):
        for count in range(5):
            some.add(side, 0, 1, BEFORE_MS + 5000 + 20 * count)
    outcome = some.solve(BEFORE_MS + 5080)
    assert outcome.curvature_per_m == 0.5  # known to 0.1 1/m, and 1 1/m to the other side is three sigma of 1.5 s
    assert outcome.curvature_variance == pytest.approx(0.01 + (0.5 * (750 / 1500) ** 2) ** 2)


@pytest.mark.parametrize("later_ms, speed", [(0, 0.0), (300, 0.01)], ids=["at_one_time", "one_after_the_other"])
def test_wheels_that_do_not_roll_over_a_same_time_show_no_curvature(later_ms, speed):
    some = Bridge(speed=0.0, curvature=0.5)
    for side in (LEFT, RIGHT):
        at_ms = BEFORE_MS + 5000 + side * later_ms
        some.add(side, 1, 0, at_ms)
        some.add(side, 0, 1, at_ms + later_ms / 3)
    outcome = some.solve(BEFORE_MS + 5400)
    assert outcome.curvature_per_m == 0.5
    assert [wheel.speed for wheel in outcome.wheels] == [speed] * 2


@pytest.mark.parametrize("blind_ms, place", [(318, 111), (324, 112)])
def test_car_that_stopped_unseen_half_way_goes_on_half_a_pulse_before_the_next_magnet(blind_ms, place):
    """From 100.5 it rolled 0.066 / 2 pulses a ms, and then half a pulse on average: to 111.49 or 111.69."""
    some = Bridge(blind_ms=blind_ms)
    for side in (LEFT, RIGHT):
        for later_ms, unproven in ((0, 1), (50, 1), (100, 0)):
            some.add(side, unproven, 1 - unproven, BEFORE_MS + 5000 + later_ms)
    outcome = some.solve(BEFORE_MS + 5100)
    assert not outcome.was_rolling and [wheel.place for wheel in outcome.wheels] == [place] * 2
    # One sigma: it stopped after a quarter to all of the time, and had gone faster or slower by 2 m/s² / 3 before.
    stopped, faster = 0.066 * blind_ms / 4, MPS2 * blind_ms ** 2 / 12
    assert outcome.mean_variance == pytest.approx(stopped ** 2 + faster ** 2 + 0.3 ** 2)


def test_curvature_after_a_reboot_is_as_uncertain_as_the_ticks_of_both_wheels_over_the_same_time():
    some = Bridge(speed=0.0)
    for side in (LEFT, RIGHT):
        for count in range(9):
            some.add(side, 0, 1, BEFORE_MS + 500 + 15 * count)
    curvature, variance = some._curvature_after()
    assert curvature == 0.0
    assert math.sqrt(variance) == pytest.approx(math.sqrt(2) * 0.45 / 120 / TRACK_M), "0.45 ms of 120 for each wheel"


def test_direction_that_one_wheel_proves_holds_for_both():
    some = Bridge(speed=0.0)
    some.add(RIGHT, 2, 0, BEFORE_MS + 5000)
    some.add(LEFT, 2, 1, BEFORE_MS + 5100)
    assert not some.is_ready(BEFORE_MS + 5100), "the other wheel may still prove its own"
    assert some.is_ready(BEFORE_MS + 5260)
    assert [wheel.forward for wheel in some.solve(BEFORE_MS + 5260).wheels] == [True, True]


def test_direction_that_comes_long_after_the_first_pulses_leaves_them_in_doubt():
    some = Bridge(speed=0.0)
    for side in (LEFT, RIGHT):
        some.add(side, 2, 0, BEFORE_MS + 5000)
        some.add(side, 0, 1, BEFORE_MS + 60_000)
    assert some.solve(BEFORE_MS + 60_000).mean_variance >= 4.0


def test_car_that_makes_no_pulse_any_more_has_stopped_on_the_way():
    some = Bridge()
    assert not some.report(BEFORE_MS + 400)
    assert some.report(BEFORE_MS + 411) == [pytest.approx(100.5 + 0.066 * 310 / 2)] * 2, "that is said"
    assert not some.report(BEFORE_MS + 611), "once"
    assert some.place_variance(BEFORE_MS + 611) > (1.34e-4 * 310 ** 2 / 12) ** 2 + (0.066 * 310 / 4) ** 2 - 1e-6
    for side in (LEFT, RIGHT):
        some.add(side, 2, 1, BEFORE_MS + 5000)
    assert some.solve(BEFORE_MS + 5000).mean_variance > 4.0, "where on the way nobody knows"


def test_car_that_reversed_unseen_has_turned_on_both_of_its_ways():
    outcome = Bridge(0.033, 0.5, 1300).roll(400, (-0.03, -0.03), (100.5, 100.5))
    left, right = (wheel.place for wheel in outcome.wheels)
    assert abs((left + right) / 2 - 100.5) < 6 and right > left  # it ends near where it began, turned to the left
    assert outcome.difference_variance > (0.2 * 10 * TRACK_M) ** 2  # 0.2 1/m on ten pulses each way


def test_car_that_reversed_unseen_may_still_be_ahead_of_where_it_was():
    """From 0.066 to −0.033 pulses a ms, evenly within 620 ms: 10.2 pulses ahead of 100.5."""
    outcome = Bridge(0.066, blind_ms=620).roll(400, (-0.033, -0.033), (110.7, 110.7))
    for wheel in outcome.wheels:
        assert not wheel.forward and abs(wheel.place - 110.7) < 5, "it may have slowed down earlier or later"


def test_car_that_reverses_before_enough_is_known_is_followed_from_there():
    some = Bridge()
    for side in (LEFT, RIGHT):
        some.add(side, 2, -2, BEFORE_MS + 400)
    some.add(LEFT, 0, 1, BEFORE_MS + 500)
    assert [some.pending(side) for side in (LEFT, RIGHT)] == [1, 0]


@pytest.mark.parametrize("speed, blind_ms, within_s", [(0.0, 1500, 1.5), (0.0, 5000, 2.0), (0.066, 1500, 1.5)],
                         ids=["parked", "parked_for_long", "rolling"])
def test_car_may_have_gone_and_come_back_to_its_speed_by_2_mps2_unseen(speed, blind_ms, within_s):
    some = Bridge(speed, blind_ms=blind_ms)
    if speed:
        outcome = some.roll()
    else:
        for side in (LEFT, RIGHT):
            some.add(side, 2, 1, BEFORE_MS + 9000)
        outcome = some.solve(BEFORE_MS + 9000)
    farther_m = 2.0 * within_s ** 2 / 4  # faster for half of the time, slower for the other
    assert 0.99 <= 3 * math.sqrt(outcome.mean_variance) * PULSE_M / farther_m < 1.1


@pytest.mark.parametrize("after_ms, has_pulse, may_have_changed", [
    (99, False, True), (100, False, False), (250, True, True), (251, True, False)])
def test_speed_is_in_doubt_until_it_is_seen_again_and_not_if_that_takes_so_long_that_the_car_has_stopped(
        after_ms, has_pulse, may_have_changed):
    some = Bridge(blind_ms=800)
    if has_pulse:
        some.add(LEFT, 1, 0, some.begin_ms + after_ms)
    changed = MPS2 * (800 + after_ms) / 3 if may_have_changed else 0.0  # 2 m/s² all the time is three sigma
    assert math.sqrt(some.speed_variance(some.begin_ms + after_ms)) == pytest.approx(changed)


def test_straight_car_may_have_turned_as_tightly_as_it_can_unseen():
    turn_rad = math.sqrt(Bridge(blind_ms=1500).roll(300).difference_variance) * PULSE_M / TRACK_M
    assert 1.0 <= 3 * turn_rad / (0.066 * 1500 * PULSE_M * 1.0) < 1.3


def test_longer_outage_is_known_less_well():
    variances = [Bridge(blind_ms=blind_ms).roll(300).mean_variance for blind_ms in (310, 1500, 5000)]
    assert variances == sorted(variances) and variances[-1] > 10 * variances[0]


def test_reset_shows_with_its_first_pulse_for_the_firmware_knows_its_direction():
    some = Bridge()
    some.restart()  # nothing was reported since
    assert some.is_reset((1, 0), (0, 0), BEFORE_MS + 15)
    assert not some.is_reset((0, 0), (1, 0), BEFORE_MS + 15), "a reboot"
    assert not some.is_reset((1, 0), (0, 0), BEFORE_MS + 600), "much was lost"


@pytest.mark.parametrize("boot_ms, stood_ms", [(None, 1400), (BEFORE_MS + 1200, 600)], ids=["unknown", "known"])
def test_parked_car_has_stood_until_the_last_report_before_the_boot(boot_ms, stood_ms):
    some = Bridge(speed=0.0, blind_ms=0)
    for after_ms in (0, 200, 400, 600, 1200, 1400):
        some.report(BEFORE_MS + after_ms)
    some.restart(boot_ms)
    some.restart()
    some.report(BEFORE_MS + 2400)
    for side in (LEFT, RIGHT):
        some.add(side, 2, 1, BEFORE_MS + 2450)
    farther = 1.34e-4 * (2450 - stood_ms) / 3
    assert some.speed_variance(BEFORE_MS + 2450) == pytest.approx(farther ** 2, rel=0.01), "by 2 m/s² all the time"


def test_pulses_of_the_first_report_after_a_known_boot_are_spread_evenly_from_the_boot_on():
    some = Bridge(speed=0.0, has_known_boot=True)
    some.add(LEFT, 2, 1, some.begin_ms)
    some.add(RIGHT, 2, 1, some.begin_ms + 100)
    left, right = (wheel.pulses for wheel in some.solve(some.begin_ms + 300).wheels)
    assert left == [(1, some.begin_ms), (2, some.begin_ms)]
    assert right == [(1, some.begin_ms + 20), (2, some.begin_ms + 100)], "each 40 ms, the first after half of that"


def test_parked_car_whose_first_report_comes_long_after_a_known_boot_may_have_started_before_it():
    some = Bridge(speed=0.0, has_known_boot=True)
    for side in (LEFT, RIGHT):
        some.add(side, 2, 7, some.begin_ms + 500)
        some.add(side, 0, 1, some.begin_ms + 520)
    outcome = some.solve(some.begin_ms + 520)
    assert not outcome.was_rolling
    # Three sigma: by 2 m/s² all the time before the boot, and from there on half of that, by changing it half-way.
    assert outcome.mean_variance == pytest.approx(0.3 ** 2 + (MPS2 * 310 ** 2 / 6) ** 2 + (MPS2 * 310 ** 2 / 12) ** 2)


def test_second_restart_before_anything_was_known_goes_on_from_the_first():
    some, other = Bridge(), Bridge(blind_ms=700)
    some.add(LEFT, 1, 0, BEFORE_MS + 320)
    some.restart()
    assert some.pending(LEFT) == 0
    some.begin_ms, some.places = other.begin_ms, other.places
    some.report(some.begin_ms)
    assert some.roll(300).wheels[LEFT].place == pytest.approx(int(some.places[LEFT]) + 1, abs=1)
