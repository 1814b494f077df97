"""The demo's scripted drive, on the package's own files and on those of another car, and the walls of its room."""
import sys
from functools import partial
from pathlib import Path

import pytest
from std_msgs.msg import Bool, Int32MultiArray

import car as cars
import demo_drive
from car import Car, config
from demo_drive import DemoDrive
from demo_script import DriveConfig
from graph import Graph

sys.path.append(str(Path(__file__).parents[1]))
from another_car import copy_another_car

FORWARD, REVERSE, STRAIGHT = 5500, 4300, 5070
WALL_M, NOSE_M = 6.0, 0.426  # the room's, along x; from the rear axle


def files_of_a_car():
    return {"steering": config("turn_arb.yaml"), "esc": config("throttle.yaml"),
            "wheels": config("teensy_sensor_hub.yaml")}


class Demo(Car):
    """The car of demo.launch, and its drive."""

    def __init__(self, without=(), **sim):
        super().__init__(Graph())
        files = files_of_a_car()
        self.pca9685()
        self.sim(**sim)
        for start in (self.hub, self.turn_arb, self.converter, self.throttle_arb, self.teleop):
            if start.__name__ not in without:
                start()
        del files["steering"]
        self.drive = self.graph.add(DemoDrive, "demo_drive", {**files, "gamepad": config("teleop_logi.yaml")})

    def drives(self):
        """Run until the drive is over; return what ended it, if it failed."""
        self.graph.run_until(lambda: not self.drive.is_alive, 90.0)
        return self.drive.fault


@pytest.fixture
def another_car(tmp_path, monkeypatch):
    copy_another_car(Path(cars.CONFIG), tmp_path / "mine")
    monkeypatch.setattr(cars, "CONFIG", str(tmp_path / "mine"))


@pytest.mark.once
def test_drive_of_a_car_that_differs_in_everything_goes_as_planned(another_car, capsys):
    demo = Demo(**files_of_a_car())
    demo.graph.run_until(lambda: demo.board.counts[6] * 16 > 6000, 30.0)  # the human's circle, to the left
    assert demo.drives() == ""
    shown = capsys.readouterr().out
    assert "as planned: yes" in shown and "frames good, bad" in shown
    assert not [line for line in demo.graph.lines(level=30) if "ran into" in line or "tipped" in line]


@pytest.mark.once
def test_drive_that_somebody_stops_has_failed_and_says_why_and_that_the_computer_stood_still(monkeypatch):
    monkeypatch.setattr(demo_drive, "DriveConfig", partial(DriveConfig, nobody_s=3.0, max_turn_s=2.0, let_go_s=1.0))
    demo = Demo()
    demo.graph.run(5.0)
    demo.graph.repeat("/e_stop", Bool(True), 10)
    demo.graph.run(0.5)
    demo.drive.stall(0.7, frozen=True)
    stopped = "all the time (e_stop is true)"
    assert demo.drives() == "the drive didn't go as planned: " + "; ".join((
        f"the human didn't steer {stopped}", f"the human didn't drive {stopped}", "the human's circle wasn't closed",
        f"the planner didn't steer {stopped}", f"the planner didn't drive {stopped}",
        "the left circle wasn't closed", "the right circle wasn't closed",
        ("this computer stood still for 0.7 s meanwhile, which a car takes for a person who is gone: end other "
         "programs, and start the demo again")))


@pytest.mark.once
def test_car_that_is_not_ready_is_given_up_after_30_s_and_what_is_missing_is_named():
    demo = Demo(without=("hub",))
    begun_ns = demo.graph.now_ns
    assert demo.drives() == "the car isn't ready: nothing from odom, the Teensy's link"
    assert 30.0 < demo.seconds_since(begun_ns) <= 30.1


@pytest.mark.once
def test_drive_that_is_ended_before_it_is_over_has_failed():
    demo = Demo()
    demo.graph.run(10.0)
    demo.drive.end()
    assert demo.drive.fault == "the drive was ended before it was over"


# --- car_sim's room ---

def test_wall_stops_the_car_which_is_counted_and_logged_once_and_it_backs_out():
    car, duties = Car(), [STRAIGHT, FORWARD] + [-1] * 14
    car.graph.record("/car_sim/collisions")
    car.pca9685()
    car.sim(start=[4.5, 0, 0])
    car.graph.repeat("/servo/cmdVector", lambda: Int32MultiArray(data=duties), 50)

    def x_m():
        return car.truth().pose.pose.position.x
    car.graph.run(5.0)
    assert (car.speed_mps, x_m()) == (0.0, pytest.approx(WALL_M - NOSE_M, abs=0.01))
    (line,) = [line for line in car.graph.lines("/car_sim", level=30) if "ran into something" in line]
    assert line.endswith("and stands, its wheels stalled (collision 1): drive it out the way it came")
    duties[1] = REVERSE
    car.graph.run_until(lambda: x_m() < 5.0)
    assert [message.data for message in car.graph.messages("/car_sim/collisions")] == [0, 1]
