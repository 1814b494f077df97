"""When the sonars should fire mostly ahead: while the car drives forward.

Pure: the measured speed and ``now_ns`` in. With obstacle_stop the speed that is allowed grows with the number of echoes
a second from ahead; those from behind are of use to a car that stands or reverses.
"""
from __future__ import annotations

from car_interface.common.units import NS_PER_S

FORWARD_MPS, BACKWARD_MPS = 0.15, -0.1
STAYS_NS = NS_PER_S  # after the car came to a standstill: a short stop changes nothing


class SonarAim:
    """Follows one car's speed.

    Attributes:
        is_ahead: whether the sonars should fire mostly ahead.
    """

    def __init__(self):
        self.is_ahead = False
        self._forward_ns = 0

    def update(self, speed_mps: float, now_ns: int) -> None:
        """The measured speed, forward positive."""
        if speed_mps >= FORWARD_MPS:
            self.is_ahead, self._forward_ns = True, now_ns
        elif speed_mps <= BACKWARD_MPS or now_ns - self._forward_ns > STAYS_NS:
            self.is_ahead = False
