#!/usr/bin/env python3
"""What of a held speed's error is the wheels' pulses' alone: 20 a second at 0.3 m/s, seen late and in steps.

    PYTHONPATH=src:test python3 -m accuracy.speed_floor

The same virtual car starts to 0.3 m/s twice: by its pulses, and with the true speed as odometry, at once. Printed is
the overshoot and the worst error of the last two seconds, over motors that lag by 0.02 to 0.15 s.
"""
from unit.throttle.speed_rig import MAP, SpeedRequest, SpeedRig, overshoot, wrong_map

TARGET_MPS = 0.3
MAPS = {"as the car is": MAP, "30 % too strong": wrong_map(1.3), "30 % too weak": wrong_map(0.7)}
LAGS_S = (0.02, 0.05, 0.1, 0.15)


def errors(value_map, lag_s, sees_pulses):
    """Overshoot and the steady speed's worst error, as ratios."""
    samples = SpeedRig(value_map=value_map, lag_s=lag_s, sees_pulses=sees_pulses).run(6.0, SpeedRequest(TARGET_MPS))
    return overshoot(samples, TARGET_MPS), max(abs(each.speed_mps / TARGET_MPS - 1.0) for each in samples[-100:])


def main():
    for name, value_map in MAPS.items():
        for lag_s in LAGS_S:
            row = [100.0 * each for sees_pulses in (True, False) for each in errors(value_map, lag_s, sees_pulses)]
            print("map {:16} lag {:.2f} s: by pulses overshoot {:4.1f} %, steady {:4.1f} %; by the true speed {:4.1f} "
                  "%, {:4.1f} %".format(name, lag_s, *row), flush=True)


if __name__ == "__main__":
    main()
