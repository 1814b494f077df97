"""By how much less than its configuration says a car slows down now: because it drives downhill, or its brake is weak.

Measured by the wheels. In neutral nothing but drag and slope act, so the deceleration is seen directly, once the motor
has let go; so is a brake's, while it holds. While the motor pushes neither is seen. So the last neutral counts on; what
it took away is given back slowly, by later ones, since the next turn may lead downhill again. And what stands in
neutral doesn't roll.

Pure. It only ever takes away from what the configuration promises.
"""
from __future__ import annotations

import math
from collections import deque

from car_interface.common.units import NS_PER_S
from car_interface.throttle.esc_config import EscConfig

ACTUATION_S, LAG_S = 0.03, 0.15  # a pulse's way to the ESC; and the largest time constant of a motor that lets go
RESIDUAL_MPS2 = 0.04  # what is left of its force by then doesn't matter
SPAN_S, MAX_SPAN_S = 0.2, 0.5  # over which a deceleration is measured
RECENT_S = 0.12  # the same of the present acceleration
NOISE_MPS2 = 0.02  # less than this is none; and more is measured no better than to twice this
ROLLS_MPS = 0.1
RELAXES_MPS3 = 0.05  # the rate at which a shortfall is given up once it isn't seen any more
MATTERS_MPS2 = 0.1  # a shortfall of more is to be measured again
KNOWN_NS = 3 * NS_PER_S  # every so often
STANDS_NS = NS_PER_S
LEFT_MPS2 = 0.12  # of the drag, at least, where the car stands in neutral
TURNED_RAD = 0.5  # since the slope was measured: on another heading it is another one
CLIMBS_MPS2 = 0.2  # beyond the drag: less is a drag that is configured with care
AHEAD_M = 1.5  # along the arc, in which the car may point downhill
NEAR_RAD, SEEN_NS, MAX_SEEN = 0.6, 20 * NS_PER_S, 8  # a measurement holds for such headings, so long
STOOD_NS = 3 * NS_PER_S  # somebody may have put the car somewhere else


class Slope:
    """What one car's decelerations lack.

    Attributes:
        acceleration_mps2: the rate at which the speed rises now, whichever way it goes; negative: it falls.
    """

    def __init__(self, esc: EscConfig):
        self._drag_mps2, self._brake_mps2 = esc.drag_deceleration_mps2, esc.brake_deceleration_mps2
        self.acceleration_mps2 = 0.0
        self._fraction = 0.0
        self._held_ns = -math.inf  # since when the ESC has had this
        self._was_brake = False  # before that it had a brake
        self._force_mps2 = 0.0  # of the motor, when that began
        self._settles_s = 0.0  # how long until nothing is left of what it had before
        self._reports: deque = deque()  # (when measured, speed), of the last 0.5 s
        self._lacks_mps2 = {False: 0.0, True: 0.0}  # forward, backward
        self._kept_mps2 = {False: 0.0, True: 0.0}  # what is left of it from before this neutral
        self._brake_lacks_mps2 = 0.0
        self._measured_rad: dict[bool, float | None] = {False: None, True: None}  # the heading where it was measured
        self._measured_ns = {False: 0, True: 0}
        self._seen: deque = deque(maxlen=MAX_SEEN)  # (where the car went, when, the drag that lacked), also less than 0
        self._yaw_rad = 0.0
        self._stood_ns: int | None = None

    @property
    def _speed_mps(self):
        return self._reports[-1][1] if self._reports else 0.0

    def update_esc(self, fraction: float, now_ns: int) -> None:
        """What the ESC gets."""
        if fraction == self._fraction:
            return
        is_brake = self._fraction < 0.0 < self._speed_mps
        braked_mps2 = max(0.0, -fraction, -self._fraction if is_brake else 0.0) * self._brake_mps2
        force_mps2 = max(0.0, self.acceleration_mps2) + self._drag_mps2 + braked_mps2
        self._fraction, self._held_ns, self._was_brake = fraction, now_ns, is_brake
        self._force_mps2 = force_mps2
        self._settles_s = ACTUATION_S + LAG_S * math.log(max(1.0, force_mps2 / RESIDUAL_MPS2))
        for is_backward, lacks_mps2 in self._lacks_mps2.items():
            given_back_mps2 = RELAXES_MPS3 * (now_ns - self._measured_ns[is_backward]) / NS_PER_S
            self._kept_mps2[is_backward] = max(0.0, lacks_mps2 - given_back_mps2)

    def update_speed(self, speed_mps: float, measured_ns: int, curvature_per_m: float) -> None:
        """The speed that was measured at a time, forward positive, and the curvature (1/m) of the arc."""
        reports = self._reports
        if not math.isfinite(speed_mps) or reports and measured_ns <= reports[-1][0]:
            return
        elapsed_s = (measured_ns - reports[-1][0]) / NS_PER_S if reports else 0.0
        self._yaw_rad += speed_mps * curvature_per_m * min(1.0, elapsed_s)
        reports.append((measured_ns, speed_mps))
        while reports[0][0] < measured_ns - round(MAX_SPAN_S * NS_PER_S):
            reports.popleft()
        self.acceleration_mps2 = -self._deceleration_mps2(RECENT_S)
        if abs(speed_mps) < ROLLS_MPS:
            self._stand(measured_ns)
            return
        self._stood_ns = None
        if self._fraction == 0.0 or self._fraction < 0.0 < speed_mps:
            self._slow(speed_mps < 0.0, measured_ns)

    def is_known(self, is_backward: bool) -> bool:
        """Whether it was measured in this direction since the car last stood, or before that on this heading; a while
        ago only where nothing was lacking.
        """
        if self._measured_rad[is_backward] is None or not self._reports:
            return False
        if self._expected_mps2(is_backward, 0.0) > MATTERS_MPS2:
            return False
        return (self._lacks_mps2[is_backward] <= MATTERS_MPS2
                or self._reports[-1][0] - self._measured_ns[is_backward] <= KNOWN_NS)

    def lacks_mps2(self, is_backward: bool, curvature_per_m: float = 0.0) -> float:
        """By how much its drag slows the car less than configured, on an arc (1/m, left positive)."""
        lacks_mps2 = self._lacks_mps2[is_backward]
        if not self._climbs_mps2:
            return lacks_mps2
        turns_rad = AHEAD_M * curvature_per_m * (-1.0 if is_backward else 1.0)
        return max(lacks_mps2, *(self._expected_mps2(is_backward, share * turns_rad) for share in (0.0, 0.5, 1.0)))

    @property
    def _climbs_mps2(self):
        return any(lacks_mps2 < -CLIMBS_MPS2 for _, _, lacks_mps2 in self._seen)

    def _expected_mps2(self, is_backward, turns_rad):
        """What will lack after a turn, by what was seen before it; 0 where it was measured."""
        way_rad = self._yaw_rad + turns_rad + (math.pi if is_backward else 0.0)
        newest_ns, expected_mps2 = self._reports[-1][0] if self._reports else 0, 0.0
        for seen_rad, seen_ns, lacks_mps2 in self._seen:
            off_rad = abs(math.remainder(way_rad - seen_rad, 2.0 * math.pi))
            if newest_ns - seen_ns > SEEN_NS:
                continue
            if off_rad <= NEAR_RAD:
                return 0.0
            if lacks_mps2 < -CLIMBS_MPS2:
                expected_mps2 = max(expected_mps2, lacks_mps2 * math.cos(off_rad))
        return min(expected_mps2, max(0.0, self._drag_mps2 - LEFT_MPS2))

    def brake_lacks_mps2(self, is_backward: bool) -> float:
        """The same of its brake."""
        return max(self._lacks_mps2[is_backward], 0.0 if is_backward else self._brake_lacks_mps2)

    def _deceleration_mps2(self, span_s):
        """Of the magnitude, by a straight line through the reports of the last ``span_s``."""
        reports = self._reports
        if len(reports) < 3:
            return 0.0
        newest_ns = reports[-1][0]
        times, speeds = [], []
        for at_ns, speed_mps in reversed(reports):
            if newest_ns - at_ns > span_s * NS_PER_S:
                break
            times.append((at_ns - newest_ns) / NS_PER_S)
            speeds.append(abs(speed_mps))
        if len(times) < 3:
            return 0.0
        mean_s, mean_mps = math.fsum(times) / len(times), math.fsum(speeds) / len(speeds)
        spread = math.fsum((time_s - mean_s) ** 2 for time_s in times)
        return -math.fsum((time_s - mean_s) * (speed_mps - mean_mps)
                          for time_s, speed_mps in zip(times, speeds)) / spread

    def _slow(self, is_backward, measured_ns):
        """In neutral, or under a brake. What the motor still pushes only hides a part of the deceleration, so one that
        is as strong as promised counts before it has let go. What is left of a brake adds to it.
        """
        held_s = (measured_ns - self._held_ns) / NS_PER_S
        settled_s = held_s - self._settles_s
        if held_s < ACTUATION_S + SPAN_S or self._was_brake and settled_s < SPAN_S:
            return
        seen_mps2 = self._deceleration_mps2(max(SPAN_S, min(MAX_SPAN_S, settled_s)))
        brakes = self._fraction < 0.0
        lacks_mps2 = signed_mps2 = (-self._fraction * self._brake_mps2 if brakes else self._drag_mps2) - seen_mps2
        if lacks_mps2 <= NOISE_MPS2:
            lacks_mps2 = 0.0
        elif settled_s < SPAN_S:
            if not brakes:
                pushes_mps2 = self._force_mps2 * math.exp((ACTUATION_S + SPAN_S / 2.0 - held_s) / LAG_S)
                at_least_mps2 = lacks_mps2 - pushes_mps2
                self._lacks_mps2[is_backward] = max(at_least_mps2, self._lacks_mps2[is_backward])
            return
        else:
            lacks_mps2 += 2.0 * NOISE_MPS2
        if brakes:
            self._brake_lacks_mps2 = lacks_mps2
        elif (settled_s >= MAX_SPAN_S or lacks_mps2 >= self._lacks_mps2[is_backward]
              or self._measured_rad[is_backward] is None):  # less than was lacking takes more than a glance
            self._lacks_mps2[is_backward] = max(lacks_mps2, self._kept_mps2[is_backward])
            self._mark_measured(is_backward, measured_ns)
            self._remember(is_backward, signed_mps2, measured_ns)

    def _remember(self, is_backward, lacks_mps2, measured_ns):
        way_rad = self._yaw_rad + (math.pi if is_backward else 0.0)
        if self._seen and abs(math.remainder(way_rad - self._seen[-1][0], 2.0 * math.pi)) < NEAR_RAD / 2.0:
            self._seen.pop()
        self._seen.append((way_rad, measured_ns, lacks_mps2))

    def _mark_measured(self, is_backward, measured_ns):
        self._measured_rad[is_backward], self._measured_ns[is_backward] = self._yaw_rad, measured_ns

    def _stand(self, measured_ns):
        if self._stood_ns is None:
            self._stood_ns = measured_ns
            if self._fraction == 0.0 and measured_ns - self._held_ns <= NS_PER_S and len(self._reports) > 2:
                self._came_to_stand(measured_ns)
        for is_backward, measured_rad in self._measured_rad.items():
            if measured_rad is not None and (abs(self._yaw_rad - measured_rad) > TURNED_RAD
                                             or measured_ns - self._stood_ns > STOOD_NS):
                self._measured_rad[is_backward] = None
        if self._fraction == 0.0 and measured_ns - max(self._stood_ns, self._held_ns) > STANDS_NS:
            most_mps2 = max(0.0, self._drag_mps2 - LEFT_MPS2)
            for is_backward, lacks_mps2 in self._lacks_mps2.items():
                if lacks_mps2 > most_mps2:  # it may roll more freely than it stands
                    self._lacks_mps2[is_backward], self._measured_rad[is_backward] = most_mps2, None

    def _came_to_stand(self, measured_ns):
        """It stopped in neutral before its deceleration was measured: what it was on the whole counts."""
        is_backward = self._reports[-2][1] < 0.0
        if self._measured_rad[is_backward] is not None or self._was_brake:
            return
        held_s = (measured_ns - self._held_ns) / NS_PER_S
        seen_mps2 = self._deceleration_mps2(min(MAX_SPAN_S, held_s))
        if abs(self._reports[0][1]) > 1.5 * ROLLS_MPS and seen_mps2 > 0.0:
            lacks_mps2 = min(self._drag_mps2 - seen_mps2, self._drag_mps2 - LEFT_MPS2)
            self._lacks_mps2[is_backward] = max(lacks_mps2, self._lacks_mps2[is_backward])
            self._mark_measured(is_backward, measured_ns)
