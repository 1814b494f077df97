"""ESCs as people's reports describe them: what the motor does with a pulse, and with the pulses before it."""
from __future__ import annotations

from typing import NamedTuple

FREE, FORWARD, BRAKE, BACKWARD = "FREE", "FORWARD", "BRAKE", "BACKWARD"
BTR, BBR, DIRECT, FORWARD_ONLY = "brake_then_reverse", "brake_becomes_reverse", "direct_reverse", "forward_only"
KINDS = (BTR, BBR, DIRECT, FORWARD_ONLY)
REFUSES, OBEYS, RELEARNS = "refuses", "obeys", "relearns"  # what it does when it is powered under a pulse
CUT_NOTHING, CUT_FORWARD, CUT_ALL = 0, 1, 2  # by low voltage
RELEARNED_MAX = 0.4  # a pulse farther from neutral is no neutral for any ESC

# What the next pull behind neutral is, for an ESC that brakes first.
_FRESH, _BRAKES, _BRAKED, _REVERSES, _BACKWARD = range(5)


class EscSpec(NamedTuple):
    """One ESC.

    Attributes:
        dwell_s: neutral of this length between two pulls makes the second one reverse.
        dead_band: of the pulse, as a fraction of the way from neutral to an end.
        forward_s: a push forward of this length makes the next pull a brake.
        pull_s: a pull of this length counts as the first one.
        senses_speed: a second pull brakes while the wheels roll forward faster than 0.5 m/s.
        forgets_s: after so long in neutral the first pull is reverse; 0 = never.
        fresh_reverses: so is the first pull after power-up.
        brakes_backward: a push brakes while the wheels roll backward.
        hold_s, roll_mps: an ESC whose brake becomes reverse waits for so long below this speed.
        drag_brake: share of the brake in neutral.
        arm_s: neutral of this length arms it after power-up.
    """

    kind: str
    dwell_s: float = 0.2
    dead_band: float = 0.06
    forward_s: float = 0.1
    pull_s: float = 0.0
    senses_speed: bool = False
    forgets_s: float = 0.0
    fresh_reverses: bool = True
    brakes_backward: bool = True
    hold_s: float = 0.1
    roll_mps: float = 0.05
    drag_brake: float = 0.0
    arm_s: float = 0.2
    power_up: str = REFUSES


class EscModel:
    """What the motor does.

    Attributes:
        motor, level: FREE, FORWARD, BRAKE or BACKWARD, and how strongly, 0..1.
        cut: what the low voltage takes away.
        is_on: whether it has power.
    """

    def __init__(self, spec: EscSpec):
        self.spec = spec
        self.motor, self.level = FREE, 0.0
        self.cut, self.is_on = CUT_NOTHING, True
        self._power_up()

    def _power_up(self):
        self._next, self._is_armed, self._neutral = _FRESH, self.spec.power_up == OBEYS, None
        self._neutral_s = self._pull_s = self._forward_s = self._stand_s = 0.0

    @property
    def has_wrong_neutral(self) -> bool:
        """Whether it took a push or a pull for neutral when it was powered."""
        return abs(self._neutral or 0.0) > self.spec.dead_band

    @property
    def brakes_next(self) -> bool:
        """Whether it was pushed forward for long enough."""
        return self._next == _BRAKES

    def switch(self, is_on: bool) -> None:
        if is_on and not self.is_on:
            self._power_up()
        self.is_on = is_on

    def step(self, pulse: float, wheel_mps: float, dt_s: float) -> None:
        """Take the pulse, −1..1 from end to end, for ``dt_s`` at the wheels' speed."""
        self.motor, self.level = FREE, 0.0
        if not self.is_on:
            return
        if self._neutral is None:
            learns = self.spec.power_up == RELEARNS and abs(pulse) < RELEARNED_MAX
            self._neutral = pulse if learns else 0.0
        pulse -= self._neutral
        band = self.spec.dead_band
        if abs(pulse) <= band:
            self._rest(dt_s)
            return
        if not self._is_armed:
            self._neutral_s = 0.0
            return
        self.level = min(1.0, (abs(pulse) - band) / (1.0 - band))
        self.motor = self._pushed(wheel_mps, dt_s) if pulse > 0 else self._pulled(wheel_mps, dt_s)
        if self.cut == CUT_ALL or self.cut == CUT_FORWARD and self.motor == FORWARD:
            self.motor, self.level = FREE, 0.0

    def _rest(self, dt_s):
        spec = self.spec
        self._neutral_s += dt_s
        self._forward_s = self._stand_s = 0.0
        self._is_armed = self._is_armed or self._neutral_s >= spec.arm_s
        if self._next == _BRAKED:
            if self._pull_s < spec.pull_s:
                self._next = _BRAKES
            elif self._neutral_s >= spec.dwell_s:
                self._next = _REVERSES
        elif self._next == _BRAKES and 0 < spec.forgets_s <= self._neutral_s or self._next == _BACKWARD:
            self._next = _REVERSES

    def _pushed(self, wheel_mps, dt_s):
        self._neutral_s = self._pull_s = self._stand_s = 0.0
        if self.spec.brakes_backward and wheel_mps < -0.3:
            return BRAKE
        self._forward_s += dt_s
        if self._forward_s >= self.spec.forward_s:
            self._next = _BRAKES
        return FORWARD

    def _pulled(self, wheel_mps, dt_s):
        kind = self.spec.kind
        if kind == BTR:
            motor = self._pulled_twice(wheel_mps)
        elif kind == FORWARD_ONLY:
            motor = BRAKE
        elif self._next == _BACKWARD:
            motor = BACKWARD
        else:
            # An ESC that reverses at once slows a car that rolls forward before it drives it backward.
            rolls = wheel_mps > (self.spec.roll_mps if kind == BBR else 0.02)
            self._stand_s = 0.0 if rolls else self._stand_s + dt_s
            motor = BACKWARD if self._stand_s > (self.spec.hold_s if kind == BBR else 0.0) else BRAKE
        self._pull_s = dt_s if self._neutral_s else self._pull_s + dt_s
        self._neutral_s = self._forward_s = 0.0
        if motor == BACKWARD:
            self._next = _BACKWARD
        return motor

    def _pulled_twice(self, wheel_mps):
        if self._next in (_BRAKES, _BRAKED) or self._next == _FRESH and not self.spec.fresh_reverses:
            self._next = _BRAKED
            return BRAKE
        if self._next != _BACKWARD and self.spec.senses_speed and wheel_mps > 0.5:
            return BRAKE
        return BACKWARD
