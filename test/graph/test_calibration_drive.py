"""calibration_drive and the person with the gamepad, on a virtual car whose steering is far from the shipped table."""
from __future__ import annotations

import math
import os
import re
import shutil
from functools import partial
from types import SimpleNamespace

import pytest
from car_interface.msg import PlannerState, SteeringState
from std_msgs.msg import Float32
from visualization_msgs.msg import Marker

from car import CENTER, CONFIG, ESC, ESC_NEUTRAL, STEERING, Car, config
from car_interface.common.errors import CarInterfaceError
from car_interface.nodes import calibration_drive
from car_interface.nodes.bag_recording import TOPICS
from car_interface.nodes.calibration_drive import CalibrationDriveNode, drive_markers
from car_interface.tools.calibration.drive.conclusion import Conclusion
from car_interface.tools.calibration.drive.config import parse
from car_interface.tools.recordings.calibration_result import CalibrationResult
from graph import NS_PER_S

CURVATURES = {3800: 1.05, 4100: 0.83, 4400: 0.58, 4700: 0.28, 4980: 0.0, 5300: -0.24, 5700: -0.52, 6200: -0.82,
              6700: -1.05}  # by duty, as practice.launch has it
REQUESTS, SPEEDS, MARKERS = "/av_steer_req", "/av_speed_req", "/calibration_drive/markers"
RESULT = "/calibration_drive/result"
HOLD_IT = "no deadman is held; hold the autonomous deadman and it"


class Terminal:
    """What ``LiveText`` and ``Keys`` are to the program: the lines that stay, the block that is drawn, typed keys."""

    width = 79

    def __init__(self, is_live: bool):
        self.is_live, self.lines, self.block, self.shown, self.typed = is_live, [], [], [], ""

    def start(self):
        return self.is_live

    def read(self):
        typed, self.typed = self.typed, ""
        return typed

    def restore(self):
        self.is_restored = True

    def show(self, lines):
        self.block = list(lines)
        self.shown += lines

    def say(self, text):
        self.lines += text.split("\n")

    def keep(self):
        self.lines, self.block = self.lines + self.block, []

    @property
    def text(self):
        return " ".join(" ".join([*self.lines, *self.block]).split())


class Recording:

    has_ended = is_ending = False
    _left = 3

    def __init__(self, car, folder, topics, stem):
        self.graph, self.topics, self.path = car.graph, topics, os.path.join(folder, f"{stem}_recorded.bag")
        self.begun_ns = car.graph.now_ns
        car.recording = self

    def has_subscribed(self, topic):
        return topic in self.topics and self.graph.now_ns - self.begun_ns > NS_PER_S

    def end(self):
        self.is_ending, self.closed_ns = True, self.graph.now_ns

    def report(self):
        self._left -= self.is_ending
        return None if self._left else [f"recording: {self.path}", "report: page"]

    def stop(self):
        self.has_ended = True
        return self.path


class Practice(Car):
    """The car of practice.launch, and what a person does to calibrate it."""

    def __init__(self, tmp_path, *arguments, live=True, starts=True, **sim):
        super().__init__()
        self.folder, self.table, self.terminal = tmp_path, tmp_path / "turn_arb.yaml", Terminal(live)
        self.graph.record(REQUESTS, SPEEDS, MARKERS, RESULT)
        if starts:
            self.whole("speed", steering_duties=[*CURVATURES], steering_curvatures=[*CURVATURES.values()],
                       **{"obstacles": False, "start": [0.0, 0.0, 0.0], **sim})
            self.graph.set_parameter("/throttle_arb/sonar_hub", config("sonars.yaml"))
            self.graph.run(2.0)
        self.arguments = arguments

    def begin(self, run_s=4.0):
        wanted = parse(["-o", str(self.table), *self.arguments])
        self.program = self.graph.add(
            partial(CalibrationDriveNode, wanted, text=self.terminal, keys=self.terminal,
                    make_recording=partial(Recording, self)), "calibration_drive")
        self.graph.run(run_s)
        return self

    def wait_for(self, pattern, within_s=60.0):
        self.graph.run_until(lambda: re.search(pattern, self.terminal.text), within_s)
        return re.search(pattern, self.terminal.text)

    def hold(self):
        """Hold the autonomous deadman until the car drives and steers."""
        self.pad(autonomous=True)
        self.graph.run_until(lambda: self.board.counts[STEERING] != CENTER and self.speed_mps > 0.3, 20)

    def rests_after_s(self):
        """How long it takes until steering and ESC are at rest."""
        at_ns = self.graph.now_ns
        return (self.graph.run_until(lambda: self.board.counts[:2] == (CENTER, ESC_NEUTRAL), 3.0) - at_ns) / NS_PER_S

    def type(self, keys, run_s=0.1):
        self.terminal.typed = keys
        self.graph.run(run_s)

    def marker(self, ns, index=0):
        return next(one for one in self.graph.newest(MARKERS).markers
                    if (one.ns, one.id, one.action) == (ns, index, Marker.ADD))


def ended(car):
    """Run until the program has ended; return what it said at its end."""
    car.graph.run_until(lambda: not car.program.is_alive, 5.0)
    assert car.terminal.is_restored
    return car.program.fault


# --- before it drives ---

def test_car_that_is_not_launched_is_told_so(tmp_path):
    with pytest.raises(CarInterfaceError, match="turn_arb's calibration isn't known: its parameter servo_left is "
                                               "missing"
                                                r".* Is the car launched, and in this namespace \(ROS_NAMESPACE\)\?"):
        Practice(tmp_path, starts=False).begin()


@pytest.mark.parametrize("arguments, text", [
    (["--output", f"{os.path.realpath(CONFIG)}/turn_arb.yaml"],
     "is the package's own: name a file of your car's by -o"),
    (["--radius", "1"], "radius is 1.0; accepted: a number from 2.5 to 100")])
def test_package_s_own_files_and_bad_options_are_named(tmp_path, arguments, text):
    with pytest.raises(CarInterfaceError, match=text):
        Practice(tmp_path, *arguments).begin()


def test_all_that_is_missing_and_another_program_that_steers_are_listed_with_the_remedy_after_8_s(tmp_path):
    car = Practice(tmp_path, starts=False)
    for node, values in (("turn_arb", config("turn_arb.yaml")),
                         ("throttle_arb", {**config("throttle.yaml"), "sonar_hub": config("sonars.yaml")})):
        car.graph.set_parameter(f"/{node}", values)
    car.graph.repeat("/planner_interface/state", PlannerState(source="drive"), 10)
    car.graph.repeat("/av_turnrad_req", Float32(math.inf), 5, sender="/other")
    begun_ns = car.graph.now_ns
    car.begin()
    assert car.terminal.block[0].startswith("waits: turn_arb isn't heard")
    assert ended(car).startswith("it can't begin: these are missing, see above")
    assert 8.0 < car.seconds_since(begun_ns) <= 8.02
    for what in ("turn_arb isn't heard", "/servo/output isn't heard", "there is no odometry on odom",
                 "throttle_arb isn't heard", "planner_interface obeys drive, not speeds", "no range of the sonars",
                 "teleop_logi isn't heard", "/other publishes /av_turnrad_req, too: end it"):
        assert f"- {what}" in car.terminal.text
    assert max(len(line) for line in car.terminal.lines if line.startswith("  ")) < 80
    assert os.listdir(tmp_path) == []


def test_gamepad_that_is_off_is_waited_for(tmp_path):
    car = Practice(tmp_path)
    car.graph.link("/joy", loses=lambda data: True)
    car.graph.run(1.0)
    car.begin(10.0)
    assert car.terminal.block[0].startswith("waits: the gamepad isn't there (joy silent for")
    assert not hasattr(car, "recording")
    assert "F: finish now with what is known. Q: give up." in car.terminal.lines
    car.graph.link("/joy")
    car.wait_for(f"^.*waits: {HOLD_IT} begins")
    car.type("q")
    assert ended(car) == "ended before it was over: nothing is written"


# --- the drive ---

@pytest.mark.more
def test_it_drives_while_the_deadman_is_held_and_only_then_and_refuses_what_is_too_little(tmp_path):
    car = Practice(tmp_path, "--no-sonars").begin()
    graph = car.graph
    assert car.terminal.block[0] == f"waits: {HOLD_IT} begins"
    assert sorted(car.recording.topics) == sorted(topic if topic.startswith("/") else f"/{topic}"
                                                  for topic in (*TOPICS, RESULT))
    assert graph.recorded[REQUESTS] == graph.recorded[SPEEDS] == []
    car.hold()
    assert graph.newest("/turn_arb/state").source == SteeringState.PLANNER
    assert graph.newest("/turn_arb/state").reason.startswith("av_steer_req is")
    assert re.match("it (measures|steers to|turns back) ", car.terminal.block[0])
    points = car.marker("area").points
    assert {round(math.hypot(point.x - points[18].x, point.y - points[0].y), 2) for point in points} == {3.0}
    at_ns = graph.now_ns + 1
    graph.run(1.0)
    assert len(graph.messages(REQUESTS, at_ns)) == len(graph.messages(SPEEDS, at_ns)) == 50
    car.pad()
    assert car.rests_after_s() <= 0.05
    rest_ns = graph.now_ns + 1
    graph.run(1.0)
    assert car.terminal.block[0] == f"paused: {HOLD_IT} goes on"
    others = [graph.repeat(topic, Float32(1.0), 20, sender="/other") for topic in (REQUESTS, SPEEDS)]
    graph.run(2.0)
    assert car.board.counts[:2] == (CENTER, ESC_NEUTRAL) and car.speed_mps == 0.0
    assert car.board.since(rest_ns, STEERING) == car.board.since(rest_ns, ESC) == []  # nobody else is obeyed either
    assert {record.sender for record in graph.recorded[REQUESTS] if record.at_ns > rest_ns} == {"/other"}
    for end in others:
        end()
    graph.run(1.0)
    car.hold()
    assert re.match("it (measures|steers to|turns back) ", car.terminal.block[0])
    car.type("f", 0.03)
    assert graph.newest(SPEEDS).data == 0.0
    assert re.search(r"ended by hand after \d+ s\. You can let go\. Calibrating", car.terminal.text)
    samples = car.program.node._drive.samples.drive()
    done_ns = graph.now_ns
    fault = ended(car)
    # The end of the asking is no fault of the recorded drive.
    assert {record.message.source for record in graph.recorded["/turn_arb/state"]
            if done_ns <= record.at_ns <= car.recording.closed_ns} == {SteeringState.PLANNER}
    assert fault.startswith("no calibration is written: ")
    assert len(samples.t_s) > 50
    graph.run(3.0)
    assert car.speed_mps == 0.0 and not graph.messages(REQUESTS, car.recording.closed_ns + 1)  # though it is still held
    assert f"recording: {car.recording.path}" in car.terminal.lines and "report: page" in car.terminal.lines
    assert [marker.action for marker in graph.newest(MARKERS).markers] == [Marker.DELETEALL]
    assert os.listdir(tmp_path) == []


@pytest.mark.once
@pytest.mark.parametrize("end", ["end", "kill"])
def test_program_that_ends_or_is_killed_leaves_a_car_that_stops(tmp_path, end):
    car = Practice(tmp_path, "--no-sonars").begin()
    car.hold()
    getattr(car.program, end)()
    assert 0.48 <= car.rests_after_s() <= 0.52
    rest_ns = car.graph.now_ns + 1
    car.graph.run(3.0)
    assert car.speed_mps == 0.0 and car.board.since(rest_ns, STEERING) == []
    if end == "end":
        assert car.program.fault == "ended before it was over: nothing is written"
        assert car.graph.newest(SPEEDS).data == 0.0
        assert car.terminal.lines[-1] == f"recording: {car.recording.path}" and car.recording.has_ended
        assert [marker.action for marker in car.graph.newest(MARKERS).markers] == [Marker.DELETEALL]


@pytest.mark.once
def test_person_with_the_stick_is_told_where_to_hold_it_and_nothing_is_asked_for(tmp_path):
    car = Practice(tmp_path, "--stick").begin()
    assert car.terminal.block[0].startswith("no deadman is held; hold the manual deadman")
    for sticks, texts in (
            ((0.0, 0.0), ["drive slowly, about 1 m/s, with the stick at 100% left"]),
            ((0.5, 0.45), ["hold the stick still at 100% left", "hold at 100% left; it is at 50% left"]),
            ((1.0, 0.45), ["hold 100% left: ", "s more at this speed"])):
        car.pad(manual=True, steering=sticks[0], throttle=sticks[1])
        car.graph.run(2.5)
        assert all(text in car.terminal.text for text in texts), car.terminal.block
        bar = next(line for line in car.terminal.block if line.startswith("left |"))
        assert re.match({0.0: r"left \|V-+o-+\| right", 0.5: r"left \|V-+o-+\+-+\| right",
                         1.0: r"left \|X-+\+-+\| right"}[sticks[0]], bar)
        if sticks[0] == 0.5:
            assert car.marker("text").text == "0%, hold the stick still at\n100% left"
    assert car.graph.recorded[REQUESTS] == car.graph.recorded[SPEEDS] == []
    car.type("q")
    assert ended(car) == "ended before it was over: nothing is written"


@pytest.mark.once
def test_without_a_terminal_there_are_plain_lines_of_what_it_waits_for_and_does(tmp_path):
    car = Practice(tmp_path, "--no-sonars", live=False).begin()
    car.hold()
    car.graph.run(10.5)
    car.pad()
    car.graph.run(1.0)
    lines = [line for line in car.terminal.lines if re.match(r" +\d+%", line)]
    assert re.match("  0%, 0:00 driven, about 4:00 left; waiting: .* hold the autonomous deadman ", lines[0])
    driven = re.compile(r" +\d+%, \d:\d\d driven, .* left; (settling|measuring|turning): ")
    assert all(driven.match(line) for line in lines[1:-1])
    assert 2 <= len(lines[1:-1]) <= 3  # at each change, and each 10 s
    assert re.match(f".* left; paused: {HOLD_IT} goes on", lines[-1])
    assert car.terminal.block == [] and "F: finish" not in car.terminal.text  # there are no keys


# --- its end ---

@pytest.mark.once
@pytest.mark.parametrize("arguments, live, key, replaces", [
    ((), True, "y", True), ((), True, "n", False), (("--yes",), True, "", True), ((), False, "", False)],
    ids=["yes", "no", "yes_by_option", "without_a_terminal"])
def test_table_that_is_there_is_replaced_after_a_question_or_the_new_one_is_written_beside_it(
        tmp_path, monkeypatch, arguments, live, key, replaces):
    shutil.copy(f"{CONFIG}/turn_arb.yaml", tmp_path)
    old = (tmp_path / "turn_arb.yaml").read_text(encoding="utf-8")
    new = old.replace("servo_center: 5100", "servo_center: 5050")
    result = CalibrationResult("", (), (), (), (), (), (5100, 5050), (), (), ())
    conclusion = Conclusion(new, ("it is so",), "", result=result)
    monkeypatch.setattr(calibration_drive, "conclude", lambda *_: conclusion)
    car = Practice(tmp_path, "--no-sonars", *arguments, live=live).begin()
    car.hold()
    car.program.node._drive.finish()
    car.terminal.width = 400
    car.graph.run(0.3)
    if key:
        assert f"Replace {car.table}? The old one is kept beside it. Y: yes, N: no" in car.terminal.text
        car.graph.run_until(lambda: car.speed_mps == 0.0)
        assert car.program.is_alive
        car.type("x")
        car.type(key)
    assert ended(car) == ""
    path = car.table if replaces else tmp_path / "turn_arb.new.yaml"
    (told,) = car.graph.messages(RESULT)
    assert RESULT in car.recording.topics
    assert (f"mv {tmp_path / 'turn_arb.new.yaml'} {car.table}" in told.data) != (arguments == ("--yes",))
    assert path.read_text(encoding="utf-8") == new
    (kept,) = [each for each in tmp_path.glob("turn_arb.yaml*") if each.read_text(encoding="utf-8") == old]
    assert (kept != car.table) == replaces
    taken = f"{car.table} is as it was. To take the new one: mv {path} {car.table}"
    assert (taken in car.terminal.lines) != replaces
    for text in ("it is so", f"written: {path}", f"to load it, launch again with config:={tmp_path}",
                 "the servo board centers the steering by the same file (duty 5050)", "recording: ", "report: page"):
        assert text in car.terminal.text
    progress = car.terminal.shown if live else car.terminal.lines
    assert "makes the recording's page: 0 s" in progress
    assert car.terminal.block == []


@pytest.mark.once
def test_picture_has_an_arc_for_each_radius_that_can_be_told_from_straight_on():
    points = [SimpleNamespace(radius_m=radius_m, is_known=True) for radius_m in (1.0, 40.0, 41.0)]
    arcs = [marker for marker in drive_markers("odom", "base_link", None, [], 2.0, {"left": points}, "").markers
            if marker.ns == "known"]
    assert [marker.id for marker in arcs] == [0, 1]
    assert [len(marker.points) for marker in arcs] == [17, 17]
    assert [(marker.scale.x, marker.scale.y, marker.scale.z) for marker in arcs] == [(0.02, 0.0, 0.0)] * 2


def test_without_a_recorder_it_drives_all_the_same(tmp_path, monkeypatch):
    monkeypatch.setattr(Recording, "has_subscribed", lambda *_: False)
    car = Practice(tmp_path, "--no-sonars").begin()
    assert "no recording" not in car.terminal.text
    car.pad(autonomous=True)
    car.wait_for("no recording: rosrun rosbag record doesn't run; the calibration doesn't need it", 12.0)
    assert 14.9 < car.seconds_since(car.recording.begun_ns) < 15.1
    car.hold()
