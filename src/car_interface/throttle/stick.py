"""Turn a gamepad's throttle stick into the human's request.

``shaped`` applies dead band and expo; ``Scale`` is the factor of driving that two buttons change while the car drives.
"""
from __future__ import annotations

from dataclasses import dataclass

from car_interface.common import declared


@dataclass(frozen=True)
class StickConfig:
    """Configure how a human's throttle stick is read.

    The sticks of usual gamepads rest within 0.03. With a scale of 0.3 the car is about as fast as a running person.
    Beyond the dead band the request begins at 0, without a step.
    """

    deadband: float = declared.number("tele_throt_deadband", 0.05, "requests this near to 0 mean 0", low=0, high=0.5)
    expo: float = declared.number(
        "expo", 0.0, "0 = linear, 1 = the cube of the stick: finest around its middle", low=0, high=1)
    human_scale: float = declared.number(
        "human_scale", 0.3, "scales the human's driving, forward and backward, at the start", low=0, high=1)
    brake_scale: float = declared.number("brake_scale", 1.0, "scales the human's brake", low=0, high=1)
    scale_step: float = declared.number(
        "scale_step", 0.1, "by how much a press of a button changes `human_scale`; 0 = not at all", low=0, high=1)


def shaped(request: float, deadband: float, expo: float) -> float:
    """Return a stick's request, −1..1: 0 within the dead band, ±1 at the ends. A finite request is clamped to these."""
    magnitude = min(1.0, abs(request))
    if magnitude <= deadband:
        return 0.0
    beyond = (magnitude - deadband) / (1.0 - deadband)
    beyond = (1.0 - expo) * beyond + expo * beyond ** 3
    return beyond if request > 0 else -beyond


class Scale:
    """Keep the scale of driving. A press changes it; a button that is held at the first message doesn't."""

    def __init__(self, config: StickConfig):
        self.value = config.human_scale
        self._step = config.scale_step
        self._low = min(config.scale_step, config.human_scale)  # not 0: the stick would do nothing
        self._pressed: int | None = None  # None: nothing was received

    def update(self, pressed: int) -> bool:
        """Take the buttons: 1 = more, −1 = less, 0 = none is pressed. Return whether the scale has changed."""
        before, self._pressed = self._pressed, pressed
        if before is None or pressed == before or pressed not in (-1, 1):
            return False
        value = max(self._low, min(1.0, round(self.value + pressed * self._step, 6)))
        has_changed, self.value = value != self.value, value
        return has_changed
