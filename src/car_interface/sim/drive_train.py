"""Models the virtual car's drive train: speed controllers (ESCs) of hobby cars, and the motor behind them.

From the duty of a servo output and the speed of the wheels to the car's acceleration. An ESC's reaction to a pulse
depends on the pulses before; one configuration is one device. Pure. The numbers of motor, brakes and drag are the truth
that a value map only approximates.

Sources on real ESCs:

* Traxxas XL-5 and VXL (owner's manuals; pictures of the same in PX4's thread 7614): three profiles, Sport (forward,
  brake, reverse), Race (forward, brake) and Training (as Sport, at half power). Pulling back while it drives forward
  brakes; reverse takes neutral and a second pull. The EZ-Set button calibrates neutral and both ends, and the LED shows
  the profile. Neither the time that neutral must last (dwell) nor the dead band is published. BARC's authors drove
  one with 125 ms of brake and 125 ms of neutral and found no less that worked (their pull request 6: neutral from about
  1450 to 1510 µs, forward from any state at once).
* Hobbywing's car ESCs and those built like them (manual of Force RC's Epidemic, "Running Mode"): "Forward with brake",
  "Forward/Reverse with brake" by double-click, where the second pull reverses only once the motor stands, and "Forward
  and Reverse" for rock crawlers, where the car brakes and reverses by itself. Drag brake 0 to 100 %.
* Which ESCs forget that they drove forward (``forget_s``): of two families, Tamiya's never do, cheap ones and HPI's
  SC-15WP take the first pull for reverse after some seconds of neutral (rc-light-controller's ESC types).
* How long other ESCs need: ArduPilot's author 0.3 s (pull request 30188), its parameter 0.1 to 1 s.
* Nobody publishes these, and so they are varied: dwell, how long the brake must be seen, the exact dead band, the
  arming time, what a second pull does while the car still rolls.
"""
from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

from car_interface.common import declared
from car_interface.common.units import NS_PER_MS, NS_PER_S

# Kinds, by their reaction to a pulse behind neutral.
BRAKE_THEN_REVERSE = "brake_then_reverse"  # after forward it brakes; reverse takes neutral and a second pull
BRAKE_BECOMES_REVERSE = "brake_becomes_reverse"  # it brakes, and a brake that is still held drives backward
DIRECT_REVERSE = "direct_reverse"  # it drives backward at once, at any speed of the car
FORWARD_ONLY = "forward_only"  # it only brakes
KINDS = (BRAKE_THEN_REVERSE, BRAKE_BECOMES_REVERSE, DIRECT_REVERSE, FORWARD_ONLY)

# Reactions of BRAKE_THEN_REVERSE to a second pull while the car still rolls forward.
REVERSES, BRAKES, BRAKES_AND_TURNS = "reverses", "brakes", "brakes and turns at standstill"

PULSE_PERIOD_NS = 20 * NS_PER_MS  # it looks at one pulse each 20 ms
# 0.5 and 2.5 ms of a period of 20 ms that is 65536 long: servos and ESCs ignore other lengths.
SHORTEST_PULSE, LONGEST_PULSE = 1638, 8192
STANDS_MPS = 0.05  # slower wheels stand, to the ESC
SAG_S = 300.0  # how long a battery takes to empty
TRUE = "of the full duty, before drag; forward and backward at standstill"  # the meaning of three parameters


class MotorState(NamedTuple):
    push: float  # −1 (full thrust backward) to 1
    brake: float  # 0..1


COASTS = MotorState(0.0, 0.0)


@dataclass(frozen=True)
class Pulses:
    """The pulses that an ESC is calibrated to, in duty."""

    full_reverse_duty: float = 3277.0  # 1.0, 1.5 and 2.0 ms at 50 Hz
    neutral_duty: float = 4915.0
    full_forward_duty: float = 6554.0
    forward_band_duty: float = 25.0  # within this distance of neutral it does nothing, likewise behind it
    reverse_band_duty: float = 25.0

    def throttle(self, duty: float) -> float:
        """Return a pulse's command: −1 to 1 from end to end, 0 within the dead band and for what is no pulse."""
        beyond = duty - self.neutral_duty
        if is_pulse(duty) and beyond > self.forward_band_duty:
            return min(1.0, (beyond - self.forward_band_duty)
                       / (self.full_forward_duty - self.neutral_duty - self.forward_band_duty))
        if is_pulse(duty) and beyond < -self.reverse_band_duty:
            return max(-1.0, (beyond + self.reverse_band_duty)
                       / (self.neutral_duty - self.full_reverse_duty - self.reverse_band_duty))
        return 0.0


def is_pulse(duty: float) -> bool:
    """Return whether a servo or an ESC takes ``duty`` for a pulse; 0 (off), -1 (never set) and 65535 (on) are none."""
    return SHORTEST_PULSE <= duty <= LONGEST_PULSE


@dataclass(frozen=True)
class VirtualEscConfig(Pulses):
    """One ESC."""

    kind: str = BRAKE_THEN_REVERSE  # one of KINDS
    forward_band_duty: float = 80.0
    reverse_band_duty: float = 80.0
    dwell_s: float = 0.2  # neutral of at least this, after a brake, makes the next pull reverse
    brake_seen_s: float = 0.04  # a shorter brake is ignored
    # After this much neutral it forgets that it drove forward, and the first pull is reverse; 0 = never.
    forget_s: float = 0.0
    starts_ready: bool = False  # after arming the first pull is reverse
    second_pull: str = REVERSES  # REVERSES, BRAKES or BRAKES_AND_TURNS
    turn_s: float = 0.1  # a crawler's wheels must stand this long before its brake becomes reverse
    drag_brake: float = 0.0  # the brake in neutral, 0..1
    arming_s: float = 0.5  # neutral of this length after power-up, or after a loss of pulses, before the motor runs
    cutoff_s: float = 0.1  # the motor stops after this long without a pulse


class VirtualEsc:
    """One ESC under power.

    Args:
        phase_ns: when, within the period, it sees a pulse.
    """

    # The memory of BRAKE_THEN_REVERSE.
    _DROVE, _BRAKED, _READY, _REVERSED = range(4)

    def __init__(self, config: VirtualEscConfig = VirtualEscConfig(), phase_ns: int = 0):
        self.config = config
        self._next_ns = self._last_pulse_ns = phase_ns
        self._neutral_since_ns: int | None = None
        self._brake_since_ns: int | None = None
        self._stood_since_ns: int | None = None
        self._held = False  # this pull was answered with a brake, and is still held
        self._armed = False
        self._memory = self._DROVE
        self._motor = COASTS

    def step(self, duty: float, now_ns: int, wheel_mps: float) -> MotorState:
        """Return the state of the motor from now on.

        Args:
            duty: of the output; not a servo's pulse = none.
            now_ns: never before an earlier call's.
            wheel_mps: of the driven wheels, backward negative.
        """
        if now_ns < self._next_ns:
            return self._motor
        while self._next_ns <= now_ns:
            self._next_ns += PULSE_PERIOD_NS
        if is_pulse(duty):
            self._last_pulse_ns = now_ns
            self._motor = self._answer(self.config.throttle(duty), now_ns, wheel_mps)
        elif now_ns - self._last_pulse_ns >= self.config.cutoff_s * NS_PER_S:
            self._motor = COASTS
            self._neutral_since_ns = self._brake_since_ns = None
            self._armed = False
        return self._motor

    def _answer(self, command, now_ns, wheel_mps):
        self._stood_since_ns = _since(self._stood_since_ns, abs(wheel_mps) < STANDS_MPS, now_ns)
        self._neutral_since_ns = _since(self._neutral_since_ns, not command, now_ns)
        if not self._armed:
            self._arm(now_ns)
            return COASTS
        if command > 0:
            self._memory, self._brake_since_ns, self._held = self._DROVE, None, False
            return MotorState(command, 0.0)
        if not command:
            self._remember_neutral(now_ns)
            return MotorState(0.0, self.config.drag_brake)
        return MotorState(command, 0.0) if self._reverses(now_ns, wheel_mps) else MotorState(0.0, -command)

    def _arm(self, now_ns):
        since_ns = self._neutral_since_ns
        if since_ns is not None and now_ns - since_ns >= self.config.arming_s * NS_PER_S:
            self._armed = True
            self._memory = self._READY if self.config.starts_ready else self._DROVE

    def _remember_neutral(self, now_ns):
        self._held = False
        neutral_ns = now_ns - self._neutral_since_ns
        if self._memory == self._BRAKED and neutral_ns >= self.config.dwell_s * NS_PER_S:
            self._memory = self._READY
        if self._memory == self._DROVE and self.config.forget_s and neutral_ns >= self.config.forget_s * NS_PER_S:
            self._memory = self._READY
        self._brake_since_ns = None

    def _reverses(self, now_ns, wheel_mps):
        """Return whether a pull drives backward; False = it brakes."""
        kind = self.config.kind
        if kind in (FORWARD_ONLY, DIRECT_REVERSE):
            return kind == DIRECT_REVERSE
        stands = self._stood_since_ns is not None
        if kind == BRAKE_BECOMES_REVERSE:
            turned = stands and now_ns - self._stood_since_ns >= self.config.turn_s * NS_PER_S
            return turned or self._motor.push < 0 or wheel_mps <= -STANDS_MPS
        return self._double_click(now_ns, stands or wheel_mps < 0)

    def _double_click(self, now_ns, stands):
        if self._memory == self._READY:
            second_pull = self.config.second_pull
            if second_pull == REVERSES or stands and (second_pull == BRAKES_AND_TURNS or not self._held):
                self._memory = self._REVERSED
            else:
                self._held = True  # it brakes first
        if self._memory in (self._READY, self._REVERSED):
            return self._memory == self._REVERSED
        self._brake_since_ns = _since(self._brake_since_ns, True, now_ns)
        if now_ns - self._brake_since_ns >= self.config.brake_seen_s * NS_PER_S:
            self._memory = self._BRAKED
        return False


def _since(before_ns, holds, now_ns):
    """Return since when something holds, if it does."""
    if not holds:
        return None
    return now_ns if before_ns is None else before_ns


@dataclass(frozen=True)
class DriveTrainConfig(Pulses):
    """The drive train, from the ESC's duty to the car's acceleration."""

    forward_mps2: float = declared.number("forward_acceleration", 5.6, TRUE, "m/s²", above=0.0, high=100)
    reverse_mps2: float = declared.number("reverse_acceleration", 3.6, TRUE, "m/s²", above=0.0, high=100)
    brake_mps2: float = declared.number("brake_deceleration", 7.0, TRUE, "m/s²", above=0.0, high=100)
    thrust_halves_mps: float = 9.4  # at this speed the motor has half its thrust
    # Resistance at speed v is the sum of these, the second times v, the third times v². With the defaults full throttle
    # ends at 14 m/s.
    drag_mps2: float = 0.35
    drag_per_s: float = 0.08
    drag_per_m: float = 0.004
    # Ratio of the thrust that is lost while the battery empties in SAG_S, from half of it above the stated thrust to
    # half of it below; it stays as it is after that. Brakes don't need the battery.
    sag: float = 0.0
    lag_s: float = 0.0  # time constant with which the motor's thrust and brake follow the ESC

    def thrust(self, elapsed_s: float) -> float:
        """Return the ratio of the stated thrust that the battery gives at a time after the start."""
        return 1.0 + self.sag * (0.5 - min(1.0, elapsed_s / SAG_S))


def following(motor: MotorState, wanted: MotorState, dt_s: float, lag_s: float) -> MotorState:
    """Return the motor's state after ``dt_s`` in which the ESC wants another."""
    share = -math.expm1(-dt_s / lag_s) if lag_s else 1.0
    return MotorState(*(now + (then - now) * share for now, then in zip(motor, wanted)))


def motor_acceleration_mps2(motor: MotorState, speed_mps: float, drive: DriveTrainConfig, thrust: float = 1.0,
                            downhill_mps2: float = 0.0) -> float:
    """Return the car's acceleration by its motor; the other arguments as of ``true_acceleration_mps2``."""
    (push, brake), speed = motor, abs(speed_mps)
    resistance_mps2 = drive.drag_mps2 + speed * (drive.drag_per_s + speed * drive.drag_per_m) + brake * drive.brake_mps2
    push_mps2 = downhill_mps2
    if push:
        way = math.copysign(1.0, push)
        full_mps2 = abs(push) * thrust * (drive.forward_mps2 if way > 0 else drive.reverse_mps2)
        # A motor's own voltage opposes the ESC's, and adds to it where the motor turns against its drive.
        own_voltage = 1.0 + speed / drive.thrust_halves_mps
        push_mps2 += way * full_mps2 * (own_voltage if way * speed_mps < 0.0 else 1.0 / own_voltage)
    if not speed_mps and abs(push_mps2) <= resistance_mps2:
        return 0.0
    return push_mps2 - math.copysign(resistance_mps2, speed_mps or push_mps2)


def true_acceleration_mps2(esc_duty: int, speed_mps: float, drive: DriveTrainConfig = DriveTrainConfig(),
                           thrust: float = 1.0, downhill_mps2: float = 0.0) -> float:
    """Return the car's acceleration without an ESC's memory, which a value map for this car approximates.

    A duty against the car's motion brakes. At standstill reverse drives backward (no double tap), and a push below the
    static drag moves nothing.

    Args:
        speed_mps: backward negative.
        thrust: the ratio of its thrust that the battery gives.
        downhill_mps2: the part of the slope, forward positive; 0 on level ground.
    """
    command = drive.throttle(esc_duty)
    motor = MotorState(0.0, abs(command)) if command * speed_mps < 0.0 else MotorState(command, 0.0)
    return motor_acceleration_mps2(motor, speed_mps, drive, thrust, downhill_mps2)
