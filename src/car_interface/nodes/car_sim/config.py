"""The configuration of the node car_sim: its parameters, a car's files, and chance where both leave it open."""
from __future__ import annotations

import math
import random
from dataclasses import dataclass, field, fields, replace
from typing import Sequence

from car_interface.common import declared
from car_interface.common.errors import require
from car_interface.common.units import CHANNELS, MAX_DUTY
from car_interface.common.vehicle_geometry import PULSES_PER_REVOLUTION, TRACK_M, WHEEL_DIAMETER_M
from car_interface.sim.drive_train import KINDS, DriveTrainConfig, Pulses, VirtualEscConfig
from car_interface.sim.teensy_firmware import BOOT_MS, FirmwareConfig
from car_interface.sim.vehicle import Pose, SteeringConfig, TyreConfig, VehicleConfig
from car_interface.sim.world import World, WorldConfig

NO_ESC = "none"
MAX_UPTIME_MS = 3_600_000
MAX_DRIFT_PPM = 50.0
SEEDS = 1 << 31
HALL_STATES = 4  # after so many pulses a wheel's hall pins have the same levels again
TABLES = ("steering/m_turnrad_axis_servo", "steering/k_pwmcmd_left_table_servo", "steering/k_pwmcmd_right_table_servo")
STEERING, ESC, WHEELS = (f"a car's `{name}.yaml`" for name in ("turn_arb", "throttle", "teensy_sensor_hub"))
SIZE = f"the car's size; `wheels/…` is {WHEELS}"
OWN = "its own"
MIN_STEP_DUTY = 1.0  # between the curve's points: tables may end in equal duties
PARTS = 8  # of each interval of a table: linear in the radius as turn_arb reads it, within 0.5 % from 1 to 2 m


@dataclass(frozen=True)
class CarSimConfig:
    """The virtual car, its room and its Teensy. Its own parameters go before those of a car's files."""

    port: str = declared.text("port", "/tmp/car_sim_teensy", "where the virtual serial port appears", "path")
    virtual_chip: str | None = declared.path(
        "virtual_chip", None, "the socket of the virtual servo board's chip", default_text="that of `pca9685`")
    collides: bool = declared.flag("collisions", True, "false = nothing stops the car")
    has_obstacles: bool = declared.flag("obstacles", True, "false = the room has its walls only, no boxes and posts")
    on_box: bool = declared.flag(
        "on_box", False, "true = its wheels hang in the air: they turn, and it stays where it is")
    is_kinematic: bool = declared.flag(
        "kinematic", False, "true = no tyres: it goes where its wheels point, and never tips over")
    tyres: TyreConfig | None = declared.group(TyreConfig())
    center_duty: float | None = declared.number("steering/servo_center", None, STEERING, default_text="none")
    radius_axis_m: Sequence[float] = declared.numbers(TABLES[0], (), STEERING, default_text="none")
    left_duties: Sequence[float] = declared.numbers(TABLES[1], (), STEERING, default_text="none")
    right_duties: Sequence[float] = declared.numbers(TABLES[2], (), STEERING, default_text="none")
    esc_channel: int = declared.integer(
        "esc/servo/channel", 1, f"{ESC}; −1 = none, then 1", low=-1, high=CHANNELS - 1, default_text="none")
    neutral_duty: float = declared.number(
        "esc/servo/neutral", DriveTrainConfig.neutral_duty, ESC, low=0, high=MAX_DUTY, default_text="none")
    steering_channel: int = declared.channel(
        "steering_channel", 0, "of the servo board", same_as="steering/servo_channel")
    given_throttle_channel: int | None = declared.channel(
        "throttle_channel", None, "of the servo board", default_text="`esc/servo/channel`")
    pose: Sequence[float] = declared.numbers(
        "start", (0.0, 0.0, 0.0), "where it starts", "x and y in m, yaw in rad", default_text="[0, 0, 0]")
    track_m: float = declared.number(
        "track", TRACK_M, SIZE, "m", above=0.0, same_as="wheels/track")
    wheel_diameter_m: float = declared.number(
        "wheel_diameter", WHEEL_DIAMETER_M, SIZE, "m", above=0.0, same_as="wheels/wheel_diameter")
    pulses_per_revolution: int = declared.integer(
        "pulses_per_revolution", PULSES_PER_REVOLUTION, "of a rear wheel", low=1,
        same_as="wheels/pulses_per_revolution")
    steering_duties: Sequence[float] | None = declared.numbers(
        "steering_duties", None, "the true steering: rising duties", default_text=OWN)
    steering_curvatures: Sequence[float] | None = declared.numbers(
        "steering_curvatures", None, "and the curvature of each, left positive", "1/m", default_text=OWN)
    drive: DriveTrainConfig = declared.group(DriveTrainConfig())
    esc_kind: str = declared.choice(
        "esc_kind", NO_ESC, "what its ESC makes of a pulse behind neutral; `none` = it has no memory and needs no "
                            "arming: at standstill it drives backward",
        choices=(NO_ESC, *KINDS))
    world: WorldConfig = declared.group(WorldConfig())
    wheel_pulses: Sequence[float] | None = declared.numbers(
        "wheel_pulses", None, "where the rear wheels (left, right) stand at the start", "pulses", default_text="random")
    firmware: FirmwareConfig = declared.group(FirmwareConfig(clock_start_ms=None, clock_drift_ppm=None))
    vehicle: VehicleConfig = field(default_factory=VehicleConfig)

    SHARED = ("steering", "esc", "wheels")  # the rest of these files is not read

    @property
    def throttle_channel(self) -> int:
        if self.given_throttle_channel is not None:
            return self.given_throttle_channel
        return self.esc_channel if self.esc_channel >= 0 else 1

    def completed(self, params) -> CarSimConfig:
        """Return the same with vehicle, world and firmware, by chance where the parameters leave them open."""
        firmware, world = self.firmware, self.world
        seed = random.randrange(SEEDS) if firmware.seed is None else firmware.seed
        rng = random.Random(seed)
        vehicle = self._vehicle(params, rng)
        uptime_ms, drift_ppm = rng.randrange(BOOT_MS, MAX_UPTIME_MS), rng.uniform(-MAX_DRIFT_PPM, MAX_DRIFT_PPM)
        firmware = replace(
            firmware, seed=seed, wheel_positions=tuple(math.floor(pulses) for pulses in vehicle.pulse_phase),
            clock_start_ms=uptime_ms if firmware.clock_start_ms is None else firmware.clock_start_ms,
            clock_drift_ppm=drift_ppm if firmware.clock_drift_ppm is None else firmware.clock_drift_ppm)
        if not self.has_obstacles:
            world = replace(world, boxes=(), posts=())
        require(not self.collides or World(world).is_free(vehicle.start), "start", list(vehicle.start),
                "a place where the car touches no wall, box or post, or collisions: false")
        return replace(self, vehicle=vehicle, world=world, firmware=firmware)

    def _vehicle(self, params, rng):
        require(len(self.pose) == len(Pose._fields), "start", self.pose, "three numbers: x, y in m, and yaw in rad")
        by_chance = [HALL_STATES * rng.random() for _ in range(2)]
        wheel_pulses = by_chance if self.wheel_pulses is None else self.wheel_pulses
        require(len(wheel_pulses) == 2, "wheel_pulses", wheel_pulses, "two numbers: left, right")
        shift = self.neutral_duty - self.drive.neutral_duty  # a car's own ESC differs in its neutral
        drive = replace(self.drive, full_reverse_duty=self.drive.full_reverse_duty + shift,
                        neutral_duty=self.neutral_duty, full_forward_duty=self.drive.full_forward_duty + shift)
        return VehicleConfig(
            steering=self._steering(params), drive=drive, esc=None if self.esc_kind == NO_ESC else VirtualEscConfig(
                kind=self.esc_kind, **{each.name: getattr(drive, each.name) for each in fields(Pulses)}),
            tyres=None if self.is_kinematic else self.tyres, track_m=self.track_m,
            wheel_diameter_m=self.wheel_diameter_m, pulses_per_revolution=self.pulses_per_revolution,
            pulse_phase=tuple(wheel_pulses), start=Pose(*self.pose), on_box=self.on_box)

    def _steering(self, params):
        """Return the servo and the steering: their own, or those of a car's calibration."""
        steering = SteeringConfig()
        if self.center_duty is not None:
            tables = [params.numbers(name) for name in TABLES]  # now they are required
            steering = SteeringConfig(center_duty=self.center_duty, curve=steering_curve(self.center_duty, *tables))
        duties, curvatures = map(list, zip(*steering.curve))
        duties = duties if self.steering_duties is None else self.steering_duties
        curvatures = curvatures if self.steering_curvatures is None else self.steering_curvatures
        require(len(duties) == len(curvatures), "steering_curvatures", curvatures,
                f"{len(duties)} numbers, one for each of steering_duties")
        return replace(steering, curve=tuple(zip(duties, curvatures)))


def steering_curve(center: float, radii_m: Sequence[float], left: Sequence[float], right: Sequence[float],
                   ) -> tuple[tuple[float, float], ...]:
    """Return the true steering of a car that turns as these tables say: (duty, curvature in 1/m, left positive).

    Duties rise; the left side may have the lower or the higher ones.

    Args:
        center: the duty that drives straight on.
        radii_m: of the tables, rising.
        left, right: the duty for each radius to either side; duties that don't come nearer to the center are left out.

    Raises:
        ConfigError: the tables are no pair of sides.
    """
    require(len(radii_m) == len(left) == len(right) and len(radii_m) > 0, "steering tables",
            [len(radii_m), len(left), len(right)], "three of the same length")
    require((left[0] - center) * (right[0] - center) < 0, "steering tables", [left[0], center, right[0]],
            "left and right on different sides of the center")
    sides = (_side(center, radii_m, left), [(center, 0.0)],
             [(duty, -curvature) for duty, curvature in _side(center, radii_m, right)])
    return tuple(sorted(point for side in sides for point in side))


def _side(center, radii_m, duties):
    """Return the points of one side, from its end to the center."""
    points, last = [], math.inf
    for radius_m, duty in _divided(list(zip(radii_m, duties))):
        apart = abs(duty - center)
        if MIN_STEP_DUTY <= apart <= last - MIN_STEP_DUTY:
            points.append((float(duty), 1.0 / radius_m))
            last = apart
    return points


def _divided(table):
    """Return a table's rows, and others between them on straight lines."""
    return [*(tuple(one + (other - one) * part / PARTS for one, other in zip(row, following))
              for row, following in zip(table, table[1:]) for part in range(PARTS)), table[-1]]
