"""gamepad_joy and teleop_logi, with gamepads whose event devices are named pipes."""
from __future__ import annotations

from functools import partial

import pytest
from pads import ABS, DUALSENSE, F710_D, F710_X, KEY, RY, RZ, TL, TR, UNKNOWN, Computer, X
from sensor_msgs.msg import Joy

from car import Car
from car_interface.common import causes
from car_interface.nodes.gamepad_joy import GamepadJoy
from graph import NS_PER_S

LB, RB = 4, 5  # as config/teleop_logi.yaml has them
DOWN, UP = 1, 0


class Driven:
    """gamepad_joy and teleop_logi on a computer with gamepads."""

    def __init__(self, folder, teleop=None, **parameters):
        self.folder = folder
        self.car, self.computer = Car(), Computer(folder)
        self.graph = self.car.graph
        for topic in ("/joy", "/teleop_logi/human_in_loop", "/teleop_logi/tele_throt_req",
                      "/teleop_logi/tele_steer_req", "/teleop_logi/scale_button"):
            self.graph.record(topic)
        self._parameters, self._teleop = parameters, teleop or {}

    def start(self, *models):
        self.pads = [self.computer.plug_in(model, 5 + number, f"usb-{number}") for number, model in enumerate(models)]
        self.node = self.graph.add(partial(GamepadJoy, find=self.computer.find, open_device=self.computer.open),
                                   "gamepad_joy", self._parameters)
        self.car.teleop(**self._teleop)
        self.graph.run(1.0)
        return self

    def send(self, *events, pad=0, run_s=0.03):
        self.pads[pad].send(*events)
        self.wake(run_s)

    def wake(self, run_s=0.03):
        device = self.node.node._device
        if device is not None:
            self.graph.readable(device.fileno())
        self.graph.run(run_s)

    def hold(self, button=TL):
        """Let go of a deadman, and hold it."""
        self.send((KEY, button, UP))
        self.send((KEY, button, DOWN))

    def unplug(self, pad):
        self.computer.unplug(pad)
        self.wake(0.0)

    @property
    def joy(self) -> Joy:
        return self.graph.newest("/joy")

    @property
    def human(self) -> bool:
        return self.graph.newest("/teleop_logi/human_in_loop").data

    @property
    def state(self):
        return self.graph.newest("/teleop_logi/state")

    @property
    def throttle(self) -> float:
        return self.graph.newest("/teleop_logi/tele_throt_req").data

    def device(self):
        """Run for 1.2 s; return level and text of the device's report, with its remedy."""
        self.graph.run(1.2)
        report = self.graph.report("gamepad_joy: gamepad device")
        return report.level, ". ".join(filter(None, (report.message, report.values.get("remedy"))))

    def warnings(self) -> str:
        return " ".join(self.graph.lines("/gamepad_joy", level=30))


def test_deadman_counts_until_it_is_released_or_the_gamepad_is_unplugged(tmp_path):
    car = Driven(tmp_path).start(F710_X)
    assert (car.joy.axes, car.joy.buttons) == ((0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 0.0, 0.0), (0,) * 11)
    assert car.joy.header.frame_id == "gamepad: Logitech Gamepad F710"
    assert car.state.cause == causes.NO_DEADMAN
    for pressed in (DOWN, UP, DOWN):
        car.send((KEY, TL, pressed))
        assert car.human == bool(pressed)
    at_ns = car.graph.now_ns
    car.unplug(car.pads[0])
    gone_ns = car.graph.run_until(lambda: not car.human)
    assert gone_ns - at_ns <= NS_PER_S // 4 + 1


def test_reconnected_gamepad_counts_under_another_path_once_the_deadman_was_released(tmp_path):
    car = Driven(tmp_path).start(F710_X)
    car.hold()
    car.unplug(car.pads[0])
    car.graph.run(1.0)
    car.pads = [car.computer.plug_in(F710_X, 9, "usb-0")]  # with the button held, which the kernel doesn't repeat
    car.graph.run(1.0)
    assert car.state.joy_age < 0.1 and not car.human and not any(car.joy.buttons)
    car.send((KEY, TL, UP))
    assert not car.human
    car.send((KEY, TL, DOWN))
    assert car.human


@pytest.mark.parametrize("place, model", [("usb-7", F710_X), ("usb-0", F710_D), ("usb-0", DUALSENSE)],
                         ids=["at_another_port", "its_switch_was_moved_to_d", "another_kind"])
def test_after_a_reconnect_no_other_gamepad_counts_and_the_reason_is_told(tmp_path, place, model):
    car = Driven(tmp_path).start(F710_X)
    car.hold()
    car.unplug(car.pads[0])
    car.graph.run(1.0)
    at_ns = car.graph.now_ns
    car.pads = [car.computer.plug_in(model, 9, place)]
    assert car.device() == (2, ("gamepad: Logitech Gamepad F710 (usb-0), which was read before, is gone; there is "
                            f"/dev/input/event9 ({model.name}). Plug it in at the same place, with its switch as it "
                            "was; to change gamepads start this node again"))
    assert car.graph.messages("/joy", at_ns) == [] and not car.human
    car.graph.nodes["/gamepad_joy"].kill()
    car.start()
    assert car.state.cause == causes.NOT_REARMED or car.state.cause == causes.NO_DEADMAN


def test_two_gamepads_are_refused_until_one_is_chosen_or_left(tmp_path):
    car = Driven(tmp_path).start(F710_X, DUALSENSE)
    assert car.device() == (2, ("gamepad: there are several: /dev/input/event5 (Logitech Gamepad F710), "
                            "/dev/input/event6 (DualSense Wireless Controller). Leave one plugged in, or choose it: "
                            "joy_device:=/dev/input/event5"))
    assert car.graph.recorded["/joy"] == [] and "there are several" in car.warnings()
    car.computer.unplug(car.pads[0])
    assert car.device() == (0, "DualSense Wireless Controller, 8 axes, 13 buttons")


def test_without_a_gamepad_one_is_looked_for_twice_a_second_from_the_first_moment_on(tmp_path, monkeypatch):
    looks, find = [], Computer.find
    car = Driven(tmp_path)
    begin_ns = car.graph.now_ns
    monkeypatch.setattr(Computer, "find", lambda self: looks.append(car.graph.now_ns - begin_ns) or find(self))
    car.start()
    assert looks == pytest.approx([0, NS_PER_S // 2, NS_PER_S], abs=5_000_000)
    assert looks[0] == 0


# --- lost events ---

def test_chosen_one_of_two_gamepads_drives(tmp_path):
    car = Driven(tmp_path, dev="/dev/input/event6").start(F710_X, DUALSENSE)
    car.send((KEY, TL, DOWN), pad=0)
    assert not car.human
    car.send((KEY, TL, DOWN), pad=1)
    assert car.human


def test_lost_events_release_the_deadman_at_once_and_it_must_be_held_again(tmp_path):
    car = Driven(tmp_path).start(F710_X)
    car.hold()
    car.send((ABS, RY, -32768))
    assert car.human and car.throttle == 1.0
    at_ns = car.graph.now_ns
    car.pads[0].lose((ABS, X, 32767), (ABS, RY, 0))  # the button is still held: nobody knows
    car.wake()
    (released,) = [record for record in car.graph.recorded["/teleop_logi/human_in_loop"]
                   if record.at_ns >= at_ns and not record.message.data][:1]
    assert released.at_ns - at_ns <= 1_000_000 and car.throttle == 0.0
    assert (car.joy.axes[0], car.joy.axes[4], any(car.joy.buttons)) == (-1.0, 0.0, False)  # as they are by now
    car.graph.run(1.0)
    assert not car.human
    car.send((KEY, TL, UP))
    assert not car.human
    car.send((KEY, TL, DOWN))
    assert car.human and car.graph.newest("/teleop_logi/tele_steer_req").data == -1.0


def test_gamepad_that_vanishes_while_its_state_is_read_again_is_gone(tmp_path):
    car = Driven(tmp_path).start(F710_X)
    car.hold()
    car.node.node._device._device.absinfo = lambda code: (_ for _ in ()).throw(OSError(19, "No such device"))
    car.pads[0].lose((KEY, TL, UP))
    car.wake()
    assert not car.human and car.device()[0] == 0  # it was opened anew
    assert "the gamepad is gone" in car.warnings()


# --- mappings ---

@pytest.mark.parametrize("model, right_stick, forward, left_shoulder, right_shoulder", [
    (F710_X, RY, -32768, TL, TR), (F710_D, RZ, 0, 0x134, 0x135), (DUALSENSE, RY, 0, TL, TR)],
    ids=lambda value: getattr(value, "name", ""))
def test_known_gamepad_drives_by_its_right_stick_and_shoulders_with_the_shipped_parameters(
        tmp_path, model, right_stick, forward, left_shoulder, right_shoulder):
    car = Driven(tmp_path).start(model)
    car.hold(left_shoulder)
    car.send((ABS, right_stick, forward))
    assert (car.state.cause, car.throttle) == (causes.MANUAL, pytest.approx(1.0, abs=1e-3))
    car.send((ABS, right_stick, (model.ranges[right_stick][0] + model.ranges[right_stick][1] + 1) // 2),
             (KEY, left_shoulder, UP))
    car.send((KEY, right_shoulder, DOWN))
    assert car.state.cause == causes.AUTONOMOUS


def test_unknown_gamepad_drives_nothing_until_it_is_mapped(tmp_path):
    car = Driven(tmp_path).start(UNKNOWN)
    car.hold()
    car.send((KEY, 0x134, DOWN))  # Y, for more speed
    car.send((ABS, RY, -32768))
    assert not any(record.message.data for topic in ("human_in_loop", "scale_button", "tele_throt_req")
                   for record in car.graph.recorded[f"/teleop_logi/{topic}"])
    assert (car.state.cause, car.state.reason) == (
        causes.JOY_UNMAPPED, ("gamepads.yaml has no entry for this gamepad, \"Nobody's Pad, 8 axes, 11 buttons\"; "
        "accepted: an entry of that name"))
    car.graph.run(1.2)
    report = car.graph.report("teleop_logi: gamepad")
    assert report.level == 2 and "Map it: rosrun car_interface map_gamepad FOLDER" in report.message

    (tmp_path / "gamepads.yaml").write_text('"Nobody\'s Pad, 8 axes, 11 buttons": {throttle_axis: 1}\n',
                                            encoding="utf-8")
    (tmp_path / "mapped").mkdir()
    mapped = Driven(tmp_path / "mapped", {"config_folder": str(tmp_path)}).start(UNKNOWN)
    mapped.hold()
    mapped.send((ABS, 1, -32768))
    assert mapped.human and mapped.throttle == 1.0


def test_held_deadman_of_a_gamepad_that_takes_anothers_place_must_be_released_first(tmp_path):
    """As when a driver starts again with another gamepad within joy_timeout."""
    car = Driven(tmp_path).start(F710_X)
    car.hold()
    assert car.human
    message = Joy(axes=[0.0] * 8, buttons=[int(number == LB) for number in range(13)])
    message.header.frame_id = "gamepad: DualSense Wireless Controller"
    car.graph.publish("/joy", message)
    car.graph.run(0.001)
    assert (car.human, car.state.cause) == (False, causes.NOT_REARMED)
    assert car.state.reason.startswith("another gamepad sends; let go of the deadman")


# --- messages ---

def test_axes_are_published_together_buttons_at_once_and_the_state_at_the_asked_rate(tmp_path):
    car = Driven(tmp_path, coalesce_interval=0.05, autorepeat_rate=5, deadzone=0.1).start(DUALSENSE)
    car.graph.run(0.07)
    at_ns = car.graph.now_ns
    car.send((ABS, X, 0), run_s=0.03)
    car.send((ABS, RY, 191), run_s=0.1)
    (record,) = [record for record in car.graph.recorded["/joy"] if record.message.axes[0] == 1.0]
    assert record.at_ns - at_ns == 50_000_000
    assert record.message.axes[4] == pytest.approx(-0.449, abs=1e-3)  # (64 / 127 − 0.1) / 0.9
    assert record.message.header.stamp.to_nsec() == record.at_ns + car.graph.ros_ahead_ns
    at_ns = car.graph.now_ns
    car.send((KEY, TR, DOWN))
    assert car.graph.recorded["/joy"][-1].at_ns == at_ns and car.joy.buttons[RB]
    car.graph.run(2.0)
    times_ns = [each.at_ns for each in car.graph.recorded["/joy"] if each.at_ns >= at_ns]
    assert {after - before for before, after in zip(times_ns, times_ns[1:])} == {NS_PER_S // 5}


def test_state_is_not_repeated_at_a_rate_of_0(tmp_path):
    car = Driven(tmp_path, autorepeat_rate=0).start(F710_X)
    at_ns = car.graph.now_ns
    car.send((KEY, TL, DOWN), run_s=2.0)
    assert [message.buttons[LB] for message in car.graph.messages("/joy", at_ns)] == [1]


def test_nothing_is_published_while_there_is_no_gamepad_and_the_log_and_diagnostics_say_what_to_do(tmp_path):
    car = Driven(tmp_path).start()
    text = ("gamepad: there is none. Plug in the gamepad or its receiver, and switch it on. If it is: rosrun "
            "car_interface doctor tells whether a driver is missing")
    assert car.device() == (2, text)
    (line,) = car.graph.lines("/gamepad_joy", level=30)
    assert line.startswith(text) and car.graph.recorded["/joy"] == []
    plugged = car.computer.plug_in(F710_X)
    assert car.device() == (0, "Logitech Gamepad F710, 8 axes, 11 buttons")
    assert "gamepad on /dev/input/event5: Logitech Gamepad F710, 8 axes, 11 buttons" in car.graph.lines("/gamepad_joy")
    car.unplug(plugged)
    car.graph.run(0.1)
    at_ns = car.graph.now_ns
    level, text = car.device()
    assert (level, car.graph.messages("/joy", at_ns), car.node.is_alive) == (2, [], True)
    assert "the gamepad is gone" in car.warnings()
