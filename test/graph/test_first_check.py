"""first_check and a person with gamepad and keys, on a virtual car on a box whose steering is far from the file's."""
import os
import shutil
from functools import partial

import pytest
from sensor_msgs.msg import Range

from car import CENTER, CONFIG, ESC, ESC_NEUTRAL, STEERING, Car
from car_interface.common.errors import CarInterfaceError
from car_interface.common.vehicle_geometry import SONARS
from car_interface.nodes.first_check import FirstCheckNode
from car_interface.steering.config import load_steering
from car_interface.throttle.config import load_throttle
from test_calibration_drive import CURVATURES, Terminal

REQUESTS = "/av_steer_req"
STRAIGHT = 0.02  # 1/m: a person doesn't see less


class Box(Car):
    """The virtual car on a box, and what a person does and sees there."""

    def __init__(self, tmp_path, live=True, **sim):
        super().__init__()
        self.folder, self.terminal, self.killed = tmp_path / "my_car", Terminal(live), []
        self.terminal.is_closed = lambda: False
        self.terminal.start = lambda: True
        shutil.copytree(CONFIG, self.folder)
        self.graph.record(REQUESTS)
        esc = {"profile": "unverified", "calibration_drive": True}
        self.whole(nodes={"turn_arb": {"config_folder": str(self.folder)}, "pca9685": {"guard": True},
                          "throttle_arb": {"esc": esc},
                          "sim": {"on_box": True, "obstacles": False, "esc_kind": "brake_then_reverse",
                                  "steering_duties": [*CURVATURES], "steering_curvatures": [*CURVATURES.values()],
                                  **sim}})
        self.graph.run(2.5)
        self.vehicle = self.graph.nodes["/car_sim"].node._vehicle

    def begin(self, run_s=0.3):
        self.program = self.graph.add(
            partial(FirstCheckNode, text=self.terminal, keys=self.terminal, kill=self.kill), "first_check")
        self.graph.run(run_s)
        return self

    def kill(self, name):
        """What the launch file does, too: it starts the node again after a second."""
        self.killed.append(name)
        self.graph.nodes[name].kill()
        self.graph.after(1.0, self.graph.nodes[name].start)
        return ""

    @property
    def asks(self):
        return self.terminal.block[0].partition(": ")[2] if self.terminal.block else ""

    def type(self, keys, run_s=0.1):
        for key in keys:
            self.terminal.typed = key
            self.graph.run(run_s)

    def skip_to(self, title):
        self.type("y")
        self.graph.run_until(lambda: self.asks == title or self.terminal.__setattr__("typed", "s"), 20)

    def press_both(self):
        for held in ("manual", "", "autonomous", ""):
            self.pad(**({held: True} if held else {}))
            self.graph.run(0.3)

    def straighten(self):
        """Turn the front wheels until they look straight."""
        self.pad(autonomous=True)
        self.graph.run(0.3)
        while abs(self.vehicle.steered_per_m) > STRAIGHT:
            self.type(">" if self.vehicle.steered_per_m > 0 else "<", 0.2)

    def push(self, throttle, run_s, **held):
        self.pad(**{"manual": True, **held}, throttle=throttle)
        self.graph.run(run_s)

    def turn_wheel(self):
        """Turn the rear wheels by hand: 20 pulses."""
        begun_m = self.vehicle.travel_m
        while self.vehicle.travel_m < begun_m + 20.4 * self.vehicle.config.pulse_m:
            self.vehicle.speed_mps = 0.3
            self.graph.run(0.02)
        self.vehicle.speed_mps = 0.0
        self.graph.run(0.5)

    def hold_hand(self, name):
        self.graph.link(f"/sonar/{name}", sender="/teensy_sensor_hub", loses=lambda data: True)
        self.graph.hold(f"/sonar/{name}", Range(range=1.0), 20, sender="/hand")
        self.graph.run(0.2)
        self.graph.hold(f"/sonar/{name}", Range(range=0.2), 20, sender="/hand")
        self.graph.run_until(lambda: name.replace("_", " ") not in self.asks)
        self.graph.silence(f"/sonar/{name}", sender="/hand")

    def at_rest(self):
        return self.board.counts[:2] == (CENTER, ESC_NEUTRAL)


@pytest.mark.more
def test_whole_conversation_on_a_box_and_its_files_and_page(tmp_path):
    car = Box(tmp_path).begin()
    assert car.asks == "the car on a box"
    car.type("y")
    assert car.asks == "the deadman"
    car.press_both()
    assert car.asks == "the steering's direction"
    car.pad(manual=True, steering=1.0)
    car.graph.run(0.5)
    assert car.vehicle.steered_per_m > 1.0
    car.type("l")

    assert car.asks == "the steering's center"
    car.straighten()
    car.type("\n")
    assert car.asks == "the steering's left end"
    car.type("<" * 18)
    assert car.vehicle.steered_per_m > 0.9
    car.type(">")
    car.type("\n")
    assert car.asks == "the steering's right end"
    car.type(">" * 25)
    assert car.vehicle.steered_per_m < -1.0
    car.type("\n")

    assert car.asks == "the ESC's neutral"
    car.push(0.0, 0.3)
    car.type("+", 0.5)
    assert car.graph.parameter("/throttle_arb/servo/neutral") == 4920
    car.type("-y", 0.5)
    assert car.graph.parameter("/throttle_arb/servo/neutral") == 4915
    assert car.asks == "the throttle's direction"
    car.push(0.5, 0.4)
    assert car.speed_mps > 0.1
    car.type("f")
    assert car.asks == "the ESC's kind"
    car.push(0.5, 0.3)
    car.push(0.0, 0.15)
    car.push(-0.5, 1.5)
    assert car.speed_mps == 0.0
    car.type("1")
    car.push(0.0, 0.7)
    car.push(-0.5, 1.3)
    assert car.speed_mps < -0.1
    car.type("y")
    car.pad()
    car.graph.run_until(lambda: abs(car.speed_mps) < 0.01, 30)
    car.vehicle.speed_mps = 0.0

    for side in ("left", "right"):
        assert car.asks == f"the sensor of the {side} rear wheel"
        car.turn_wheel()
        car.type("\n")
    for name in SONARS:
        assert car.asks == f"the sonar {name.replace('_', ' ')}"
        car.hold_hand(name)
    assert car.asks == "letting go"
    car.push(0.5, 0.5)
    assert car.board.counts[ESC] > ESC_NEUTRAL
    car.push(0.5, 0.2, manual=False)
    assert car.at_rest() and "The ESC got neutral or its brake within 0.1 s" in car.terminal.text
    car.type("y")
    assert car.asks == "unplugging the Teensy"
    car.inject("unplug")
    car.graph.run(1.0)
    assert "It was noticed. Plug it in again" in car.terminal.text
    car.inject("plug")
    car.graph.run_until(lambda: car.asks == "killing the servo board's node")
    car.pad()
    car.graph.run(0.2)
    car.pad(autonomous=True)
    car.graph.run(0.5)
    assert car.vehicle.steered_per_m > 0.2
    car.type("k", 2.5)
    assert car.killed == ["/pca9685"] and abs(car.board.counts[STEERING] - CENTER) <= 1
    assert "and the node is back. Did the front wheels go straight at once?" in car.terminal.text
    car.type("y")

    text = car.terminal.text
    assert "/pca9685_guard reported the center" in text and "to be repaired" not in text
    for line in ("turn_arb.yaml: servo_left 3800 → 38", "turn_arb.yaml: servo_center 5100 → 49",
                 "throttle.yaml: esc/profile unverified → brake_then_reverse", "Y yes, and a page"):
        assert line in text
    answers = [line for line in car.terminal.lines if line.startswith(("fine ", "learned ", " " * 16))]
    assert max(map(len, answers)) < car.terminal.width  # so that the terminal cuts no word
    assert sorted(os.listdir(car.folder)) == sorted(os.listdir(CONFIG))  # nothing is written yet
    car.type("y")
    assert not car.program.is_alive and car.program.fault == ""
    steering = load_steering(str(car.folder / "turn_arb.yaml"))
    assert abs(steering.servo_center - 4980) < 40 and 3850 < steering.servo_left < 3950 and steering.servo_right == 6700
    assert load_throttle(str(car.folder / "throttle.yaml")).esc.profile == "brake_then_reverse"
    page, = car.folder.glob("first_check_*.html")
    assert "<td>have calibrate_esc measure it" in page.read_text(encoding="utf-8")
    assert len(list(car.folder.glob("turn_arb.yaml.bak*"))) == 1 and f"page: {page}" in car.terminal.lines


# --- it steers and stops as any planner ---

def test_it_steers_only_while_the_autonomous_deadman_is_held(tmp_path):
    car = Box(tmp_path).begin()
    car.skip_to("the steering's left end")
    at_ns = car.graph.now_ns
    car.type("<<<")
    assert not car.graph.messages(REQUESTS, at_ns) and car.at_rest()
    car.pad(autonomous=True)
    car.graph.run(0.3)
    car.type("<" * 8)
    assert car.board.counts[STEERING] < CENTER - 20 and car.graph.newest(REQUESTS).data == pytest.approx(0.4)
    car.pad()
    car.graph.run(0.1)
    assert car.at_rest()
    car.graph.run(2.0)
    assert car.graph.newest(REQUESTS).data == 0.0 and car.at_rest()


@pytest.mark.parametrize("end", ["quit", "kill"])
def test_any_exit_leaves_neutral_and_nothing_written(tmp_path, end):
    car = Box(tmp_path).begin()
    car.skip_to("the steering's left end")
    car.pad(autonomous=True)
    car.graph.run(0.3)
    car.type("<" * 8)
    if end == "quit":
        car.type("q")
    else:
        car.program.kill()
    car.graph.run(0.1 if end != "kill" else 0.6)
    assert car.at_rest() and not car.program.is_alive
    car.graph.run(1.0)
    assert car.at_rest() and sorted(os.listdir(car.folder)) == sorted(os.listdir(CONFIG))
    if end == "quit":
        assert car.program.fault == "ended before it was over: nothing is written" and car.terminal.is_restored


@pytest.mark.once
@pytest.mark.parametrize("keys, kept", [("q", 4915), ("en", 4915), ("ey", 4925)], ids=["quit", "no", "yes"])
def test_neutral_that_is_not_written_is_given_back(tmp_path, keys, kept):
    car = Box(tmp_path).begin()
    car.skip_to("the ESC's neutral")
    car.push(0.0, 0.3)
    car.type("++y", 0.4)
    assert car.graph.parameter("/throttle_arb/servo/neutral") == 4925
    car.type(keys, 0.5)
    assert car.graph.parameter("/throttle_arb/servo/neutral") == kept and not car.program.is_alive
    assert load_throttle(str(car.folder / "throttle.yaml")).calibration.neutral == kept
    assert bool(list(car.folder.glob("first_check_*.html"))) == (keys != "q")


@pytest.mark.once
def test_neutral_is_given_back_too_where_only_another_file_can_be_written(tmp_path):
    car = Box(tmp_path).begin()
    car.skip_to("the steering's direction")
    car.pad(manual=True, steering=1.0)
    car.graph.run(0.5)
    car.type("r")
    car.graph.run_until(lambda: car.asks == "the ESC's neutral" or car.terminal.__setattr__("typed", "s"), 20)
    car.push(0.0, 0.3)
    car.type("++y", 0.4)
    (car.folder / "throttle.yaml").unlink()
    car.type("ey", 0.5)
    assert load_steering(str(car.folder / "turn_arb.yaml")).servo_left == 6700
    assert car.graph.parameter("/throttle_arb/servo/neutral") == 4915


@pytest.mark.once
def test_neutrals_are_asked_for_one_after_the_other_and_the_newest_last(tmp_path):
    car, tuned, waiting = Box(tmp_path).begin(), [], []

    def call(service, service_type, request, on_done):
        assert service == "/throttle_arb/servo/set_parameters"
        tuned.append([(each.name, each.value) for each in request.config.ints])
        waiting.append(lambda: on_done(request, ""))
    car.skip_to("the ESC's neutral")
    car.program.inbox.graph.call = call
    car.push(0.0, 0.3)
    car.type("+++", 0.1)
    assert tuned == [[("neutral", 4920)]]
    waiting.pop()()
    car.graph.run(0.2)
    waiting.pop()()
    assert tuned == [[("neutral", 4920)], [("neutral", 4930)]]
    car.type("q", 0.3)
    assert tuned[2:] == [[("neutral", 4915)]]


@pytest.mark.once
def test_neutral_that_throttle_arb_does_not_take_back_in_time_is_told(tmp_path):
    car, asked = Box(tmp_path).begin(), []
    car.skip_to("the ESC's neutral")
    car.program.inbox.graph.call = lambda service, service_type, request, on_done: asked.append(request)
    car.push(0.0, 0.3)
    car.type("+", 0.1)
    car.type("q", 0.1)
    assert [request.config.ints[0].value for request in asked] == [4920, 4915]
    assert "/throttle_arb/servo has not answered: its neutral may still be 4920" in car.graph.lines()


@pytest.mark.once
@pytest.mark.parametrize("frame, buttons, name", [
    ("gamepad: Wireless Controller", 13, "L1"), ("gamepad: Logitech Gamepad F710", 11, "LB"), ("keyboard", 11, "key M"),
    ("", 11, "button 4")])
def test_deadman_is_called_as_on_the_gamepad_or_keyboard_that_sends(tmp_path, frame, buttons, name):
    car = Box(tmp_path).begin()
    car.pad(axes=8, buttons=buttons)
    car.joy_now.header.frame_id = frame
    car.graph.run(0.5)
    car.type("y", 0.3)
    assert f"Hold the manual deadman ({name})." in car.terminal.text


def test_board_s_node_that_cannot_be_killed_is_not_asked_about(tmp_path):
    car = Box(tmp_path)
    car.kill = lambda name: f"{name} runs on another computer"
    car.begin().type("yep")
    assert car.asks == "killing the servo board's node"
    car.pad(autonomous=True)
    car.graph.run(0.5)
    car.type("k", 0.3)
    assert ("not asked killing the servo board's node: it couldn't be killed: /pca9685 runs on another computer"
            in car.terminal.text)


@pytest.mark.once
def test_terminal_that_is_closed_ends_it(tmp_path):
    car = Box(tmp_path).begin()
    car.terminal.read, car.terminal.is_closed = lambda: None, lambda: True
    car.graph.run(0.2)
    assert car.program.fault == "its terminal was closed: nothing is written" and car.at_rest()


def test_car_that_drives_on_the_ground_ends_it(tmp_path):
    car = Box(tmp_path, on_box=False, start=[3.5, 0.0, 0.0]).begin()  # 2.1 m before the wall
    car.skip_to("the throttle's direction")
    car.push(0.4, 0.0)
    car.graph.run_until(lambda: not car.program.is_alive, 10)
    assert car.program.fault.startswith("the car seems to move: what the sonar front_")
    assert car.program.fault.endswith("Nothing is written")


# --- before it asks ---

@pytest.mark.once
def test_without_a_terminal_it_is_refused(tmp_path):
    car = Box(tmp_path)
    car.terminal.start = lambda: False
    with pytest.raises(CarInterfaceError, match="no terminal to ask in"):
        car.begin()


@pytest.mark.once
def test_board_that_is_not_heard_ends_it_with_a_line(tmp_path):
    car = Box(tmp_path)
    car.graph.nodes["/pca9685"].kill()
    for guard in car.board.guards:
        guard.kill()
    car.graph.run(3.0)
    car.begin(9.0)
    assert car.program.fault.startswith("it can't begin: /servo/output")


@pytest.mark.once
def test_where_nothing_can_be_drawn_over_each_question_is_printed_once(tmp_path):
    car = Box(tmp_path, live=False).begin(1.0)
    car.type("y", 1.0)

    def asked():
        return [line for line in car.terminal.lines if " of 20: " in line]
    assert asked() == ["1 of 20: the car on a box", "2 of 20: the deadman"]
    for _ in range(20):
        if "Write the page?" not in car.terminal.text:
            car.type("s")
    car.type("p", 0.2)
    assert asked()[-2:] == ["20 of 20: killing the servo board's node"] * 2
