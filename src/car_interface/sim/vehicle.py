"""Simulates a Slash 4x4 that moves: a bicycle with a servo, tyres, an ESC, and hall sensors in its rear wheels.

Consumes PWM duties and time steps; produces a pose and wheel pulses with their true times. Its steering and drive-train
curves are the truth that calibration tables only approximate: they are near the tables of the package, and not equal to
them on purpose.

REP-103 throughout: metres, radians, seconds, x forward, y left, left turns positive. The pose is that of the middle of
the rear axle. Backlash of the steering, a slope and a sagging battery are options: the default car has none of them.

Tyres limit how hard it can brake, and make its path differ from its steering; without them it is a kinematic car. The
front wheels slip sideways by an angle that grows with the square of the lateral acceleration a: the path is less curved
than the steering points, by ``understeer`` · a². Measured circles of a 3.5 kg F1TENTH car (motion capture, 0.5 to 2.5
m/s, 3 steering angles; recordings of Tinker-Twins/F1TENTH-Mocap-Data-Recording-Pipeline) follow that within 2.5 % in
radius, up to 5 m/s² sideways. Beyond, the friction circle holds: √(along² + across²) ≤ grip. Weight doesn't move and
slip takes no time: no skid, no oversteer, no rocking before it tips.

A brake that is stronger than the tyres' grip locks the wheels: no pulses, and the car slides straight on. A motor that
is stronger than the grip is limited to it, and the wheels don't spin.

The car stops dead at an obstacle, without a bounce, and can be driven out the way it came. Its wheels stall: full
throttle pushes it with 5.6 m/s², and tyres hold some 7.8 m/s² on a dry floor (0.8 g) before they slip. So odometry
agrees with the truth.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from dataclasses import dataclass, field
from typing import NamedTuple

from car_interface.common import declared
from car_interface.common.errors import require
from car_interface.common.units import NS_PER_S
from car_interface.common.vehicle_geometry import PULSES_PER_REVOLUTION, TRACK_M, WHEEL_DIAMETER_M
from car_interface.sim import drive_train
from car_interface.sim.drive_train import COASTS, DriveTrainConfig, VirtualEsc, VirtualEscConfig
from car_interface.sim.teensy_sensors import BACKWARD, FORWARD, LEFT, RIGHT
from car_interface.sim.world import Pose, World

GRAVITY_MPS2 = 9.81
ARRIVED_DUTY = 0.01  # a servo this near its target has arrived: its creep would never end
UPRIGHT_RATIO = 0.9  # below this part of the acceleration at which it tips, the car stands on its wheels again
ORIGIN = Pose(0.0, 0.0, 0.0)


class Pulse(NamedTuple):
    """A magnet that passed a wheel's sensor: true time, LEFT or RIGHT, FORWARD or BACKWARD."""

    at_ns: int
    side: int
    direction: int


@dataclass(frozen=True)
class SteeringConfig:
    """The servo's motion, and the curvature at each of its positions."""

    # Points (duty, curvature in 1/m, left positive), duties rising, curvatures falling, or rising with a servo that is
    # built in the other way round. Linear in between, saturated at the ends, where the wheels are at their stops: by
    # default 0.97 m is the tightest left turn, 1.03 m the tightest right one.
    curve: tuple[tuple[float, float], ...] = (
        (3800, 1.030), (3808, 0.812), (3815, 0.692), (3822, 0.601), (3830, 0.516), (3835, 0.415), (3840, 0.344),
        (3850, 0.259), (3860, 0.205), (3870, 0.171), (3880, 0.147), (3890, 0.103), (3900, 0.0515), (3950, 0.0345),
        (4000, 0.0257), (4300, 0.0172), (4600, 0.0129), (4900, 0.0103), (5070, 0.0), (5300, -0.0097),
        (5600, -0.0121), (5900, -0.0162), (5950, -0.0242), (6050, -0.0322), (6150, -0.0486), (6250, -0.0968),
        (6350, -0.138), (6400, -0.161), (6450, -0.195), (6500, -0.243), (6550, -0.278), (6600, -0.324), (6625, -0.386),
        (6650, -0.487), (6662, -0.550), (6675, -0.645), (6688, -0.783), (6700, -0.970),
    )  # fmt: skip
    # Where the servo stands at power-up. It steers 1.3e-3 1/m to the right: this car has to be trimmed.
    center_duty: float = 5100.0
    rate_duty_per_s: float = 12850.0  # the fastest that the servo turns: 60° (2185 duty, 90° being 1 ms) in 0.17 s
    lag_s: float = 0.015  # time constant with which it creeps up to a near target
    # How far the servo turns, after it has turned round, before the wheels follow; the curve is that of the middle
    # between both ways to come there.
    backlash_duty: float = 0.0

    def __post_init__(self):
        duties, curvatures = zip(*self.curve)
        rising = all(low < high for low, high in zip(duties, duties[1:]))
        steps = [after - before for before, after in zip(curvatures, curvatures[1:])]
        one_way = all(step < 0 for step in steps) or all(step > 0 for step in steps)
        require(len(self.curve) > 1 and rising and one_way, "steering curve", self.curve,
                "rising duty, falling 1/m (or rising, for a reversed servo)")


@dataclass(frozen=True)
class TyreConfig:
    """One car's tyres and its balance: those of the measured car, and rubber on a dry floor, 0.8 g."""

    understeer: float = declared.number(
        "understeer", 0.0078, "curvature that it loses by its lateral acceleration", "1/m for each (m/s²)²", low=0,
        high=1)
    grip_mps2: float = declared.number(
        "grip", 7.8, "the most acceleration, along and across together", "m/s²", above=0.0, high=100)
    rollover_mps2: float = declared.number(
        "rollover", 7.0, "the lateral acceleration at which it tips", "m/s²", above=0.0, high=100)


@dataclass(frozen=True)
class VehicleConfig:
    """One car."""

    steering: SteeringConfig = SteeringConfig()
    drive: DriveTrainConfig = field(default_factory=DriveTrainConfig)
    track_m: float = TRACK_M  # between the rear wheels
    wheel_diameter_m: float = WHEEL_DIAMETER_M  # with the next: one pulse each 14.9 mm
    pulses_per_revolution: int = PULSES_PER_REVOLUTION
    # Where each rear wheel (left, right) stands at the start, in pulses; at each whole number one of its two hall pins
    # changes, and after four of them their levels are the same again.
    pulse_phase: tuple[float, float] = (0.25, 0.75)
    start: Pose = ORIGIN
    slope: float = 0.0  # of the ground, all of which is one plane: metres up for each metre, 0.02 is 2 %
    uphill_rad: float = 0.0  # the heading in which it rises
    on_box: bool = False  # its wheels hang in the air: they turn as on the ground, and it stays where it is
    # The speed controller between pulses and motor; ``None`` = one without a memory: a duty against the way the car
    # rolls brakes, and at standstill reverse drives backward.
    esc: VirtualEscConfig | None = None
    tyres: TyreConfig | None = field(default_factory=TyreConfig)

    def __post_init__(self):
        sharpest = max(abs(curvature) for _, curvature in self.steering.curve)
        require(0 < self.track_m < 2 / sharpest, "track_m", self.track_m, "more than 0, inside the tightest turn")

    @property
    def pulse_m(self) -> float:
        """A rear wheel's distance from one pulse to the next."""
        return math.pi * self.wheel_diameter_m / self.pulses_per_revolution


class Vehicle:
    """The car at one moment.

    Args:
        start_ns: the true time at the start; pulses are stamped on this scale.
        world: what stops it; ``None`` = nothing does.
    """

    def __init__(self, config: VehicleConfig = VehicleConfig(), start_ns: int = 0, world: World | None = None):
        self.config, self.pose = config, config.start
        self._world = world
        self.time_ns = start_ns  # true time now
        self.speed_mps = 0.0  # of the rear axle, backward negative
        self.travel_m = 0.0  # signed distance so far
        self.servo_duty = config.steering.center_duty  # the place of the servo, as the duty that holds it there
        self._start_ns = start_ns
        self._esc = None if config.esc is None else VirtualEsc(config.esc, start_ns)
        self._motor = COASTS
        self._linkage_duty = self.servo_duty  # the place of the wheels, as the servo's duty without backlash
        self._duties, self._curvatures = (tuple(column) for column in zip(*config.steering.curve))
        # The curvature of the steering, which is its path's at a crawl, and that of its path now; left positive.
        self.steered_per_m = self.curvature_per_m = self.true_curvature_per_m(self.servo_duty)
        self.slides = False  # its wheels are locked
        self._along_mps2 = 0.0  # what the tyres transmit along the car
        # How often it would have tipped over; a kinematic car's stay 0.
        self.rollovers = Rollovers(config.tyres.rollover_mps2 if config.tyres else math.inf)
        self._pulse_m = config.pulse_m
        self._wheel_pulses = list(config.pulse_phase)  # each rear wheel's distance, in pulses

    @property
    def yaw_rate_radps(self) -> float:
        return self.speed_mps * self.curvature_per_m

    @property
    def lateral_mps2(self) -> float:
        """Its lateral acceleration, left turns positive."""
        return self.speed_mps * self.speed_mps * self.curvature_per_m

    def true_curvature_per_m(self, duty: float) -> float:
        """Return the curvature when the servo stands at ``duty``; saturated at the stops."""
        duties, curvatures = self._duties, self._curvatures
        if duty <= duties[0]:
            return curvatures[0]
        if duty >= duties[-1]:
            return curvatures[-1]
        index = bisect_right(duties, duty)
        low, high = duties[index - 1], duties[index]
        ratio = (duty - low) / (high - low)
        return curvatures[index - 1] + ratio * (curvatures[index] - curvatures[index - 1])

    def step(self, dt_ns: int, steering_duty: int, esc_duty: int) -> list[Pulse]:
        """Move on by ``dt_ns`` with both outputs held.

        Args:
            dt_ns: 1 or more. Speed changes evenly within a step; with 20 ms the error is a few mm/s.
            steering_duty: of the servo's channel; -1, 0 or any duty that is no servo pulse: the servo stays where it
                is, without power.
            esc_duty: of the ESC's channel; without a pulse it lets the car coast.

        Returns:
            The rear wheels' pulses of this step in the order of time.
        """
        dt_s = dt_ns / NS_PER_S
        steered_per_m = self._turn_servo(dt_s, steering_duty)
        speed_mps, distance_m, moving_s = self._accelerate(dt_s, esc_duty)
        curvature_per_m = self._path_curvature_per_m(steered_per_m, (self.speed_mps + speed_mps) / 2)
        pulses = []
        if distance_m:
            pose = self.pose if self.config.on_box else self._pose_after(distance_m, curvature_per_m)
            if self._world is not None and self._world.blocks(pose, distance_m, self.speed_mps):
                speed_mps = 0.0
            else:
                self.pose = pose
                pulses = self._roll(distance_m, moving_s, speed_mps, curvature_per_m)
        self.time_ns += dt_ns
        self.speed_mps = speed_mps
        self.curvature_per_m = self._path_curvature_per_m(self.steered_per_m, speed_mps)
        self.rollovers.update(self.lateral_mps2)
        return pulses

    def _path_curvature_per_m(self, steered_per_m: float, speed_mps: float) -> float:
        """Return the curvature of the path by the steering's."""
        if self.config.on_box or self.slides:
            return 0.0
        if self.config.tyres is None:
            return steered_per_m
        return path_curvature_per_m(steered_per_m, speed_mps, self._along_mps2, self.config.tyres)

    def _turn_servo(self, dt_s: float, duty: int) -> float:
        """Turn the servo and return the mean curvature during that."""
        error = duty - self.servo_duty
        if error == 0.0 or not drive_train.is_pulse(duty):
            return self.steered_per_m
        steering = self.config.steering
        if abs(error) < ARRIVED_DUTY:
            self.servo_duty = float(duty)
        else:
            farthest = steering.rate_duty_per_s * dt_s
            wanted = error * -math.expm1(-dt_s / steering.lag_s)
            self.servo_duty += max(-farthest, min(farthest, wanted))
        before_per_m = self.steered_per_m
        half_backlash = steering.backlash_duty / 2
        low, high = self.servo_duty - half_backlash, self.servo_duty + half_backlash
        self._linkage_duty = max(low, min(high, self._linkage_duty))
        self.steered_per_m = self.true_curvature_per_m(self._linkage_duty)
        return (before_per_m + self.steered_per_m) / 2

    def _accelerate(self, dt_s: float, esc_duty: int) -> tuple[float, float, float]:
        """Return (speed after the step, distance in it, seconds of it that the car moved)."""
        before_mps = self.speed_mps
        drive = self.config.drive
        thrust = drive.thrust((self.time_ns - self._start_ns) / NS_PER_S)
        downhill_mps2 = -GRAVITY_MPS2 * math.sin(math.atan(self.config.slope)) * math.cos(
            self.pose.yaw_rad - self.config.uphill_rad)
        if self._esc is None:
            acceleration_mps2 = drive_train.true_acceleration_mps2(esc_duty, before_mps, drive, thrust, downhill_mps2)
        else:
            wanted = self._esc.step(esc_duty, self.time_ns, before_mps)
            self._motor = drive_train.following(self._motor, wanted, dt_s, drive.lag_s)
            acceleration_mps2 = drive_train.motor_acceleration_mps2(
                self._motor, before_mps, drive, thrust, downhill_mps2)
        if self.config.tyres is not None:
            grip_mps2, demanded_mps2 = self.config.tyres.grip_mps2, acceleration_mps2 - downhill_mps2
            self._along_mps2 = max(-grip_mps2, min(grip_mps2, demanded_mps2))
            self.slides = self._along_mps2 != demanded_mps2 and demanded_mps2 * before_mps < 0.0
            acceleration_mps2 = self._along_mps2 + downhill_mps2
        after_mps = before_mps + acceleration_mps2 * dt_s
        moving_s = dt_s
        if before_mps * after_mps < 0.0:
            # It stops within the step. Whether it goes on backward is decided at standstill, by the next step.
            moving_s = -before_mps / acceleration_mps2
            after_mps = 0.0
        return after_mps, (before_mps + after_mps) / 2 * moving_s, moving_s

    def _pose_after(self, distance_m: float, curvature_per_m: float) -> Pose:
        x_m, y_m, yaw_rad = self.pose
        turn_rad = distance_m * curvature_per_m
        # The chord of an arc: its length is distance · sin(h)/h, in the mean of both headings (h: half the turn).
        half_rad = turn_rad / 2
        chord_m = distance_m * (math.sin(half_rad) / half_rad if abs(half_rad) > 1e-6 else 1.0)
        direction_rad = yaw_rad + half_rad
        return Pose(x_m + chord_m * math.cos(direction_rad), y_m + chord_m * math.sin(direction_rad),
                    yaw_rad + turn_rad)

    def _roll(self, distance_m: float, moving_s: float, speed_mps: float, curvature_per_m: float) -> list[Pulse]:
        """Turn the wheels along an arc and return the pulses on it."""
        self.travel_m += distance_m
        if self.slides:
            return []
        widening = self.config.track_m / 2 * curvature_per_m
        acceleration_mps2 = (speed_mps - self.speed_mps) / moving_s
        left = self._wheel(LEFT, distance_m, 1.0 - widening, acceleration_mps2)
        right = self._wheel(RIGHT, distance_m, 1.0 + widening, acceleration_mps2)
        return sorted(left + right)

    def _wheel(self, side: int, distance_m: float, ratio: float, acceleration_mps2: float) -> list[Pulse]:
        """Turn one wheel, whose distance is ``ratio`` of the axle's, and return its pulses."""
        before = self._wheel_pulses[side]
        after = before + distance_m * ratio / self._pulse_m
        self._wheel_pulses[side] = after
        # A magnet sits at each whole number. Rolling back over it gives a pulse as well.
        first, last = math.floor(before), math.floor(after)
        if first == last:
            return []
        magnets, direction = ((range(first + 1, last + 1), FORWARD) if last > first else
                              (range(first, last, -1), BACKWARD))
        to_axle_m = self._pulse_m / ratio
        return [
            Pulse(self.time_ns + self._time_to_ns((magnet - before) * to_axle_m, acceleration_mps2), side, direction)
            for magnet in magnets
        ]

    def _time_to_ns(self, distance_m: float, acceleration_mps2: float) -> int:
        """Return when the axle has gone ``distance_m``: the first root of v·t + a·t²/2 = s, in a form for any a."""
        speed_mps = self.speed_mps
        root_mps = math.sqrt(max(0.0, speed_mps * speed_mps + 2.0 * acceleration_mps2 * distance_m))
        return int(2.0 * distance_m / (speed_mps + math.copysign(root_mps, distance_m)) * NS_PER_S)


def path_curvature_per_m(steered_per_m: float, speed_mps: float, along_mps2: float, tyres: TyreConfig) -> float:
    """Return the curvature of the path.

    Args:
        steered_per_m: the curvature of the steering at a crawl.
        speed_mps: its sign doesn't matter.
        along_mps2: transmitted by the tyres along the car; the rest of the friction circle is left for the turn.
    """
    speed2 = speed_mps * speed_mps
    loss = tyres.understeer * speed2 * speed2
    magnitude = abs(steered_per_m)
    if loss * magnitude > 1e-9:
        # steered = path + loss · path²: its positive root, in a form that takes a small loss.
        magnitude = 2 * magnitude / (1 + math.sqrt(1 + 4 * loss * magnitude))
    if speed2:
        across_mps2 = math.sqrt(max(0.0, tyres.grip_mps2 ** 2 - along_mps2 ** 2))
        magnitude = min(magnitude, across_mps2 / speed2)
    return math.copysign(magnitude, steered_per_m)


class Rollovers:
    """Counts how often a car would have tipped over. The car drives on."""

    def __init__(self, rollover_mps2: float):
        self._rollover_mps2 = rollover_mps2
        self._tips = False
        self.count = 0  # how often; once until it stands on its wheels again
        self.lateral_mps2 = 0.0  # of the newest, the largest so far; left turns positive

    def update(self, lateral_mps2: float) -> None:
        magnitude = abs(lateral_mps2)
        if self._tips:
            self._tips = magnitude >= UPRIGHT_RATIO * self._rollover_mps2
            if magnitude > abs(self.lateral_mps2):
                self.lateral_mps2 = lateral_mps2
        elif magnitude >= self._rollover_mps2:
            self._tips = True
            self.count += 1
            self.lateral_mps2 = lateral_mps2
