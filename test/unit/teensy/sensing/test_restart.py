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

    def __init__(self, speed=0.066, curvature=0.0, blind_ms=310):
        self.speeds = [speed * (1 + sign * curvature * TRACK_M / 2) for sign in (-1, 1)]
        wheels, heading = (WheelFilter(), WheelFilter()), HeadingFilter()
        for wheel, one in zip(wheels, self.speeds):
            wheel.count, wheel.position, wheel.speed = 100, 100.5, one
        heading.begin(0.0, HEADING_VARIANCE, 0.01)
        heading.curvature_per_m = curvature
        super().__init__(BEFORE_MS, wheels, heading, TRACK_M)
        self.begin_ms, self.places = BEFORE_MS + blind_ms, [100.5 + one * blind_ms for one in self.speeds]
        self.report(self.begin_ms)

    def roll(self, lasts_ms=400, speeds=None, places=None):
        """Roll on, the first two pulses of each wheel unproven, until the outcome is ready."""
        speeds, times = speeds or self.speeds, []
        forward = speeds[LEFT] > 0
        for side, (speed, place) in enumerate(zip(speeds, places or self.places)):
            first, step = int(place) + forward - place, 1 if forward else -1
            times += [(self.begin_ms + (first + step * number) / speed, side, number) for number in range(1000)]
        for at_ms, side, number in sorted(each for each in times if each[0] <= self.begin_ms + lasts_ms):
            self.report(at_ms)
            self.add(side, *((1, 0) if number < 2 else (0, step)), round(at_ms))
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
    assert 1 / 9 <= outcome.difference_variance < 1


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


@pytest.mark.parametrize("blind_ms, place", [(318, 111), (324, 112)])
def test_car_that_stopped_unseen_half_way_goes_on_half_a_pulse_before_the_next_magnet(blind_ms, place):
    """From 100.5 it rolled 0.066 / 2 pulses a ms, and then half a pulse on average: to 111.49 or 111.69."""
    some = Bridge(blind_ms=blind_ms)
    for side in (LEFT, RIGHT):
        for later_ms, unproven in ((0, 1), (50, 1), (100, 0)):
            some.add(side, unproven, 1 - unproven, BEFORE_MS + 5000 + later_ms)
    outcome = some.solve(BEFORE_MS + 5100)
    assert not outcome.was_rolling and [wheel.place for wheel in outcome.wheels] == [place] * 2


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


def test_car_that_reverses_before_enough_is_known_is_followed_from_there():
    some = Bridge()
    for side in (LEFT, RIGHT):
        some.add(side, 2, -2, BEFORE_MS + 400)
    some.add(LEFT, 0, 1, BEFORE_MS + 500)
    assert [some.pending(side) for side in (LEFT, RIGHT)] == [1, 0]


@pytest.mark.parametrize("speed", [0.0, 0.066], ids=["parked", "rolling"])
def test_car_may_have_gone_and_come_back_to_its_speed_by_2_mps2_unseen(speed):
    some = Bridge(speed, blind_ms=1500)
    if speed:
        outcome = some.roll()
    else:
        for side in (LEFT, RIGHT):
            some.add(side, 2, 1, BEFORE_MS + 5000)
        outcome = some.solve(BEFORE_MS + 5000)
    farther_m = 2.0 * 1.5 ** 2 / 4  # faster for half of the time, slower for the other
    assert 0.99 <= 3 * math.sqrt(outcome.mean_variance) * PULSE_M / farther_m < 1.1


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


def test_second_restart_before_anything_was_known_goes_on_from_the_first():
    some, other = Bridge(), Bridge(blind_ms=700)
    some.add(LEFT, 1, 0, BEFORE_MS + 320)
    some.restart()
    assert some.pending(LEFT) == 0
    some.begin_ms, some.places = other.begin_ms, other.places
    some.report(some.begin_ms)
    assert some.roll(300).wheels[LEFT].place == pytest.approx(int(some.places[LEFT]) + 1, abs=1)
