"""The gamepad, as the doctor judges it: the text that its owner reads."""
import math
from types import SimpleNamespace

import pytest

from car_interface.common import causes
from car_interface.teleop.gamepad import GamepadConfig
from car_interface.tools.doctor.car import GamepadFacts, Report, check_gamepad
from car_interface.tools.doctor.computer import probe_driver
from car_interface.tools.doctor.findings import BAD, OK, WARN

SHIPPED = GamepadConfig(steer_axis=0, throttle_axis=4, manual_button=4, autonomous_button=5)
NOTHING = {"messages": 0, "period_s": math.inf, "axes": 0, "buttons": 0}


def check(**changes):
    """The finding about a gamepad that sends at 20 Hz, but for these facts, and what teleop_logi says of it."""
    state = SimpleNamespace(**{name: changes.pop(name, value) for name, value in (
        ("cause", causes.NO_DEADMAN), ("reason", "no deadman is held"), ("steering_stick", ""),
        ("throttle_stick", ""))})
    found, = check_gamepad(GamepadFacts("/teleop_logi", **{
        "topic": "/joy", "publishers": ["/joy_node"], "config": SHIPPED, "messages": 21, "period_s": 0.05, "axes": 8,
        "buttons": 11, "odd": {}, "state": state, "driver": None, **changes}))
    return found


def test_gamepad_that_works_is_ok_and_so_is_none_where_phones_drive():
    found = check()
    assert (found.level, found.subject) == (OK, "gamepad")
    assert found.what == "/joy: 8 axes, 11 buttons, 20.0 times a second; no deadman is held"
    found = check(**NOTHING, publishers=(), reason="phone: no deadman is held")
    assert (found.level, found.what) == (OK, "there is none; phone: no deadman is held")
    found = check(**NOTHING, publishers=(), cause=causes.JOY_STALE, reason="phone: phone/joy silent for 0.30 s")
    assert (found.level, found.what) == (WARN, "there is none; phone: phone/joy silent for 0.30 s")


@pytest.mark.parametrize("changes, level, what, remedy", [
    pytest.param({**NOTHING, "publishers": (), "reason": "joy was never heard"}, WARN,
                 "no node publishes /joy, so that no deadman can be held (joy was never heard)",
                 "Launch the car with gamepad:=true, which starts its driver", id="nobody_publishes"),
    pytest.param(NOTHING, WARN, "/joy_node publishes /joy, but nothing came",
                 "Set its driver's autorepeat_rate to 20", id="joy_node_without_a_message"),
    pytest.param({**NOTHING, "driver": Report("joy_node: gamepad device", BAD, "gamepad: there are several",
                                                      "Leave one")}, WARN, "gamepad: there are several", "Leave one",
                 id="driver_without_a_gamepad"),
    pytest.param({"axes": 4}, BAD,
                 "the gamepad has 4 axes (0 to 3), but throttle_axis is 4", "needs its switch at X", id="wrong_mode"),
    pytest.param({"axes": 4, "topic": "/car1/joy"}, BAD, "the gamepad has 4 axes",
                 "rostopic echo /car1/joy", id="below_a_namespace"),
    pytest.param({"odd": {4: math.nan}}, BAD,
                 "the gamepad's throttle_axis 4 is nan, no number to act on", "See what sends it", id="nan"),
    pytest.param({"messages": 4, "period_s": 0.3}, BAD,
                 "/joy comes 3.3 times a second, too seldom for a joy_timeout of 0.25 s: the deadman is released again "
                 "and again", "autorepeat_rate to 20", id="rate_below_the_timeout"),
    pytest.param({"messages": 1, "period_s": 2.0}, BAD, "/joy comes once in 2.0 s, too seldom",
                 "/joy must come at 20 Hz", id="a_single_message"),
    pytest.param({"messages": 6, "period_s": 0.2}, WARN,
                 "with a joy_timeout of 0.25 s one message that is late releases the deadman", "autorepeat_rate to 20",
                 id="rate_near_the_timeout"),
    pytest.param({"axes": 6, "buttons": 12}, WARN,
                 "6 axes and 12 buttons, as a Logitech gamepad has in D mode", "needs its switch at X", id="d_mode"),
    pytest.param({"throttle_stick": causes.NOT_AT_REST, "reason": "no deadman is held; the gamepad's throttle_axis 4 "
                  "is 1.00 and was not seen at its rest: it doesn't count"}, WARN,
                 "throttle_axis 4 is 1.00 and was not",
                 "Let go of the stick. If the axis stays where it is, it is a trigger", id="trigger_for_a_stick"),
    pytest.param({"cause": causes.NOT_REARMED, "reason": "the gamepad was silent; let go"}, WARN,
                 "the gamepad was silent; let go", "Let go of both deadman buttons once", id="not_rearmed"),
    pytest.param({"cause": causes.JOY_NEVER_RECEIVED, "reason": "joy was never heard"}, BAD,
                 "/joy comes here, but /teleop_logi says: joy was never heard", "rosnode info /teleop_logi",
                 id="teleop_logi_does_not_hear_it"),
    pytest.param({"cause": causes.JOY_UNMAPPED, "reason": "gamepads.yaml has no entry", "config": None}, BAD,
                 "gamepads.yaml has no entry", "Map it: rosrun car_interface map_gamepad FOLDER", id="unknown_gamepad"),
])
def test_what_is_wrong_is_named_with_its_remedy(changes, level, what, remedy):
    found = check(**changes)
    assert found.level == level
    assert what in found.what and remedy in found.remedy


@pytest.mark.parametrize("changes", [
    pytest.param({"odd": {7: math.nan}}, id="nan_on_an_axis_that_nobody_uses"),
    pytest.param({"messages": 2, "period_s": 2.9,
                  "config": GamepadConfig(0, 4, 4, 5, joy_timeout_s=0.0)}, id="slow_but_without_a_timeout"),
    pytest.param({"axes": 6, "buttons": 12, "config": GamepadConfig(0, 3, 4, 5)},
                 id="d_mode_with_indices_for_it"),
    pytest.param({"config": None, "axes": 1}, id="bad_parameters_are_another_finding"),
    pytest.param({"cause": "", "reason": ""}, id="old_teleop_without_a_state"),
])
def test_what_is_not_wrong_is_ok(changes):
    assert check(**changes).level == OK


# --- its driver ---

def plug_in(folder, name, kind, has_driver, product="Wireless Gamepad F710", numbers=("046d", "c21f")):
    """A device of the USB bus with one interface, as sysfs shows them."""
    (folder / name).mkdir()
    (folder / f"{name}:1.0").mkdir()
    words = {"idVendor": numbers[0], "idProduct": numbers[1], "product": product}
    for file, word in words.items():
        if word:
            (folder / name / file).write_text(f"{word}\n", encoding="utf-8")
    for file, word in zip(("bInterfaceClass", "bInterfaceSubClass", "bInterfaceProtocol"), kind):
        (folder / f"{name}:1.0" / file).write_text(f"{word}\n", encoding="utf-8")
    if has_driver:
        (folder / f"{name}:1.0" / "driver").symlink_to("../../../bus/usb/drivers/xpad")


def test_driver_that_is_missing_is_named_with_what_to_do(tmp_path):
    plug_in(tmp_path, "1-2", ("ff", "5d", "01"), False)
    plug_in(tmp_path, "1-3", ("ff", "47", "d0"), False, "", ("045e", "02ea"))
    first, second = probe_driver(str(tmp_path))
    assert (first.level, first.what) == (WARN, ("Wireless Gamepad F710 (046d:c21f) is plugged in, but no driver has it:"
                                         " no xpad"))
    assert first.remedy.startswith("sudo modprobe xpad. If there is no such module, as on a Jetson: set the switch")
    assert second.what.startswith("a gamepad (045e:02ea)")


@pytest.mark.parametrize("kind, has_driver", [(("ff", "5d", "01"), True), (("03", "00", "00"), False)],
                         ids=["xpad_has_it", "no_xbox_gamepad"])
def test_gamepad_that_has_a_driver_or_needs_none_is_no_finding(tmp_path, kind, has_driver):
    (tmp_path / "bus").mkdir()
    plug_in(tmp_path, "1-2", kind, has_driver)
    if has_driver:
        (tmp_path / "1-2:1.0" / "driver").unlink()
        (tmp_path / "1-2:1.0" / "driver").symlink_to(tmp_path / "bus")
    assert probe_driver(str(tmp_path)) == [] and probe_driver("/nowhere") == []
