"""A person's hands on the gamepad of a virtual car that a planner drives: who has which actuator, and what it does."""
import re

import pytest
from car_interface.msg import SteeringState, ThrottleState
from std_msgs.msg import Float32

from car import THIRD, Car

SPEED_MPS, RADIUS_M = 1.5, 5.0
HOLD_S = 0.5
NOISE_MPS = 0.02
DEADMEN = [{"autonomous": True}, {"third": True}]  # the third one: the human steers
TELEOP, PLANNER = ThrottleState.TELEOP, ThrottleState.PLANNER


class Drive:
    """A whole car whose ESC is known, its planner, and two hands."""

    def __init__(self):
        self.car = Car()
        self.graph, self.pad = self.car.graph, self.car.pad
        self.car.whole("speed", {"throttle_arb": {"esc": {"profile": "brake_then_reverse"}},
                                 "teleop": {"third_button": THIRD}},
                       esc_kind="brake_then_reverse", obstacles=False, collisions=False)
        self.ask(0.0)
        self.graph.run(2.5)  # for the ESC, and for the e-stop

    def ask(self, speed_mps):
        """Have the planner drive on a circle to the left."""
        self.graph.hold("/av_turnrad_req", Float32(RADIUS_M), 20)
        self.graph.hold("/av_speed_req", Float32(speed_mps), 20)

    def hold(self, lasts_s=0.1, **what):
        self.pad(**what)
        self.graph.run(lasts_s)

    def press(self, **what):
        """The same, after all deadmen were let go."""
        self.hold(**{name: value for name, value in what.items() if name not in ("manual", "autonomous", "third")})
        self.hold(**what)

    def drive(self, **deadman):
        """Let the planner drive, until it does."""
        self.ask(SPEED_MPS)
        self.press(**deadman or {"autonomous": True})
        self.graph.run_until(lambda: self.speed > 0.9 * SPEED_MPS)
        assert self.throttle.source == PLANNER

    @property
    def speed(self):
        return self.car.speed_mps

    def speeds(self, since_ns):
        return [message.twist.twist.linear.x for message in self.graph.messages("/car_sim/truth", since_ns)]

    @property
    def steering(self):
        return self.graph.newest("/turn_arb/state")

    @property
    def throttle(self):
        return self.graph.newest("/throttle_arb/state")

    def logged(self, node, pattern, since_ns):
        return any(re.search(pattern, line) for line in self.graph.lines(f"/{node}", since_ns))


@pytest.fixture
def drive():
    return Drive()


# --- the throttle ---

@pytest.mark.parametrize("deadman", DEADMEN, ids=["autonomous", "third"])
def test_pull_brakes_under_each_planner_s_deadman_and_the_planner_gets_it_back(drive, deadman):
    drive.drive(**deadman)
    pulled_ns = drive.graph.now_ns
    drive.pad(throttle=-1.0, **deadman)
    braked_ns = drive.graph.run_until(lambda: drive.throttle.esc == "BRAKING")
    assert braked_ns - pulled_ns <= 20_000_000 + 1_000_000  # the gamepad's period, and the report's delay
    assert (drive.throttle.source, drive.throttle.cause, drive.throttle.asked) == (TELEOP, "override", -1.0)
    drive.graph.run_until(lambda: drive.speed == 0.0)
    assert drive.logged("teleop_logi", r"the throttle stick overrides the planner by -1\.00", pulled_ns)
    assert drive.logged("throttle_arb", r"^TELEOP: tele_throt_req is -1\.000, .*it overrides the planner", pulled_ns)
    centered_ns = drive.graph.now_ns
    drive.pad(**deadman)
    back_ns = drive.graph.run_until(lambda: drive.throttle.source == PLANNER)
    assert HOLD_S <= (back_ns - centered_ns) / 1e9 <= HOLD_S + 0.08
    drive.graph.run_until(lambda: drive.speed > 0.5)
    assert min(drive.speeds(pulled_ns)) > -NOISE_MPS


# --- the steering ---

@pytest.mark.more
def test_stick_steers_while_the_planner_drives_on_and_half_a_second_longer(drive):
    drive.drive()
    assert drive.steering.source == SteeringState.PLANNER
    since_ns = drive.graph.now_ns
    drive.hold(0.15, autonomous=True, steering=-0.8)
    assert (drive.steering.source, drive.steering.reason) == (
        SteeringState.TELEOP, "tele_steer_req is -0.800: it overrides the planner")
    assert drive.steering.turn_radius < 0 and drive.steering.duty == 6380
    assert drive.logged("teleop_logi", r"the steering stick overrides the planner by -0\.80", since_ns)
    centered_ns = drive.graph.now_ns
    drive.pad(autonomous=True)
    back_ns = drive.graph.run_until(lambda: drive.steering.source == SteeringState.PLANNER)
    assert HOLD_S <= (back_ns - centered_ns) / 1e9 <= HOLD_S + 0.08
    assert {state.source for state in drive.graph.messages("/throttle_arb/state", since_ns)} == {PLANNER}


# --- stop and go ---

def fires(distances, sequence):
    """Whether the newest reports are of the sonars of a sequence, twice in its order."""
    sensors = [record.message.sensor for record in distances[-3 * len(sequence):]]
    return any(sensors[begin:begin + 2 * len(sequence)] == 2 * sequence for begin in range(len(sequence)))


@pytest.mark.once
def test_car_sets_off_again_after_each_stop_with_odometry_and_all_sonars_while_it_stands():
    """The throttle needs odometry that is not older than half a second. Sonars ahead fire more often as it drives."""
    ahead, everywhere = [1, 0, 1, 2, 1, 4], list(range(6))
    car = Car()
    graph = car.graph
    graph.record("/odom", "/teensy_distance")
    car.whole("speed", {"hub": {"sonar_sequence_ahead": ahead}}, obstacles=False, collisions=False)
    graph.hold("/av_turnrad_req", Float32(300.0), 20)
    graph.run(2.5)
    car.pad(autonomous=True)
    for speed_mps in (1.5, 0.0, 1.5):
        graph.hold("/av_speed_req", Float32(speed_mps), 20)
        graph.run_until(lambda speed_mps=speed_mps: abs(car.speed_mps - speed_mps) < 0.1, 6.0)
        graph.run_until(lambda speed_mps=speed_mps: fires(graph.recorded["/teensy_distance"],
                                                          ahead if speed_mps else everywhere), 6.0)
        assert graph.newest("/odom").twist.twist.linear.x == pytest.approx(car.speed_mps, abs=0.2)
        if not speed_mps:
            graph.run_until(lambda: car.speed_mps == 0.0, 3.0)
            since_ns = graph.now_ns
            graph.run(1.5)  # longer than any timeout in the chain
            times = [record.at_ns for record in graph.recorded["/odom"] if record.at_ns >= since_ns]
            assert max(after - before for before, after in zip(times, times[1:])) < 500_000_000
            assert graph.newest("/odom").twist.twist.linear.x == 0.0
    seen, real = graph.newest("/odom").pose.pose.position, car.truth().pose.pose.position
    assert abs(complex(seen.x - real.x, seen.y - real.y)) < 0.1
