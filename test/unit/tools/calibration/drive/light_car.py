"""A car for the drive's tests: a servo with a lag, a known curve, speeds that follow, odometry without errors."""
import math

import numpy as np

from car_interface.steering.calibration import SteeringCalibration
from car_interface.tools.calibration.drive.area import Pose, moved
from car_interface.tools.calibration.drive.knowledge import assess
from car_interface.tools.calibration.drive.positions import Positions

S, TICK_NS = 1_000_000_000, 20_000_000
START_NS = 7_000 * S
CURVE = ((3900, 5200, 6400), (1.0, 0.0, -0.95))  # its ends are the base's
RADII_M = (1.0, 5.0, 300.0)


def base(left=3900, center=5180, right=6400):
    """What turn_arb's file says: ends and a rough center; its radii are wrong."""
    inner = [center + (end - center) * 0.1 for end in (left, right)]
    return SteeringCalibration(left, center, right, 0, RADII_M, (left, inner[0], center), (right, inner[1], center))


def offer(monkeypatch, *candidates):
    """These are worth measuring, whatever is known by then."""
    monkeypatch.setattr(Positions, "candidates", lambda self, accepts=lambda duty: True: [
        candidate for candidate in candidates if accepts(candidate.duty)])


class LightCar:
    """The car, driven by whatever a drive asks for.

    Attributes:
        pose, speed_mps, servo: now.
        extent_m: the farthest that the rear axle got from the start.
        seconds: since the start.
    """

    def __init__(self, drive, curve=CURVE, lag_s=0.1, accelerates_mps2=2.0, fits=True, slows_mps2=2.0):
        self.drive, self._curve, self._lag_s, self._accelerates_mps2 = drive, curve, lag_s, accelerates_mps2
        self._slows_mps2 = slows_mps2
        self.pose, self.speed_mps, self.servo, self.duty = Pose(0.0, 0.0, 0.0), 0.0, 5180.0, 5180
        self.now_ns, self.extent_m = START_NS, 0.0
        self.holds, self.fits = True, fits
        self.ranges = {}
        self.steps = []

    @property
    def seconds(self):
        return (self.now_ns - START_NS) / S

    def tick(self, speed_mps=None, duty=None):
        """20 ms; a speed and a duty in place of what the drive asks for."""
        drive, now_ns = self.drive, self.now_ns
        drive.update_odometry(self.pose.x_m, self.pose.y_m, math.remainder(self.pose.yaw_rad, 2 * math.pi),
                              self.speed_mps, now_ns, now_ns)
        drive.update_duty(self.duty, now_ns)
        for name, range_m in self.ranges.items():
            drive.update_range(name, range_m, now_ns)
        task = drive.take_fit_task() if self.fits else None
        if task is not None:
            drive.update_knowledge(assess(*task), now_ns)
        step = drive.step(now_ns, "" if self.holds else "human_in_loop is false")
        self.steps.append(step)
        if duty is not None:
            self.duty = duty
        elif step.steering is not None and step.held is None:
            self.duty = 16 * round(base().teleop_duty(step.steering) / 16)
        else:
            self.duty = 5184
        asked_mps = speed_mps if speed_mps is not None else step.speed_mps
        self._move(asked_mps)
        self.now_ns += TICK_NS
        return step

    def _move(self, asked_mps):
        self.speed_mps += max(-0.02 * self._slows_mps2, min(0.02 * self._accelerates_mps2, asked_mps - self.speed_mps))
        self.servo += (self.duty - self.servo) * -math.expm1(-0.02 / self._lag_s)
        self.pose = moved(self.pose, 0.02 * self.speed_mps, float(np.interp(self.servo, *self._curve)))
        self.extent_m = max(self.extent_m, math.hypot(self.pose.x_m, self.pose.y_m))

    def run(self, seconds, until=lambda step: False):
        """Drive on; the last step."""
        for _ in range(round(50 * seconds)):
            step = self.tick()
            if until(step):
                break
        return step
