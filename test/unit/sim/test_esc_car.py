"""The car on a line: which way it goes under a motor, and what its wheels do."""
from __future__ import annotations

import pytest

from car_interface.common.errors import ConfigError
from car_interface.sim.esc import BACKWARD, BRAKE, COAST, FORWARD, MotorState
from car_interface.sim.esc_car import EscCar, EscCarConfig


def run(car, motor, seconds):
    for _ in range(round(seconds * 100)):
        car.step(0.01, motor)
    return car


def test_car_drives_forward_and_backward_and_coasts_to_a_stop():
    assert run(EscCar(), MotorState(FORWARD, 0.5), 1.0).speed_mps > 1
    assert run(EscCar(), MotorState(BACKWARD, 0.5), 1.0).speed_mps < -1
    car = run(EscCar(speed_mps=1.0), MotorState(COAST, 0.0), 5.0)
    assert car.speed_mps == 0 and 1.0 < car.place_m < 1.4  # 1 / (2 · 0.35) less what grows with speed


def test_brake_stops_and_holds_but_does_not_turn_round():
    car = run(EscCar(speed_mps=2.0), MotorState(BRAKE, 1.0), 1.0)
    assert car.speed_mps == 0 and car.place_m == pytest.approx(0.27, abs=0.02)  # 4 / (2 · 7.4)
    assert run(EscCar(EscCarConfig(slope=0.2)), MotorState(BRAKE, 1.0), 1.0).place_m == 0


def test_reverse_push_brakes_a_car_that_rolls_forward_and_then_drives_it_backward():
    car = EscCar(speed_mps=1.0)
    assert 0 < run(car, MotorState(BACKWARD, 1.0), 0.2).speed_mps < 0.3
    assert run(car, MotorState(BACKWARD, 1.0), 0.5).speed_mps < -1


def test_locked_wheels_stand_while_the_car_slides():
    car = run(EscCar(EscCarConfig(lock_mps2=3.0, slide_mps2=4.0), speed_mps=4.0), MotorState(BRAKE, 1.0), 0.5)
    assert car.speed_mps == pytest.approx(2.0) and car.wheel_mps == 0
    assert run(car, MotorState(COAST, 0.0), 0.01).wheel_mps == car.speed_mps


def test_slope_rolls_a_car_backward():
    assert run(EscCar(EscCarConfig(slope=0.1)), MotorState(COAST, 0.0), 1.0).speed_mps < -0.5


def test_impossible_car_is_refused():
    with pytest.raises(ConfigError, match="slide_mps2"):
        EscCarConfig(slide_mps2=0)
    with pytest.raises(ConfigError, match="thrust_halves_mps"):
        EscCarConfig(thrust_halves_mps=0)
