"""What no car or Teensy of the simulation can be like: values that parameters give together."""

import pytest

from car_interface.common.errors import ConfigError
from car_interface.sim.drive_train import DriveTrainConfig
from car_interface.sim.esc import VirtualEscConfig
from car_interface.sim.teensy_firmware import FirmwareConfig
from car_interface.sim.vehicle import SteeringConfig, VehicleConfig


@pytest.mark.parametrize("kind, name, value, accepted", [
    (SteeringConfig, "curve", ((4000, 1.0), (3900, 0.0)), "rising duty, falling 1/m"),
    (DriveTrainConfig, "neutral_duty", 7000, "between full reverse and full forward"),
    (VehicleConfig, "track_m", 3.0, "inside the tightest turn"),
    (VirtualEscConfig, "neutral_duty", 7000, ""),
    (FirmwareConfig, "baud", 0, "more than 0"), (FirmwareConfig, "pool_size", 0, "more than 0"),
    (FirmwareConfig, "loop_us", 0, "1 to 1000"), (FirmwareConfig, "clock_start_ms", 2**32, r"0 to 2\*\*32 - 1"),
    (FirmwareConfig, "clock_drift_ppm", 1e6, "-10000 to 10000"), (FirmwareConfig, "boot_byte", 256, "0 to 255"),
    (FirmwareConfig, "sonar_pulse_end_us", 11_000, "more than 11428, up to 1000000"),
    (FirmwareConfig, "sonars_missing", (6,), "sensors from 0 to 5"),
    *((FirmwareConfig, "sonar_sequence", value, "1 to 24 sensors from 0 to 5") for value in ((0, 6), ())),
])
def test_impossible_config_is_refused(kind, name, value, accepted):
    with pytest.raises(ConfigError, match=f"{name} is .*; accepted: .*{accepted}"):
        kind(**{name: value})
