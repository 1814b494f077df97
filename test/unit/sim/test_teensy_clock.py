"""The simulated Teensy's clock."""

import pytest

from car_interface.sim.teensy_config import FirmwareConfig
from car_interface.sim.teensy_firmware import TeensyFirmware
from car_interface.sim.teensy_wheels import FORWARD, LEFT
from teensy_bench import MS, WHEELS, Bench, S, parse_wheels


@pytest.mark.parametrize(
    ("drift_ppm", "ramp_ppm_per_h", "after_1h_ms"),
    [(40, 0, 3_600_144), (-100, 0, 3_599_640), (0, 20, 3_600_036), (100, -20, 3_600_324)],
)
def test_clock_drifts(drift_ppm, ramp_ppm_per_h, after_1h_ms):
    config = FirmwareConfig(clock_start_ms=0, clock_drift_ppm=drift_ppm, clock_ramp_ppm_per_h=ramp_ppm_per_h)
    teensy = TeensyFirmware(config)
    assert teensy.device_ns(3600 * S) == pytest.approx(after_1h_ms * MS, abs=1000)
    assert teensy.millis(3600 * S) in (after_1h_ms - 1, after_1h_ms)


def test_power_up_later_starts_the_clock_then():
    teensy = TeensyFirmware(FirmwareConfig(clock_start_ms=5), power_up_ns=1000 * S)
    assert [teensy.millis(1000 * S + after_ns) for after_ns in (0, MS - 1, MS, 2 * MS - 1)] == [5, 5, 6, 6]
    assert teensy.transmit(1000 * S + MS)[:4] == b"\x7e\xc1\x3e\x7e"


def test_time_that_ran_back_changes_nothing():
    bench = Bench(lambda sensor, at_ns: 1000).until(1100 * MS)
    assert bench.teensy.transmit(0) == b""
    bench.teensy.wheel_pulse(LEFT, FORWARD, 0)
    assert parse_wheels(bench.after(10 * MS).frames(WHEELS)[-1])[0].when == 300 + 1100


def test_next_event_is_when_something_happens():
    bench = Bench(lambda sensor, at_ns: 1000).until(20 * MS)
    for _ in range(150):
        bench.until(bench.teensy.next_event_ns)
        assert bench.teensy.next_event_ns > bench.now_ns
    assert bench.now_ns > S
