"""What no car of the simulation can be like: values that parameters give together."""

import pytest

from car_interface.common.errors import ConfigError
from car_interface.sim.vehicle import SteeringConfig, VehicleConfig


@pytest.mark.parametrize("kind, name, value, accepted", [
    (SteeringConfig, "curve", ((4000, 1.0), (3900, 0.0)), "rising duty, falling 1/m"),
    (VehicleConfig, "track_m", 3.0, "inside the tightest turn"),
])
def test_impossible_config_is_refused(kind, name, value, accepted):
    with pytest.raises(ConfigError, match=f"{name} is .*; accepted: .*{accepted}"):
        kind(**{name: value})
