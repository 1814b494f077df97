"""The kernel's list of input devices, and which gamepad in it is read."""
import os

import pads
import pytest
from pads import DUALSENSE, F310_D, F710_D, F710_X, KEYBOARD, MOTION_SENSORS, TOUCHPAD, XBOX_BLUETOOTH, listed

from car_interface.common.errors import DeviceError
from car_interface.teleop import input_devices
from car_interface.teleop.input_devices import ANY, choose_pad, find_pads, parse_pads

OPTION = "joy_device:="


def pad(model=F710_X, event=5, place="usb-1", number="", more="js0"):
    (found,) = parse_pads(listed(model, event, place, number, more), 64)
    return found


@pytest.mark.parametrize("model, buttons, axes", [
    (F710_X, 11, 8), (F710_D, 12, 6), (F310_D, 12, 6), (XBOX_BLUETOOTH, 15, 8), (DUALSENSE, 13, 8)],
    ids=lambda value: getattr(value, "name", value))
def test_gamepad_is_found_with_its_keys_and_axes(model, buttons, axes):
    found = pad(model)
    assert (found.name, found.path) == (model.name, "/dev/input/event5")
    assert (len(found.keys), len(found.axes)) == (buttons, axes)
    assert found.axes == set(model.ranges)


@pytest.mark.parametrize("code, is_gamepad", [(0x120, True), (0x130, True), (0x121, False), (0x131, False)])
def test_a_gamepad_has_btn_trigger_or_btn_south(code, is_gamepad):
    """By linux/input-event-codes.h."""
    keys = f"{1 << code - 0x100:x} 0 0 0 0"
    assert bool(parse_pads(listed(F710_X._replace(keys=keys), 5), 64)) == is_gamepad


@pytest.mark.parametrize("model", [MOTION_SENSORS, TOUCHPAD, KEYBOARD], ids=lambda model: model.name)
def test_what_lacks_a_gamepads_buttons_or_two_sticks_is_none(model):
    assert parse_pads(listed(model, 5), 64) == []


def test_list_is_the_kernels_also_of_a_32_bit_process_and_a_computer_without_one_has_no_gamepad(tmp_path, monkeypatch):
    monkeypatch.setattr(input_devices, "DEVICES", str(tmp_path / "devices"))
    assert find_pads() == []
    (tmp_path / "devices").write_text(listed(KEYBOARD, 0) + listed(pads.F710_X, 5), encoding="utf-8")
    assert [found.name for found in find_pads()] == [F710_X.name]
    text = listed(F710_X, 5).replace("7cdb000000000000 0 0 0 0", "7cdb0000 0 0 0 0 0 0 0 0 0")
    assert parse_pads(text, 32) == parse_pads(listed(F710_X, 5), 64)


@pytest.mark.parametrize("device", [ANY, "/dev/input/event5", "/dev/input/js0"])
def test_only_gamepad_is_chosen_by_itself_by_its_event_device_or_by_its_js_device(device):
    assert choose_pad([pad()], device, OPTION) == pad()


def test_one_of_two_is_chosen_by_a_link_such_as_by_id(tmp_path):
    os.symlink("/dev/input/event7", str(tmp_path / "usb-Logitech-event-joystick"))
    found = [pad(), pad(DUALSENSE, 7, more="js1")]
    assert choose_pad(found, str(tmp_path / "usb-Logitech-event-joystick"), OPTION) == found[1]


@pytest.mark.parametrize("found, device, text", [
    ([], ANY, "gamepad: there is none. Plug in the gamepad or its receiver, and switch it on"),
    ([], "/dev/input/js0", "gamepad: there is none"),
    ([pad(), pad(DUALSENSE, 7)], ANY,
     (r"several: /dev/input/event5 \(Logitech Gamepad F710\), /dev/input/event7 \(DualSense .*\)\. Leave one plugged "
     r"in, or choose it: joy_device:=/dev/input/event5$")),
    ([pad(more="")], "/dev/input/js0",
     r"gamepad: /dev/input/js0 is none; there is /dev/input/event5 .*\. Choose it: joy_device:=/dev/input/event5$"),
], ids=["none", "none_at_the_path", "two", "no_js0"])
def test_what_can_not_be_chosen_is_refused_with_what_there_is_and_what_to_type(found, device, text):
    with pytest.raises(DeviceError, match=text):
        choose_pad(found, device, OPTION)


@pytest.mark.parametrize("first, again", [
    (pad(), pad(event=8)),
    (pad(number="a0:b1"), pad(event=8, place="usb-2", number="a0:b1")),
], ids=["same_port", "same_address_elsewhere"])
def test_after_a_reconnect_the_same_gamepad_is_read_under_any_path_beside_others(first, again):
    assert choose_pad([pad(DUALSENSE, 5), again], "/dev/input/event5", OPTION, first) == again


@pytest.mark.parametrize("other", [pad(place="usb-2"), pad(F710_D), pad(number="a0:b1")],
                         ids=["at_another_port", "in_another_mode", "of_another_address"])
def test_after_a_reconnect_another_gamepad_is_refused(other):
    with pytest.raises(DeviceError, match=r"Logitech Gamepad F710 \(usb-1\), which was read before, is gone; there is"):
        choose_pad([other], ANY, OPTION, pad())
