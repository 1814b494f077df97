"""map_gamepad: what a person shows with a gamepad becomes an entry of gamepads.yaml."""
import os
import sys

import pytest
from pads import (
    ABS,
    DROPPED,
    HAT_X,
    KEY,
    NORTH,
    RX,
    RY,
    RZ,
    SOUTH,
    SYN,
    TL,
    TR,
    UNKNOWN,
    Computer,
    X,
    Y,
    Z,
)

from car_interface.common.errors import CarInterfaceError
from car_interface.common.package_files import package_file
from car_interface.common.yaml_file import load_yaml
from car_interface.teleop.joystick import Joystick
from car_interface.tools.host_setup import map_gamepad

LEFT, FORWARD, DOWN, UP = -32768, -32768, 1, 0
ENTRY = {"third_button": -1, "steer_axis": 0, "steer_scale": 1.0, "throttle_axis": 4, "throttle_scale": 1.0,
         "manual_button": 4, "autonomous_button": 5, "faster_button": -1, "slower_button": -1}
MODEL = "Nobody's Pad, 8 axes, 11 buttons"


class Person:
    """Shows what is asked for, once for each line that is printed: a step, or why something won't do."""

    def __init__(self, folder):
        self.computer = Computer(folder)
        self.plugged = self.computer.plug_in(UNKNOWN)
        self.device = self.computer.open(self.computer.find()[0])
        self.lines = []
        read, self._keyboard = os.pipe()
        self.keyboard = os.fdopen(read)

    def follow(self, *answers):
        """Returns the entry; an answer is a list of reports and of texts that are typed, or one text."""
        left = list(answers)

        def answer(line):
            self.lines.append(line)
            for report in left.pop(0):
                if isinstance(report, str):
                    os.write(self._keyboard, report.encode())
                else:
                    self.plugged.send(*report)
        entry = map_gamepad.ask(self.device, Joystick(self.device.keys, self.device.ranges), self.keyboard, answer)
        assert left == []
        return entry

    def close(self):
        self.keyboard.close()
        os.close(self._keyboard)
        self.device.close()


@pytest.fixture(name="person")
def fixture_person(tmp_path):
    person = Person(tmp_path)
    yield person
    person.close()


def push(code, position, rest=0):
    return [[(ABS, code, position // 2)], [(ABS, code, position)], [(ABS, code, rest)]]


def press(code):
    return [[(KEY, code, DOWN)], [(KEY, code, UP)]]


def test_controls_that_are_shown_become_the_entry(person):
    entry = person.follow(push(X, LEFT), push(RY, FORWARD), press(TL), press(TR), press(NORTH), press(SOUTH))
    assert entry == {**ENTRY, "faster_button": 2, "slower_button": 0}
    assert person.lines[0] == "Push the stick that steers to the left; then let go."
    assert person.lines[4].endswith("driving by hand faster, or type Enter if there is none; then let go.")


def test_inverted_axes_get_a_negative_scale_and_enter_leaves_a_control_out(person):
    entry = person.follow(push(RX, -LEFT - 1), "\n", press(TL), press(TR), "\n", "\n")
    assert entry == {"third_button": -1, "steer_axis": 3, "steer_scale": -1.0, "throttle_axis": -1,
                     "manual_button": 4, "autonomous_button": 5, "faster_button": -1, "slower_button": -1}


def test_cross_trigger_and_what_is_taken_already_are_refused_with_the_reason(person):
    person.plugged.send((ABS, Z, 0), (ABS, RZ, 0))
    entry = person.follow(push(HAT_X, -1), push(X, LEFT), push(X, LEFT), push(Z, 255), push(RY, FORWARD), press(TL),
                          press(TL), press(TR), "\n", "\n")
    assert entry == ENTRY
    assert [line for line in person.lines if line.startswith("that")] == [
        "that is the cross: use a stick", "that axis steers already",
        "that axis rests at its end, as a trigger does: use a stick",
        "that is manual_button already: press another one"]


def test_control_that_is_needed_can_not_be_left_out(person):
    assert person.follow(["\n", *push(X, LEFT)], push(RY, FORWARD), press(TL), press(TR), "\n", "\n") == ENTRY


def test_closed_keyboard_is_no_answer(person):
    person.keyboard.close()
    with open(os.devnull, encoding="utf-8") as person.keyboard:
        entry = person.follow(push(X, LEFT), push(RY, FORWARD), press(TL), press(TR), press(NORTH), press(SOUTH))
    assert entry == {**ENTRY, "faster_button": 2, "slower_button": 0}


def test_button_counts_once_everything_was_let_go_of(person):
    held = [[(ABS, RY, FORWARD)], [(KEY, TL, DOWN)], [(ABS, RY, 0)], [(KEY, TL, UP)], *press(TR)]
    entry = person.follow(push(X, LEFT), held, [], press(SOUTH), "\n", "\n")
    assert (entry["manual_button"], entry["autonomous_button"]) == (5, 0)


def test_stick_that_was_pushed_by_lost_events_is_read(person, monkeypatch):
    positions = iter([{**person.device.positions()}, {**person.device.positions(), X: LEFT}])

    def read():
        found = next(positions)
        if found[X] == LEFT:
            person.plugged.send((ABS, X, 0))
        return found
    monkeypatch.setattr(person.device, "positions", read)
    lost = [[(SYN, DROPPED, 0), (ABS, Y, 0)]]
    assert person.follow(lost, push(RY, FORWARD), press(TL), press(TR), "\n", "\n") == ENTRY


# --- the command ---

def run(monkeypatch, person, *arguments):
    monkeypatch.setattr(sys, "argv", ["map_gamepad", *arguments, "__name:=map"])
    monkeypatch.setattr(map_gamepad, "find_pads", person.computer.find)
    monkeypatch.setattr(map_gamepad, "GamepadDevice", person.computer.open)
    monkeypatch.setattr(map_gamepad, "ask", lambda device, joystick, keyboard: ENTRY)
    map_gamepad.main()


def test_entry_is_written_into_the_folder_and_the_old_file_is_kept(person, tmp_path, monkeypatch, capsys):
    folder = tmp_path / "my_car"
    folder.mkdir()
    run(monkeypatch, person, str(folder))
    assert load_yaml(str(folder / "gamepads.yaml")) == {MODEL: ENTRY}
    assert capsys.readouterr().out.startswith(f"{MODEL}\nLet go of everything.\nwritten: {folder}/gamepads.yaml. ")
    run(monkeypatch, person, str(folder))
    assert len(list(folder.iterdir())) == 2


@pytest.mark.parametrize("folder, text", [
    ("/nowhere", "there is no folder /nowhere: give your car's, which config:= names"),
    (str(package_file("config")), "is the package's own: give a folder of your car's")], ids=["missing", "the_package"])
def test_folder_that_is_not_the_cars_is_refused_before_anything_is_asked(person, monkeypatch, folder, text):
    with pytest.raises(CarInterfaceError, match=text):
        run(monkeypatch, person, folder)


def test_file_that_can_not_be_written_is_told(person, tmp_path, monkeypatch):
    def refuse(*_, **__):
        raise PermissionError(13, "Permission denied")
    monkeypatch.setattr(map_gamepad.output, "replace", refuse)
    with pytest.raises(CarInterfaceError, match=r"gamepads\.yaml can't be written: Permission denied"):
        run(monkeypatch, person, str(tmp_path))
