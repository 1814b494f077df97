"""The demo's script: who holds what, stage by stage. Time is passed in."""
from __future__ import annotations

import pytest

from car_interface.sim.demo_script import DONE, LET_GO, NOBODY, TELEOP, Drive, DriveConfig

S = 1_000_000_000
NOW = 1000 * S
CONFIG = DriveConfig(nobody_s=5.0, picked_up_s=2.0, let_go_s=6.0, max_turn_s=20.0)


@pytest.mark.parametrize("at_s, stage, gamepad_on, held", [
    pytest.param(0.0, NOBODY, False, False, id="nobody_there"),
    pytest.param(2.9, NOBODY, False, False, id="still_nobody"),
    pytest.param(3.0, NOBODY, True, False, id="gamepad_picked_up_with_nothing_held"),
    pytest.param(4.9, NOBODY, True, False, id="still_nothing_held"),
    pytest.param(5.0, TELEOP, True, True, id="deadman_held"),
])
def test_gamepad_is_there_for_a_while_before_its_deadman_is_held(at_s, stage, gamepad_on, held):
    """What is held when a node starts, or when the gamepad is first heard, counts for nothing."""
    orders = Drive(CONFIG, NOW).orders(NOW + round(at_s * S), 0.0, 0.0)
    assert (orders.stage, orders.gamepad_on, orders.manual or orders.autonomous) == (stage, gamepad_on, held)


def test_gamepad_stays_until_the_human_has_let_go():
    drive, now_ns, seen = Drive(CONFIG, NOW), NOW, {}
    while drive.stage != DONE:
        now_ns += S
        orders = drive.orders(now_ns, 0.0, 0.0)  # never turns: each circle is given up
        assert (orders.throttle > 0) == (orders.stage == TELEOP)
        seen.setdefault(orders.stage, set()).add((orders.gamepad_on, orders.manual or orders.autonomous))
    assert seen[LET_GO] == {(True, False)}
    assert seen[DONE] == {(False, False)}


@pytest.mark.parametrize("speed_mps, throttle", [
    pytest.param(0.0, 0.95, id="standing"),
    pytest.param(1.2, 0.35, id="at_its_speed"),
    pytest.param(5.0, 0.0, id="too_fast_it_rolls"),
])
def test_human_drives_by_the_other_stick(speed_mps, throttle):
    drive = Drive(CONFIG, NOW)
    drive.orders(NOW + 5 * S, 0.0, 0.0)
    assert drive.orders(NOW + 6 * S, 0.0, speed_mps).throttle == pytest.approx(throttle)
