"""What the random drives of virtual cars share: times, what the cars' files say, the servo board."""
from __future__ import annotations

import sys
from collections import deque
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "src"))

from car_interface.throttle.calibration import ThrottleCalibration

MS, S = 1_000_000, 1_000_000_000
COUNT = 16  # duty of one count of the servo board
NEUTRAL = 4915
THROTTLE = ThrottleCalibration(  # config/throttle.yaml
    channel=1, value_axis=[-5.0, 0.0, 3.0], duty_table=[3277, NEUTRAL, 6554], neutral=NEUTRAL)


def count_duty(duty: float) -> int:
    return int((duty + COUNT / 2) // COUNT) * COUNT


class Chip:
    """The servo board: duties for steering and ESC come to it late."""

    def __init__(self, rng, steering: int, at_ns: int = 0):
        self._rng = rng
        self._duties = deque([(at_ns, steering, NEUTRAL)])

    def command(self, steering: int, throttle: int, now_ns: int) -> None:
        self._duties.append((now_ns + round(self._rng.uniform(1, 22)) * MS, steering, throttle))

    def duties(self, now_ns: int) -> tuple[int, int]:
        while len(self._duties) > 1 and self._duties[1][0] <= now_ns:
            self._duties.popleft()
        return self._duties[0][1:]
