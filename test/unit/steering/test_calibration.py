"""Radius to duty and back, and the calibration's tables when ends or center are tuned."""

import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from car_interface.common.errors import ConfigError
from car_interface.steering.calibration import driven_radius_m, lost_per_m, slow_radius_m, trimmed
from slash import PARAMETERS, SKIDPAD, SLASH

TRIPLES = st.tuples(st.integers(3000, 4600), st.integers(4300, 5900), st.integers(5900, 7500))


@pytest.mark.parametrize("steering, duty", [
    (0.5, 4450), (-0.5, 5900), (0.0, 5100), (1.5, 3800), (-1e300, 6700),
    (1.0 / 2600, 5100), (-1.0 / 3200, 5101)])  # a half goes away from zero
def test_teleop_request_makes_duty(steering, duty):
    assert SLASH.teleop_duty(steering) == duty


@pytest.mark.parametrize("left, right, duties", [(6700, 3800, [6700, 5900, 5100, 4450, 3800]),
                                                 (5100, 6700, [5100, 5100, 5100, 5900, 6700])])
def test_servo_may_turn_the_other_way_round_or_to_one_side_only(left, right, duties):
    calibration = replace(SLASH, servo_left=left, servo_right=right)
    assert [calibration.teleop_duty(steering) for steering in (1.0, 0.5, 0.0, -0.5, -1.0)] == duties


def test_planner_that_asks_for_straight_on_gets_the_center_also_where_the_tables_end_beside_it():
    calibration = replace(SLASH, radius_axis_m=(1, 2), left_duties=(3800, 4000), right_duties=(6700, 6000))
    assert calibration.planner_duty(math.inf) == calibration.planner_duty(-math.inf) == 5100


@pytest.mark.parametrize("side, table", [(1, "k_pwmcmd_left_table_servo"), (-1, "k_pwmcmd_right_table_servo")])
def test_planner_radius_at_each_breakpoint_makes_the_table_s_duty(side, table):
    for radius_m, duty in zip(PARAMETERS["m_turnrad_axis_servo"], PARAMETERS[table]):
        assert SLASH.planner_duty(side * radius_m) == duty


@pytest.mark.parametrize("duty, radius_m", (
    (5100, math.inf), (3800, 1.0), (3700, 1.0), (3835, 2.5), (5000, 200.0),
    (6700, -1.0), (6800, -1.0), (6675, -1.5), (5200, -200.0)))
def test_turn_radius_of_a_duty_is_the_one_that_the_tables_have_for_it(duty, radius_m):
    assert SLASH.turn_radius_m(duty) == pytest.approx(radius_m)


@pytest.mark.once
@given(st.floats(1, 299), st.sampled_from((-1, 1)))
def test_turn_radius_of_a_planner_s_duty_is_what_the_planner_asked_for(radius_m, side):
    duty = SLASH.planner_duty(side * radius_m)
    assert SLASH.planner_duty(SLASH.turn_radius_m(duty)) == duty


def test_turn_radius_where_the_servo_turns_the_other_way_and_tables_repeat():
    calibration = replace(SLASH, servo_left=6700, servo_right=3800, radius_axis_m=(1, 2, 4),
                          left_duties=(6700, 6700, 6000), right_duties=(3800, 4000, 4000))
    assert calibration.turn_radius_m(6700) == 2.0  # the wheels are at their stop from there on
    assert calibration.turn_radius_m(6350) == pytest.approx(3.0)
    assert calibration.turn_radius_m(5500) == math.inf  # straighter than the widest turn of the table
    assert calibration.turn_radius_m(4000) == pytest.approx(-2.0)


@pytest.mark.parametrize("side, tightest_m", [(1.0, 1.3), (-1.0, 1.1), (0.01, 1.3), (-300.0, 1.1)])
def test_tightest_radius_is_that_of_its_side_and_the_widest_of_those_with_its_duty(side, tightest_m):
    calibration = replace(SLASH, radius_axis_m=(1.0, 1.1, 1.3, 2.0, 300.0),
                          left_duties=(3800, 3800.3, 3800.4, 3830, 5100), right_duties=(6700, 6700, 6690, 6650, 5100))
    assert calibration.tightest_radius_m(side) == tightest_m
    assert calibration.turn_radius_m(calibration.planner_duty(math.copysign(0.2, side))) == math.copysign(
        tightest_m, side)


def test_tightest_radius_to_a_side_to_which_the_servo_does_not_turn_is_the_widest_of_the_table():
    calibration = replace(SLASH, servo_left=5100, radius_axis_m=(1, 2, 4), left_duties=(5100,) * 3,
                          right_duties=(6700, 6000, 5500))
    assert calibration.tightest_radius_m(1.0) == 4.0 and calibration.turn_radius_m(6700) == -1.0


def test_tables_with_fractions_are_interpolated_before_they_are_rounded():
    calibration = replace(SLASH, radius_axis_m=[0.4, 0.9], left_duties=[3800.2, 3800.9],
                          right_duties=[6700.0, 6699.0])
    assert calibration.planner_duty(0.4) == 3800
    assert calibration.planner_duty(0.65) == 3801  # 3800.55
    assert calibration.planner_duty(-0.65) == 6700  # 6699.5


@pytest.mark.parametrize("changes, message", [
    ({"servo_center": 3799}, "servo_center is 3799; accepted: a duty between servo_left 3800 and servo_right 6700"),
    ({"servo_center": 6701}, "servo_center is 6701; accepted: a duty between servo_left 3800"),
    ({"servo_left": 5100, "servo_right": 5100}, "servo_right is 5100; accepted: a duty other than servo_left's"),
    ({"radius_axis_m": []}, r"m_turnrad_axis_servo is \[\]; accepted: at least two"),
    ({"radius_axis_m": [2, 1]}, r"m_turnrad_axis_servo\[1\] is 1; accepted: more than"),
    ({"left_duties": [3800]}, "k_pwmcmd_left_table_servo is .3800.; accepted: 15 numbers"),
    ({"right_duties": [6700] * 16}, "k_pwmcmd_right_table_servo is .*; accepted: 15 numbers"),
])
def test_calibration_with_a_fault_is_refused_naming_the_parameter(changes, message):
    with pytest.raises(ConfigError, match=message):
        replace(SLASH, **changes)


def test_planner_drives_straight_on_and_turns_tightest_where_the_gamepad_does_after_a_trim():
    assert trimmed(SLASH, 3800, 5100, 6700) is SLASH
    calibration = trimmed(SLASH, 3750, 5200, 6800)
    assert [calibration.planner_duty(radius) for radius in (300, -300, 1, -1)] == [5200, 5200, 3750, 6800]
    assert [calibration.teleop_duty(request) for request in (0, 1, -1)] == [5200, 3750, 6800]
    assert calibration.turn_radius_m(5200) == math.inf
    assert calibration.turn_radius_m(calibration.planner_duty(50)) == pytest.approx(50, rel=0.01)


def test_table_between_keeps_its_ratio_between_center_and_end():
    scaled = trimmed(SLASH, 3800, 5200, 6700)
    assert scaled.left_duties[11] == 5200 - (5100 - 4300) * 1400 / 1300 // 0.1 / 10  # 60 m: 861.5
    assert scaled.right_duties[13] == round(5200 + 200 * 1500 / 1600, 1)
    moved = trimmed(SLASH, 3830, 5130, 6730)
    assert moved.left_duties == [duty + 30 for duty in SLASH.left_duties]
    assert moved.right_duties == [duty + 30 for duty in SLASH.right_duties]


def test_car_whose_left_is_the_larger_duty_is_tuned_alike():
    turned = replace(SLASH, servo_left=6700, servo_right=3800, left_duties=SLASH.right_duties,
                     right_duties=SLASH.left_duties)
    calibration = trimmed(turned, 6750, 5050, 3850)
    assert [calibration.planner_duty(radius) for radius in (1, 300, -300, -1)] == [6750, 5050, 5050, 3850]


@pytest.mark.parametrize("center, wanted, message", [
    (5100, (3800, 6701, 6700), "servo_center is 6701; accepted: a duty between servo_left 3800 and servo_right"),
    (5100, (3800, 3800, 6700), "servo_center is 3800; accepted: .*, and neither of them"),
    (5100, (3800, 6700, 6700), "servo_center is 6700; accepted: .*, and neither of them"),
    (5100, (6700, 5100, 3800), "servo_left is 6700; accepted: a duty on the same side of servo_right 3800"),
    (5100, (5100, 5100, 5100), "servo_left is 5100; accepted: a duty on the same side"),
    (3800, (3900, 3950, 6700), "servo_center is an end at start"),  # a side without a way can't be tuned back
])
def test_impossible_trim_is_refused(center, wanted, message):
    calibration = replace(SLASH, servo_center=center)
    with pytest.raises(ConfigError, match=message):
        trimmed(calibration, *wanted)
    assert trimmed(calibration, 3800, center, 6700) is calibration


@pytest.mark.once
@given(TRIPLES)
def test_trimmed_tables_keep_their_order_and_stay_duties(wanted):
    try:
        scaled = trimmed(SLASH, *wanted)
    except ConfigError:
        return
    assert list(scaled.left_duties) == sorted(scaled.left_duties)
    assert list(scaled.right_duties) == sorted(scaled.right_duties, reverse=True)
    assert all(0 <= duty <= 65535 for duty in (*scaled.left_duties, *scaled.right_duties))


@pytest.mark.parametrize("angle", SKIDPAD)
def test_a_term_fitted_below_1_5_mps_predicts_a_real_car_s_radii_at_2_and_2_5_mps(angle):
    understeer, slow_mps = 0.0091, (0.48, 0.96, 1.44)  # true speeds are 4 % below those asked for
    rows = {0.96 * asked_mps: radius_m for asked_mps, radius_m in SKIDPAD[angle].items()}
    crawl_m = sum(slow_radius_m(rows[speed_mps], speed_mps, understeer) for speed_mps in slow_mps) / len(slow_mps)
    for speed_mps in (1.92, 2.4):  # up to 4.6 m/s² sideways
        assert driven_radius_m(crawl_m, speed_mps, understeer) == pytest.approx(rows[speed_mps], rel=0.02)
    assert crawl_m / rows[1.92] < 0.935  # a table without speed is off by more than twice that


def test_term_is_understeer_times_the_square_of_3_5_mps2_there_and_opposite_to_the_other_side():
    # 0.875 1/m at 2 m/s
    assert lost_per_m(0.875, 2.0, 0.0078) == pytest.approx(0.0078 * 3.5 ** 2)
    assert lost_per_m(-0.875, -2.0, 0.0078) == -lost_per_m(0.875, 2.0, 0.0078)


@pytest.mark.parametrize("speed_mps", [-4.0, 0.0, 1e-60, 0.01, 0.1, 8.0])
@pytest.mark.parametrize("radius_m", [0.5, 100.0, math.inf])
def test_the_radius_to_steer_by_drives_the_radius_that_is_wanted(radius_m, speed_mps):
    slow_m = slow_radius_m(radius_m, speed_mps, 0.0078)
    assert slow_m <= radius_m and driven_radius_m(slow_m, speed_mps, 0.0078) == pytest.approx(radius_m)


def test_with_the_term_it_steers_tighter_the_faster_it_is_and_reads_its_own_duty_back():
    car = replace(SLASH, understeer=0.0078)
    assert car.planner_duty(5.0, 0.0) == SLASH.planner_duty(5.0) == SLASH.planner_duty(5.0, 10.0)
    assert SLASH.turn_radius_m(3815, 5.0) == SLASH.turn_radius_m(3815)
    for side in (1, -1):
        duties = [car.planner_duty(side * 5.0, speed_mps) for speed_mps in (1.0, 3.0, 5.0)]
        assert duties == sorted(duties, reverse=side > 0) and duties[0] != duties[-1]
        assert car.turn_radius_m(car.planner_duty(side * 5.0, 4.0), 4.0) == pytest.approx(side * 5.0, rel=0.02)
    assert car.turn_radius_m(5100, 4.0) == math.inf
    assert car.planner_duty(1.2, 8.0) == SLASH.servo_left


def test_without_a_speed_a_car_is_taken_to_stand():
    car = replace(SLASH, understeer=1.0)
    assert car.planner_duty(5.0) == SLASH.planner_duty(5.0) != car.planner_duty(5.0, 1.0)
    assert car.tightest_radius_m(1.0) == SLASH.tightest_radius_m(1.0) < car.tightest_radius_m(1.0, 1.0)
    assert car.turn_radius_m(4400) == SLASH.turn_radius_m(4400) < car.turn_radius_m(4400, 1.0)
