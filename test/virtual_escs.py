"""ESCs as they are sold, for the virtual car: one configuration of ``sim.drive_train`` is one device."""
from __future__ import annotations

from car_interface.sim.drive_train import (
    BRAKE_BECOMES_REVERSE,
    BRAKE_THEN_REVERSE,
    BRAKES,
    DIRECT_REVERSE,
    FORWARD_ONLY,
    VirtualEscConfig,
)


def xl5(**changes) -> VirtualEscConfig:
    """Return one like a Traxxas XL-5 in Sport: the second pull reverses, whether or not the car still rolls."""
    return VirtualEscConfig(**{"kind": BRAKE_THEN_REVERSE, "dwell_s": 0.12, "drag_brake": 0.05, **changes})


def vxl(**changes) -> VirtualEscConfig:
    """Return one like a brushless ESC: it knows whether the motor stands, and the second pull brakes until then."""
    return VirtualEscConfig(**{"kind": BRAKE_THEN_REVERSE, "dwell_s": 0.25, "second_pull": BRAKES, **changes})


def crawler(**changes) -> VirtualEscConfig:
    """Return one like a rock crawler's in "Forward and Reverse", with its strong drag brake."""
    return VirtualEscConfig(**{"kind": BRAKE_BECOMES_REVERSE, "drag_brake": 0.6, **changes})


def direct(**changes) -> VirtualEscConfig:
    """Return one like a boat's or a tank's: no brake at all."""
    return VirtualEscConfig(**{"kind": DIRECT_REVERSE, **changes})


def race(**changes) -> VirtualEscConfig:
    """Return one like a Traxxas in Race: no reverse."""
    return VirtualEscConfig(**{"kind": FORWARD_ONLY, "drag_brake": 0.05, **changes})
