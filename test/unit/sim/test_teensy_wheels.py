"""The simulated Teensy's wheels, specified as rules; test_captures.py holds them against captures of the original."""

import pytest

from car_interface.sim.teensy_wheels import BACKWARD, FORWARD, LEFT, RIGHT
from teensy_bench import MS, Bench, wheel_reports


# Each pair is a hall state (pulses modulo 4 of a Gray code 0 1 3 2) and what the first pulses seem to be:
# (direction, dist, dist_abs). The levels are never read at power-up, and an interrupt reads its own pin only.
@pytest.mark.parametrize(("direction", "position", "seen"), [
    pytest.param(FORWARD, 0, [(0, 1, 1), (0, 1, 2), (0, 1, 3)], id="forward_from_00_is_right"),
    pytest.param(FORWARD, 1, [(1, 1, 1), (1, 1, 2), (0, 3, 3)], id="forward_from_01_seems_backward_twice"),
    pytest.param(BACKWARD, 3, [(0, 1, 1), (0, 1, 2), (1, 3, 3)], id="backward_from_10_seems_forward_twice"),
    pytest.param(BACKWARD, 2, [(2, 0, 1), (2, 0, 2), (1, 3, 3)], id="backward_from_11_has_no_direction_twice"),
    pytest.param(BACKWARD, 1, [(2, 0, 1), (1, 2, 2), (1, 2, 3)], id="backward_from_01_has_no_direction_once"),
])
def test_hall_pins_are_taken_for_00_at_power_up(direction, position, seen):
    bench = Bench(wheel_positions=(position, position + 4)).until(300 * MS)
    bench.roll(LEFT, direction, 3, 15 * MS).roll(RIGHT, direction, 3, 15 * MS).after(5 * MS)
    for side in (LEFT, RIGHT):
        reports = [report for report in wheel_reports(bench, side) if report.dist_abs]
        assert [(report.direction, report.dist, report.dist_abs) for report in reports[:2]] == seen[:2]
        assert (reports[-1].direction, reports[-1].dist, reports[-1].dist_abs) == seen[2]
