"""Tuning while the car drives: the nodes with an owner's files, tuned, saved, and started again from the files."""
from __future__ import annotations

import os
import re
import shutil
from pathlib import Path

import pytest
import yaml
from car_interface.msg import SteeringState
from std_msgs.msg import Bool, Float32

from car import CONFIG, ESC, STEERING, Car
from graph import NS_PER_S

LEFT, CENTER, RIGHT, NEUTRAL = 3800, 5100, 6700, 4915
TICK = 5  # duty: 500 per second at 100 Hz
ORDERS = "/servo/cmdVector"


class Tuned:
    """turn_arb, throttle_arb and the servo board, as their launch files start them from a folder."""

    def __init__(self, folder: Path, **steering):
        self.folder, self.car = folder, Car()
        self.graph = graph = self.car.graph
        graph.record(ORDERS, "/servo/neutral")
        self.sends = {"/teleop_logi/human_in_loop": Bool(False), "/teleop_logi/tele_steer_req": Float32(0.0),
                      "/av_turnrad_req": Float32(0.0)}
        for topic in self.sends:
            graph.repeat(topic, lambda topic=topic: self.sends[topic], 20)
        files = self.values("turn_arb.yaml"), self.values("throttle.yaml")
        self.board = self.car.pca9685(steering=files[0], esc=files[1])
        self.steering = self.car.turn_arb(**{**files[0], "save_to": str(folder / "turn_arb.yaml"), **steering})
        self.throttle = self.car.throttle_arb(**files[1], save_to=str(folder / "throttle.yaml"))
        graph.run(2.0)

    def values(self, name):
        return yaml.safe_load((self.folder / name).read_text(encoding="utf-8"))

    def drive(self, teleop=0.0, planner=0.0):
        self.sends["/teleop_logi/human_in_loop"] = Bool(True)
        self.sends["/teleop_logi/tele_steer_req"], self.sends["/av_turnrad_req"] = Float32(teleop), Float32(planner)
        self.graph.run(0.2)

    def release(self):
        self.sends.update({"/teleop_logi/human_in_loop": Bool(False), "/teleop_logi/tele_steer_req": Float32(0.0)})
        self.graph.run(0.2)

    def tune(self, run_s=1.5, **changes):
        answer = self.graph.reconfigure("/throttle_arb/servo" if "neutral" in changes else "/turn_arb", **changes)
        self.graph.run(run_s)
        return answer

    def save(self, node):
        answer = self.graph.call(f"/{node}/save", None)
        return answer.success, answer.message

    def duties(self, channel, since_ns=0):
        return [(record.at_ns, record.message.data[channel]) for record in self.graph.recorded[ORDERS]
                if record.at_ns >= since_ns and record.message.data[channel] >= 0]

    @property
    def steers(self):
        return self.duties(STEERING)[-1][1]

    def backups(self, name):
        return sorted(self.folder.glob(f"{name}.bak-*"))

    def rests(self):
        """Return what the servo board gives both channels when nobody commands them."""
        self.graph.run(1.1)
        return next([int(text) for text in value.value.split()[:2]]
                    for message in reversed(self.graph.messages("/diagnostics")) for status in message.status
                    for value in status.values if value.key == "timeout values")


@pytest.fixture
def folder(tmp_path):
    shutil.copytree(CONFIG, tmp_path / "my_car")
    return tmp_path / "my_car"


def counts(duty):
    return (duty + 8) // 16


def test_center_moved_while_driving_glides_there_and_everything_moves_along(folder):
    tuned = Tuned(folder)
    tuned.drive(planner=300.0)
    assert tuned.steers == CENTER
    at_ns = tuned.graph.now_ns
    assert tuned.tune(servo_center=CENTER + 200)["servo_center"] == CENTER + 200
    duties = tuned.duties(STEERING, at_ns)
    steps = [after - before for (_, before), (_, after) in zip(duties, duties[1:])]
    assert set(steps) <= {0, TICK} and sum(steps) == 200
    moving_ns = [moved_ns for (moved_ns, _), step in zip(duties[1:], steps) if step]
    assert moving_ns[-1] - moving_ns[0] == 39 * NS_PER_S // 100
    state = tuned.graph.newest("/turn_arb/state")
    assert (state.source, state.duty) == (SteeringState.PLANNER, CENTER + 200)
    tuned.graph.run(1.0)
    assert tuned.graph.report("turn_arb: steering").values["tuned live"] == "servo_center 5100 → 5300"
    for radius, duty in ((-300.0, CENTER + 200), (1.0, LEFT), (-1.0, RIGHT)):
        tuned.drive(planner=radius)
        assert tuned.steers == duty
    for request, duty in ((1.0, LEFT), (-1.0, RIGHT), (0.5, (LEFT + CENTER + 200) // 2)):
        tuned.drive(teleop=request)
        assert tuned.steers == duty
    tuned.release()
    assert tuned.steers == CENTER + 200


def test_what_is_beyond_the_limits_is_clamped_and_what_is_impossible_is_refused_and_both_are_said(folder):
    tuned = Tuned(folder, servo_left=5000)  # so near to the center that it can be asked for the other side
    tuned.drive()
    at_ns = tuned.graph.now_ns
    answer = tuned.tune(servo_center=4900, servo_right=6800)
    assert [answer[f"servo_{name}"] for name in ("left", "center", "right")] == [5000, CENTER, RIGHT]
    assert {duty for _, duty in tuned.duties(STEERING, at_ns)} == {CENTER}
    assert tuned.graph.parameter("/turn_arb/servo_right") == RIGHT
    tuned.graph.run(10.0)  # until another warning of the kind may follow
    assert tuned.tune(servo_center=65535)["servo_center"] == 5600 == tuned.steers
    assert tuned.tune(neutral=6000)["neutral"] == NEUTRAL + 100
    warnings = " ".join(tuned.graph.lines(since_ns=at_ns, level=30))
    for text in ("servo_center is 4900; accepted: a duty between servo_left 5000 and servo_right 6800: refused",
                 "servo_center 65535 is beyond 4600 to 5600: clamped to 5600",
                 "neutral 6000 is beyond 4815 to 5015: clamped to 5015"):
        assert text in warnings


def test_servo_board_rests_where_center_and_neutral_were_tuned_to_also_when_it_or_they_start_again(folder):
    tuned = Tuned(folder)
    tuned.tune(servo_center=5200)
    tuned.tune(neutral=NEUTRAL + 40)
    assert NEUTRAL + 40 in [message.data[ESC] for message in tuned.graph.messages("/servo/neutral")]
    assert ("the timeout value of channel 0 follows servo/neutral, away from the YAML file's. To save it: ~save of the "
            "node that was tuned") in tuned.graph.lines("/pca9685")
    tuned.drive(teleop=1.0)
    for node in (tuned.steering, tuned.throttle):
        node.kill()
    at_ns = tuned.graph.now_ns
    tuned.graph.run(1.0)
    assert tuned.car.board.counts[:2] == (counts(5200), counts(NEUTRAL + 40))
    (off_ns, _), = tuned.car.board.since(at_ns, STEERING)
    assert 0.2e9 <= off_ns - at_ns <= 0.25e9
    for node in (tuned.steering, tuned.throttle, tuned.board):
        node.kill()
        node.start()
    assert tuned.rests() == [5200, NEUTRAL + 40]
    tuned.release()
    at_ns = tuned.graph.now_ns
    tuned.drive(planner=300.0)
    assert {duty for _, duty in tuned.duties(STEERING, at_ns)} == {5200}
    assert tuned.duties(ESC)[-1][1] == NEUTRAL + 40


def test_neutral_of_the_esc_glides(folder):
    tuned = Tuned(folder)
    at_ns = tuned.graph.now_ns
    assert tuned.tune(neutral=NEUTRAL + 80)["neutral"] == NEUTRAL + 80
    duties = [duty for _, duty in tuned.duties(ESC, at_ns)]
    assert duties[-1] == NEUTRAL + 80 and {b - a for a, b in zip(duties, duties[1:])} == {0, 2}  # 100 in a second
    assert tuned.graph.report("throttle_arb: throttle").values["tuned live"] == "neutral 4915 → 4995"


def test_saved_values_are_there_at_the_next_start_and_comments_and_old_files_stay(folder):
    tuned = Tuned(folder)
    texts = {path.name: path.read_text(encoding="utf-8") for path in folder.glob("*.yaml")}
    tuned.tune(run_s=0.0, servo_left=3750, servo_center=5150)
    success, message = tuned.save("turn_arb")  # while it glides: what was accepted is saved
    assert success
    assert re.fullmatch(rf"saved to {folder}/turn_arb.yaml, the old one is {folder}/turn_arb.yaml.bak-[\d-]+", message)
    tuned.tune(neutral=NEUTRAL + 35)
    assert tuned.save("throttle_arb")[0]
    steering, throttle = tuned.values("turn_arb.yaml"), tuned.values("throttle.yaml")
    assert [steering[f"servo_{name}"] for name in ("left", "center", "right")] == [3750, 5150, RIGHT]
    for side, end in (("left", 3750), ("right", RIGHT)):
        table = steering[f"k_pwmcmd_{side}_table_servo"]
        assert (table[0], table[-1]) == (end, 5150)
    assert (throttle["servo"]["neutral"], throttle["servo"]["duty_table"]) == (4950, [3312, 4950, 6589])
    for name, text in texts.items():
        now = (folder / name).read_text(encoding="utf-8")
        assert re.findall("#.*", now) == re.findall("#.*", text)
        saved = name in ("turn_arb.yaml", "throttle.yaml")
        assert [path.read_text(encoding="utf-8") for path in tuned.backups(name)] == [text] * saved
        assert (now != text) == saved
    again = Tuned(folder)
    for node in ("turn_arb", "throttle_arb"):
        assert again.graph.parameter(f"/{node}") == tuned.graph.parameter(f"/{node}")
        assert again.save(node)[0]
    assert len([*folder.glob("*.bak-*")]) == 2  # the files say so already
    assert again.rests() == [5150, 4950]
    again.drive(planner=300.0)
    assert (again.steers, again.duties(ESC)[-1][1]) == (5150, 4950)
    assert again.tune(servo_center=9999)["servo_center"] == 5650  # 500 from where it starts


def test_file_that_cannot_be_saved_is_named_and_the_drive_goes_on(folder):
    tuned = Tuned(folder)
    tuned.tune(servo_center=5150)
    path = folder / "turn_arb.yaml"
    path.write_text("a: [1\n", encoding="utf-8")
    success, message = tuned.save("turn_arb")
    assert not success and message.startswith(f"not saved: {path}, line 2 is no YAML: ") and "\n" not in message
    assert path.read_text(encoding="utf-8") == "a: [1\n"
    path.unlink()
    assert "turn_arb.yaml can't be saved (No such file or directory)" in tuned.save("turn_arb")[1]
    assert tuned.backups("turn_arb.yaml") == [] and tuned.steers == 5150


def test_node_without_save_to_saves_nowhere_and_one_without_a_range_tunes_nothing():
    car = Car()
    car.turn_arb(live_range=0)
    car.graph.run(0.1)
    answer = car.graph.call("/turn_arb/save", None)
    assert not answer.success
    assert re.fullmatch("servo_left and .* not saved: the parameter ~save_to names no file", answer.message)
    assert car.graph.reconfigure("/turn_arb", servo_center=5101)["servo_center"] == CENTER


def test_the_package_s_own_files_are_not_saved_to_by_the_demo(tmp_path):
    link = tmp_path / "package"
    link.symlink_to(os.path.dirname(os.path.realpath(CONFIG)))
    for shown in (os.path.realpath(CONFIG), str(link / "config")):
        car = Car()
        car.turn_arb(save_to=f"{shown}/turn_arb.yaml", save_to_package=False)
        car.graph.run(0.1)
        answer = car.graph.call("/turn_arb/save", None)
        assert (answer.success, answer.message) == (False, (
            f"not saved: {shown}/turn_arb.yaml is the package's own, which the demo leaves as it is. Copy the folder "
            f"(cp -r {shown} ~/my_car) and start the demo with config:=$HOME/my_car"))
