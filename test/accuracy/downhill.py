#!/usr/bin/env python3
"""How well the virtual car holds a speed downhill, by the kind of its ESC and what the configuration says of it.

    PYTHONPATH=src:test python3 -m accuracy.downhill

It begins from standstill, with a drag brake of 0, 0.05 and 0.1, and a motor that lags by 0.02 and 0.15 s. Printed are
the highest speed of the first 4 s, and the lowest, mean and highest one of the 10 s after them.
"""
from __future__ import annotations

from itertools import product

from unit.throttle.speed_rig import SpeedRequest, SpeedRig
from virtual_escs import crawler, direct, race, xl5

KINDS = ((xl5, "brake_then_reverse", True), (xl5, "brake_then_reverse", False), (xl5, "unverified", False),
         (crawler, "brake_becomes_reverse", True), (crawler, "unverified", False), (direct, "direct_reverse", True),
         (direct, "unverified", False), (race, "forward_only", True))
HILLS = tuple(product((0.05, 0.08), (0.3, 1.0, -0.3, -1.0)))
CARS = tuple(product((0.0, 0.05, 0.1), (0.02, 0.15)))


def speeds(kind, slope, target_mps, drag_brake, lag_s):
    """Return the speeds in the direction of the target, in m/s, every 20 ms."""
    esc, profile, is_measured = kind
    sign = 1.0 if target_mps > 0 else -1.0
    rig = SpeedRig(slope=-sign * slope, esc=esc(drag_brake=drag_brake), profile=profile, is_measured=is_measured,
                   lag_s=lag_s)
    rig.car.speed_mps = 0.0  # it was held until now
    return [sign * sample.speed_mps for sample in rig.run(14.0, SpeedRequest(target_mps))]


def main():
    for kind, (slope, target_mps) in product(KINDS, HILLS):
        if kind[0] is race and target_mps < 0:
            continue
        drives = [speeds(kind, slope, target_mps, *car) for car in CARS]
        later = [drive[200:] for drive in drives]
        means = [sum(drive) / len(drive) for drive in later]
        print(f"{kind[0].__name__:8} {kind[1]:22} {'measured' if kind[2] else '':9} {slope:.0%} {target_mps:+.1f} m/s: "
              f"at first {max(max(drive[:200]) for drive in drives):.2f}, then {min(map(min, later)):.2f} to "
              f"{max(map(max, later)):.2f}, mean {min(means):.2f} to {max(means):.2f}", flush=True)


if __name__ == "__main__":
    main()
