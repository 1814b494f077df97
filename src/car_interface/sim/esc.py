"""Models speed controllers (ESCs) of hobby cars, whose reaction to a pulse depends on the pulses before.

Consumes the duty of a servo output and the speed of the wheels, and answers what the motor does: coast, drive forward,
brake, or drive backward. One configuration is one device.

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

from dataclasses import dataclass
from typing import NamedTuple

from car_interface.common.units import NS_PER_MS, NS_PER_S

# Kinds, by their reaction to a pulse behind neutral.
BRAKE_THEN_REVERSE = "brake_then_reverse"  # after forward it brakes; reverse takes neutral and a second pull
BRAKE_BECOMES_REVERSE = "brake_becomes_reverse"  # it brakes, and a brake that is still held drives backward
DIRECT_REVERSE = "direct_reverse"  # it drives backward at once, at any speed of the car
FORWARD_ONLY = "forward_only"  # it only brakes
KINDS = (BRAKE_THEN_REVERSE, BRAKE_BECOMES_REVERSE, DIRECT_REVERSE, FORWARD_ONLY)

# Reactions of BRAKE_THEN_REVERSE to a second pull while the car still rolls forward.
REVERSES, BRAKES, BRAKES_AND_TURNS = "reverses", "brakes", "brakes and turns at standstill"

COAST, FORWARD, BRAKE, BACKWARD = "coast", "forward", "brake", "backward"

PULSE_PERIOD_NS = 20 * NS_PER_MS  # it looks at one pulse each 20 ms
# 0.5 and 2.5 ms of a period of 20 ms that is 65536 long: servos and ESCs ignore other lengths.
SHORTEST_PULSE, LONGEST_PULSE = 1638, 8192
STANDS_MPS = 0.05  # slower wheels stand, to the ESC


class MotorState(NamedTuple):
    mode: str  # COAST, FORWARD, BRAKE or BACKWARD
    level: float  # 0..1


@dataclass(frozen=True)
class VirtualEscConfig:
    """One ESC."""

    kind: str = BRAKE_THEN_REVERSE  # one of KINDS
    neutral_duty: float = 4915.0  # these three are the pulses it was calibrated to
    full_forward_duty: float = 6554.0
    full_reverse_duty: float = 3277.0
    forward_band_duty: float = 80.0  # within this distance of neutral it does nothing, likewise behind it
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
    rearms: bool = True  # a loss of pulses must be followed by neutral for ``arming_s``, as power-up


def is_pulse(duty: int) -> bool:
    """Return whether a servo or an ESC takes ``duty`` for a pulse; 0 (off), -1 (never set) and 65535 (on) are none."""
    return SHORTEST_PULSE <= duty <= LONGEST_PULSE


def throttle_of(duty: float, full_reverse: float, neutral: float, full_forward: float, reverse_band: float,
                forward_band: float) -> float:
    """Return a pulse's command: −1 to 1 from end to end, 0 within the dead band; all arguments in duty."""
    beyond = duty - neutral
    if beyond > forward_band:
        return min(1.0, (beyond - forward_band) / (full_forward - neutral - forward_band))
    if beyond < -reverse_band:
        return max(-1.0, (beyond + reverse_band) / (neutral - full_reverse - reverse_band))
    return 0.0


class VirtualEsc:
    """One ESC under power.

    Args:
        phase_ns: when, within the period, it sees a pulse.
    """

    # The memory of BRAKE_THEN_REVERSE.
    _DROVE, _BRAKED, _READY, _REVERSED = range(4)

    def __init__(self, config: VirtualEscConfig = VirtualEscConfig(), phase_ns: int = 0):
        self.config = config
        self._next_ns = phase_ns
        self._last_pulse_ns: int | None = None
        self._neutral_since_ns: int | None = None
        self._brake_since_ns: int | None = None
        self._stood_since_ns: int | None = None
        self._held = False  # this pull was answered with a brake, and is still held
        self._armed = False
        self._memory = self._DROVE
        self._motor = MotorState(COAST, 0.0)

    def step(self, duty: float | None, now_ns: int, wheel_mps: float) -> MotorState:
        """Return the state of the motor from now on.

        Args:
            duty: of the output; ``None``, or not a servo's pulse = none.
            now_ns: never before an earlier call's.
            wheel_mps: of the driven wheels, backward negative.
        """
        if now_ns < self._next_ns:
            return self._motor
        while self._next_ns <= now_ns:
            self._next_ns += PULSE_PERIOD_NS
        if duty is None or not is_pulse(duty):
            self._miss_pulse(now_ns)
        else:
            self._last_pulse_ns = now_ns
            self._motor = self._answer(self._command(duty), now_ns, wheel_mps)
        return self._motor

    def _command(self, duty):
        config = self.config
        return throttle_of(duty, config.full_reverse_duty, config.neutral_duty, config.full_forward_duty,
                           config.reverse_band_duty, config.forward_band_duty)

    def _miss_pulse(self, now_ns):
        if self._last_pulse_ns is None or now_ns - self._last_pulse_ns < self.config.cutoff_s * NS_PER_S:
            return
        self._motor = MotorState(COAST, 0.0)
        self._neutral_since_ns = self._brake_since_ns = None
        if self.config.rearms:
            self._armed = False

    def _answer(self, command, now_ns, wheel_mps):
        config = self.config
        if abs(wheel_mps) >= STANDS_MPS:
            self._stood_since_ns = None
        elif self._stood_since_ns is None:
            self._stood_since_ns = now_ns
        if command:
            self._neutral_since_ns = None
        elif self._neutral_since_ns is None:
            self._neutral_since_ns = now_ns
        if not self._armed:
            self._arm(now_ns)
            return MotorState(COAST, 0.0)
        if command > 0:
            self._memory, self._brake_since_ns, self._held = self._DROVE, None, False
            return MotorState(FORWARD, command)
        if not command:
            self._remember_neutral(now_ns)
            return MotorState(BRAKE, config.drag_brake) if config.drag_brake else MotorState(COAST, 0.0)
        return MotorState(BACKWARD if self._reverses(now_ns, wheel_mps) else BRAKE, -command)

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
        if kind == FORWARD_ONLY:
            return False
        if kind == DIRECT_REVERSE:
            return True
        stands = self._stood_since_ns is not None
        if kind == BRAKE_BECOMES_REVERSE:
            turned = stands and now_ns - self._stood_since_ns >= self.config.turn_s * NS_PER_S
            return turned or self._motor.mode == BACKWARD or wheel_mps <= -STANDS_MPS
        return self._double_click(now_ns, stands or wheel_mps < 0)

    def _double_click(self, now_ns, stands):
        if self._memory == self._REVERSED:
            return True
        if self._memory == self._READY:
            if stands and not self._held or self.config.second_pull == REVERSES:
                self._memory = self._REVERSED
                return True
            self._held = True  # it brakes first
            if stands and self.config.second_pull == BRAKES_AND_TURNS:
                self._memory = self._REVERSED
                return True
            return False
        if self._brake_since_ns is None:
            self._brake_since_ns = now_ns
        if now_ns - self._brake_since_ns >= self.config.brake_seen_s * NS_PER_S:
            self._memory = self._BRAKED
        return False
