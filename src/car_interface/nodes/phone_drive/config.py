"""The parameters of phone_drive."""
from __future__ import annotations

import ipaddress
import re
from dataclasses import dataclass

from car_interface.common import declared
from car_interface.common.errors import require

AUTO = "auto"


@dataclass(frozen=True)
class PhoneDriveConfig:
    """Where phones find the car, and what they may do."""

    address: str = declared.text(
        "address", "127.0.0.1", "this computer's, as phones reach it; 127.0.0.1 = from this computer only")
    port: int = declared.integer("port", 8484, "of the page", low=1024, high=65535)
    pin: str | int = declared.text_or_integer(
        "pin", AUTO, "six digits, which admit a page; `auto` = others at each start")
    certificate: str | None = declared.path(
        "certificate", None, "of TLS, a PEM file with its chain: the page is https then", default_text="none: http")
    key: str | None = declared.path("key", None, "the certificate's private key, a PEM file", default_text="none")
    watch_without_pin: bool = declared.flag(
        "watch_without_pin", False, "true = whoever opens the page sees the car, and may stop it")
    folder: str | None = declared.path(
        "folder", None, "of the recordings", default_text="`~/.ros/car_interface/recordings`")
    e_stop: bool = declared.flag(
        "e_stop", False, "the phones' e-stop at start; the node sets it itself, so that a stop outlives it")

    @property
    def host(self) -> str:
        """Return the address and the port as a browser has them in a URL: small letters, IPv6 by RFC 5952."""
        try:
            address = ipaddress.ip_address(self.address)
        except ValueError:
            return f"{self.address.lower()}:{self.port}"
        return f"[{address}]:{self.port}" if address.version == 6 else f"{address}:{self.port}"

    def __post_init__(self):
        require(self.pin == AUTO or re.fullmatch("[0-9]{6}", str(self.pin)), "pin", self.pin, f"six digits, or {AUTO}")
        require((self.certificate is None) == (self.key is None), "certificate" if self.key else "key", None,
                "both a certificate and its key, or neither")
