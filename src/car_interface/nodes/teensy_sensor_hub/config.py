"""The configuration of the node teensy_sensor_hub, and of car_display, which draws by the same frames."""
from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Sequence

from car_interface.common import declared
from car_interface.common.errors import require
from car_interface.common.vehicle_geometry import TRACK_M, WHEEL_DIAMETER_M, WHEELBASE_M
from car_interface.teensy.link.framing import CORRECTED, SHIPPED
from car_interface.teensy.link.pinging import AUTO
from car_interface.teensy.link.protocol import MAX_SEQUENCE, SONARS
from car_interface.teensy.sensing.measurements import MeasurementConfig
from car_interface.teensy.sensing.odometry import OdometryConfig
from car_interface.teensy.sensing.plausibility import MAX_GAP_MS
from car_interface.teensy.sensing.ranging import RangingConfig

# Of the virtual car: x and y from the middle of the rear axle, in m, and its yaw, in rad.
MOUNTS = {"front_right": (0.40, -0.10, -0.524), "front_middle": (0.42, 0.0, 0.0), "front_left": (0.40, 0.10, 0.524),
          "rear_right": (-0.12, -0.10, -2.618), "rear_middle": (-0.14, 0.0, math.pi), "rear_left": (-0.12, 0.10, 2.618)}
SLOWEST_ODOM_HZ = 0.1


@dataclass(frozen=True)
class HubConfig:
    """The serial line, the car's wheels and sonars, and the frames of the messages."""

    port: str = declared.text("port", "/dev/ttyAMA0", "opened exclusively, reopened when it was lost", "path")
    baud: int = declared.integer("baud", 115200, "of the serial line", low=300, high=4_000_000)
    ping_period_s: float = declared.number(
        "ping_period", 1.0, "with the sonars stopped only its pongs carry the Teensy's time", "s", low=0.01, high=3600)
    firmware_checksum: str = declared.choice(
        "firmware_checksum", AUTO, "which checksum the Teensy's receiver expects; `auto` = the one that it answers",
        choices=(AUTO, SHIPPED, CORRECTED))
    required: bool = declared.flag("required", False, "true = exit code 1 when the port can't be opened at start")
    sonar_restart_s: float = declared.number(
        "sonar_restart", 3.0, "time without any sonar report after which SONAR_START is sent; 0 = never", "s", low=0.0,
        high=3600)
    sonar_sequence: Sequence[float] = declared.numbers(
        "sonar_sequence", (), "the order in which the sonars fire; [] = the firmware's own, all six",
        f"up to {MAX_SEQUENCE}", low=0, high=len(SONARS) - 1)
    sonar_sequence_ahead: Sequence[float] = declared.numbers(
        "sonar_sequence_ahead", (), "the same while the car drives forward, for "
                                    "[obstacle_stop](limits.md#obstacle_stop); [] = no other",
        f"up to {MAX_SEQUENCE}", low=0, high=len(SONARS) - 1)
    raw_only: bool = declared.flag(
        "raw_only", False, "true = the four raw topics and the link only, for half of the CPU")
    odometry: OdometryConfig = declared.group(OdometryConfig())
    odom_rate_hz: float = declared.number(
        "odom_rate", 50.0, "maximum rate of `odom`, its transform and `joint_states`; 0 = with each report of the "
                           f"wheels, up to 200; else at least {SLOWEST_ODOM_HZ}", "Hz", low=0.0, high=1000)
    publish_tf: bool = declared.flag("publish_tf", True, "false if another node publishes odom → base_link")
    odom_frame: str = declared.text("odom_frame", "odom", "frame that `odom` is in")
    base_frame: str = declared.text("base_frame", "base_link", "frame of the car")
    frame_prefix: str = declared.text(
        "frame_prefix", "", "before every frame and joint; with `ns:=car1` `car1/`", may_be_empty=True)
    mounts: Sequence[Sequence[float]] = declared.numbers(
        "sonars/", tuple(MOUNTS[name] for name in SONARS), "pose in base_link, the middle of the rear axle",
        "x, y in m, yaw in rad", family=SONARS, default_text="as in `config/sonars.yaml`")
    field_of_view_rad: float = declared.number(
        "field_of_view", 0.524, "the whole cone of a sonar", "rad", above=0.0, high=math.pi)
    ranging: RangingConfig = declared.group(RangingConfig())

    def __post_init__(self):
        for name in ("sonar_sequence", "sonar_sequence_ahead"):
            sequence = getattr(self, name)
            require(len(sequence) <= MAX_SEQUENCE and not any(sensor % 1 for sensor in sequence), name, sequence,
                    f"up to {MAX_SEQUENCE} whole numbers from 0 to 5")
        require(not 0 < self.odom_rate_hz < SLOWEST_ODOM_HZ, "odom_rate", self.odom_rate_hz,
                f"0, or a number from {SLOWEST_ODOM_HZ} to 1000")
        for name, mount in zip(SONARS, self.mounts):
            require(len(mount) == 3, f"sonars/{name}", mount, "three numbers: x, y in m, and yaw in rad, in base_link")

    def frame(self, name: str) -> str:
        return self.frame_prefix + name

    @property
    def measurement(self) -> MeasurementConfig:
        """Return the configuration of what is measured."""
        # Whatever the sonars do, pongs come with the pings, of which one may be lost.
        max_gap_ms = max(MAX_GAP_MS, math.ceil(2000 * self.ping_period_s))
        return MeasurementConfig(self.odometry, self.ranging, self.baud, max_gap_ms)


@dataclass(frozen=True)
class CarDisplayConfig:
    """The car's size, and the frames, which are to be those of teensy_sensor_hub."""

    wheelbase_m: float = declared.number("wheelbase", WHEELBASE_M, "the car's size", "m", above=0.0, high=10)
    track_m: float = declared.number("track", TRACK_M, "the car's size", "m", above=0.0, high=10)
    wheel_m: float = declared.number("wheel_diameter", WHEEL_DIAMETER_M, "the car's size", "m", above=0.0, high=10)
    odom_frame: str = declared.text("odom_frame", "odom", "as teensy_sensor_hub's")
    base_frame: str = declared.text("base_frame", "base_link", "as teensy_sensor_hub's")
    frame_prefix: str = declared.text("frame_prefix", "", "before both frames", may_be_empty=True)
