"""The parameters of phone_drive."""
from __future__ import annotations

from dataclasses import dataclass

from car_interface.common import declared


@dataclass(frozen=True)
class PhoneDriveConfig:
    """Where phones find the car."""

    address: str = declared.text(
        "address", "127.0.0.1", "this computer's, as phones reach it; 127.0.0.1 = from this computer only")
    port: int = declared.integer("port", 8484, "of the page", low=1024, high=65535)
