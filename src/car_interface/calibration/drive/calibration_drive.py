"""A car that drives its own steering calibration while a person holds a button and watches.

Consumes odometry, the duty that the servo board holds, six sonars' ranges and whether it may drive; answers with a
steering and a speed. Pure: ``now_ns`` is passed in. A node's loop:

    drive = CalibrationDrive(base, config)
    on odom:            drive.update_odometry(x, y, yaw, speed, measured_ns, now_ns)
    on /servo/output:   drive.update_duty(duty of the channel, now_ns)
    on sonar/*:         drive.update_range(name, range, now_ns)
    on *_arb/state:     drive.update_grant(may_drive, reason, now_ns)
    50 times a second:  step = drive.step(now_ns); publish step.steering and step.speed_mps unless steering is None
    second thread:      task = drive.take_fit_task(); if task: knowledge = assess(task) …
    back in the loop:   drive.update_knowledge(knowledge, now_ns)
    at any time:        drive.progress(now_ns); drive.path_m(…) for rviz
    step.phase is DONE: conclude(drive.samples, base, base_text, name)

All of it but ``assess`` and ``conclude`` is called by one thread.
"""
from __future__ import annotations

from car_interface.calibration.drive.config import DriveConfig
from car_interface.calibration.drive.knowledge import FitTask, Knowledge
from car_interface.calibration.drive.samples import Samples
from car_interface.calibration.drive.step import Progress, Step
from car_interface.steering.calibration import SteeringCalibration


class CalibrationDrive:
    """One drive.

    Args:
        base: turn_arb's calibration, by which av_steer_req becomes a duty, with the car's ends and rough center; its
            radii aren't believed.
        config: of the drive.
    """

    def __init__(self, base: SteeringCalibration, config: DriveConfig = DriveConfig()):
        raise NotImplementedError

    @property
    def samples(self) -> Samples:
        """All that was measured so far, for ``conclude``."""
        raise NotImplementedError

    @property
    def start(self) -> tuple[float, float] | None:
        """The area's center in odometry's frame, for rviz; ``None`` before the button was first held."""
        raise NotImplementedError

    def update_odometry(self, x_m: float, y_m: float, yaw_rad: float, speed_mps: float, measured_ns: int,
                        now_ns: int) -> None:
        """The car's pose (middle of the rear axle, odometry's frame) and speed, forward positive.

        Args:
            x_m, y_m, yaw_rad, speed_mps: as odom has them; the yaw may be wrapped.
            measured_ns: when that was, on the same scale as now_ns.
            now_ns: when it arrived.
        """
        raise NotImplementedError

    def update_duty(self, duty: float, now_ns: int) -> None:
        """What the servo board holds on the steering's channel, by /servo/output."""
        raise NotImplementedError

    def update_range(self, name: str, range_m: float, now_ns: int) -> None:
        """A sonar's range, as on its topic: inf = no echo, −inf = too near, NaN = nonsense. See ``obstacle_stop``."""
        raise NotImplementedError

    def update_grant(self, may_drive: bool, reason: str, now_ns: int) -> None:
        """Whether turn_arb and throttle_arb obey the planner: the autonomous deadman is held, no e-stop, armed.

        Args:
            may_drive: both do. Older than 0.5 s it counts as no.
            reason: why not, in the arbiters' own words; quoted in Step.text.
            now_ns: when it arrived.
        """
        raise NotImplementedError

    def step(self, now_ns: int) -> Step:
        """What to ask for now. Call it 20 to 100 times a second; it takes about 0.1 ms on a PC."""
        raise NotImplementedError

    def take_fit_task(self) -> FitTask | None:
        """What is to be fitted now, once; ``None`` while one is under way, or when nothing new was measured."""
        raise NotImplementedError

    def update_knowledge(self, knowledge: Knowledge, now_ns: int) -> None:
        """The answer to a task; the drive goes on with what it knew until it comes."""
        raise NotImplementedError

    def progress(self, now_ns: int) -> Progress:
        """How far it is."""
        raise NotImplementedError

    def finish(self) -> None:
        """End now, with what there is (the person asks for it): the next step is DONE."""
        raise NotImplementedError

    def expected_path(self) -> list[tuple[float, float]]:
        """The next seconds' path in odometry's frame, as far as it is known, for rviz: (x, y) in m."""
        raise NotImplementedError
