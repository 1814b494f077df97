"""A fitted steering curve that is a straight line, made by hand: no drive has to be fitted for it."""
from types import SimpleNamespace

import numpy as np

from car_interface.tools.calibration.steering.drive import KNOT, Delay
from car_interface.tools.calibration.steering.fit import UNKNOWN_UNDERSTEER, Curve, Side
from car_interface.tools.calibration.steering.segments import Observations

CENTER, LEFT_DUTY, RIGHT_DUTY = 5200.0, 4000.0, 6400.0


def line_curve(low=LEFT_DUTY, high=RIGHT_DUTY, center=CENTER, sigma_per_m=0.001, **changes):
    """1/m at 4000, straight on at 5200, −1/m at 6400; one segment of 2 m at each count."""
    duties = np.arange(low, high + KNOT, KNOT)
    curvatures = (center - duties) / 1200
    driven = np.arange(0, len(duties), 2)
    count = len(driven)
    weights = np.zeros((count, len(duties)))
    weights[np.arange(count), driven] = 1.0
    found = Observations(curvatures[driven], np.full(count, sigma_per_m), duties[driven],
                         np.ones(count), np.full(count, 2.0), np.ones(count), weights)
    fields = {
        "duties": duties, "curvatures": curvatures, "sigmas": np.full(len(duties), sigma_per_m),
        "delay": Delay(0.1, 0.15), "backlash_duty": 6.0, "backlash_sigma": 1.0, "observations": found,
        "understeer": UNKNOWN_UNDERSTEER, "counts": {},
        "center": center, "center_sigma": 2.0,
        "left": Side(low, max(0.0, curvatures[0]), True, True, low),
        "right": Side(high, max(0.0, -curvatures[-1]), True, True, high)}
    return Curve(**{**fields, **changes})


def recorded(path="drives/a.bag", **changes):
    """A recording of which calibration and report need no more than this."""
    fields = {"path": path, "drive": path, "notes": (), "duration_s": 60.0, "uses_imu": False}
    return SimpleNamespace(**{**fields, **changes})
