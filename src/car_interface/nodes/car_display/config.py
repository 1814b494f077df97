"""The configuration of the node car_display."""
from __future__ import annotations

from dataclasses import dataclass

from car_interface.common import declared
from car_interface.common.vehicle_geometry import TRACK_M, WHEEL_DIAMETER_M, WHEELBASE_M


@dataclass(frozen=True)
class CarDisplayConfig:
    """The car's size, and the frames, which are to be those of teensy_sensor_hub."""

    wheelbase_m: float = declared.number("wheelbase", WHEELBASE_M, "the car's size", "m", above=0.0, high=10)
    track_m: float = declared.number("track", TRACK_M, "the car's size", "m", above=0.0, high=10)
    wheel_m: float = declared.number("wheel_diameter", WHEEL_DIAMETER_M, "the car's size", "m", above=0.0, high=10)
    odom_frame: str = declared.text("odom_frame", "odom", "as teensy_sensor_hub's")
    base_frame: str = declared.text("base_frame", "base_link", "as teensy_sensor_hub's")
    frame_prefix: str = declared.text("frame_prefix", "", "before both frames", may_be_empty=True)
