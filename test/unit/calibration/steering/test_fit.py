"""From drives to a steering curve: known curves come out, whatever is monotone; what wasn't driven isn't made up."""
from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from car_interface.calibration.delay import Delay, held, lagged
from car_interface.calibration.steering import fit, segments, smooth, table
from car_interface.calibration.steering.segments import Drive, FitConfig, NothingToFit
from car_interface.calibration.steering.table import DRIVEN, END, LEFT, OLD, RIGHT, UNKNOWN, Breakpoint

pytestmark = pytest.mark.once

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


def with_gaps(whole, every_s, missed_s, first_s=3.0):
    """As if the recorder had stopped now and then."""
    def has_subscribers(t_s):
        return (t_s - whole.t_s[0] - first_s) % every_s >= missed_s
    # A duty that is held is said again ten times a second.
    t_s = np.arange(whole.duty_t_s[0], whole.t_s[-1], 0.1)
    duty = held(whole.duty_t_s, whole.duty, t_s + 1e-9)
    odom, output = has_subscribers(whole.t_s), has_subscribers(t_s)
    return Drive(whole.t_s[odom], whole.distance_m[odom], whole.yaw_rad[odom], t_s[output], duty[output])


def mixed(low=3700, high=6600, count=40, seed=3):
    """Positions all over, in no order, as multiples of the board's counts."""
    rng = np.random.default_rng(seed)
    return 16 * np.round(rng.permutation(np.linspace(low, high, count)) / 16)


def test_curve_center_and_stops_are_those_of_the_car():  # positions are 75 duty apart
    found = fit.fit([drive(mixed())])
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
    found = fit.fit([drive(mixed(), lag_s=lag_s, delay_s=delay_s)]).delay
    assert found.delay_s + found.lag_s == pytest.approx(lag_s + delay_s, abs=0.04)


@pytest.mark.parametrize("play", (0.0, 12.0, 30.0, 60.0))
def test_play_is_found_and_the_curve_is_that_of_its_middle(play):
    duties = np.concatenate([mixed(), mixed(seed=4)])
    found = fit.fit([drive(duties, play=play)])
    assert found.backlash_duty == pytest.approx(play, abs=6)
    inside = (found.duties > LEFT_STOP + 100) & (found.duties < RIGHT_STOP - 100)
    assert np.abs(found.curvatures - true_curvature(found.duties))[inside].max() < 0.01


def test_servo_that_is_the_other_way_round_is_found():
    found = fit.fit([drive(mixed(), curve=lambda duty: -true_curvature(duty))])
    assert found.left.duty > found.center > found.right.duty
    left = table.breakpoints(found, [2.0], LEFT)[0]
    assert -true_curvature(left.duty) == pytest.approx(0.5, abs=0.01)


def test_driving_backward_tells_the_same():
    found = fit.fit([drive(mixed(), speed_mps=-1.0)])
    assert found.curvature(4500) == pytest.approx(true_curvature(4500), abs=0.01)


def test_several_drives_count_together():
    halves = mixed(count=40)
    found = fit.fit([drive(halves[:20]), drive(halves[20:], seed=5, start_s=1000.0)])
    assert found.curvature(5800) == pytest.approx(true_curvature(5800), abs=0.01)
    assert len(found.kept) == len(fit.fit([drive(halves[:20])]).kept) + len(
        fit.fit([drive(halves[20:], seed=5)], FitConfig()).kept)


def test_pieces_that_do_not_belong_are_left_out_and_counted():
    good = drive(mixed(count=60))
    yaw = good.yaw_rad.copy()
    for begin in (1055, 4055, 7055):  # the car was pushed
        yaw[begin:begin + 140] += np.linspace(0, 1.5, 140)
        yaw[begin + 140:] += 1.5
    found = fit.fit([good._replace(yaw_rad=yaw)])
    assert found.counts["apart from all others"] >= 2
    inside = (found.duties > LEFT_STOP + 100) & (found.duties < RIGHT_STOP - 100)
    assert np.abs(found.curvatures - true_curvature(found.duties))[inside].max() < 0.02


@pytest.mark.parametrize("change, reason", (
    (lambda d: d._replace(distance_m=d.distance_m * 0.1), "slow or standing"),
    (lambda d: d._replace(distance_m=d.distance_m * 4, yaw_rad=d.yaw_rad * 4), "fast in a bend: tyres may slide"),
), ids=("too slow", "too fast"))
def test_stretches_that_tell_nothing_are_counted_by_reason(change, reason):
    good = drive(mixed())
    bad = change(drive(mixed(seed=9), start_s=500.0))
    found = fit.fit([good, bad])
    assert found.counts[reason] > 0
    assert found.curvature(4500) == pytest.approx(true_curvature(4500), abs=0.01)


def test_breakpoints_have_the_duty_that_turns_so_tight_with_a_band_that_holds_the_truth():
    found = fit.fit([drive(mixed(count=60))])
    points = table.breakpoints(found, [1.2, 1.5, 2.0, 3.0, 5.0, 10.0, 50.0], LEFT)
    for point in points:
        assert point.source == DRIVEN
        assert true_curvature(point.duty) == pytest.approx(1 / point.radius_m, abs=0.01)
        truth = CENTER - 1300 / point.radius_m
        assert abs(point.duty - truth) < 4 * point.duty_sigma + 3
    assert points[0].pieces > 0 and points[0].distance_m > 1


def test_tighter_than_the_stop_has_the_duty_of_the_stop():
    found = fit.fit([drive(mixed())])
    points = table.breakpoints(found, [0.5, 0.8, 1.5], RIGHT)
    assert [point.source for point in points] == [END, END, DRIVEN]
    assert points[0].duty == points[1].duty == found.right.duty


def test_tighter_than_what_was_driven_is_unknown_unless_a_stop_was_met():
    found = fit.fit([drive(mixed(low=3700, high=5700))])
    assert not found.right.is_stop
    points = table.breakpoints(found, [1.0, 2.0, 4.0], RIGHT)
    assert [point.source for point in points] == [UNKNOWN, UNKNOWN, DRIVEN]
    assert all(point.duty <= found.right.farthest_duty + 1 for point in points)


def test_limit_of_the_stick_is_an_end_too():
    found = fit.fit([drive(mixed(low=3700, high=6000))], FitConfig(limits=(3800, 6000)))
    assert found.right.is_end and not found.right.is_stop
    assert table.breakpoints(found, [1.0], RIGHT)[0].source == END


def test_gap_in_what_was_driven_is_unknown():
    duties = np.concatenate([mixed(low=3700, high=4100, count=15), mixed(low=4950, high=6600, count=25)])
    curve = lambda duty: np.sign(CENTER - duty) * np.abs((CENTER - duty) / 1250) ** 2.5  # noqa: E731
    found = fit.fit([drive(duties, curve=curve)])
    sources = {point.radius_m: point.source for point in table.breakpoints(found, [1.2, 3.0, 100.0], LEFT)}
    assert sources == {1.2: DRIVEN, 3.0: UNKNOWN, 100.0: DRIVEN}


def test_what_the_servo_did_in_a_gap_of_the_recording_is_not_taken_for_known():
    whole = drive(mixed(count=60), play=30.0)
    # The recorder misses 1 s around each third change of the duty; the servo moves meanwhile.
    missed = np.zeros(len(whole.t_s), bool)
    kept_duty = np.ones(len(whole.duty), bool)
    for index in range(3, len(whole.duty), 3):
        missed |= np.abs(whole.t_s - whole.duty_t_s[index]) < 0.5
        kept_duty[index] = False
    gappy = whole._replace(t_s=whole.t_s[~missed], distance_m=whole.distance_m[~missed], yaw_rad=whole.yaw_rad[~missed],
                           duty_t_s=whole.duty_t_s[kept_duty], duty=whole.duty[kept_duty])
    assert missed.any()
    found = fit.fit([gappy])
    # Each piece, not the curve: that one is robust, and would pass over a few that rest on a duty from before the gap.
    assert len(found.pieces.duty) > 15
    assert np.abs(found.pieces.curvature_per_m - true_curvature(found.pieces.duty)).max() < 0.05


def steep_ends(duty):
    """Nearly level in the middle, all of its turning within a few counts at the ends, with sharp bends."""
    return np.interp(duty, (3700, 3720, 3760, 3800, 3900, 4400, 4900, 5100, 5300, 5700, 6300, 6500, 6700, 6740),
                     (1.1, 0.9, 0.35, 0.15, 0.03, 0.018, 0.012, 0.0, -0.011, -0.015, -0.06, -0.2, -0.5, -1.0))


STEEP_PLACES = 16 * np.round(np.concatenate([np.arange(3664, 3840, 16), [3872, 3936, 4100, 4400, 4700, 4900, 5000, 5100,
                             5200, 5400, 5600, 5900, 6100, 6200, 6300, 6400], np.arange(6464, 6800, 16), [7000]]) / 16)


def from_both_sides(places, seed=1):
    """Each held twice, come to from a little below and from a little above."""
    places = np.random.default_rng(seed).permutation(places)
    return np.column_stack([places - 100, places, places + 100, places]).ravel()


def steep_drive(play=6.0):
    return drive(from_both_sides(STEEP_PLACES), curve=steep_ends, speed_mps=1.2, hold_s=2.0, play=play)


def test_bands_hold_the_truth_where_a_steering_is_steep_and_where_it_is_nearly_level():
    found = fit.fit([steep_drive()])
    off = np.abs(found.curvatures - steep_ends(found.duties))
    assert np.mean(off <= fit.BAND * found.sigmas) > 0.95
    assert found.backlash_duty == pytest.approx(6.0, abs=0.3)


def test_smooth_curve_may_bend_a_little_where_it_was_straight_beside_a_sharp_corner():
    curve = smooth.Smooth.__new__(smooth.Smooth)
    curve.curvatures = np.maximum(0.0, np.arange(400) - 350.0)
    curve._second = smooth.sparse.diags([1.0, -2.0, 1.0], [0, 1, 2], shape=(398, 400), format="csr")
    local = curve._local()
    assert local.max() / local.min() < 1.001e5
    assert local.argmax() == pytest.approx(349, abs=1)


def test_duty_for_a_turn_is_such_that_the_nearest_count_is_the_best_one():
    found = fit.fit([steep_drive()])
    counts = np.arange(math.ceil(found.duties[0] / 16), math.floor(found.duties[-1] / 16) + 1) * 16.0
    made = found.curvature(counts)
    for curvature in np.linspace(-0.95, 1.05, 300):
        count = round(float(found.duty(curvature)) / 16) * 16.0
        assert abs(found.curvature(count) - curvature) <= np.abs(made - curvature).min() + 1e-4


def test_stop_is_a_count_that_turns_as_tight_as_any():
    found = fit.fit([drive(mixed())])
    for side in (found.left, found.right):
        assert side.is_stop and side.duty % 16 == 0
        assert abs(found.curvature(side.duty)) >= 0.993 * side.curvature_per_m


def test_between_places_that_differ_the_band_holds_a_stop_that_nobody_drove_at():
    duties = np.concatenate([[3500, 3600, 3700], np.arange(3984, 6700, 48)])
    found = fit.fit([drive(np.random.default_rng(1).permutation(16 * np.round(duties / 16)), hold_s=2.0)])
    inside = (found.duties > 3700) & (found.duties < 3984)
    off = np.abs(found.curvatures - true_curvature(found.duties))[inside]
    assert np.all(off <= fit.BAND * found.sigmas[inside])
    bends = fit._bends(found.duties, found.pieces, found.kept)[inside]
    assert bends.max() > 0.03 and fit.BAND * found.sigmas[inside].max() > bends.max() / 2


def test_where_the_wheels_are_is_less_known_when_the_linkage_floats_in_its_play():
    sure = np.repeat(from_both_sides(mixed(count=30)), 5)
    # Half a second a little beyond, and back by less than the play: how far it came is a matter of the servo's lag.
    floating = [6000] * 5 + [4940] + [5000] * 6
    found = fit.fit([drive(np.concatenate([sure, floating]), hold_s=0.5, play=30.0)])
    pieces = found.pieces
    assert np.median(pieces.duty_sigma) < 1.2
    assert pieces.duty_sigma[np.argmax(pieces.t_s)] > 4.0


@pytest.mark.parametrize("lag_s", (0.1, 0.2))
def test_lag_is_found_though_the_recording_has_gaps(lag_s):
    whole = drive(mixed(count=90), lag_s=lag_s, hold_s=2.0)
    found = fit.fit([with_gaps(whole, every_s=7.0, missed_s=2.5)])
    assert found.delay.delay_s + found.delay.lag_s == pytest.approx(lag_s, abs=0.03)


def test_servo_is_not_taken_for_arrived_when_nobody_knows_from_where_it_came():
    swings = with_gaps(drive(np.tile([4800, 5600], 60), hold_s=0.3), every_s=9.0, missed_s=2.0)
    wheels = segments.Wheels(swings, Delay(0.05, 0.2, 1.0), 0.3)
    for end_s in (5.0, 14.0, 23.0):
        known_s = wheels.t_s[(wheels.t_s > end_s) & wheels.is_known][0] - end_s
        assert 0.05 + 5 * 0.2 <= known_s < 2.5  # less than 1 % of its way is left, wherever that began


def pieces_at(duty, curvature):
    return SimpleNamespace(duty=np.array(duty, float), curvature_per_m=np.array(curvature), sigma_per_m=np.full(
        len(duty), 1e-4))


def test_curve_may_bend_between_two_places_as_far_as_both_neighbours_lead():
    stop = pieces_at([0, 100, 400, 500], [0.0, 0.0, 0.1, 0.2])  # level up to a corner at 300
    knots = np.array([100.0, 200.0, 300.0, 350.0, 400.0])
    bends = fit._bends(knots, stop, np.ones(4, bool))
    assert bends == pytest.approx([0.0, 0.1 / 3, 0.2 / 3, 0.1 / 3, 0.0], abs=1e-3)
    straight = pieces_at([0, 100, 400, 500], [0.0, 0.1, 0.4, 0.5])
    assert fit._bends(knots, straight, np.ones(4, bool)) == pytest.approx(np.zeros(5), abs=1e-9)


def test_what_a_table_says_was_driven_is_known_as_well_as_it_is_promised():
    found = fit.fit([drive(from_both_sides(mixed(count=8)), curve=lambda duty: np.sign(CENTER - duty) * np.abs(
        (CENTER - duty) / 1300) ** 2.5, hold_s=2.0)])
    radii = np.exp(np.linspace(math.log(1.1), math.log(100), 80))
    points = [point for side in (LEFT, RIGHT) for point in table.breakpoints(found, radii, side)]
    assert {UNKNOWN, DRIVEN} <= {point.source for point in points}
    for point in points:
        count = round(point.duty / 16) * 16
        half_count = abs(np.diff(found.curvature(np.array([count - 16, count + 16])))[0]) / 4
        band = fit.BAND * point.radius_sigma_m / point.radius_m ** 2
        promised = max(0.08 / point.radius_m, 0.01) + half_count
        assert band <= promised + 1e-9 or point.source == UNKNOWN


@pytest.mark.parametrize("drives", (
    [], [drive([5200])], [drive([5200, 5216, 5200])], [drive(mixed())._replace(yaw_rad=np.zeros(6000))],
    [drive(mixed())._replace(distance_m=np.zeros(6000))], [drive(mixed())._replace(duty=np.full(40, math.nan))],
), ids=("none", "one position", "nearly one", "no heading", "standing", "no pulses"))
def test_drives_that_tell_nothing_are_refused_in_words(drives):
    with pytest.raises(NothingToFit, match=r"the|recordings"):
        fit.fit(drives)


@settings(max_examples=25, deadline=None)
@given(st.lists(st.tuples(st.integers(3600, 6800), st.floats(-1.5, 1.5)), min_size=6, max_size=20), st.integers(0, 99))
def test_curve_and_table_are_monotone_whatever_the_data(places, seed):
    duties = [duty for duty, _ in places]
    known, curvatures = np.array(duties), np.array([curvature for _, curvature in places])
    one = drive(duties, curve=lambda at: curvatures[np.argmin(np.abs(at[:, None] - known), axis=1)], seed=seed,
                lag_s=0.0)
    try:
        found = fit.fit([one], FitConfig(delay=Delay(0.0, 0.0, 1.0), backlash_duty=0.0))
    except NothingToFit:
        return
    steps = np.diff(found.curvatures)
    assert np.all(steps >= -1e-12) or np.all(steps <= 1e-12)
    for side in (LEFT, RIGHT):
        points = table.breakpoints(found, [0.7, 1.0, 1.5, 2.0, 5.0, 20.0, 300.0], side)
        center = found.center if math.isfinite(found.center) else 5200.0
        made = [point.duty for point in table.completed(points, center, [4000.0] * 7)]
        steps = np.diff(made)
        assert np.all(steps >= -1e-6) or np.all(steps <= 1e-6)


@given(st.lists(st.tuples(st.floats(-1e3, 1e3), st.floats(1e-3, 1e3)), min_size=1, max_size=40))
def test_nearest_rising_sequence_rises_and_leaves_a_rising_one_alone(pairs):
    values, weights = (np.array(column) for column in zip(*pairs))
    made = smooth.rising(values, weights)
    assert len(made) == len(values) and np.all(np.diff(made) >= -1e-9)
    assert np.average(made, weights=weights) == pytest.approx(np.average(values, weights=weights), abs=1e-6)
    assert np.allclose(smooth.rising(np.sort(values), weights), np.sort(values))


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
    made = table.completed(points, center, old)
    assert [one.duty for one in made] == expected
    assert [one.source for one in made] == [OLD, DRIVEN, OLD, DRIVEN]


@given(st.floats(0.3, 7.0))
def test_axis_rises_whatever_the_tightest_turn(tightest_m):
    side = SimpleNamespace(curvature_per_m=1 / tightest_m)
    radii = table.axis(SimpleNamespace(left=side, right=side))
    assert all(wider > radius + 0.01 for radius, wider in zip(radii, radii[1:]))


def test_axis_begins_at_the_tightest_turn_and_lines_between_its_radii_are_exact():
    found = fit.fit([drive(mixed())])
    radii = table.axis(found)
    assert radii[0] == pytest.approx(1.0, abs=0.03) and radii[-1] == 300
    assert all(wider > radius for radius, wider in zip(radii, radii[1:]))
    tables = {side: [one.duty for one in table.breakpoints(found, radii, side)] for side in (LEFT, RIGHT)}
    for radius in np.exp(np.linspace(math.log(1.2), math.log(300), 200)):
        for side, sign in ((LEFT, 1), (RIGHT, -1)):
            assert found.curvature(np.interp(radius, radii, tables[side])) == pytest.approx(sign / radius, abs=0.008)
