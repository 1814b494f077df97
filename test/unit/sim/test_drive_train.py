"""What a duty of the virtual ESC does to the car's speed."""

import pytest

from car_interface.sim.drive_train import (
    COASTS,
    DriveTrainConfig,
    MotorState,
    following,
    is_pulse,
    motor_acceleration_mps2,
    true_acceleration_mps2,
)

REVERSE, NEUTRAL, FULL = 3277, 4915, 6554
OFF, NEVER_SET = 0, -1


@pytest.mark.parametrize("duty, expected", [
    (NEUTRAL, 0), (4930, 0), (4900, 0), (FULL, 1), (8000, 1), (REVERSE, -1), (1700, -1), (5747, 0.5), (4084, -0.5)])
def test_throttle_of_a_duty_is_linear_beyond_the_neutral_band_and_0_without_a_pulse(duty, expected):
    assert DriveTrainConfig().throttle(duty) == pytest.approx(expected, abs=0.001)
    assert DriveTrainConfig().throttle(65535) == DriveTrainConfig().throttle(OFF) == 0


@pytest.mark.parametrize(("duty", "expected"), [(OFF, False), (NEVER_SET, False), (65535, False), (1637, False),
                                                (1638, True), (NEUTRAL, True), (8192, True), (8193, False)])
def test_pulse_is_between_half_a_millisecond_and_two_and_a_half(duty, expected):
    assert is_pulse(duty) is expected


@pytest.mark.parametrize("motor, speed_mps, expected_mps2", [
    (COASTS, 0.0, 0.0),
    (COASTS, 2.0, -0.526),  # 0.35 + 2 · (0.08 + 2 · 0.004)
    (MotorState(0.0, 0.5), 2.0, -4.026), (MotorState(0.0, 0.5), -2.0, 4.026),  # 0.5 · 7 more
    (MotorState(0.0, 1.0), 0.0, 0.0),
    (MotorState(1.0, 0.0), 0.0, 5.25), (MotorState(-1.0, 0.0), 0.0, -3.25),  # 5.6 and 3.6 − 0.35
    (MotorState(-1.0, 0.0), 2.0, -4.892),  # 3.6 · (1 + 2 / 9.4) + 0.526: its own voltage helps
    (MotorState(0.05, 0.0), 0.0, 0.0),  # less than the drag
], ids=str)
def test_motor_moves_the_car(motor, speed_mps, expected_mps2):
    moved_mps2 = motor_acceleration_mps2(following(COASTS, motor, 0.001, 0.0), speed_mps, DriveTrainConfig())
    assert moved_mps2 == pytest.approx(expected_mps2, abs=0.001)


def test_motor_follows_its_esc_with_its_lag():
    motor = following(COASTS, MotorState(1.0, 0.0), 0.1, 0.1)
    assert motor == (pytest.approx(0.632, abs=0.001), 0.0)
    motor = following(motor, MotorState(0.0, 0.5), 0.1, 0.1)
    assert motor == (pytest.approx(0.632 * 0.368, abs=0.001), pytest.approx(0.5 * 0.632, abs=0.001))
    assert following(motor, MotorState(-1.0, 0.0), 10.0, 0.1) == (pytest.approx(-1.0), pytest.approx(0.0))


def test_motor_agrees_with_the_esc_without_a_memory_where_that_drives():
    motor = MotorState(DriveTrainConfig().throttle(6000), 0.0)
    for speed_mps in (0.0, 1.0, 5.0):
        assert motor_acceleration_mps2(motor, speed_mps, DriveTrainConfig(), 0.9, 0.1) == (
            true_acceleration_mps2(6000, speed_mps, DriveTrainConfig(), 0.9, 0.1))
