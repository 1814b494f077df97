"""A gamepad's throttle stick → the human's request, and the scale that two buttons change while the car drives."""
from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class StickConfig:
    """How a human's throttle stick is read, named as the ROS parameters.

    Attributes:
        deadband: requests this near to 0 mean 0; beyond, the request begins at 0, without a step. 0.05: the sticks of
            usual gamepads rest within 0.03.
        expo: 0..1, the weight of the cube: 0 = linear, 1 = finest around 0.
        human_scale: scales driving, forward and backward, at the start; 0.3 of an ESC is about a running person.
        brake_scale: scales the brake.
        scale_step: by how much a press of a button changes the scale of driving; 0 = not at all.
    """

    deadband: float = 0.05
    expo: float = 0.0
    human_scale: float = 0.3
    brake_scale: float = 1.0
    scale_step: float = 0.1


def read_stick(params) -> StickConfig:
    """The configuration from ~tele_throt_deadband, ~expo, ~human_scale, ~brake_scale and ~scale_step.

    Raises:
        ConfigError: naming the parameter.
    """
    default = StickConfig()
    return StickConfig(
        deadband=params.number("tele_throt_deadband", default.deadband, low=0, high=0.5),
        expo=params.number("expo", default.expo, low=0, high=1),
        human_scale=params.number("human_scale", default.human_scale, low=0, high=1),
        brake_scale=params.number("brake_scale", default.brake_scale, low=0, high=1),
        scale_step=params.number("scale_step", default.scale_step, low=0, high=1))


def shaped(request: float, deadband: float, expo: float) -> float:
    """The request of a stick, −1..1: 0 within the dead band, ±1 at the ends.

    Args:
        request: finite; clamped to −1..1.
    """
    magnitude = min(1.0, abs(request))
    if magnitude <= deadband:
        return 0.0
    beyond = (magnitude - deadband) / (1.0 - deadband)
    beyond = (1.0 - expo) * beyond + expo * beyond ** 3
    return beyond if request > 0 else -beyond


class Scale:
    """The scale of driving. A button counts when it is pressed: one that is held at the first message doesn't count."""

    def __init__(self, config: StickConfig):
        self.value = config.human_scale
        self._step = config.scale_step
        self._low = min(config.scale_step, config.human_scale)  # never 0, where the stick would do nothing
        self._pressed: int | None = None  # None: nothing was received

    def update(self, pressed: int) -> bool:
        """The buttons: 1 = more, −1 = less, 0 = neither is pressed; whether that changed the scale."""
        before, self._pressed = self._pressed, pressed
        if before is None or pressed == before or pressed not in (-1, 1):
            return False
        value = max(self._low, min(1.0, round(self.value + pressed * self._step, 6)))
        has_changed, self.value = value != self.value, value
        return has_changed
