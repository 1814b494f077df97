"""How the car stopped whenever the button was let go."""
import math

import pytest

from car_interface.tools.calibration.drive.stops import MIN_MPS2, Stops
from tools.calibration.drive.light_car import S

TICK_S = 0.02
REACTION_S = 0.2  # from the button until it rolls


def stopped(stops, mps2, begin_mps=0.8, held_again_s=math.inf, pushed_mps=None, slow_mps2=None):
    """The button is let go, and held again later; once it stands hands may move it. The way that it rolled.

    With ``slow_mps2`` its deceleration below 0.6 m/s is that one.
    """
    now_ns, speed_mps, seconds, rolled_m = 0, begin_mps, 0.0, 0.0
    for _ in range(10):
        now_ns += round(TICK_S * S)
        stops.update(begin_mps * TICK_S, begin_mps, True, now_ns)
    while seconds < min(held_again_s, 12.0):
        if seconds > REACTION_S:
            slower_mps2 = mps2 if slow_mps2 is None or speed_mps > 0.6 else slow_mps2
            speed_mps = max(0.0, speed_mps - slower_mps2 * TICK_S)
        shown_mps = pushed_mps if pushed_mps and seconds > 4.0 else speed_mps
        now_ns, seconds, rolled_m = now_ns + round(TICK_S * S), seconds + TICK_S, rolled_m + speed_mps * TICK_S
        stops.update(shown_mps * TICK_S, shown_mps, False, now_ns)
    stops.update(0.0, speed_mps, True, now_ns + round(TICK_S * S))
    return rolled_m


@pytest.mark.parametrize("mps2, held_again_s", [(0.15, math.inf), (0.6, math.inf), (1.2, math.inf), (0.3, 1.2)])
def test_a_stop_is_measured_by_the_way_that_the_car_rolled_or_by_the_speed_that_was_left(mps2, held_again_s):
    stops = Stops()
    rolled_m = stopped(stops, mps2, held_again_s=held_again_s)
    # What is seen never promises a shorter way.
    assert rolled_m <= 0.25 * 0.8 + 0.8 ** 2 / (2 * stops.least_mps2)
    assert stops.least_mps2 == pytest.approx(mps2, rel=0.35)
    stopped(stops, 0.01, held_again_s=3.0)
    assert stops.least_mps2 == MIN_MPS2, "downhill"


def test_a_car_that_brakes_only_at_first_is_measured_by_its_slowest_second_too():
    stops = Stops()
    stopped(stops, 1.0, begin_mps=1.2, slow_mps2=0.12)
    assert stops.least_mps2 == pytest.approx(0.12, rel=0.1)


def test_a_second_in_which_hands_made_it_faster_does_not_count():
    stops = Stops()
    stops.update(0.024, 1.2, True, 0)
    for tick in range(1, 180):
        speed_mps = max(0.5, 1.2 - 0.8 * tick * TICK_S) + max(0.0, 0.07 * (tick * TICK_S - 1.6))
        stops.update(speed_mps * TICK_S, speed_mps, False, round(tick * TICK_S * S))
    stops.update(0.0, speed_mps, True, 4 * S)
    assert stops.least_mps2 > 0.2


@pytest.mark.parametrize("how", [{"held_again_s": 0.15}, {"begin_mps": 0.2}], ids=("short", "slow"))
def test_what_shows_little_does_not_count(how):
    stops = Stops()
    stopped(stops, 0.3, **how)
    assert stops.least_mps2 == math.inf


def test_hands_that_move_a_standing_car_change_nothing():
    alone, pushed = Stops(), Stops()
    stopped(alone, 0.5)
    stopped(pushed, 0.5, pushed_mps=0.7)
    assert pushed.least_mps2 == alone.least_mps2


@pytest.mark.parametrize("shown_mps, ticks, is_discarded", [(1.2, 200, False), (-0.3, 200, False), (0.8, 2, True)],
                         ids=("faster", "backward", "driven_by_hand"))
def test_a_car_that_is_pushed_or_driven_by_hand_shows_nothing(shown_mps, ticks, is_discarded):
    stops = Stops()
    stops.update(0.016, 0.8, True, 0)
    for tick in range(1, ticks):
        stops.update(shown_mps * TICK_S, shown_mps, False, tick * 20_000_000)
    if is_discarded:
        stops.discard()
    stops.update(0.0, 0.0, False, 5 * S)
    assert stops.least_mps2 == math.inf
