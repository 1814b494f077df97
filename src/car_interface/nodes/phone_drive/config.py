"""Where phones find the car: the parameters of phone_drive, and what the terminal says of its page."""
from __future__ import annotations

import fcntl
import io
import ipaddress
import re
import socket
import struct
from dataclasses import dataclass
from typing import Mapping

from car_interface.common import declared
from car_interface.common.errors import require

AUTO = "auto"
SIOCGIFADDR = 0x8915  # of Linux, netdevice(7): the IPv4 address of an interface
REQUEST, ADDRESS_AT = struct.Struct("256s"), 20  # struct ifreq: the name, 16; family and port, 4; the address
BLACK_ON_WHITE, PLAIN = "\x1b[30;107m", "\x1b[0m"  # ECMA-48: whatever the terminal's colours are


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


def announce(config: PhoneDriveConfig, pin: str, addresses: Mapping[str, str], is_terminal: bool) -> list[str]:
    """Return what to print.

    Args:
        addresses: this computer's, by interface.
        is_terminal: false = no QR code, which a log can't show.
    """
    url = f"{'https' if config.certificate else 'http'}://{config.host}/#{pin}"
    if _is_loopback(config.address):
        return [f"Phones can't reach this car yet: its page is for this computer only, at {url}",
                "To drive it by phone, start it with the address at which phones reach this computer",
                "(for rosrun and ./dev demo --phone: _address:=…):",
                *(f"    phone_address:={address}    ({interface})" for interface, address in addresses.items()),
                *([] if addresses else ["    it has none: connect it to a network"])]
    listeners = "" if config.certificate else ", and so can whoever reads along: http"
    return [*(qr_code(url) if is_terminal else []), f"Phones drive this car at {url}",
            f"The PIN is {pin}; whoever has it can drive{listeners}"]


def _is_loopback(address):
    try:
        return ipaddress.ip_address(address).is_loopback
    except ValueError:
        return address == "localhost"


def qr_code(text: str) -> list[str]:
    """Return the lines of a QR code, black on white; none without the library."""
    try:
        import qrcode
    except ImportError:
        return []
    code, drawn = qrcode.QRCode(border=2), io.StringIO()
    code.add_data(text)
    code.print_ascii(drawn)  # two rows in a line, what is dark in the colour of the text
    return [f"{BLACK_ON_WHITE}{line}{PLAIN}" for line in drawn.getvalue().splitlines()]


def own_addresses() -> dict[str, str]:
    """Return this computer's IPv4 addresses by interface, without the loopback's."""
    found = {}
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        for _, name in socket.if_nameindex():
            try:
                answer = fcntl.ioctl(probe.fileno(), SIOCGIFADDR, REQUEST.pack(name.encode()))
            except OSError:  # it has none
                continue
            address = socket.inet_ntoa(answer[ADDRESS_AT:ADDRESS_AT + 4])
            if not _is_loopback(address):
                found[name] = address
    return found
