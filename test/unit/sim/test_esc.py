"""What virtual ESCs make of pulses, as their manuals and owners tell it."""

import pytest
from virtual_escs import crawler, direct, race, vxl, xl5

from car_interface.sim import drive_train as virtual
from car_interface.sim.drive_train import VirtualEsc

MS = 1_000_000
NEUTRAL, AHEAD, BACK = 4915, 5734, 4096  # half to both sides
COAST, FORWARD, BRAKE, BACKWARD = "coast", "forward", "brake", "backward"
ARMED = [(NEUTRAL, 1.0, 0.0)]
STOPPED = 0.0
BRAKED = [(AHEAD, 1.0, 2.0), (BACK, 0.5, 1.0)]


def play(config, steps, armed=True):
    """The mode at the end of each step: (duty, seconds, speed of the wheels)."""
    esc, now_ns, modes = VirtualEsc(config), 0, []
    for duty, seconds, wheel_mps in [*(ARMED if armed else []), *steps]:
        end_ns = now_ns + round(seconds * 1e9)
        while now_ns < end_ns:
            now_ns += 10 * MS
            motor = esc.step(duty, now_ns, wheel_mps)
        modes.append(BRAKE if motor.brake else FORWARD if motor.push > 0 else BACKWARD if motor.push else COAST)
    return modes[1:] if armed else modes


@pytest.mark.parametrize("make", [xl5, vxl, crawler, direct, race])
def test_forward_drives_and_neutral_does_not(make):
    assert play(make(drag_brake=0.0), [(AHEAD, 0.1, 0.0), (NEUTRAL, 0.1, 1.0)]) == [FORWARD, COAST]


@pytest.mark.parametrize("config, expected", [
    pytest.param(xl5(), [FORWARD, BRAKE, BRAKE], id="xl5_a_held_brake_stays_a_brake_at_standstill"),
    pytest.param(vxl(), [FORWARD, BRAKE, BRAKE], id="vxl_too"),
    pytest.param(race(), [FORWARD, BRAKE, BRAKE], id="race_too"),
    pytest.param(crawler(), [FORWARD, BRAKE, BACKWARD], id="a_crawler_s_becomes_reverse"),
    pytest.param(direct(), [FORWARD, BACKWARD, BACKWARD], id="direct_drives_backward_at_once"),
])
def test_pull_after_forward(config, expected):
    assert play(config, [*BRAKED, (BACK, 0.5, STOPPED)]) == expected


@pytest.mark.parametrize("config, neutral_s, rolls_mps, expected", [
    pytest.param(xl5(dwell_s=0.2), 0.3, STOPPED, BACKWARD, id="xl5_reverses_after_its_dwell"),
    pytest.param(xl5(dwell_s=0.2), 0.1, STOPPED, BRAKE, id="and_brakes_before"),
    pytest.param(xl5(dwell_s=0.2), 0.3, 1.0, BACKWARD, id="also_while_it_rolls"),
    pytest.param(vxl(dwell_s=0.2), 0.3, 1.0, BRAKE, id="a_vxl_does_not"),
    pytest.param(race(dwell_s=0.2), 0.3, STOPPED, BRAKE, id="race_never_reverses"),
])
def test_second_pull(config, neutral_s, rolls_mps, expected):
    assert play(config, [*BRAKED, (NEUTRAL, neutral_s, rolls_mps), (BACK, 0.1, rolls_mps)])[-1] == expected


@pytest.mark.parametrize("second_pull, expected", [(virtual.BRAKES, BRAKE), (virtual.BRAKES_AND_TURNS, BACKWARD)])
def test_second_pull_that_began_rolling_and_is_held_at_standstill(second_pull, expected):
    config = vxl(second_pull=second_pull)
    steps = [*BRAKED, (NEUTRAL, 0.5, 1.0), (BACK, 0.2, 1.0), (BACK, 0.3, STOPPED)]
    assert play(config, steps)[-2:] == [BRAKE, expected]


def test_esc_that_forgets_reverses_at_the_first_pull_after_its_time_in_neutral():
    steps = [(AHEAD, 1.0, 2.0), (NEUTRAL, 2.0, 0.0), (BACK, 0.1, 0.0)]
    assert play(xl5(), steps)[-1] == BRAKE
    assert play(xl5(forget_s=1.5), steps)[-1] == BACKWARD


def test_esc_runs_only_after_neutral():
    config = xl5(arming_s=0.5)
    assert play(config, [(AHEAD, 2.0, 0.0), (NEUTRAL, 0.3, 0.0), (AHEAD, 0.1, 0.0)], armed=False)[-1] == COAST
    assert play(config, [(NEUTRAL, 0.6, 0.0), (AHEAD, 0.1, 0.0)], armed=False)[-1] == FORWARD


@pytest.mark.parametrize("no_pulse", [0, -1, 65535])
def test_esc_without_pulses_holds_for_its_time_then_stops_and_must_be_armed_again(no_pulse):
    config = xl5(cutoff_s=0.2)
    assert play(config, [(AHEAD, 0.5, 1.0), (no_pulse, 0.1, 1.0), (no_pulse, 0.3, 1.0), (AHEAD, 0.5, 1.0)]) == [
        FORWARD, FORWARD, COAST, COAST]
