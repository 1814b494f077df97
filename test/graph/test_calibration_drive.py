"""calibration_drive and the person with the gamepad, on a virtual car whose steering is far from the shipped table."""
from __future__ import annotations

import math
import os
import random
import re
import shutil
from functools import partial

import pytest
import yaml
from std_msgs.msg import Float32
from visualization_msgs.msg import Marker

from bags import write_bag
from car import CENTER, CONFIG, ESC, ESC_NEUTRAL, STEERING, Car, config
from car_interface.calibration.drive import options
from car_interface.cli import main as cli
from car_interface.common.errors import CarInterfaceError
from car_interface.common.units import yaw_rad
from car_interface.msg import PlannerState, SteeringState
from car_interface.nodes import calibration_drive
from car_interface.nodes.calibration_drive import CalibrationDriveNode
from car_interface.ros.drive_topics import TOPICS
from graph import NS_PER_S

COUNT = 16  # of duty
CURVATURES = {3800: 1.05, 4100: 0.83, 4400: 0.58, 4700: 0.28, 4980: 0.0, 5300: -0.24, 5700: -0.52, 6200: -0.82,
              6700: -1.05}  # by duty, as practice.launch has it
REQUESTS, SPEEDS, MARKERS = "/av_steer_req", "/av_speed_req", "/calibration_drive/markers"
HOLD_IT = "no deadman is held; hold the autonomous deadman and it"


class Terminal:
    """What ``LiveText`` and ``Keys`` are to the program: the lines that stay, the block that is drawn, typed keys."""

    width = 79

    def __init__(self, is_live: bool):
        self.is_live, self.lines, self.block, self.typed = is_live, [], [], ""

    def start(self):
        return self.is_live

    def read(self):
        typed, self.typed = self.typed, ""
        return typed

    def restore(self):
        self.is_restored = True

    def show(self, lines):
        self.block = list(lines)

    def say(self, text):
        self.lines += text.split("\n")

    def keep(self):
        self.lines, self.block = self.lines + self.block, []

    @property
    def text(self):
        """All in one line."""
        return " ".join(" ".join([*self.lines, *self.block]).split())


class Recording:
    """What ``BagRecording`` is: the graph's messages, written when it is stopped; and its page."""

    has_ended = False

    def __init__(self, car, folder, topics, stem):
        self._car, self.topics, self.path = car, topics, os.path.join(folder, f"{stem}_recorded.bag")
        self.begun_ns = car.graph.now_ns
        car.recording = self
        car.graph.record(*topics)

    def has_subscribed(self, topic):
        return topic in self.topics and self._car.graph.now_ns - self.begun_ns > NS_PER_S

    def stop(self):
        self.has_ended = True
        return self.path


class Page:
    """What ``BagPage`` is."""

    def __init__(self, recording):
        self._recording, self._left = recording, 3

    def step(self):
        self._left -= 1
        return None if self._left else [f"recording: {self._recording.path}", "report: page"]

    def close(self):
        self._recording.stop()


class Practice(Car):
    """The car of practice.launch, and what a person does to calibrate it."""

    def __init__(self, tmp_path, *arguments, live=True, starts=True, **sim):
        super().__init__()
        self.folder, self.table, self.terminal = tmp_path, tmp_path / "turn_arb.yaml", Terminal(live)
        self.graph.record(REQUESTS, SPEEDS, MARKERS)
        if starts:
            self.whole("speed", steering_duties=[*CURVATURES], steering_curvatures=[*CURVATURES.values()],
                       **{"obstacles": False, "start": [0.0, 0.0, 0.0], **sim})
            self.graph.set_parameter("/throttle_arb/sonar_hub", config("sonars.yaml"))
            self.graph.run(2.0)
        self.arguments = arguments

    def begin(self, run_s=4.0):
        """Start the program."""
        wanted = options.parse(["-o", str(self.table), *self.arguments])
        self.program = self.graph.add(
            partial(CalibrationDriveNode, wanted, text=self.terminal, keys=self.terminal, make_page=Page,
                    make_recording=partial(Recording, self)), "calibration_drive")
        self.graph.run(run_s)
        return self

    def wait_for(self, pattern, within_s=60.0):
        """Run until the terminal shows it; return the match."""
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

    def check_table(self, path, within=0.08):
        """Hold a table against the car's true steering."""
        table = yaml.safe_load(path.read_text(encoding="utf-8"))
        assert abs(table["servo_center"] - 4980) < 2 * COUNT
        for side, name in ((1, "left"), (-1, "right")):
            for radius_m, duty in zip(table["m_turnrad_axis_servo"], table[f"k_pwmcmd_{name}_table_servo"]):
                if 1.0 < radius_m < 5.0:
                    assert abs(side * radius_m * curvature_of(duty) - 1) < within, (side, radius_m, duty)

    def type(self, keys, run_s=0.1):
        self.terminal.typed = keys
        self.graph.run(run_s)

    def marker(self, ns, index=0):
        return next(one for one in self.graph.newest(MARKERS).markers
                    if (one.ns, one.id, one.action) == (ns, index, Marker.ADD))


def curvature_of(duty):
    duties = sorted(CURVATURES)
    low = max(index for index in range(len(duties) - 1) if duties[index] <= duty)
    ratio = (duty - duties[low]) / (duties[low + 1] - duties[low])
    return (1 - ratio) * CURVATURES[duties[low]] + ratio * CURVATURES[duties[low + 1]]


def test_whole_drive_by_the_autonomous_deadman(tmp_path):
    import time
    shutil.copy(f"{CONFIG}/turn_arb.yaml", tmp_path)
    car = Practice(tmp_path).begin()
    print(car.terminal.text)
    car.pad(autonomous=True)
    began = time.process_time()
    for _ in range(60):
        car.graph.run(10.0)
        print(round(time.process_time() - began, 1), car.terminal.block[-8:])
        if "Replace" in car.terminal.text:
            break
    car.type("y", 5.0)
    print(car.terminal.lines)
    print(car.program.fault)
    car.check_table(car.table)
    assert False
