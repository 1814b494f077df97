"""Follows one stick of the gamepad: whether its axis is trusted, and whether the human overrides the planner by it.

Pure: deflections from the center in, each with its arrival. A deflection is −1..1, 0 at the center; a pull is negative.
"""
from __future__ import annotations

from car_interface.common.causes import OVERRIDE_HOLD_S
from car_interface.common.units import NS_PER_S

HOLD_NS = round(OVERRIDE_HOLD_S * NS_PER_S)
# An axis that was off its center at first is trusted once it was at the center for this long. A trigger rests at an
# end: if it is pressed or let go within 1.5 s, it is within a dead band of 0.1 for less.
REST_NS = round(0.15 * NS_PER_S)
# A stick is centered within this part of the dead band, or farther out while it stays within STILL, as a worn stick may
# rest there. A hand that holds a stick moves it by more.
CENTER_RATIO, STILL = 0.5, 0.02


class Stick:
    """One stick's newest deflection, and what follows from the earlier ones.

    Args:
        deadband: of the override. A rest is within it, too.
        brakes: a pull brakes, and is obeyed even where nothing else of the stick is.

    Attributes:
        counts: the axis is trusted, as it was seen at its rest.
        is_off_center: it was off its center when a deadman that gives its actuator to the planner was pressed, and has
            not been centered since.
    """

    def __init__(self, deadband: float, brakes: bool):
        self._deadband, self._brakes = deadband, brakes
        self.deflection = 0.0
        self.distrust()

    def distrust(self) -> None:
        """Forget that the axis was seen at rest: another gamepad may send it, or this one in another mode."""
        self.counts = self.is_off_center = self._is_active = self._was_out = self._is_planners = False
        self._rests_since_ns: int | None = None
        self._anchor, self._centered_since_ns = self.deflection, None

    def update(self, deflection: float, is_planners: bool, is_believable: bool, now_ns: int) -> None:
        """Take a message's deflection.

        Args:
            is_planners: a deadman that gives this actuator to the planner is held.
            is_believable: False = other signs show that the axis belongs to no stick.
        """
        self.deflection = deflection
        is_out = self.is_out
        self._look_for_rest(is_out, is_believable, now_ns)
        self._look_for_center(is_out, now_ns)
        began, self._is_planners = is_planners and not self._is_planners, is_planners
        if not is_planners or began:
            self._is_active, self.is_off_center = False, is_planners and is_out
        elif self._is_centered(now_ns):
            self.is_off_center = False
        if is_planners and (self.is_pulled or is_out and self.counts and not self.is_off_center):
            self._is_active = True
        elif self._has_returned(now_ns):
            self._is_active = False

    @property
    def is_pulled(self) -> bool:
        """Return whether it is pulled beyond the dead band, which brakes."""
        return self._brakes and self.deflection < -self._deadband

    @property
    def is_out(self) -> bool:
        return abs(self.deflection) > self._deadband

    def overrides(self, now_ns: int) -> bool:
        """Return whether the human controls the actuator by it, under a deadman that gives it to the planner."""
        return self._is_active and not self._has_returned(now_ns)

    def override(self) -> float:
        """Return the deflection by which it overrides: 0 on a side that isn't trusted."""
        return self.deflection if self.counts and not self.is_off_center else min(0.0, self.deflection)

    def _look_for_rest(self, is_out, is_believable, now_ns):
        if is_out:
            self._rests_since_ns, self._was_out = None, True
            return
        if self._rests_since_ns is None:
            self._rests_since_ns = now_ns
        rests = not self._was_out or now_ns - self._rests_since_ns >= REST_NS
        self.counts = self.counts or is_believable and rests

    def _look_for_center(self, is_out, now_ns):
        magnitude = abs(self.deflection)
        is_inside = magnitude <= CENTER_RATIO * self._deadband
        if is_out:
            self._centered_since_ns = None
        elif self._centered_since_ns is None or not is_inside and abs(self.deflection - self._anchor) > STILL:
            self._centered_since_ns, self._anchor = now_ns, self.deflection
        self._is_inside = is_inside

    def _is_centered(self, now_ns):
        return self._is_inside or self._has_returned(now_ns)

    def _has_returned(self, now_ns):
        since_ns = self._centered_since_ns
        return since_ns is not None and now_ns - since_ns >= HOLD_NS
