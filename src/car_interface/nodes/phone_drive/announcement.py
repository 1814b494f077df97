"""Where phones find the page, as lines for the terminal: its address and PIN, and a QR code of both."""
from __future__ import annotations

import fcntl
import io
import ipaddress
import socket
import struct
from typing import Mapping

from car_interface.nodes.phone_drive.config import PhoneDriveConfig

SIOCGIFADDR = 0x8915  # of Linux, netdevice(7): the IPv4 address of an interface
REQUEST, ADDRESS_AT = struct.Struct("256s"), 20  # struct ifreq: the name, 16; family and port, 4; the address
BLACK_ON_WHITE, PLAIN = "\x1b[30;107m", "\x1b[0m"  # ECMA-48: whatever the terminal's colours are


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
