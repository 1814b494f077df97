"""What a simulated Teensy can be like."""
from __future__ import annotations

import pytest

from car_interface.common.errors import ConfigError
from car_interface.sim.teensy_config import FirmwareConfig


@pytest.mark.parametrize(("name", "value", "accepted"), [
    ("baud", 0, "more than 0"), ("pool_size", 0, "more than 0"), ("loop_us", 0, "1 to 1000"),
    ("clock_start_ms", 2**32, r"0 to 2\*\*32 - 1"), ("clock_drift_ppm", 1e6, "-10000 to 10000"),
    ("sonar_pulse_end_us", 11_000, "more than 11428, up to 1000000"), ("boot_byte", 256, "0 to 255"),
    ("sonars_missing", (6,), "sensors from 0 to 5"), ("sonar_sequence", (0, 6), "1 to 24 sensors from 0 to 5"),
    ("sonar_sequence", (), "1 to 24 sensors from 0 to 5"),
])
def test_config_that_no_teensy_could_have_is_refused(name, value, accepted):
    with pytest.raises(ConfigError, match=f"{name} is .*; accepted: {accepted}"):
        FirmwareConfig(**{name: value})
