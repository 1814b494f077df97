"""The header of a computer, by the model that its kernel names."""
import os

import pytest

from car_interface.common import devices
from car_interface.common.devices import UNKNOWN, header_of, port_note, read_header


@pytest.mark.parametrize("model, computer, buses", [
    ("NVIDIA Jetson Orin Nano Engineering Reference Developer Kit Super", "Jetson Orin", (7, 1)),
    ("NVIDIA Jetson Orin Nano Developer Kit", "Jetson Orin", (7, 1)),
    ("NVIDIA Orin NX Developer Kit", "Jetson Orin", (7, 1)),
    ("NVIDIA Jetson AGX Orin Developer Kit", "Jetson Orin", (7, 1)),
    ("NVIDIA Jetson Xavier NX Developer Kit", "Jetson Xavier", (8, 1)),
    ("Jetson-AGX", "Jetson Xavier", (8, 1)),
    ("NVIDIA Jetson Nano Developer Kit", "Jetson", (1, 0)),
    ("quill", "Jetson", (1, 0)),
    ("Raspberry Pi 5 Model B Rev 1.0", "Raspberry Pi 5", (1,)),
    ("Raspberry Pi 4 Model B Rev 1.5", "Raspberry Pi", (1,)),
    ("Raspberry Pi Compute Module 4 Rev 1.0", "Raspberry Pi", (1,)),
    ("Radxa ROCK 5B", "", (1,)),
    ("", "", (1,)),
])
def test_header_is_known_by_the_model_and_of_another_computer_it_is_bus_1(model, computer, buses):
    found = header_of(model)
    assert (found.computer, tuple(found.buses)) == (computer, buses)
    assert found.bus_paths == [f"/dev/i2c-{number}" for number in buses]


def test_model_is_read_as_the_kernel_gives_it_with_a_zero_at_its_end(tmp_path, monkeypatch):
    monkeypatch.setattr(devices, "MODEL_FILE", str(tmp_path / "model"))
    assert read_header() == UNKNOWN
    (tmp_path / "model").write_bytes(b"Raspberry Pi 5 Model B Rev 1.0\0")
    assert read_header().computer == "Raspberry Pi 5"


@pytest.mark.parametrize("model, path, note", [
    ("Raspberry Pi 5 Model B Rev 1.0", "/dev/ttyAMA0", "dtoverlay=uart0-pi5"),
    ("Raspberry Pi 5 Model B Rev 1.0", "/dev/ttyAMA10", "it is the debug plug; pins 8 and 10 are /dev/ttyAMA0"),
    ("Raspberry Pi 4 Model B Rev 1.5", "/dev/ttyAMA0", "; pins 8 and 10 are /dev/serial0"),
    ("Raspberry Pi Zero 2 W Rev 1.0", "/dev/ttyAMA0", "dtoverlay=disable-bt"),
    ("Raspberry Pi 2 Model B Rev 1.1", "/dev/ttyAMA0", ""),
    ("NVIDIA Jetson Orin Nano Developer Kit", "/dev/ttyAMA0", "one of /dev/ttyTHS*"),
    ("Raspberry Pi 5 Model B Rev 1.0", "/dev/ttyACM0", ""),
    ("", "/dev/ttyAMA0", ""),
])
def test_port_that_is_not_the_header_s_or_needs_a_setting_has_a_note(model, path, note):
    found = port_note(path, header_of(model))
    assert note in found and bool(found) == bool(note)


def test_link_to_a_port_has_the_port_s_note(monkeypatch):
    monkeypatch.setattr(os.path, "realpath", {"/dev/teensy": "/dev/ttyAMA10"}.get)
    assert "debug plug" in port_note("/dev/teensy", header_of("Raspberry Pi 5 Model B Rev 1.0"))


@pytest.mark.parametrize("model, words", [
    ("NVIDIA Jetson Orin Nano Developer Kit", "disable --now nvgetty, and reboot"),
    ("Raspberry Pi 4 Model B Rev 1.5", "raspi-config, Interface Options, Serial Port"),
    ("", "disable --now serial-getty@ttyS0"),
], ids=["jetson", "raspberry_pi", "unknown"])
def test_console_has_the_remedy_of_its_computer(model, words):
    assert words in header_of(model).console_remedy.format(port="ttyS0")
