"""Recordings of virtual cars whose true curves are known: what the calibration tools are judged by.

``random_car`` makes a car, ``record`` lets a scripted person drive it in virtual time (car, Teensy byte by byte,
measurements, messages) and writes a ROS 1 bag as rosbag would have written it of the real nodes. Whoever calibrates
sees only the bag; ``true_curvature_per_m`` is for the judge.

The person sees what odometry says, reacts every quarter of a second, and knows the car only by what it did before.
"""
from __future__ import annotations

import math
import random
from collections import deque
from pathlib import Path
from typing import Iterator, NamedTuple

import numpy as np
from many_drives import COUNT, THROTTLE, count_duty
from unit.written_recordings import Written, stamp, write_ros1

from car_interface.sim.teensy_firmware import FirmwareConfig, TeensyFirmware
from car_interface.sim.teensy_sensors import BACKWARD
from car_interface.sim.vehicle import DriveTrainConfig, SteeringConfig, Vehicle, VehicleConfig
from car_interface.teensy.link.framing import SHIPPED, FrameDecoder
from car_interface.teensy.link.pinging import Pinger
from car_interface.teensy.link.protocol import Pong, SonarStatus, WheelStatus, decode
from car_interface.teensy.sensing.measurements import MeasurementConfig, Measurements
from car_interface.teensy.sensing.odometry import OdometryConfig

NS_PER_S, NS_PER_MS = 1_000_000_000, 1_000_000
STEP_NS = 4 * NS_PER_MS
CONTROL_NS = 20 * NS_PER_MS
OUTPUT_NS = 100 * NS_PER_MS  # /servo/output at the least
ODOM_NS = 20 * NS_PER_MS  # odom at the most: the hub's odom_rate of 50 Hz
REACTION_S, MISSED_S, BEYOND_S = 0.25, 0.5, 0.4
HELD_S = 1.8  # a position of the stick, from either side
START_NS = 5_000 * NS_PER_S  # monotonic
CHANNELS = 16
LEAST_DUTY, MOST_DUTY = 3350, 7050  # as far as the person turns the stick
SIDEWAYS_MPS2 = 3.0  # nobody drives faster than that round a bend
SLOWEST_MPS, FASTEST_MPS = 0.8, 8.5  # straight on


def random_car(seed: int) -> VehicleConfig:
    """A car as no other: where it goes straight and where its stops are, how steep in between, what drives it.

    Each fourth one has a steering like the Slash's that the package's table is of: flat in the middle, all of its turns
    within a few counts at both ends.
    """
    rng = random.Random(seed)
    like_slash = seed % 4 == 3
    curve, center = _slash_curve(rng) if like_slash else _smooth_curve(rng)
    steering = SteeringConfig(curve=curve, center_duty=center + rng.uniform(-60, 60), lag_s=0.15,
                              backlash_duty=rng.uniform(2, 6) if like_slash else rng.uniform(8, 32))
    neutral = 4915 + rng.uniform(-15, 15)
    band = rng.uniform(20, 45)
    drive = DriveTrainConfig(
        neutral_duty=neutral, forward_band_duty=band, reverse_band_duty=band,
        forward_mps2=rng.uniform(4.5, 7.0), reverse_mps2=rng.uniform(2.8, 4.5), brake_mps2=rng.uniform(5.5, 8.5),
        thrust_halves_mps=rng.uniform(7.0, 13.0), drag_mps2=rng.uniform(0.25, 0.5), drag_per_s=rng.uniform(0.05, 0.12),
        drag_per_m=rng.uniform(0.002, 0.007), sag=0.10)
    return VehicleConfig(steering=steering, drive=drive, pulse_phase=(rng.random(), rng.random()), slope=0.02,
                         uphill_rad=rng.uniform(-math.pi, math.pi), tyres=None)


def _smooth_curve(rng):
    """A linkage that turns by w·u + (1 − w)·u^p of what its stop allows, u being how far the servo is on its way."""
    center = rng.uniform(4850, 5250)
    sides = []
    for towards in (-1, 1):
        reach = rng.uniform(950, 1450)
        tightest_per_m = rng.uniform(0.8, 1.2)
        linear, power = rng.uniform(0.3, 1.0), rng.uniform(2.0, 4.0)
        shares = [index / 40 for index in range(1, 41)]
        sides.append([(center + towards * reach * u,
                       -towards * tightest_per_m * (linear * u + (1 - linear) * u ** power)) for u in shares])
    left, right = sides
    return (*reversed(left), (center, 0.0), *right), center


def _slash_curve(rng):
    shift, narrower, tighter = rng.uniform(-120, 120), rng.uniform(0.9, 1.15), rng.uniform(0.9, 1.15)
    curve = tuple((5070 + shift + (duty - 5070) * narrower, curvature * tighter)
                  for duty, curvature in SteeringConfig().curve)
    return curve, 5070 + shift


def true_curvature_per_m(car: VehicleConfig, duty) -> np.ndarray:
    """Where the steering leads, left positive, in the middle of its play."""
    duties, curvatures = zip(*car.steering.curve)
    return np.interp(duty, duties, curvatures)


def duty_of_value(value: float) -> float:
    """The ESC's, by config/throttle.yaml."""
    return float(np.interp(value, THROTTLE.value_axis, THROTTLE.duty_table))


class Command(NamedTuple):
    """What stick and trigger ask for."""

    duty: float  # of the steering
    value: float  # −5..3, brake and reverse negative
    esc_duty: int | None = None  # what throttle_arb sends to the board by hand; then there is no value
    state: dict | None = None  # fields of throttle_arb's state, to be recorded


class View:
    """What the person sees, and has learnt of the car."""

    def __init__(self, rng):
        self.random = rng
        self.now_s = self.speed_mps = self.yaw_rad = self.distance_m = 0.0
        self.stick_duty = self.straight_duty = 5100.0
        self.push = 0.4  # the value that keeps a slow speed
        self.seen = {}  # duty of the steering → curvature

    def look(self, now_s, motion):
        self.now_s = now_s
        if motion is not None:
            self.speed_mps, self.yaw_rad, self.distance_m = motion.speed_mps, motion.yaw_rad, motion.distance_m


def mixed_drive(see: View) -> Iterator[Command]:
    """Slow circles at ever other positions of the stick, and in between straights with throttle, coasting and brake."""
    yield from rest(see, 2.5)
    yield from straight_on(see, 4.0, 1.5)
    positions = _positions(see)
    while True:
        for _ in range(9):
            duty = next(positions, None)
            if duty is not None:
                yield from circle(see, duty)
        yield from straight_on(see, 2.0, 2.0)
        if see.random.random() < 0.5:
            yield from launches(see, 3)
        else:
            yield from steps(see, 18.0)
        if see.random.random() < 0.25:
            yield from back_off(see)


def rest(see, seconds):
    until_s = see.now_s + seconds
    while see.now_s < until_s:
        yield Command(see.straight_duty, 0.0)


def circle(see, duty):
    """Hold the stick at a position at an easy speed, come to from either side, and remember how tight that was."""
    pace, curvatures = _pace(see), []
    side = math.copysign(1.0, see.stick_duty - duty)
    for come_from, seconds in ((side, MISSED_S), (-side, BEYOND_S)):
        begun_s, missed = see.now_s, come_from * see.random.uniform(80, 140)
        while see.now_s < begun_s + seconds:
            yield Command(duty + missed, pace(1.5))
        yield from _hold_circle(see, duty, pace, curvatures)
    see.seen[count_duty(duty)] = sum(curvatures) / len(curvatures)


def _hold_circle(see, duty, pace, curvatures, seconds=HELD_S):
    begun_s, yaw_rad, distance_m = see.now_s, None, None
    curvature = curvatures[-1] if curvatures else 0.3
    while see.now_s < begun_s + seconds:
        if yaw_rad is None and see.now_s > begun_s + 0.5:
            yaw_rad, distance_m = see.yaw_rad, see.distance_m
        if yaw_rad is not None and see.distance_m > distance_m + 0.3:
            curvature = (see.yaw_rad - yaw_rad) / (see.distance_m - distance_m)
        speed_mps = min(2.2, math.sqrt(SIDEWAYS_MPS2 / 2 / max(0.05, abs(curvature))))
        yield Command(duty, pace(speed_mps))
    curvatures.append(curvature)


def straight_on(see, seconds, speed_mps):
    """Keep the heading at a speed."""
    steer, pace = _straight(see), _pace(see)
    until_s = see.now_s + seconds
    while see.now_s < until_s:
        yield Command(steer(), pace(speed_mps))


def launches(see, times):
    """Throttle up to some speed, then let it roll, or brake, or both."""
    rng = see.random
    for _ in range(times):
        value, top_mps = rng.uniform(0.5, 3.0), rng.uniform(0.4, 1.0) * FASTEST_MPS
        yield from _hold(see, value, lambda top=top_mps: see.speed_mps > top, 5.0)
        if rng.random() < 0.5:
            lowest_mps = rng.uniform(0.2, 0.8) * see.speed_mps
            yield from _hold(see, rng.choice((0.0, 0.0, 0.2, -0.15)), lambda low=lowest_mps: see.speed_mps < low, 5.0)
        value = -0.2 - 4.8 * rng.random() ** 1.5
        yield from _hold(see, value, lambda: see.speed_mps < 0.6, 4.0)


def steps(see, seconds):
    """Another throttle or brake each second or two."""
    rng, until_s = see.random, see.now_s + seconds
    while see.now_s < until_s:
        faster = rng.random() < (FASTEST_MPS - see.speed_mps) / (FASTEST_MPS - SLOWEST_MPS)
        value = rng.uniform(0.2, 3.0) if faster else rng.uniform(-4.0, 0.3)
        yield from _hold(see, value,
                         lambda: not SLOWEST_MPS - 0.2 < see.speed_mps < FASTEST_MPS + 0.5, rng.uniform(0.8, 2.0))


def back_off(see):
    yield from _hold(see, -1.0, lambda: see.speed_mps < 0.4, 6.0)
    yield from rest(see, 1.0)
    yield from _hold(see, -1.2, lambda: see.speed_mps < -0.8, 3.0)
    yield from rest(see, 1.5)


def _hold(see, value, is_over, max_s):
    steer, begun_s = _straight(see), see.now_s
    while see.now_s < begun_s + max_s:
        yield Command(steer(), value)
        if see.now_s > begun_s + 0.4 and is_over():
            return


def _positions(see):
    """Of the stick: first all over its way, then in between where it's least clear what the car does there."""
    for index in range(9):
        yield LEAST_DUTY + (MOST_DUTY - LEAST_DUTY) * index / 8
    while True:
        duties = sorted(see.seen)
        curvatures = [see.seen[duty] for duty in duties]
        gaps = [(0.5 * _contrast(*curvatures[index:index + 2]) + 3 * _bend(duties, curvatures, index)
                 + 2e-4 * (high - low), low, high)
                for index, (low, high) in enumerate(zip(duties, duties[1:])) if high - low > COUNT]
        if not gaps:
            yield see.random.uniform(LEAST_DUTY, MOST_DUTY)
            continue
        _, low, high = max(gaps)
        steps = (high - low) / COUNT
        yield low + COUNT * max(1, min(steps - 1, round(steps * see.random.uniform(0.35, 0.65))))


def _contrast(one, other):
    """How much two curvatures differ, by their ratio as well as by their difference."""
    apart = abs(one - other)
    return min(0.4, apart + 0.5 * apart / (0.08 + (abs(one) + abs(other)) / 2))


def _bend(duties, curvatures, index):
    """How far off the straight line from one position to the next the car may be, if it bends only once in between."""
    def slope(at):
        at = min(max(at, 0), len(duties) - 2)
        return (curvatures[at + 1] - curvatures[at]) / (duties[at + 1] - duties[at])
    before, behind = slope(index) - slope(index - 1), slope(index + 1) - slope(index)
    width = duties[index + 1] - duties[index]
    if before * behind <= 0:  # an S, or a straight line
        return width * min(abs(before), abs(behind)) / 2
    return width * before * behind / (before + behind) * math.copysign(1.0, before)


def _pace(see):
    """The trigger for a speed: what seems right, corrected every now and then."""
    state = {"at_s": -1.0, "value": see.push}

    def trigger(speed_mps):
        if see.now_s >= state["at_s"]:
            state["at_s"] = see.now_s + REACTION_S
            missing_mps = speed_mps - see.speed_mps
            see.push = max(0.1, min(1.0, see.push + 0.03 * missing_mps))
            state["value"] = max(-1.5 if see.speed_mps > 1.0 else 0.0, min(1.5, see.push + 0.7 * missing_mps))
        return state["value"]
    return trigger


def _straight(see):
    """The stick for the heading that the car has now: corrected every now and then, and better known each time."""
    state = {"at_s": -1.0, "duty": see.straight_duty, "yaw_rad": see.yaw_rad, "since_s": see.now_s}

    def stick():
        if see.now_s < state["since_s"] + 0.5:  # still coming out of a bend
            state["yaw_rad"] = see.yaw_rad
        elif see.now_s >= state["at_s"]:
            state["at_s"] = see.now_s + REACTION_S
            off_rad = see.yaw_rad - state["yaw_rad"]
            if abs(off_rad) > 0.6:
                state["yaw_rad"] = see.yaw_rad - math.copysign(0.6, off_rad)
            see.straight_duty += max(-6.0, min(6.0, 8.0 * off_rad))
            state["duty"] = see.straight_duty + 160 * off_rad / (1 + max(0.0, see.speed_mps) / 4)
        return state["duty"]
    return stick


def record(car: VehicleConfig, path, seed: int = 0, script=mixed_drive, has_gaps: bool = False,
           duration_s: float = 300.0) -> None:
    """Drive a car and write the bag.

    Args:
        script: ``View -> Command``s, 50 a second; its end is the drive's.
        has_gaps: the recorder ran only 7 s of each 10.
    """
    recorder = _Recorder(car, random.Random(seed))
    messages = recorder.drive(script(recorder.see), duration_s)
    if has_gaps:
        messages = (message for message in messages if message.time_s % 10 < 7)
    write_ros1(Path(path), messages)


class Link:
    """What teensy_sensor_hub makes of a virtual Teensy, byte by byte."""

    def __init__(self, teensy: TeensyFirmware, begin_ns: int = 0, config: MeasurementConfig | None = None):
        self.teensy = teensy
        self.pinger = Pinger(NS_PER_S, SHIPPED, begin_ns)
        self._decoder, self._measurements = FrameDecoder(), Measurements(config or MeasurementConfig())

    def step(self, now_ns: int) -> Iterator[tuple]:
        """Ping if it is time; yield each record that has come, and what was measured by it, if anything.

        Of a pong also the answer by which it was measured.
        """
        if now_ns >= self.pinger.next_event_ns():
            self.pinger.expire(now_ns)
        if now_ns >= self.pinger.due_ns:
            self.teensy.receive(self.pinger.ping(now_ns // NS_PER_MS % 2 ** 32, now_ns), now_ns)
        for body in self._decoder.feed(self.teensy.transmit(now_ns)):
            record = decode(body)
            if isinstance(record, WheelStatus):
                yield record, self._measurements.wheels(record, now_ns)
            elif isinstance(record, SonarStatus):
                yield record, self._measurements.sonar(record, now_ns)
            elif isinstance(record, Pong):
                answer = self.pinger.pong(record.timestamp1, now_ns)
                yield record, (answer, self._measurements.pong(record, answer, now_ns))


class Hub(Link):
    """The link to the Teensy of a car, whose clock (``rng``) and magnets (``noise``) are a little off."""

    def __init__(self, car: VehicleConfig, rng, noise):
        super().__init__(
            TeensyFirmware(FirmwareConfig(clock_start_ms=300 + rng.randrange(3_600_000),
                                          clock_drift_ppm=rng.uniform(-50, 50)), power_up_ns=START_NS),
            START_NS, MeasurementConfig(
                OdometryConfig(car.pulses_per_revolution, car.wheel_diameter_m, car.track_m)))
        self._magnets = _Magnets(car, noise)

    def roll(self, pulses, speed_mps: float, now_ns: int) -> None:
        for at_ns, side, direction in self._magnets.pass_by(pulses, speed_mps, now_ns):
            self.teensy.wheel_pulse(side, direction, at_ns)


class _Recorder:
    """The car, its hub, and the messages as they are recorded."""

    def __init__(self, car, rng):
        self._random = rng
        noise = np.random.default_rng(rng.randrange(1 << 30))
        self._car = Vehicle(car, START_NS)
        self._hub = Hub(car, rng, noise)
        self._motion = None
        self._odom, self._odom_due_ns = None, START_NS  # what waits to be published, and until when
        self._held, self._held_ns = None, 0
        self.see = View(random.Random(rng.randrange(1 << 30)))

    def drive(self, commands, duration_s) -> Iterator[Written]:
        car, now_ns = self._car, START_NS
        end_ns, control_ns = START_NS + round(duration_s * NS_PER_S), START_NS
        duties = (-1, -1)
        while now_ns < end_ns:
            if now_ns >= control_ns:
                control_ns += CONTROL_NS
                self.see.look((now_ns - START_NS) / NS_PER_S, self._motion)
                command = next(commands, None)
                if command is None:
                    return
                self.see.stick_duty = command.duty
                esc_duty = duty_of_value(command.value) if command.esc_duty is None else command.esc_duty
                duties = count_duty(command.duty), count_duty(esc_duty)
                yield from self._command(command, duties, now_ns)
            pulses = car.step(STEP_NS, *duties)
            now_ns = car.time_ns
            self._hub.roll(pulses, car.speed_mps, now_ns)
            for record, measured in self._hub.step(now_ns):
                yield from self._record(record, measured, now_ns)
            if self._odom is not None and now_ns >= self._odom_due_ns:  # the newest, at most 50 a second
                yield self._message(now_ns, "odom", "nav_msgs/Odometry", odometry_fields(self._odom))
                self._odom, self._odom_due_ns = None, now_ns + ODOM_NS

    def _message(self, now_ns, topic, type_name, fields):
        received_ns = now_ns + int(self._random.expovariate(2e-6))  # the way from node to recorder takes a while
        return Written((received_ns - START_NS) / NS_PER_S, "/" + topic.lstrip("/"), type_name, fields)

    def _command(self, command, duties, now_ns):
        if command.esc_duty is None:
            yield self._message(now_ns, "generic/output/value", "car_interface/Float64Stamped",
                                {"stamp": stamp_of(now_ns), "data": float(command.value)})
        if command.state is not None:
            yield self._message(now_ns, "throttle_arb/state", "car_interface/ThrottleState",
                                {"mode": "manual", "human_scale": 0.5, **command.state, "stamp": stamp_of(now_ns)})
        if duties == self._held and now_ns < self._held_ns + OUTPUT_NS:
            return
        self._held, self._held_ns = duties, now_ns
        yield self._message(now_ns, "servo/output", "std_msgs/Int32MultiArray", {
            "layout": {"dim": [{"label": "pwm_channel", "size": CHANNELS, "stride": 1}]},
            "data": [*duties, *[-1] * (CHANNELS - 2)]})

    def _record(self, record, measured, now_ns):
        if isinstance(record, WheelStatus):
            yield self._message(now_ns, "teensy_wheel", "car_interface/Wheel",
                                {side: wheel._asdict() for side, wheel in record._asdict().items()})
            if measured is not None:
                self._motion, self._odom = measured.motion, measured
        elif isinstance(record, SonarStatus):
            yield self._message(now_ns, "teensy_distance", "car_interface/Distance",
                                {"sensor": record.sensor, "distance": record.echo_us, "when": record.when})
        elif measured[1] is not None:
            answer, sync = measured
            yield self._message(now_ns, "teensy_clock", "car_interface/TeensyClock", {
                "stamp": stamp_of(now_ns), "sent": answer.sent_ns, "received": now_ns, "sent_bytes": answer.sent_bytes,
                "baud": 115200, "tick": record.timestamp2, "used": sync.used, "reason": sync.reason,
                "converged": sync.converged, "offset": sync.offset_ns / NS_PER_S, "skew": sync.skew_ppm,
                "uncertainty": sync.uncertainty_ns / NS_PER_S, "round_trip": sync.round_trip_ns / NS_PER_S})


def stamp_of(monotonic_ns: int) -> dict:
    return stamp((monotonic_ns - START_NS) / NS_PER_S)


def odometry_fields(measured) -> dict:
    motion = measured.motion
    pose_covariance, twist_covariance = np.zeros((6, 6)), np.zeros(36)
    pose_covariance[np.ix_((0, 1, 5), (0, 1, 5))] = motion.pose_covariance
    twist_covariance[0], twist_covariance[35] = motion.speed_variance, motion.yaw_rate_variance
    return {"header": {"stamp": stamp_of(measured.stamp.time_ns), "frame_id": "odom"}, "child_frame_id": "base_link",
            "pose": {"pose": {"position": {"x": motion.x_m, "y": motion.y_m},
                              "orientation": {"z": math.sin(motion.yaw_rad / 2), "w": math.cos(motion.yaw_rad / 2)}},
                     "covariance": pose_covariance.ravel()},
            "twist": {"twist": {"linear": {"x": motion.speed_mps}, "angular": {"z": motion.yaw_rate_radps}},
                      "covariance": twist_covariance}}


class _Magnets:
    """Pulses come a little late, each magnet by its own share of the way to the next: none sits where it should."""

    def __init__(self, car, noise):
        self._pulse_m = car.pulse_m
        self._late = noise.uniform(0.0, 0.06, size=(2, car.pulses_per_revolution))
        self._places = [0, 0]
        self._waiting: deque = deque()
        self._last_ns = 0

    def pass_by(self, pulses, speed_mps, now_ns):
        for pulse in pulses:
            step = -1 if pulse.direction == BACKWARD else 1
            self._places[pulse.side] += step
            late = self._late[pulse.side][self._places[pulse.side] % self._late.shape[1]]
            late_s = min(0.05, late * self._pulse_m / max(1e-3, abs(speed_mps)))
            at_ns = pulse.at_ns + int(late_s * NS_PER_S)
            self._waiting.append((max(at_ns, self._last_ns), pulse.side, pulse.direction))
            self._last_ns = self._waiting[-1][0]
        while self._waiting and self._waiting[0][0] <= now_ns:
            yield self._waiting.popleft()
