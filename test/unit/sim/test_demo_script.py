"""The demo's script: who holds what, stage by stage. Time is passed in."""
from __future__ import annotations

import pytest

from car_interface.sim.demo_script import DONE, LET_GO, NOBODY, TELEOP, Drive, DriveConfig

S = 1_000_000_000
NOW = 1000 * S
CONFIG = DriveConfig(nobody_s=5.0, picked_up_s=2.0, let_go_s=6.0, max_turn_s=20.0)


def test_gamepad_is_there_before_its_deadman_is_held_and_stays_until_the_human_has_let_go():
    drive, now_ns, seen = Drive(CONFIG, NOW), NOW, {}
    while drive.stage != DONE:
        now_ns += S
        orders = drive.orders(now_ns, 0.0, 0.0)  # never turns: each circle is given up
        assert (orders.throttle > 0) == (orders.stage == TELEOP)
        seen.setdefault(orders.stage, set()).add((orders.gamepad_on, orders.manual or orders.autonomous))
    assert seen[NOBODY] == {(False, False), (True, False)}, "picked up before its deadman is held"
    assert seen[TELEOP] == {(True, True)} and seen[LET_GO] == {(True, False)}
    assert seen[DONE] == {(False, False)}


@pytest.mark.parametrize("speed_mps, throttle", [
    (0.0, 0.95), (1.2, 0.35), (5.0, 0.0)], ids=["standing", "at_its_speed", "too_fast_it_rolls"])
def test_human_drives_by_the_other_stick(speed_mps, throttle):
    drive = Drive(CONFIG, NOW)
    drive.orders(NOW + 5 * S, 0.0, 0.0)
    assert drive.orders(NOW + 6 * S, 0.0, speed_mps).throttle == pytest.approx(throttle)
