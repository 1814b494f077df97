"""A virtual car under the speed control, the converter, throttle_arb's rules and the servo board, in virtual time.

Its speed is what its Teensy's reports make of it, byte by byte, as on a real car: late, and coarse at a crawl.
"""
from __future__ import annotations

import math
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

from many_drives import MS, THROTTLE, S
from virtual_escs import xl5

from car_interface.common.sources import TELEOP
from car_interface.interlock.motion_interlock import InterlockConfig
from car_interface.planner.messages import PlannerRequest
from car_interface.sim.teensy_firmware import FirmwareConfig, TeensyFirmware
from car_interface.sim.vehicle import DriveTrainConfig, Vehicle, VehicleConfig
from car_interface.teensy.link.framing import SHIPPED, FrameDecoder
from car_interface.teensy.link.pinging import Pinger
from car_interface.teensy.link.protocol import Pong, WheelStatus, decode
from car_interface.teensy.sensing.measurements import Measurements
from car_interface.throttle.arbiter import ThrottleArbiterConfig
from car_interface.throttle.board_watch import Trouble
from car_interface.throttle.control import ThrottleControl
from car_interface.throttle.converter import Converter, ConverterConfig
from car_interface.throttle.esc_config import EscConfig
from car_interface.throttle.speed_control import STOP, SpeedControl
from car_interface.throttle.value_map import ValueMap, load_value_map

STEP_NS, TICK_NS, ODOM_NS = 4 * MS, 20 * MS, 20 * MS
START_NS = 1000 * S
MAP = load_value_map(str(Path(__file__).resolve().parents[3] / "config" / "value_map.csv"))
NO_STEERING = -1
XL5 = xl5()
SpeedRequest = partial(PlannerRequest, None)  # of a speed alone


def wrong_map(of_acceleration=1.0, of_value=1.0):
    """The shipped map with its accelerations, or the part of each value that drives, wrong by a ratio."""
    values = [value * of_value for value in MAP.values]
    table = [[MAP.acceleration_at(value, velocity) * of_acceleration for velocity in MAP.velocities]
             for value in MAP.values]
    return ValueMap(values, MAP.velocities, table)


class Sample(NamedTuple):
    at_s: float
    speed_mps: float  # the true one
    acceleration_mps2: float  # commanded
    granted: float
    esc: str


class SpeedRig:
    """One car on a straight road, its deadman held for the planner.

    Args:
        slope: metres up for each metre ahead.
        thrust: ratio of the motor's thrust to that of the car that the shipped map is of.
        value_map: the converter's.
        lag_s: of the motor: 0.02 to 0.15.
        esc, profile, is_measured: the ESC, and what the configuration says of it.
        sees_pulses: odometry is what its Teensy's reports make of the wheels' pulses; else the true speed, at once.
    """

    def __init__(self, slope=0.0, thrust=1.0, value_map=MAP, lag_s=0.05, esc=XL5, profile="brake_then_reverse",
                 is_measured=False, sees_pulses=True):
        drive = DriveTrainConfig(lag_s=lag_s)
        drive = replace(drive, forward_mps2=drive.forward_mps2 * thrust, reverse_mps2=drive.reverse_mps2 * thrust)
        self.car = Vehicle(VehicleConfig(drive=drive, slope=slope, esc=esc), START_NS)
        self.control = SpeedControl()
        self.converter = Converter(ConverterConfig(value_map=value_map))
        self.throttle = ThrottleControl(
            THROTTLE, ThrottleArbiterConfig(interlock=InterlockConfig(grant_at_start=True)),
            EscConfig(profile=profile, profile_measured=is_measured))
        self.request: PlannerRequest | None = STOP
        self.human = False
        self._sees_pulses = sees_pulses
        self.is_deaf = False  # odometry doesn't arrive
        self.samples: list[Sample] = []
        self.commands: list = []
        self._teensy = TeensyFirmware(FirmwareConfig(), power_up_ns=START_NS)
        self._decoder, self._pinger = FrameDecoder(), Pinger(S, SHIPPED, START_NS)
        self._measurements = Measurements()
        self._motion = None
        self._odom_due_ns = self._tick_due_ns = START_NS
        self._duty = 4915
        self.run(2.0)  # the ESC is armed
        self.human = True
        self.samples.clear()

    def run(self, seconds, request=None):
        """Drive on; the samples of that time."""
        if request is not None:
            self.request = request
        first, end_ns = len(self.samples), self.car.time_ns + round(seconds * S)
        while self.car.time_ns < end_ns:
            now_ns = self.car.time_ns
            if now_ns >= self._tick_due_ns:
                self._tick_due_ns += TICK_NS
                self._tick(now_ns)
            for pulse in self.car.step(STEP_NS, NO_STEERING, self._duty):
                self._teensy.wheel_pulse(pulse.side, pulse.direction, pulse.at_ns)
            self._measure(self.car.time_ns)
        return self.samples[first:]

    def _measure(self, now_ns):
        if now_ns >= self._pinger.due_ns:
            self._teensy.receive(self._pinger.ping(now_ns // MS % 2 ** 32, now_ns), now_ns)
        for body in self._decoder.feed(self._teensy.transmit(now_ns)):
            record = decode(body)
            if isinstance(record, WheelStatus):
                self._motion = self._measurements.wheels(record, now_ns) or self._motion
            elif isinstance(record, Pong):
                self._measurements.pong(record, self._pinger.pong(record.timestamp1, now_ns), now_ns)
        if self._motion is not None and now_ns >= self._odom_due_ns:
            odom_mps, age_ns, self._motion = self._motion.motion.speed_mps, now_ns - self._motion.stamp.time_ns, None
            self._odom_due_ns = now_ns + ODOM_NS
            if not self._sees_pulses:
                odom_mps, age_ns = self.car.speed_mps, MS
            if not self.is_deaf:
                for update in (self.control.speed.update, self.converter.odometry.update,
                               self.throttle.update_odometry):
                    update(odom_mps, now_ns, age_ns)

    def _tick(self, now_ns):
        command = self.control.step(self.request, now_ns)
        conversion = self.converter.convert(command.acceleration_mps2, now_ns)
        arbiter = self.throttle.arbiter
        arbiter.update_converter(None if conversion.value is not None
                                 else Trouble(conversion.cause, conversion.reason))
        speed_mps = 0.0 if self.request is None else self.request.speed_mps
        arbiter.update_planner_state(command.gear, None, now_ns, speed_mps)
        if conversion.value is not None:
            self.throttle.update_planner(conversion.value, now_ns)
        arbiter.update_human(self.human, now_ns)
        arbiter.update_steering(TELEOP, "", now_ns)
        arbiter.update_teleop(0.0, now_ns)
        decision = self.throttle.decide(now_ns)
        self._duty = (decision.duty + 8) // 16 * 16  # the board counts to 4096
        self.throttle.update_output([-1, self._duty, *[-1] * 14], now_ns)
        self.control.update_throttle(decision.arbitration.source, decision.arbitration.asked, decision.esc.fraction,
                                     decision.esc.cause, now_ns)
        self.commands.append(command)
        self.samples.append(Sample((self.car.time_ns - START_NS) / S, self.car.speed_mps, command.acceleration_mps2,
                                   decision.esc.fraction, decision.esc.state))


def overshoot(samples, target_mps):
    return max(sample.speed_mps for sample in samples) / target_mps - 1.0


def settled_s(samples, target_mps, within=0.05):
    """How long it took until the speed stayed within a ratio of the target; inf = it didn't."""
    late = [sample.at_s for sample in samples if abs(sample.speed_mps - target_mps) > within * target_mps]
    if late and late[-1] == samples[-1].at_s:
        return math.inf
    return (late[-1] if late else samples[0].at_s) - samples[0].at_s


def mean_error(samples, target_mps):
    return sum(sample.speed_mps for sample in samples) / len(samples) / target_mps - 1.0
