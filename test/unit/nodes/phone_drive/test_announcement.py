"""What the terminal says of the phones' page."""
import pytest

from car_interface.common.errors import ConfigError
from car_interface.nodes.phone_drive.config import PhoneDriveConfig, announce, own_addresses, qr_code

ADDRESSES = {"wlan0": "192.168.4.1", "eth0": "10.0.0.5"}


def lines(is_terminal=False, **config):
    return announce(PhoneDriveConfig(**config), "271828", ADDRESSES, is_terminal)


def test_without_an_address_it_lists_them_and_the_argument_to_type_or_says_that_there_is_no_network():
    text = "\n".join(lines())
    assert "http://127.0.0.1:8484/#271828" in text
    assert "phone_address:=192.168.4.1    (wlan0)" in text and "phone_address:=10.0.0.5    (eth0)" in text
    assert "connect it to a network" in announce(PhoneDriveConfig(), "271828", {}, False)[-1]


@pytest.mark.parametrize("config, url", [
    ({"address": "192.168.4.1"}, "http://192.168.4.1:8484/#271828"),
    ({"address": "192.168.4.1", "certificate": "/a.pem", "key": "/k.pem", "port": 9000},
     "https://192.168.4.1:9000/#271828"),
    ({"address": "FD00:0::1"}, "http://[fd00::1]:8484/#271828"), ({"address": "Car.local"}, "http://car.local:8484/#271828"),
], ids=["http", "certificate_and_port", "ipv6_as_browsers_have_it", "name_as_browsers_have_it"])
def test_with_an_address_the_page_s_url_has_the_pin_in_its_fragment(config, url):
    text = "\n".join(lines(**config))
    assert url in text and "The PIN is 271828" in text and "phone_address:=" not in text
    assert ("reads along: http" in text) == url.startswith("http:")


def test_qr_code_is_for_a_terminal_only_and_needs_an_address():
    pytest.importorskip("qrcode")
    assert "▀" in "".join(lines(True, address="192.168.4.1"))
    assert "▀" not in "".join(lines(False, address="192.168.4.1")) + "".join(lines(True))


@pytest.mark.parametrize("changes, name", [
    ({"pin": 12345}, "pin"), ({"pin": "secret"}, "pin"), ({"key": "/k.pem"}, "cert"),
], ids=["five_digits", "letters", "key_without_certificate"])
def test_parameters_that_no_page_could_use_are_refused(changes, name):
    with pytest.raises(ConfigError, match=name):
        PhoneDriveConfig(**changes)


def test_two_rows_of_a_code_become_one_line_black_on_white():
    qrcode = pytest.importorskip("qrcode")
    code = qrcode.QRCode(border=2)
    code.add_data("a text")
    rows = [*code.get_matrix(), [False] * 100]
    blocks = {(False, False): "\xa0", (True, False): "▀", (False, True): "▄", (True, True): "█"}
    assert qr_code("a text") == [
        "\x1b[30;107m" + "".join(blocks[pair] for pair in zip(upper, lower)) + "\x1b[0m"
        for upper, lower in zip(rows[0:-1:2], rows[1::2])]


def test_own_addresses_are_ipv4_without_the_loopback():
    assert all(address.count(".") == 3 and not address.startswith("127.") for address in own_addresses().values())
