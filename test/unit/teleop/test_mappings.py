"""What the axes and buttons of which gamepad do."""
import pytest

from car_interface.common.declared import read
from car_interface.common.errors import ConfigError
from car_interface.common.package_files import package_file
from car_interface.common.params import Params
from car_interface.common.yaml_file import load_yaml
from car_interface.teleop.gamepad import GamepadConfig
from car_interface.teleop.mappings import HEAD, button_label, config_for, frame_of, load_entries, model_of, with_entry

SHIPPED = read(Params(load_yaml(str(package_file("config/teleop_logi.yaml")))), GamepadConfig)
MODEL = "Nobody's \"Pad\", 4 axes, 10 buttons"
ENTRY = {"steer_axis": 1, "steer_scale": -1.0, "throttle_axis": -1}


# leftx, righty, leftshoulder, rightshoulder, y (PlayStation: x) and a of SDL's gamecontrollerdb.txt for Linux, which
# numbers as the joystick interface does.
@pytest.mark.parametrize("name, axes, buttons, expected", [
    ("Logitech Gamepad F710", 8, 11, (0, 4, 4, 5, 3, 0)),
    ("Logitech Logitech Cordless RumblePad 2", 6, 12, (0, 3, 4, 5, 3, 1)),
    ("Logitech Logitech Dual Action", 6, 12, (0, 3, 4, 5, 3, 1)),
    ("Microsoft X-Box 360 pad", 8, 11, (0, 4, 4, 5, 3, 0)),
    ("Xbox Wireless Controller", 8, 15, (0, 3, 6, 7, 4, 0)),
    ("Wireless Controller", 8, 13, (0, 4, 4, 5, 3, 0)),
    ("DualSense Wireless Controller", 8, 13, (0, 4, 4, 5, 3, 0)),
])
def test_shipped_gamepad_steers_left_drives_right_and_has_its_deadmen_at_the_shoulders(name, axes, buttons, expected):
    config = config_for(model_of(frame_of(name), axes, buttons), SHIPPED, load_entries(None))
    assert (config.steer_axis, config.throttle_axis, config.manual_button, config.autonomous_button,
            config.faster_button, config.slower_button) == expected
    assert (config.steer_scale, config.throttle_scale, config.joy_timeout_s) == (1.0, 1.0, 0.25)


@pytest.mark.parametrize("model, expected", [
    ("Xbox Wireless Controller", ["LB", "RB", "Y", "A"]), ("Wireless Controller", ["L1", "R1", "square", "cross"]),
    ("Nobody's Pad", ["button 4", "button 5", "button 3", "button 0"])])
def test_button_is_called_what_is_printed_on_it_and_by_its_number_on_an_unknown_gamepad(model, expected):
    entries = load_entries(None)
    model = next((known for known in entries if known.startswith(model)), "")
    config = config_for(model, SHIPPED, entries)
    assert [button_label(model, number) for number in (config.manual_button, config.autonomous_button,
                                                       config.faster_button, config.slower_button)] == expected


def test_every_shipped_entry_can_be_used_with_the_shipped_parameters_and_names_its_buttons_but_not_others():
    entries = load_entries(None)
    for model in entries:
        config = config_for(model, SHIPPED, entries)
        names = [button_label(model, number) for number in (config.manual_button, config.autonomous_button,
                                                            config.faster_button, config.slower_button)]
        assert names in (["LB", "RB", "Y", "A"], ["L1", "R1", "square", "cross"])
    assert len(entries) >= 14
    names = [button_label("Xbox Wireless Controller, 8 axes, 15 buttons", number) for number in (-1, 2, 14)]
    assert names == ["button -1", "button 2", "button 14"]


@pytest.mark.parametrize("frame", ["", "/dev/input/js0", "joy"])
def test_messages_that_name_no_gamepad_go_by_the_parameters_alone(frame):
    assert config_for(model_of(frame, 2, 2), SHIPPED, {}) is SHIPPED


@pytest.mark.parametrize("axes, buttons", [(8, 12), (6, 11)])
def test_known_name_with_other_numbers_is_another_gamepad(axes, buttons):
    model = model_of(frame_of("Logitech Gamepad F710"), axes, buttons)
    with pytest.raises(ConfigError, match=rf"gamepads\.yaml has no entry for this gamepad, 'Logitech Gamepad F710, "
                                          rf"{axes} axes, {buttons} buttons'"):
        config_for(model, SHIPPED, load_entries(None))


@pytest.mark.parametrize("entry, text", [
    ({"steer_axes": 1}, "unknown parameter steer_axes"), ({"steer_axis": 64}, "steer_axis is 64"),
    ({"manual_button": 5}, "a button other than manual_button's"), (None, "the entry is missing"),
    ([1], "the entry is")])
def test_entry_that_can_not_be_used_is_refused_by_name(entry, text):
    with pytest.raises(ConfigError, match=f"gamepads.yaml, {MODEL}, .*{text}"):
        config_for(MODEL, SHIPPED, {MODEL: entry})


def test_entry_says_what_differs_and_the_parameters_the_rest():
    config = config_for(MODEL, GamepadConfig(0, 4, 4, 5, third_button=2, joy_timeout_s=0.5), {MODEL: ENTRY})
    assert config == GamepadConfig(1, -1, 4, 5, third_button=2, joy_timeout_s=0.5, steer_scale=-1.0)


def test_entries_of_the_cars_folder_go_before_the_packages(tmp_path):
    f710, f310 = (f"Logitech Gamepad {name}, 8 axes, 11 buttons" for name in ("F710", "F310"))
    assert load_entries(str(tmp_path)) == load_entries(None)
    (tmp_path / "gamepads.yaml").write_text(f'"{f710}": {{throttle_axis: 1}}\n', encoding="utf-8")
    entries = load_entries(str(tmp_path))
    assert (entries[f710], entries[f310]) == ({"throttle_axis": 1}, {})
    (tmp_path / "gamepads.yaml").write_text('"F710": {', encoding="utf-8")
    with pytest.raises(ConfigError, match=r"gamepads\.yaml"):
        load_entries(str(tmp_path))


def test_entry_is_written_and_replaced_and_the_other_lines_stay():
    once = with_entry("", "gamepads.yaml", MODEL, ENTRY)
    assert load_yaml("gamepads.yaml", once) == {MODEL: ENTRY} and once.startswith(HEAD)
    other = once + '"Other, 2 axes, 2 buttons": {}  # mine\n'
    again = with_entry(other, "gamepads.yaml", MODEL, {"steer_axis": 3})
    assert load_yaml("gamepads.yaml", again) == {"Other, 2 axes, 2 buttons": {}, MODEL: {"steer_axis": 3}}
    assert "# mine" in again and again.count("\n") == other.count("\n")


def test_entry_of_a_name_with_umlauts_is_replaced_as_it_was_typed():
    text = with_entry('"Gerät, 2 axes, 2 buttons": {steer_axis: 1}\n', "f", "Gerät, 2 axes, 2 buttons", ENTRY)
    assert load_yaml("f", text) == {"Gerät, 2 axes, 2 buttons": ENTRY}


def test_file_whose_entry_is_on_several_lines_is_left_alone():
    text = with_entry("", "f", MODEL, {}).replace(" {}", "\n  steer_axis: 1")
    with pytest.raises(ConfigError, match=r"f can't be edited safely; accepted: a file whose entry .* is on one line"):
        with_entry(text, "f", MODEL, ENTRY)
