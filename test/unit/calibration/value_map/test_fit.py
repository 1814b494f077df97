"""Value maps out of drives: synthetic ones, whose map, slope, battery and delay are known."""
from __future__ import annotations

import random

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from car_interface.calibration.value_map import acceleration as cut
from car_interface.calibration.value_map import fit as fitting
from car_interface.calibration.value_map import table as tables
from car_interface.calibration.value_map import windows as taken
from car_interface.calibration.value_map.acceleration import Drive, Series, WindowConfig, windows
from car_interface.calibration.value_map.surface import Grid, rising_column
from car_interface.throttle.value_map import ValueMap

pytestmark = pytest.mark.once

PULSE_M, STEP_S, NOTHING = 0.0149, 0.005, Series(np.zeros(0), np.zeros(0))
DELAY_S = 0.08


def acceleration(value, speed):
    """The synthetic car's: two slopes, a motor that gets weaker, drag."""
    return np.where(value > 0, 1.8 * value / (1 + speed / 10), 1.4 * value) - 0.35 - 0.08 * speed


def drive(seed=0, seconds=240.0, uphill=(0.0, 0.0), sag=0.0, turns=True, with_pitch=False, with_imu=False, pulses=True,
          mounting_rad=0.0, map_of=acceleration, there_and_back=False,
          circles=False):
    """A drive with a random value every second or so, straight on or all round."""
    rng = random.Random(seed)
    count = int(seconds / STEP_S)
    t_s = np.arange(count) * STEP_S
    value, speed, yaw = np.zeros(count), np.zeros(count), np.zeros(count)
    now, until, turn, held, v, heading = 0.0, 0.0, 0.0, [], 1.0, 0.0
    forces = np.zeros(count)
    for index in range(count):
        if t_s[index] >= until or v < 0.6 and now < 0 or v > 7.0 and now > 0:
            now = rng.uniform(0.5, 3.0) if v < 1.0 else rng.uniform(-4.0, 0.0) if v > 6.0 else rng.uniform(-4.0, 3.0)
            until, turn = t_s[index] + rng.uniform(0.6, 1.6), rng.uniform(-0.4, 0.4) if turns else 0.0
        held.append(now)
        value[index] = now
        acting = held[max(0, index - round(DELAY_S / STEP_S))]
        push = map_of(acting, v)
        coasting = map_of(0.0, v)
        push = coasting + (push - coasting) * (1 + sag * (0.5 - index / count) if acting > 0 else 1.0)
        forces[index] = push
        if circles and t_s[index] % 40 > 30:
            turn, push = 0.7 * v, push - 0.4  # tyres brake
        elif circles:
            turn, heading = 0.0, 2 * np.pi * round(heading / 2 / np.pi)
        change = push - 9.81 * (uphill[0] * np.cos(heading) + uphill[1] * np.sin(heading))
        v = max(0.0, v + change * STEP_S)
        heading = np.pi * (t_s[index] // 20 % 2) if there_and_back else heading + turn * STEP_S
        speed[index], yaw[index] = v, heading
    commanded_s, t_s = t_s, t_s + STEP_S  # what follows from a command is there a step later
    distance_m = np.concatenate(([0.0], np.cumsum((speed[1:] + speed[:-1]) / 2 * STEP_S)))
    wheels = []
    for phase in (0.3, 0.8):
        places = (np.arange(int(distance_m[-1] / PULSE_M) - 1) + phase) * PULSE_M
        ticks = np.floor(np.interp(places, distance_m, t_s) * 1000) / 1000 + 0.0005
        fresh = np.concatenate(([True], np.diff(ticks) > 0))
        wheels.append(Series(ticks[fresh], places[fresh]))
    pitch = -(uphill[0] * np.cos(yaw) + uphill[1] * np.sin(yaw)) + mounting_rad  # nose down is positive
    noise = np.random.default_rng(seed).normal(0.0, 0.1, count)
    every = slice(None, None, 4)
    return Drive("a.bag", Series(commanded_s, value), Series(t_s[every], speed[every]), Series(t_s[every], yaw[every]),
                 wheels if pulses else (),
                 imu=Series(commanded_s[::2], (forces + noise)[::2] + 0.2) if with_imu else None,
                 pitch=Series(t_s[every], pitch[every]) if with_pitch else None)


def error(found, map_of=acceleration):
    """RMS over what is supported."""
    truth = map_of(found.values[:, None], found.velocities[None, :])
    assert found.supported.sum() > 0.3 * found.supported.size
    return float(np.sqrt(np.mean((found.accelerations - truth)[found.supported] ** 2)))


@pytest.fixture(scope="module")
def mixed():
    return fitting.fit([drive(uphill=(0.012, -0.016), sag=0.1)], None, None)


# --- what is found ---


def test_map_of_a_drive_on_a_slope_with_a_sagging_battery_is_the_level_one_at_mean_battery(mixed):
    assert error(mixed) < 0.03


def test_delay_slope_and_battery_are_found(mixed):
    ground = mixed.grounds[0]
    assert mixed.delay_s == pytest.approx(DELAY_S, abs=0.01)
    assert ground.uphill == pytest.approx((0.012, -0.016), abs=0.002)
    assert ground.sag_above == pytest.approx(0.1, abs=0.02)
    assert ground.sag_below == pytest.approx(0.0, abs=0.03)


def test_error_is_of_the_size_that_the_standard_errors_say(mixed):
    truth = acceleration(mixed.values[:, None], mixed.velocities[None, :])
    ratios = (np.abs(mixed.accelerations - truth) / mixed.sigma_mps2)[mixed.supported]
    assert np.mean(ratios < 2) > 0.8


def test_held_out_manoeuvres_are_predicted_nearly_as_well_as_the_others(mixed):
    assert mixed.held_out_windows > 50
    assert mixed.held_out_mps2 < 1.5 * mixed.residual_mps2 + 0.01


def test_turns_tell_the_slope_and_nothing_else_where_straights_all_go_one_way():
    found = fitting.fit([drive(uphill=(0.02, 0.01), circles=True)], None, None)
    assert found.rejected[taken.RULES[cut.STEERING]] > 100
    assert found.grounds[0].uphill == pytest.approx((0.02, 0.01), abs=0.003)
    assert error(found) < 0.04


def test_slope_is_left_alone_where_headings_do_not_spread():
    found = fitting.fit([drive(uphill=(0.02, 0.0), turns=False)], None, None)
    assert np.isnan(found.grounds[0].uphill).all()
    truth = acceleration(found.values[:, None], found.velocities[None, :])
    assert np.median((found.accelerations - truth)[found.supported]) == pytest.approx(-0.02 * 9.81, abs=0.03)


def test_pitch_takes_gravity_off_and_its_mounting_does_not_matter():
    found = fitting.fit([drive(uphill=(0.012, -0.016), with_pitch=True, mounting_rad=0.03)], None, None)
    assert found.grounds[0].pitch_offset_rad == pytest.approx(0.03, abs=0.002)
    assert error(found) < 0.03


def test_imu_measures_without_gravity_and_its_bias_does_not_matter():
    found = fitting.fit([drive(uphill=(0.012, -0.016), with_imu=True)], None, None, fitting.FitConfig(from_imu=True))
    assert error(found) < 0.05


def test_odometry_speed_serves_where_no_pulses_were_recorded():
    assert error(fitting.fit([drive(pulses=False)], None, None)) < 0.05


def test_slow_odometry_gets_longer_windows():
    one = drive(pulses=False)
    slow = Drive("a", one.value, Series(one.speed.t_s[::5], one.speed.y[::5]), one.yaw)  # 10 a second
    assert error(fitting.fit([slow], None, None)) < 0.08


def test_two_drives_with_slopes_of_their_own_make_one_map():
    found = fitting.fit([drive(1, 200.0, (0.02, 0.0)), drive(2, 200.0, (0.0, -0.02))], None, None)
    assert found.grounds[0].uphill == pytest.approx((0.02, 0.0), abs=0.003)
    assert found.grounds[1].uphill == pytest.approx((0.0, -0.02), abs=0.003)
    assert error(found) < 0.03


def test_given_axes_are_used_and_a_given_delay_too():
    found = fitting.fit([drive(seconds=60.0)], np.array([-3.0, 0.0, 2.0]), np.array([1.0, 3.0, 4.5]),
                        fitting.FitConfig(delay_s=0.07))
    assert (list(found.values), list(found.velocities), found.delay_s) == ([-3.0, 0.0, 2.0], [1.0, 3.0, 4.5], 0.07)


def test_flat_band_around_neutral_rises_all_the_same():
    def with_band(value, speed):
        return acceleration(np.sign(value) * np.maximum(0.0, np.abs(value) - 0.5), speed)
    found = fitting.fit([drive(map_of=with_band)], np.array([-4, -2, -1, -0.5, -0.25, 0, 0.25, 0.5, 1, 2, 3.0]), None)
    assert (np.diff(found.accelerations, axis=0) > 0).all()
    assert error(found, with_band) < 0.08


# --- monotone by construction ---


@settings(max_examples=25)
@given(seed=st.integers(0, 10_000), size=st.integers(2, 12), noise=st.floats(0.0, 5.0), falling=st.booleans())
def test_map_rises_whatever_the_data(seed, size, noise, falling):
    rng = np.random.default_rng(seed)
    t_s = np.arange(0.0, 30.0, 0.05)
    value = np.repeat(rng.uniform(-1, 1, 30), 20)
    speed = np.abs(np.cumsum(value * (-0.05 if falling else 0.05)) + 2 + rng.normal(0, noise, t_s.size) / 10) + 0.4
    one = Drive("a", Series(t_s, value), Series(t_s, speed), Series(t_s, np.zeros(t_s.size)))
    found = fitting.fit([one], np.linspace(-1, 1, size), np.linspace(0, 5, size), fitting.FitConfig(delay_s=0.0))
    assert (np.diff(found.accelerations, axis=0) > 0).all()
    written = [[float(f"{cell:.{fitting.DECIMALS}f}") for cell in row] for row in found.accelerations]
    ValueMap(found.values, found.velocities, written)


@given(st.lists(st.tuples(st.floats(-10, 10), st.floats(-10, 10)), min_size=2, max_size=8))
def test_rounded_columns_rise_and_are_near(rows):
    table = fitting.rounded(np.sort(np.array(rows), axis=0) + 0.002 * np.arange(len(rows))[:, None])
    assert (np.diff(table, axis=0) > 0).all()
    assert np.abs(table - np.sort(np.array(rows), axis=0)).max() < 0.002 * len(rows) + 0.001


def test_rounding_makes_even_level_columns_rise():
    assert fitting.rounded(np.array([[1.0], [1.0], [0.9999]]))[:, 0].tolist() == [1.0, 1.001, 1.002]


@given(st.lists(st.floats(-10, 10), min_size=2, max_size=8))
def test_rising_column_rises_and_leaves_alone_what_does(column):
    least = np.full(len(column) - 1, 0.01)
    risen = rising_column(np.array(column), np.ones(len(column)), least)
    assert (np.diff(risen) >= 0.01 - 1e-12).all()
    again = rising_column(risen, np.ones(len(column)), least - 1e-9)
    assert again == pytest.approx(risen, abs=1e-6)


# --- nothing is invented ---


def fit_of(supported, accelerations=None, sure=None):
    supported = np.array(supported, bool)
    rows, columns = supported.shape
    table = np.add.outer(np.arange(rows) * 1.0, -0.1 * np.arange(columns)) if accelerations is None else accelerations
    return fitting.Fit(np.arange(rows) - 1.0, np.arange(columns) * 1.0, table, np.full(supported.shape, 0.05),
                       np.ones(supported.shape), np.ones(supported.shape, int), supported,
                       supported if sure is None else np.array(sure, bool), 0.0, 0.0, (), {}, 0.0, 0.0, 0)


def test_axes_are_cut_to_the_largest_part_that_was_driven():
    table = tables.table(fit_of([[0, 1, 1, 1], [0, 1, 1, 1], [1, 1, 0, 0]]), 0.0)
    assert (list(table.values), list(table.velocities)) == ([-1.0, 0.0], [1.0, 2.0, 3.0])
    assert table.share() == 1.0


def test_a_part_that_drives_and_brakes_is_preferred_to_one_that_reaches_farther():
    table = tables.table(fit_of([[1, 1, 0, 0], [1, 1, 0, 0], [1, 1, 1, 1], [0, 1, 1, 1]]), 0.0)
    assert list(table.values) == [-1.0, 0.0, 1.0]


def test_a_part_with_three_of_each_is_preferred_to_a_longer_one_with_two():
    driven = [[1, 1, 0, 0], [1, 1, 0, 0], [1, 1, 1, 0], [1, 1, 1, 0], [1, 1, 1, 0], [1, 1, 0, 0], [1, 1, 0, 0]]
    assert tables.table(fit_of(driven), 0.0).accelerations.shape == (3, 3)


def test_a_value_that_was_hardly_driven_is_left_out_of_the_axis_but_no_three_side_by_side():
    driven, gap = [1, 1], [0, 0]
    table = tables.table(fit_of([driven, driven, gap, gap, driven]), 0.0)
    assert list(table.values) == [-1.0, 0.0, 3.0] and table.share() == 1.0
    table = tables.table(fit_of([driven, driven, gap, gap, gap, driven]), 0.0)
    assert list(table.values) == [-1.0, 0.0]


def test_no_table_where_no_two_values_have_two_velocities():
    assert tables.table(fit_of([[0, 1, 0], [1, 0, 1]]), 0.0) is None


def test_slope_is_found_on_a_road_there_and_back():
    found = fitting.fit([drive(uphill=(0.02, 0.0), there_and_back=True)], None, None)
    assert found.grounds[0].uphill[0] == pytest.approx(0.02, abs=0.003)
    assert error(found) < 0.03


def test_what_lies_between_driven_nodes_and_is_as_sure_is_stated():
    driven = [[1, 1, 1], [1, 0, 1], [1, 1, 1]]
    table = tables.table(fit_of(driven, sure=np.ones((3, 3))), 0.0)
    assert table.origin[1, 1] == tables.BETWEEN and table.accelerations.shape == (3, 3)
    unsure = tables.table(fit_of(driven), 0.0)
    assert list(unsure.values) == [-1.0, 1.0] and (unsure.origin == tables.DRIVEN).all()


def test_prior_stays_where_nothing_was_driven():
    prior = np.add.outer(np.arange(3) * 1.0, np.full(3, -0.3))
    table = tables.table(fit_of([[1, 1, 0], [1, 1, 0], [1, 1, 0]]), 0.0, prior)
    assert list(table.accelerations[:, 2]) == [-0.3, 0.7, 1.7]
    assert set(table.origin[:, 2]) == {tables.OLD} and np.isnan(table.sigma_mps2[:, 2]).all()


def test_prior_that_contradicts_its_column_is_moved_and_what_was_driven_is_not():
    prior = np.full((3, 2), -5.0)
    table = tables.table(fit_of([[1, 1], [1, 1], [0, 1]]), 0.0, prior)
    assert table.origin[2, 0] == tables.MOVED
    assert table.accelerations[1, 0] == 1.0 and table.accelerations[2, 0] == pytest.approx(1.002, abs=0.001)


def test_what_the_prior_lacks_is_cut():
    prior = np.add.outer(np.arange(3) * 1.0, np.array([0.0, 0.0, np.nan]))
    assert tables.table(fit_of([[1, 1, 0], [1, 0, 0], [1, 1, 0]]), 0.0, prior).accelerations.shape == (3, 2)


def test_velocities_never_driven_are_not_supported():
    found = fitting.fit([drive(seconds=120.0)], np.array([-3.0, 0.0, 2.0]), np.array([0.0, 1.0, 3.0, 5.0, 12.0, 14.0]))
    assert not found.supported[:, 4:].any() and found.supported[:, 2].all()


def test_a_drive_of_one_value_supports_no_other():
    one = drive(seconds=60.0)
    lonely = Drive("a", Series(one.value.t_s, np.full(one.value.y.size, 1.0)), one.speed, one.yaw, one.wheels)
    found = fitting.fit([lonely], np.array([-1.0, 0.0, 1.0, 2.0]), None, fitting.FitConfig(delay_s=0.0))
    assert not found.supported[[0, 1, 3]].any()


# --- what doesn't count ---


def rejected(one, config=None):
    found = fitting.fit([one], None, None, config or fitting.FitConfig(delay_s=DELAY_S))
    return {text: number for text, number in found.rejected.items() if number and text != "counted"}


def with_(one, **changes):
    fields = {"name": one.name, "value": one.value, "speed": one.speed, "yaw": one.yaw, "wheels": one.wheels}
    return Drive(**{**fields, **changes})


def test_a_clean_drive_loses_little():
    one = drive(seconds=60.0)
    assert sum(rejected(one).values()) < 30


def test_each_rule_counts_its_own():
    one = drive(seconds=60.0, with_imu=True)
    t_s = one.speed.t_s
    later = (t_s > 20.0) & (t_s < 30.0)
    twisted = Series(t_s, one.yaw.y + np.where(later, 3.0 * (t_s - 20.0), np.where(t_s >= 30.0, 30.0, 0.0)))
    silent = one.value.t_s[(one.value.t_s < 20.0) | (one.value.t_s > 30.0)]
    gone = Series(silent, np.interp(silent, one.value.t_s, one.value.y))
    unplugged = [Series(wheel.t_s[keep], wheel.y[keep]) for wheel in one.wheels
                 for keep in [(wheel.t_s < 20.0) | (wheel.t_s > 30.0)]]
    idle = Series(np.array([0.0, 20.0, 30.0]), np.array([1.0, 0.0, 1.0]))
    lying = Series(one.imu.t_s, one.imu.y + np.where((one.imu.t_s > 20.0) & (one.imu.t_s < 30.0), 20.0, 0.0))
    for changes, rule in (
        ({"yaw": twisted}, cut.STEERING),
        ({"value": gone}, taken.NO_VALUE),
        ({"wheels": unplugged}, cut.NOTHING_MEASURED),
        ({"driven": idle}, taken.NOT_DRIVEN),
        ({"imu": lying}, cut.SLIPPING),
        ({"pitch": Series(t_s, np.where(later, 0.5, 0.0))}, taken.STEEP),
    ):
        assert 40 <= rejected(with_(one, **changes))[taken.RULES[rule]] <= 60, taken.RULES[rule]


def test_stops_and_rolling_backward_and_the_change_of_gear_after_it_do_not_count():
    t_s = np.arange(0.0, 20.0, 0.02)
    speed = np.interp(t_s, [0, 5, 6, 8, 9, 11, 12, 20], [2, 2, 0, 0, -1, -1, 0.5, 4])
    state = windows(Drive("a", Series(t_s, t_s), Series(t_s, speed), Series(t_s, 0 * t_s))).state
    middle = 0.2 + 0.2 * np.arange(state.size)
    assert set(state[(middle > 6.2) & (middle < 7.8)]) == {cut.STANDING}
    assert set(state[(middle > 9.2) & (middle < 10.8)]) == {cut.BACKWARD}
    assert cut.TURNED_ROUND in state[(middle > 11.2) & (middle < 12.4)]
    assert set(state[middle > 13.0]) == {cut.MEASURED}


def test_wheels_that_spin_are_slipping():
    t_s = np.arange(0.0, 10.0, 0.02)
    speed = np.interp(t_s, [0, 5, 5.5, 6, 10], [2, 2, 9, 2, 2])
    state = windows(Drive("a", Series(t_s, t_s), Series(t_s, speed), Series(t_s, 0 * t_s))).state
    assert cut.SLIPPING in state


def test_outliers_do_not_bend_the_map():
    one = drive(seconds=120.0)
    bump = np.where((one.speed.t_s % 20 > 10) & (one.speed.t_s % 20 < 10.6), 1.0, 0.0)
    kicked = with_(one, speed=Series(one.speed.t_s, one.speed.y + bump), wheels=())
    found = fitting.fit([kicked], None, None)
    assert found.rejected[taken.RULES[taken.OUTLYING]] > 5
    assert error(found) < 0.08


@pytest.mark.parametrize("one", [
    Drive("a", NOTHING, NOTHING, NOTHING),
    Drive("a", NOTHING, Series(np.arange(9) / 9, np.ones(9)), Series(np.arange(9) / 9, np.ones(9))),
    Drive("a", Series(np.zeros(1), np.zeros(1)), Series(np.arange(900) / 9, np.zeros(900)),
          Series(np.arange(900) / 9, np.zeros(900))),
], ids=["nothing_recorded", "no_value", "stood_still"])
def test_nothing_to_fit_says_why(one):
    with pytest.raises(fitting.NothingToFit, match=r"shorter than a window|no value|a stop|too few"):
        fitting.fit([one], None, None)


# --- windows ---


def test_window_over_a_step_of_the_value_is_exactly_its_mean_under_phi():
    t_s = np.arange(0.0, 4.0, 0.0001)
    a = np.where(t_s < 2.1, 1.0, -3.0)
    v = 3.0 + np.cumsum(a) * 0.0001
    s = np.cumsum(v) * 0.0001
    places = np.arange(0.0, s[-1], PULSE_M)
    wheel = Series(np.interp(places, s, t_s), places)
    one = Drive("a", NOTHING, Series(t_s[::100], v[::100]), Series(t_s[::100], 0 * t_s[::100]), (wheel, wheel))
    found = windows(one, WindowConfig(max_mps2=99.0))
    counts = found.state == cut.MEASURED
    expected = (np.where(found.t_s < 2.1, 1.0, -3.0) * found.weight).sum(axis=1)
    assert found.acceleration_mps2[counts] == pytest.approx(expected[counts], abs=0.06)  # φ's grid is 10 ms
    assert found.acceleration_mps2[counts][:5] == pytest.approx(1.0, abs=0.01)


def test_grid_gives_back_its_nodes_and_what_is_linear_between():
    grid = Grid(np.array([0.0, 1.0, 3.0]), np.array([0.0, 2.0]))
    nodes = np.array([[0.0, 2.0], [1.0, 3.0], [3.0, 5.0]])
    rows, columns = np.array([0.0, 0.5, 2.0, 3.0]), np.array([0.0, 1.0, 1.0, 2.0])
    assert grid.at(nodes, rows, columns) == pytest.approx([0, 1.5, 3, 5])
