"""The car_sim node: a car without hardware, for the real nodes to drive.

It turns what the servo board holds into motion and answers as the Teensy does, byte by byte, on a pseudo-terminal. The
true steering and drive-train curves are its own; the tables of the other nodes only come near them.

It follows the virtual servo board's chip itself, also while no pca9685 node lives; without one, /servo/output.

Subscribes:
    /servo/output (std_msgs/Int32MultiArray): what the servo board holds.
Publishes:
    ~truth (nav_msgs/Odometry, 50 Hz): where the car really is, in odom, and how fast.
    ~collisions (std_msgs/Int32, latched): how often it ran into a wall, a box or a post.
    ~rollovers (std_msgs/Int32, latched): how often it turned so fast that it would have tipped over. It drives on.
Service:
    ~inject_fault (InjectFault): makes the Teensy and its line misbehave; see ``virtual_line``.
Parameters:
    ~port /tmp/car_sim_teensy: where to put the link to the pseudo-terminal.
    ~virtual_chip: the socket of the virtual servo board's chip; by default that of the node pca9685 in its namespace.
    ~steering_channel 0, ~throttle_channel 1: of the servo board.
    ~start [0, 0, 0]: x and y in m, yaw in rad.
    ~steering, ~esc, ~wheels: what turn_arb.yaml, throttle.yaml and teensy_sensor_hub.yaml of a car say, as demo.launch
        loads them with config:=; the simulated car has its channels, its servo, its ESC's neutral and its wheels then.
        What the parameters below say goes before that.
    ~wheelbase 0.324, ~track 0.296, ~wheel_diameter 0.095 (m), ~pulses_per_revolution 20.
    ~steering_duties, ~steering_curvatures: the true steering, rising duties and curvatures in 1/m, left positive.
    ~esc_kind none: what its ESC makes of a pulse behind neutral: brake_then_reverse, brake_becomes_reverse,
        direct_reverse, forward_only; none = it has no memory and takes no arming: a duty against the way the car rolls
        brakes, and at standstill reverse drives backward. The launch files have brake_then_reverse.
    ~forward_acceleration, ~reverse_acceleration, ~brake_deceleration (m/s²): the true drive train.
    ~kinematic false: true = it goes where its wheels point at any speed; the three below don't count then.
    ~understeer 0.0078 (1/m for each (m/s²)²), ~grip 7.8, ~rollover 7.0 (m/s²): by how much its turns widen, the most
        acceleration that its tyres hold, and the lateral one at which it tips; see ``sim.tyres``.
    ~collisions true: walls, boxes and posts stop the car; false = it drives through them.
    ~obstacles true: boxes and posts stand in the room; false = it has its walls only.
    ~temperature 20 (°C): of the air that the sonars' sound travels through.
    ~wheel_pulses: where the rear wheels (left, right) stand at the start, in pulses: how far to the next ones, and
        the levels of their hall pins, which the Teensy takes for 00 (0.25 and 0.75: they are).
    ~clock_start_ms, ~clock_drift_ppm: the Teensy's clock.  ~corrected_checksum false: its receiver repaired.
    ~sonar_pulse_end 38000 (µs): so long a sonar that hears nothing holds its echo pin.
    ~seed: of all that isn't given: wheel_pulses, clock_start_ms (up to an hour), clock_drift_ppm (±50); of the garbage
        in the Teensy's memory at power-up, and of the noise on its line. Not given it differs each time; it is logged.
Arguments, by a launch file: --port, --virtual-chip, which these parameters must agree with: see
    ``common.fixed_parameters``.
"""
from __future__ import annotations

import math
import random
from dataclasses import dataclass, replace

import rospy
from geometry_msgs.msg import Point, Quaternion, Vector3
from nav_msgs.msg import Odometry
from std_msgs.msg import Int32, Int32MultiArray

from car_interface.common.errors import ConfigError
from car_interface.common.rate_timer import RateTimer
from car_interface.common.units import CHANNELS, MAX_DUTY, NS_PER_S, UNCHANGED
from car_interface.nodes.car_sim.chip_follower import ChipFollower
from car_interface.nodes.car_sim.virtual_line import VirtualLine
from car_interface.nodes.pca9685.virtual_board import chip_path
from car_interface.ros.clocks import RosClock
from car_interface.ros.logs import ThrottledWarnings
from car_interface.ros.runtime import run
from car_interface.ros.topics import advertise, subscribe
from car_interface.sim.calibrated_car import steering_curve
from car_interface.sim.collision import Collisions
from car_interface.sim.esc import KINDS, VirtualEscConfig
from car_interface.sim.teensy_config import BOOT_MS, FirmwareConfig
from car_interface.sim.teensy_firmware import TeensyFirmware
from car_interface.sim.tyres import TyreConfig
from car_interface.sim.vehicle import DriveConfig, Pose, SteeringConfig, Vehicle, VehicleConfig
from car_interface.sim.world import World, WorldConfig

NO_ESC = "none"
STEP_NS = 2_000_000  # the car's maximum step, and how often bytes leave
MAX_UPTIME_MS = 3_600_000
MAX_DRIFT_PPM = 50.0
SEEDS = 1 << 31
HALL_STATES = 4  # after so many pulses a wheel's hall pins have the same levels again
TRUTH_RATE_HZ = 50
MAX_CATCH_UP_NS = NS_PER_S // 2  # a simulator that was stopped for longer goes on from now


def read_vehicle(params, rng) -> VehicleConfig:
    """The car's configuration from the node's parameters, and by chance where they leave it open."""
    steering = _read_steering(params)
    duties, curvatures = zip(*steering.curve)
    duties = params.numbers("steering_duties", list(duties))
    curvatures = params.numbers("steering_curvatures", list(curvatures))
    if len(duties) != len(curvatures):
        raise ConfigError("steering_curvatures", curvatures, f"{len(duties)} numbers, one for each of steering_duties")
    start = params.numbers("start", [0.0, 0.0, 0.0])
    if len(start) != len(Pose._fields):
        raise ConfigError("start", start, "three numbers: x, y in m, and yaw in rad")
    wheel_pulses = params.numbers("wheel_pulses", [HALL_STATES * rng.random() for _ in range(2)])
    if len(wheel_pulses) != 2:
        raise ConfigError("wheel_pulses", wheel_pulses, "two numbers: left, right")
    drive = _read_drive(params)
    return VehicleConfig(
        steering=replace(steering, curve=tuple(zip(duties, curvatures))),
        drive=drive,
        esc=_read_esc(params, drive),
        tyres=_read_tyres(params),
        wheelbase_m=params.number("wheelbase", params.number("wheels/wheelbase", 0.324), above=0.0),
        track_m=params.number("track", params.number("wheels/track", 0.296), above=0.0),
        wheel_diameter_m=params.number("wheel_diameter", params.number("wheels/wheel_diameter", 0.095), above=0.0),
        pulses_per_revolution=params.integer(
            "pulses_per_revolution", params.integer("wheels/pulses_per_revolution", 20), low=1),
        pulse_phase=tuple(wheel_pulses),
        start=Pose(*start))


def _read_steering(params):
    """The servo and the steering: their own, or near those of a car's calibration."""
    center = params.number("steering/servo_center", None)
    if center is None:
        return SteeringConfig()
    return SteeringConfig(center_duty=center, curve=steering_curve(
        center, params.numbers("steering/m_turnrad_axis_servo"), params.numbers("steering/k_pwmcmd_left_table_servo"),
        params.numbers("steering/k_pwmcmd_right_table_servo")))


def _esc_channel(params):
    """The ESC's channel by a car's files, whose −1 means that the car has none."""
    channel = params.integer("esc/servo/channel", 1)
    return channel if channel >= 0 else 1


def _read_drive(params):
    """The ESC and the motor. A car's own ESC differs in its neutral."""
    drive = DriveConfig()
    shift = params.number("esc/servo/neutral", drive.neutral_duty, low=0, high=MAX_DUTY) - drive.neutral_duty
    return DriveConfig(
        full_reverse_duty=drive.full_reverse_duty + shift,
        neutral_duty=drive.neutral_duty + shift,
        full_forward_duty=drive.full_forward_duty + shift,
        forward_mps2=params.number("forward_acceleration", drive.forward_mps2, above=0.0, high=100),
        reverse_mps2=params.number("reverse_acceleration", drive.reverse_mps2, above=0.0, high=100),
        brake_mps2=params.number("brake_deceleration", drive.brake_mps2, above=0.0, high=100))


def _read_esc(params, drive):
    """The ESC, which is calibrated to the drive train's duties; ``None`` = one without a memory."""
    kind = params.choice("esc_kind", NO_ESC, (NO_ESC, *KINDS))
    if kind == NO_ESC:
        return None
    return VirtualEscConfig(kind=kind, neutral_duty=drive.neutral_duty, full_forward_duty=drive.full_forward_duty,
                            full_reverse_duty=drive.full_reverse_duty, forward_band_duty=drive.neutral_band_duty,
                            reverse_band_duty=drive.neutral_band_duty)


def _read_tyres(params):
    """What its tyres hold; ``None`` = a kinematic car."""
    default = TyreConfig()
    tyres = TyreConfig(understeer=params.number("understeer", default.understeer, low=0, high=1),
                       grip_mps2=params.number("grip", default.grip_mps2, above=0.0, high=100),
                       rollover_mps2=params.number("rollover", default.rollover_mps2, above=0.0, high=100))
    return None if params.flag("kinematic", False) else tyres


def read_firmware(params, rng, seed, wheel_pulses) -> FirmwareConfig:
    """The Teensy's configuration from the node's parameters, and by chance where they leave it open."""
    uptime_ms = rng.randrange(BOOT_MS, MAX_UPTIME_MS)
    drift_ppm = rng.uniform(-MAX_DRIFT_PPM, MAX_DRIFT_PPM)
    return FirmwareConfig(
        clock_start_ms=int(params.number("clock_start_ms", uptime_ms, low=0, high=2 ** 32 - 1)),
        clock_drift_ppm=params.number("clock_drift_ppm", drift_ppm, low=-10_000, high=10_000),
        sonar_pulse_end_us=params.integer(
            "sonar_pulse_end", FirmwareConfig.sonar_pulse_end_us, low=12_000, high=1_000_000),
        wheel_positions=tuple(math.floor(pulses) for pulses in wheel_pulses),
        corrected_checksum=params.flag("corrected_checksum", False),
        seed=seed)


def _read_world(params):
    """The room and the air in it."""
    world = WorldConfig(temperature_c=params.number("temperature", 20.0, low=-50, high=60))
    return world if params.flag("obstacles", True) else replace(world, boxes=(), posts=())


@dataclass(frozen=True)
class CarSimConfig:
    """What the node's parameters say.

    Attributes:
        port: where the link to the Teensy's pseudo-terminal appears.
        virtual_chip: the socket of the servo board's chip; ``None`` = the default.
        steering_channel, throttle_channel: of /servo/output, 0..15.
        vehicle: the car.
        world: what its sonars see.
        firmware: its Teensy.
        collides: whether what its sonars see also stops it.
    """

    port: str
    virtual_chip: str | None
    steering_channel: int
    throttle_channel: int
    vehicle: VehicleConfig
    world: WorldConfig
    firmware: FirmwareConfig
    collides: bool


def read_config(params) -> CarSimConfig:
    """The node's configuration from its parameters, and by chance where they leave it open.

    Raises:
        ConfigError: naming the parameter.
    """
    seed = params.integer("seed", random.randrange(SEEDS), low=0)
    rng = random.Random(seed)
    vehicle = read_vehicle(params, rng)
    config = CarSimConfig(
        port=params.text("port", "/tmp/car_sim_teensy"),
        virtual_chip=params.path("virtual_chip", None),
        steering_channel=params.integer(
            "steering_channel", params.integer("steering/servo_channel", 0), low=0, high=CHANNELS - 1),
        throttle_channel=params.integer("throttle_channel", _esc_channel(params), low=0, high=CHANNELS - 1),
        vehicle=vehicle,
        world=_read_world(params),
        firmware=read_firmware(params, rng, seed, vehicle.pulse_phase),
        collides=params.flag("collisions", True))
    params.finish(ignored_namespaces=("steering", "esc", "wheels"))
    if config.collides and not World(config.world).obstacles.is_free(vehicle.start):
        raise ConfigError("start", list(vehicle.start), "a place where the car touches no wall, box or post, or "
                                                        "collisions: false")
    return config


class CarSim:
    """Moves the car, feeds the Teensy, and carries its bytes to and from the pseudo-terminal.

    Args:
        make_chip, make_line: of other classes where a test connects them.
    """

    def __init__(self, params, inbox, make_chip=ChipFollower, make_line=VirtualLine):
        config = read_config(params)
        now_ns = inbox.clocks.now_ns()
        self._steering_channel, self._throttle_channel = config.steering_channel, config.throttle_channel
        world = World(config.world)
        self._collisions = Collisions(world.obstacles)
        self._reported_collisions = self._reported_rollovers = 0
        self._vehicle = Vehicle(config.vehicle, now_ns, self._collisions if config.collides else None)
        self._firmware = TeensyFirmware(
            config.firmware, lambda sensor, at_ns: world.echo_us(self._vehicle.pose, sensor), now_ns)
        self._outputs = [UNCHANGED] * CHANNELS  # by the topic
        self._chip = make_chip(config.virtual_chip or chip_path(f"{inbox.graph.namespace()}pca9685"), inbox)
        self._inbox = inbox
        self._warnings = ThrottledWarnings(inbox.clocks)
        self._line = make_line(config.port, self._firmware, config.firmware.seed, inbox)
        self._line.serve(inbox.clocks.now_ns)
        self._timer = RateTimer(TRUTH_RATE_HZ, now_ns)
        self._ros_clock = RosClock(inbox.clocks)
        self._truth = advertise("~truth", Odometry, inbox)
        self._collision_counts = advertise("~collisions", Int32, inbox, latch=True)
        self._collision_counts.publish(0)
        self._rollover_counts = advertise("~rollovers", Int32, inbox, latch=True)
        self._rollover_counts.publish(0)
        subscribe("/servo/output", Int32MultiArray, inbox, self._on_output)
        rospy.loginfo("a virtual Teensy is on %s (seed %d)", config.port, config.firmware.seed)

    def step(self, now_ns):
        """Live on until now: first the car, then the Teensy, then the line."""
        self._move(now_ns)
        for handler, message, arrival_ns in self._inbox.drain():
            handler(message, arrival_ns)
        self._chip.step(now_ns)
        if self._chip.problem:
            self._warnings.warn("chip", f"the virtual servo board isn't followed: {self._chip.problem}")
        self._line.step(now_ns)
        self._report_collisions()
        self._report_rollovers()
        if self._timer.is_due(now_ns):
            self._publish_truth()
        return now_ns + STEP_NS

    def shut_down(self):
        """Take the link to the pseudo-terminal away."""
        self._line.close()
        self._chip.close()

    def _on_output(self, message, now_ns):
        if len(message.data) != CHANNELS:
            self._warnings.warn("length", f"/servo/output has {len(message.data)} values, not {CHANNELS}: ignored")
            return
        self._outputs = message.data

    def _move(self, now_ns):
        outputs = self._chip.duties or self._outputs
        steering, throttle = outputs[self._steering_channel], outputs[self._throttle_channel]
        vehicle = self._vehicle
        if now_ns - vehicle.time_ns > MAX_CATCH_UP_NS:
            vehicle.time_ns = now_ns - STEP_NS
        while vehicle.time_ns < now_ns:
            for pulse in vehicle.step(min(STEP_NS, now_ns - vehicle.time_ns), steering, throttle):
                self._firmware.wheel_pulse(pulse.side, pulse.direction, pulse.at_ns)

    def _report_collisions(self):
        """Publish and log each collision once."""
        count = self._collisions.count
        if count != self._reported_collisions:
            self._reported_collisions = count
            self._collision_counts.publish(count)
            rospy.logwarn("the car ran into something at %.2f m/s and stands, its wheels stalled (collision %d): drive "
                          "it out the way it came", abs(self._collisions.speed_mps), count)

    def _report_rollovers(self):
        """Publish and log each rollover once."""
        rollovers = self._vehicle.rollovers
        if rollovers.count != self._reported_rollovers:
            self._reported_rollovers = rollovers.count
            self._rollover_counts.publish(rollovers.count)
            rospy.logwarn("the car would have tipped over: %.1f m/s² sideways at %.1f m/s (rollover %d)",
                          abs(rollovers.lateral_mps2), abs(self._vehicle.speed_mps), rollovers.count)

    def _publish_truth(self):
        vehicle = self._vehicle
        message = Odometry(child_frame_id="base_link")
        message.header.stamp = self._ros_clock.stamp("truth", vehicle.time_ns)
        message.header.frame_id = "odom"
        message.pose.pose.position = Point(vehicle.pose.x_m, vehicle.pose.y_m, 0.0)
        half_yaw = vehicle.pose.yaw_rad / 2
        message.pose.pose.orientation = Quaternion(0.0, 0.0, math.sin(half_yaw), math.cos(half_yaw))
        message.twist.twist.linear = Vector3(vehicle.speed_mps, 0.0, 0.0)
        message.twist.twist.angular = Vector3(0.0, 0.0, vehicle.yaw_rate_radps)
        self._truth.publish(message)


def main():
    """Run the node."""
    run("car_sim", CarSim)
