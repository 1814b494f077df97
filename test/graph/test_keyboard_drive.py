"""keyboard_drive: a virtual car by the keys of a terminal, a real one by the events of a keyboard, too."""
from __future__ import annotations

from functools import partial

import pytest
from sensor_msgs.msg import Joy

from car import Car
from car_interface.common.errors import CarInterfaceError
from car_interface.nodes.keyboard_drive import KeyboardDrive
from graph import Graph

MANUAL = 4  # as config/teleop_logi.yaml has them
CODE_M = 50
REAL = {"pca9685": {"device": "/dev/i2c-1"}}


class Keys:
    """A terminal: what is typed, whether the node is in its foreground, and whether it is still there."""

    typed, is_foreground, closed, is_restored, starts = "", True, False, False, True

    def start(self):
        return self.starts

    def read(self):
        typed, self.typed = self.typed, ""
        return typed if self.is_foreground else None

    def is_closed(self):
        return self.closed

    def restore(self):
        self.is_restored = True


class Keyboards:
    """Keyboards of this computer: events that are still to be read; ``None`` = one was unplugged."""

    def __init__(self, count):
        self.count, self.events, self.is_closed = count, [], False

    def __len__(self):
        return self.count

    def read(self):
        events, self.events = self.events, []
        return events

    def close(self):
        self.is_closed = True


class Hand:
    """keyboard_drive beside a graph, and a person at its keys."""

    def __init__(self, graph=None, keyboards=0, parameters=None, text=None, **own):
        self.graph, self.keys, self.keyboards = graph or Graph(), Keys(), Keyboards(keyboards)
        self.graph.record("/joy")
        for name, values in {"pca9685": {"device": "virtual"}, **(parameters or {})}.items():
            self.graph.set_parameter(f"/{name}", values)
        self.node = self.graph.add(
            partial(KeyboardDrive, keys=self.keys, make_keyboards=lambda pattern: self.keyboards, text=text),
                                   "keyboard_drive", own)
        self.graph.run(0.1)

    def type(self, keys, run_s=0.1):
        self.keys.typed += keys
        self.graph.run(run_s)
        return self.joy

    def press(self, pressed, run_s=0.1):
        self.keyboards.events.append((CODE_M, pressed))
        self.graph.run(run_s)

    def hold(self, key, duration_s):
        """Hold a key, which repeats as on a desktop."""
        self.type(key, min(duration_s, 0.5))
        for _ in range(int((duration_s - 0.5) / 0.033)):
            self.type(key, 0.033)

    @property
    def joy(self) -> Joy:
        return self.graph.newest("/joy")

    @property
    def deadman(self):
        return self.joy.buttons[MANUAL]

    def held_since(self, at_ns):
        return {message.buttons[MANUAL] for message in self.graph.messages("/joy", at_ns)}


def test_joy_comes_at_50_hz_with_the_axes_and_buttons_of_teleop_logi():
    hand = Hand(parameters={"teleop_logi": {"steer_axis": 2, "throttle_axis": 9, "manual_button": 12,
                                            "autonomous_button": 1, "steer_scale": -1.0, "faster_button": 3,
                                            "slower_button": 0}})
    at_ns = hand.graph.now_ns + 1
    hand.graph.run(1.0)
    assert len(hand.graph.messages("/joy", at_ns)) == 50
    left = hand.type("ma", 0.3)
    assert (left.axes, len(left.buttons), left.header.frame_id) == ((0, 0, -1.0, *[0] * 7), 13, "keyboard")
    assert [index for index, held in enumerate(left.buttons) if held] == [12]
    hand.graph.run(1.0)
    assert not any(hand.joy.buttons)
    forward = hand.type("pw", 0.6)
    assert (forward.axes[9], [index for index, held in enumerate(forward.buttons) if held]) == (1.0, [1])
    for key, button in (("+", 3), ("-", 0)):
        hand.graph.run(1.0)
        assert [index for index, held in enumerate(hand.type("m" + key).buttons) if held] == [button, 12]


def test_key_counts_for_0_7_s_and_space_and_the_end_let_go_at_once():
    hand = Hand()
    at_ns = hand.graph.now_ns
    hand.type("m", 2.0)
    held = [record.at_ns for record in hand.graph.recorded["/joy"] if record.message.buttons[MANUAL]]
    assert 0.68e9 <= held[-1] - held[0] <= 0.7e9 and held[0] - at_ns <= 0.02e9
    for let_go in (lambda: hand.type(" ", 0.021), hand.node.end):
        hand.type("m", 0.1)
        assert hand.deadman
        let_go()
        assert not hand.deadman
    assert hand.keys.is_restored and hand.keyboards.is_closed


def test_background_lets_go_and_what_was_held_must_be_pressed_anew_in_the_foreground():
    hand = Hand()
    hand.type("m")
    assert hand.deadman
    hand.keys.is_foreground = False
    hand.graph.run(0.021)
    at_ns = hand.graph.now_ns
    hand.type("mmm", 0.5)
    assert hand.held_since(at_ns) == {0}
    hand.keys.is_foreground = True
    hand.graph.run(0.3)
    assert hand.held_since(at_ns) == {0}
    assert hand.type("m").buttons[MANUAL]


def test_stop_of_the_process_lets_go():
    hand = Hand()
    hand.type("m")
    hand.node.stall(0.3, frozen=True)
    hand.graph.run(0.35)
    assert not hand.deadman


def test_terminal_that_is_closed_and_a_car_that_becomes_real_end_it_and_let_go():
    hand = Hand()
    hand.type("m")
    hand.keys.is_foreground, hand.keys.closed = False, True
    hand.graph.run(0.1)
    assert (hand.node.fault, hand.deadman) == ("its terminal was closed", 0)
    hand = Hand()
    hand.graph.run(2.5)  # it has looked at the device already
    hand.graph.set_parameter("/pca9685/device", "/dev/i2c-1")
    hand.hold("m", 1.5)
    assert (hand.node.fault, hand.deadman) == (
        "pca9685's device was virtual when this node started and is /dev/i2c-1 now: start it again", 0)


@pytest.mark.parametrize("parameters, own, keys, text", [
    ({"pca9685": {}}, {}, {}, (
        "there is no /pca9685/device: no car, or it is in another namespace (ROS_NAMESPACE). Start the virtual car "
        "first: roslaunch car_interface demo.launch drive:=false")),
    (REAL, {"input_devices": "none"}, {}, (
        "/pca9685/device is /dev/i2c-1, a real servo board, and no keyboard can be read (none): a terminal doesn't say "
        "when a key is released. Drive by gamepad; or, with a keyboard on this computer: rosrun car_interface "
        "setup_hardware")),
    ({}, {}, {"starts": False}, (
        "no terminal to read keys from: start it by rosrun in a terminal of its own, not by roslaunch and not in the "
        "background"))])
def test_where_it_cannot_drive_it_is_refused(monkeypatch, parameters, own, keys, text):
    for name, value in keys.items():
        monkeypatch.setattr(Keys, name, value)
    with pytest.raises(CarInterfaceError) as error:
        Hand(parameters=parameters, **own)
    assert str(error.value) == text


def test_second_publisher_of_joy_is_refused_by_name(graph):
    graph.publish("/joy", Joy(), sender="/joy_node")
    with pytest.raises(CarInterfaceError, match=r"^/joy_node publishes /joy already\. End it first: rosnode "
                                               "kill /joy_node"):
        Hand(graph)


# --- its screen ---

class Text:
    is_live, width, lines = True, 100, ()

    def say(self, text):
        pass

    def show(self, lines):
        self.lines = lines


@pytest.fixture
def driver():
    car, text = Car(), Text()
    car.graph.record("/car_sim/collisions")
    car.whole(nodes={"throttle_arb": {"esc/profile": "brake_then_reverse", "esc/profile_measured": True}},
              esc_kind="brake_then_reverse", start=[4.0, 0.0, 0.0])  # two metres from a wall
    car.graph.silence("/joy", sender="/joy_node")
    car.graph.drop("/joy_node")
    hand = Hand(car.graph, text=text)
    hand.car, hand.text = car, text
    return hand


@pytest.mark.more
def test_screen_says_who_drives_and_what_is_near_and_by_typed_keys_alone_one_backs_out_of_a_wall(driver):
    """As by ssh: no release is seen, and a key counts for 0.7 s."""
    graph, text = driver.graph, driver.text
    graph.run(1.5)
    assert text.lines[-1] == "--> hold M to drive, P to let the planner drive"
    driver.type("m")
    driver.hold("w", 3.0)
    assert graph.newest("/car_sim/collisions").data == 1
    assert any(line.startswith("near:   front middle 0.") for line in text.lines)
    assert any(line.startswith("drives: TELEOP, tele_throt_req is 1.000, scaled by 0.3") for line in text.lines)
    assert text.lines[-1] == "--> you hit a wall. To back out: hold S; then M alone for a second; then S again"
    driver.hold("s", 1.0)
    driver.hold("m", 1.0)
    driver.hold("s", 2.0)
    assert driver.car.speed_mps < -0.2
    assert text.lines[-1] == "--> let go of M to stop"
    graph.run_until(lambda: driver.car.speed_mps == 0.0, 8.0)  # nothing is held, and nothing pushes ahead to stop it


# --- a real car, with a keyboard ---

def test_key_counts_until_its_release_and_only_if_it_was_typed_here_and_pressed_here():
    hand = Hand(keyboards=1, parameters=REAL)
    for _ in range(2):
        assert not hand.type("m").buttons[MANUAL]  # of another computer's keyboard
    assert ["a key was typed here, but not on a keyboard of this computer: its release can't be seen, so it doesn't "
            "count" in line for line in hand.graph.lines("/keyboard_drive", level=30)] == [True]
    hand.graph.run(1.0)
    hand.press(True, 0.5)
    assert not hand.deadman  # another program gets it
    hand.press(False, 1.0)
    hand.press(True, 0.0)
    hand.type("m", 0.03)
    at_ns = hand.graph.now_ns
    hand.graph.run(1.5)
    assert hand.held_since(at_ns) == {1}
    hand.press(False, 0.021)
    assert not hand.deadman


def test_keyboard_that_is_unplugged_lets_go():
    hand = Hand(keyboards=1, parameters=REAL)
    hand.press(True, 0.0)
    hand.type("m", 0.1)
    assert hand.deadman
    hand.keyboards.events = None
    hand.graph.run(0.021)
    assert not hand.deadman
