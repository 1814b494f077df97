"""Synthetic drives of a car whose steering curve is known."""
import functools

import numpy as np

from car_interface.tools.calibration.shared import held
from car_interface.tools.calibration.steering import fit
from car_interface.tools.calibration.steering.drive import CurveFitConfig, Delay, SteeringDrive, lagged

STEP_S = 0.02
LEFT_STOP, CENTER, RIGHT_STOP = 3900, 5200, 6400
KNOWN_DELAY = Delay(0.0, 0.15)  # to find it takes most of a fit's time
KNOWN = CurveFitConfig(delay=KNOWN_DELAY, backlash_duty=0.0)  # the synthetic car's, unless it is told otherwise


def true_curvature(duty):
    """A linkage, linear to 1 and −0.9 1/m, with stops."""
    return np.interp(duty, (LEFT_STOP, CENTER, RIGHT_STOP), (1.0, 0.0, -0.9))


def drive(duties, curve=true_curvature, speed_mps=1.5, hold_s=3.0, lag_s=0.15, delay_s=0.0, backlash=0.0,
          noise_rad=0.005, seed=0, start_s=0.0):
    """The steering held at one duty after the other."""
    rng = np.random.default_rng(seed)
    t_s = start_s + np.arange(0.0, hold_s * len(duties), STEP_S)
    duty_t_s = start_s + hold_s * np.arange(len(duties))
    servo = lagged(held(duty_t_s, np.array(duties, float), t_s - delay_s), STEP_S, lag_s)
    wheels, now = np.empty(len(servo)), servo[0]
    for index, at in enumerate(servo):
        now = min(max(now, at - backlash / 2), at + backlash / 2)
        wheels[index] = now
    speed = np.full(len(t_s), speed_mps)
    distance_m = np.cumsum(speed) * STEP_S
    yaw = np.cumsum(curve(wheels) * speed) * STEP_S + noise_rad * rng.standard_normal(len(t_s))
    return SteeringDrive(t_s, distance_m, yaw, duty_t_s, np.array(duties, float))


def with_gaps(whole, every_s, missed_s, first_s=3.0):
    """As if the recorder had stopped now and then."""
    def has_subscribers(t_s):
        return (t_s - whole.t_s[0] - first_s) % every_s >= missed_s
    # A duty that is held is said again ten times a second.
    t_s = np.arange(whole.duty_t_s[0], whole.t_s[-1], 0.1)
    duty = held(whole.duty_t_s, whole.duty, t_s + 1e-9)
    odom, output = has_subscribers(whole.t_s), has_subscribers(t_s)
    return SteeringDrive(whole.t_s[odom], whole.distance_m[odom], whole.yaw_rad[odom], t_s[output], duty[output])


def mixed(low=3700, high=6600, count=40, seed=3):
    """Positions all over, in no order, as multiples of the board's counts."""
    rng = np.random.default_rng(seed)
    return 16 * np.round(rng.permutation(np.linspace(low, high, count)) / 16)


def steep_ends(duty):
    """Nearly level in the middle, all of its turning within a few counts at the ends, with sharp bends."""
    return np.interp(duty, (3700, 3720, 3760, 3800, 3900, 4400, 4900, 5100, 5300, 5700, 6300, 6500, 6700, 6740),
                     (1.1, 0.9, 0.35, 0.15, 0.03, 0.018, 0.012, 0.0, -0.011, -0.015, -0.06, -0.2, -0.5, -1.0))


STEEP_PLACES = 16 * np.round(np.concatenate([np.arange(3664, 3840, 16), [3872, 3936, 4100, 4400, 4700, 4900, 5000, 5100,
                             5200, 5400, 5600, 5900, 6100, 6200, 6300, 6400], np.arange(6464, 6800, 16), [7000]]) / 16)


def from_both_sides(places, seed=1):
    """Each held twice, come to from a little below and from a little above."""
    places = np.random.default_rng(seed).permutation(places)
    return np.column_stack([places - 100, places, places + 100, places]).ravel()


def steep_drive(backlash=6.0):
    return drive(from_both_sides(STEEP_PLACES), curve=steep_ends, speed_mps=1.2, hold_s=2.0, backlash=backlash)


@functools.lru_cache(maxsize=None)
def fitted_mixed():
    return fit.fit([drive(mixed())])


@functools.lru_cache(maxsize=None)
def fitted_steep():
    return fit.fit([steep_drive()])
