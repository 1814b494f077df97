"""From drives to a steering curve: known curves come out, whatever is monotone; what wasn't driven isn't made up."""
from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from car_interface.calibration import steering
from car_interface.calibration.delay import Delay, held, lagged
from car_interface.calibration.steering import DRIVEN, END, LEFT, OLD, RIGHT, UNKNOWN, Breakpoint, Drive, FitConfig

STEP_S = 0.02
LEFT_STOP, CENTER, RIGHT_STOP = 3900, 5200, 6400


def true_curvature(duty):
    """A linkage, linear to 1 and −0.9 1/m, with stops."""
    return np.interp(duty, (LEFT_STOP, CENTER, RIGHT_STOP), (1.0, 0.0, -0.9))


def drive(duties, curve=true_curvature, speed_mps=1.5, hold_s=3.0, lag_s=0.15, delay_s=0.0, play=0.0, noise_rad=0.005,
          seed=0, start_s=0.0):
    """The steering held at one duty after the other."""
    rng = np.random.default_rng(seed)
    t_s = start_s + np.arange(0.0, hold_s * len(duties), STEP_S)
    duty_t_s = start_s + hold_s * np.arange(len(duties))
    servo = lagged(held(duty_t_s, np.array(duties, float), t_s - delay_s), STEP_S, lag_s)
    wheels, now = np.empty(len(servo)), servo[0]
    for index, at in enumerate(servo):
        now = min(max(now, at - play / 2), at + play / 2)
        wheels[index] = now
    speed = np.full(len(t_s), speed_mps)
    way = np.cumsum(speed) * STEP_S
    yaw = np.cumsum(curve(wheels) * speed) * STEP_S + noise_rad * rng.standard_normal(len(t_s))
    return Drive(t_s, way, yaw, duty_t_s, np.array(duties, float))


def mixed(low=3700, high=6600, count=40, seed=3):
    """Positions all over, in no order, as multiples of the board's counts."""
    rng = np.random.default_rng(seed)
    return 16 * np.round(rng.permutation(np.linspace(low, high, count)) / 16)


def test_curve_center_and_stops_are_those_of_the_car():  # positions are 75 duty apart
    found = steering.fit([drive(mixed())])
    inside = (found.duties > LEFT_STOP + 50) & (found.duties < RIGHT_STOP - 50)
    assert np.abs(found.curvatures - true_curvature(found.duties))[inside].max() < 0.01
    assert found.center == pytest.approx(CENTER, abs=8)
    assert abs(found.center - CENTER) < 3 * found.center_sigma + 2
    assert found.left.is_stop and found.left.duty == pytest.approx(LEFT_STOP, abs=50)
    assert found.right.is_stop and found.right.duty == pytest.approx(RIGHT_STOP, abs=50)
    assert found.left.curvature_per_m == pytest.approx(1.0, abs=0.01)
    assert found.right.curvature_per_m == pytest.approx(0.9, abs=0.01)


@pytest.mark.parametrize("lag_s, delay_s", ((0.15, 0.0), (0.05, 0.2)))
def test_delay_and_lag_of_the_servo_are_found(lag_s, delay_s):
    found = steering.fit([drive(mixed(), lag_s=lag_s, delay_s=delay_s)]).delay
    assert found.delay_s + found.lag_s == pytest.approx(lag_s + delay_s, abs=0.04)


@pytest.mark.parametrize("play", (0.0, 12.0, 30.0, 60.0))
def test_play_is_found_and_the_curve_is_that_of_its_middle(play):
    duties = np.concatenate([mixed(), mixed(seed=4)])
    found = steering.fit([drive(duties, play=play)])
    assert found.play_duty == pytest.approx(play, abs=6)
    inside = (found.duties > LEFT_STOP + 100) & (found.duties < RIGHT_STOP - 100)
    assert np.abs(found.curvatures - true_curvature(found.duties))[inside].max() < 0.01


def test_servo_that_is_the_other_way_round_is_found():
    found = steering.fit([drive(mixed(), curve=lambda duty: -true_curvature(duty))])
    assert found.left.duty > found.center > found.right.duty
    left = steering.breakpoints(found, [2.0], LEFT)[0]
    assert -true_curvature(left.duty) == pytest.approx(0.5, abs=0.01)


def test_driving_backward_tells_the_same():
    found = steering.fit([drive(mixed(), speed_mps=-1.0)])
    assert found.curvature(4500) == pytest.approx(true_curvature(4500), abs=0.01)


def test_several_drives_count_together():
    halves = mixed(count=40)
    found = steering.fit([drive(halves[:20]), drive(halves[20:], seed=5, start_s=1000.0)])
    assert found.curvature(5800) == pytest.approx(true_curvature(5800), abs=0.01)
    assert len(found.kept) == len(steering.fit([drive(halves[:20])]).kept) + len(
        steering.fit([drive(halves[20:], seed=5)], FitConfig()).kept)


def test_pieces_that_do_not_belong_are_left_out_and_counted():
    good = drive(mixed(count=60))
    yaw = good.yaw_rad.copy()
    for begin in (1055, 4055, 7055):  # the car was pushed
        yaw[begin:begin + 140] += np.linspace(0, 1.5, 140)
        yaw[begin + 140:] += 1.5
    found = steering.fit([good._replace(yaw_rad=yaw)])
    assert found.counts["apart from all others"] >= 2
    inside = (found.duties > LEFT_STOP + 100) & (found.duties < RIGHT_STOP - 100)
    assert np.abs(found.curvatures - true_curvature(found.duties))[inside].max() < 0.02


@pytest.mark.parametrize("change, reason", (
    (lambda d: d._replace(way_m=d.way_m * 0.1), "slow or standing"),
    (lambda d: d._replace(way_m=d.way_m * 4, yaw_rad=d.yaw_rad * 4), "fast in a bend: tyres may slide"),
), ids=("too slow", "too fast"))
def test_stretches_that_tell_nothing_are_counted_by_reason(change, reason):
    good = drive(mixed())
    bad = change(drive(mixed(seed=9), start_s=500.0))
    found = steering.fit([good, bad])
    assert found.counts[reason] > 0
    assert found.curvature(4500) == pytest.approx(true_curvature(4500), abs=0.01)


def test_breakpoints_have_the_duty_that_turns_so_tight_with_a_band_that_holds_the_truth():
    found = steering.fit([drive(mixed(count=60))])
    points = steering.breakpoints(found, [1.2, 1.5, 2.0, 3.0, 5.0, 10.0, 50.0], LEFT)
    for point in points:
        assert point.source == DRIVEN
        assert true_curvature(point.duty) == pytest.approx(1 / point.radius_m, abs=0.01)
        truth = CENTER - 1300 / point.radius_m
        assert abs(point.duty - truth) < 4 * point.duty_sigma + 3
    assert points[0].pieces > 0 and points[0].way_m > 1


def test_tighter_than_the_stop_has_the_duty_of_the_stop():
    found = steering.fit([drive(mixed())])
    points = steering.breakpoints(found, [0.5, 0.8, 1.5], RIGHT)
    assert [point.source for point in points] == [END, END, DRIVEN]
    assert points[0].duty == points[1].duty == found.right.duty


def test_tighter_than_what_was_driven_is_unknown_unless_a_stop_was_met():
    found = steering.fit([drive(mixed(low=3700, high=5700))])
    assert not found.right.is_stop
    points = steering.breakpoints(found, [1.0, 2.0, 4.0], RIGHT)
    assert [point.source for point in points] == [UNKNOWN, UNKNOWN, DRIVEN]
    assert all(point.duty <= found.right.farthest_duty + 1 for point in points)


def test_limit_of_the_stick_is_an_end_too():
    found = steering.fit([drive(mixed(low=3700, high=6000))], FitConfig(limits=(3800, 6000)))
    assert found.right.is_end and not found.right.is_stop
    assert steering.breakpoints(found, [1.0], RIGHT)[0].source == END


def test_gap_in_what_was_driven_is_unknown():
    duties = np.concatenate([mixed(low=3700, high=4100, count=15), mixed(low=4950, high=6600, count=25)])
    curve = lambda duty: np.sign(CENTER - duty) * np.abs((CENTER - duty) / 1250) ** 2.5  # noqa: E731
    found = steering.fit([drive(duties, curve=curve)])
    sources = {point.radius_m: point.source for point in steering.breakpoints(found, [1.2, 3.0, 100.0], LEFT)}
    assert sources == {1.2: DRIVEN, 3.0: UNKNOWN, 100.0: DRIVEN}


def test_what_the_servo_did_in_a_gap_of_the_recording_is_not_taken_for_known():
    whole = drive(mixed(count=60), play=30.0)
    # The recorder misses 1 s around each third change of the duty; the servo moves meanwhile.
    missed = np.zeros(len(whole.t_s), bool)
    kept_duty = np.ones(len(whole.duty), bool)
    for index in range(3, len(whole.duty), 3):
        missed |= np.abs(whole.t_s - whole.duty_t_s[index]) < 0.5
        kept_duty[index] = False
    gappy = whole._replace(t_s=whole.t_s[~missed], way_m=whole.way_m[~missed], yaw_rad=whole.yaw_rad[~missed],
                           duty_t_s=whole.duty_t_s[kept_duty], duty=whole.duty[kept_duty])
    assert missed.any()
    found = steering.fit([gappy])
    # Each piece, not the curve: that one is robust, and would pass over a few that rest on a duty from before the gap.
    assert len(found.pieces.duty) > 15
    assert np.abs(found.pieces.curvature_per_m - true_curvature(found.pieces.duty)).max() < 0.05


@pytest.mark.parametrize("drives", (
    [], [drive([5200])], [drive([5200, 5216, 5200])], [drive(mixed())._replace(yaw_rad=np.zeros(6000))],
    [drive(mixed())._replace(way_m=np.zeros(6000))], [drive(mixed())._replace(duty=np.full(40, math.nan))],
), ids=("none", "one position", "nearly one", "no heading", "standing", "no pulses"))
def test_drives_that_tell_nothing_are_refused_in_words(drives):
    with pytest.raises(steering.NothingToFit, match=r"the|recordings"):
        steering.fit(drives)


@settings(max_examples=25, deadline=None)
@given(st.lists(st.tuples(st.integers(3600, 6800), st.floats(-1.5, 1.5)), min_size=6, max_size=20), st.integers(0, 99))
def test_curve_and_table_are_monotone_whatever_the_data(places, seed):
    duties = [duty for duty, _ in places]
    known, curvatures = np.array(duties), np.array([curvature for _, curvature in places])
    one = drive(duties, curve=lambda at: curvatures[np.argmin(np.abs(at[:, None] - known), axis=1)], seed=seed,
                lag_s=0.0)
    try:
        found = steering.fit([one], FitConfig(delay=Delay(0.0, 0.0, 1.0), play_duty=0.0))
    except steering.NothingToFit:
        return
    steps = np.diff(found.curvatures)
    assert np.all(steps >= -1e-12) or np.all(steps <= 1e-12)
    for side in (LEFT, RIGHT):
        points = steering.breakpoints(found, [0.7, 1.0, 1.5, 2.0, 5.0, 20.0, 300.0], side)
        center = found.center if math.isfinite(found.center) else 5200.0
        made = [point.duty for point in steering.completed(points, center, [4000.0] * 7)]
        steps = np.diff(made)
        assert np.all(steps >= -1e-6) or np.all(steps <= 1e-6)


@given(st.lists(st.tuples(st.floats(-1e3, 1e3), st.floats(1e-3, 1e3)), min_size=1, max_size=40))
def test_nearest_rising_sequence_rises_and_leaves_a_rising_one_alone(pairs):
    values, weights = (np.array(column) for column in zip(*pairs))
    made = steering.rising(values, weights)
    assert len(made) == len(values) and np.all(np.diff(made) >= -1e-9)
    assert np.average(made, weights=weights) == pytest.approx(np.average(values, weights=weights), abs=1e-6)
    assert np.allclose(steering.rising(np.sort(values), weights), np.sort(values))


def point(radius_m, duty, source):
    return Breakpoint(radius_m, duty, 1.0, 0.1, 3, 10.0, source)


@pytest.mark.parametrize("center, old, expected", (
    (5000, [6000, 5700, 5300, 5100], [6000, 5800, 5300, 5200]),
    (5000, [5500, 5700, 5900, 4000], [5800, 5800, 5800, 5200]),
    (5000, [9000, 5700, 5700, 5100], [9000, 5800, 5700, 5200]),
), ids=("they fit", "too near to the center", "one too far"))
def test_old_duties_give_way_to_driven_ones(center, old, expected):
    points = [point(1.0, 0.0, UNKNOWN), point(2.0, 5800.0, DRIVEN), point(3.0, 0.0, UNKNOWN),
              point(9.0, 5200.0, DRIVEN)]
    made = steering.completed(points, center, old)
    assert [one.duty for one in made] == expected
    assert [one.source for one in made] == [OLD, DRIVEN, OLD, DRIVEN]


def test_axis_begins_at_the_tightest_turn_and_lines_between_its_radii_are_exact():
    found = steering.fit([drive(mixed())])
    radii = steering.axis(found)
    assert radii[0] == pytest.approx(1.0, abs=0.03) and radii[-1] == 300
    assert all(wider > radius for radius, wider in zip(radii, radii[1:]))
    tables = {side: [one.duty for one in steering.breakpoints(found, radii, side)] for side in (LEFT, RIGHT)}
    for radius in np.exp(np.linspace(math.log(1.2), math.log(300), 200)):
        for side, sign in ((LEFT, 1), (RIGHT, -1)):
            assert found.curvature(np.interp(radius, radii, tables[side])) == pytest.approx(sign / radius, abs=0.008)
