"""Find out whether an ESC has shown that its brake doesn't become reverse.

A car that stands under a held brake proves little: its ESC may be switched off, its battery low, or a wall behind it.
So ``BrakeProof`` demands a sequence: the car is driven until just before (DRIVEN), is braked (BRAKED), slows down as a
brake slows a car (SLOWED), stands for a second with the brake held (HELD), and drives again at the next push.
Anything else starts the sequence over. It has to be seen twice, since a wall that a reversing car meets just as it
stands looks like a brake that holds. A car that rolls backward under a brake withdraws the proof.

``step`` takes what the ESC gets and the measured motion; ``is_given`` is the result. Pure: ``now_ns`` is passed in.
"""
from __future__ import annotations

from car_interface.common.units import NS_PER_S
from car_interface.throttle.esc_motion import MeasuredMotion

MIN_BRAKE = 0.5  # of the full brake
MIN_SPEED_MPS = 1.0  # at the brake's beginning; chosen, test_esc_proof.py fails with 0.3 m/s
JUST_BEFORE_NS = round(0.3 * NS_PER_S)  # from the last push to the brake
# The deceleration of at least half a brake, from dust to asphalt. A car that coasts slows by less, one that hits
# something by more.
SLOWS_MPS2 = (1.5, 10.0)
SLOW_MPS = 0.3  # the deceleration is measured down to this speed
# If the brake were reverse, half of a Slash's (3.6 m/s²) would make the car far faster than the standstill speed in
# this time. The slowest crawler's ESC changes to reverse within some tenths of a second.
HELD_NS = NS_PER_S
AGAIN_NS = NS_PER_S  # if the car doesn't drive within this time of a push, its ESC may be switched off

TIMES = 2  # a wall where the car comes to stand, twice in a row, is left to esc/profile_measured

DRIVEN, BRAKED, SLOWED, HELD = "driven", "braked", "slowed", "held"


class BrakeProof:
    """Follow what the ESC gets and what the car does. A brake counts from ``min_brake`` on, and from MIN_BRAKE."""

    def __init__(self, min_brake: float):
        self._min_brake = max(MIN_BRAKE, min_brake)
        self.doubt()

    @property
    def is_given(self) -> bool:
        """Return whether the ESC has shown that its brake doesn't become reverse."""
        return self._times >= TIMES

    def doubt(self) -> None:
        """Withdraw the proof: the car moved in a way that a brake can't cause."""
        self._times = 0
        self._begin_anew()

    def step(self, fraction: float, is_push: bool, pulled_ns: int, motion: MeasuredMotion, now_ns: int) -> None:
        """Take the fraction, −1..1, that the ESC gets from now on, and follow the sequence.

        ``pulled_ns`` is for how long the servo board is known to have held a pull.
        """
        speed_mps = motion.speed_mps(now_ns)
        if speed_mps is None:
            self._begin_anew()
        elif is_push:
            self._push(speed_mps, motion, now_ns)
        elif fraction <= -self._min_brake:
            self._pull(speed_mps, pulled_ns, motion, now_ns)
        elif self._stage in (BRAKED, SLOWED) or self._stage == DRIVEN and now_ns - self._since_ns > JUST_BEFORE_NS:
            self._begin_anew()

    def _begin_anew(self):
        self._stage, self._since_ns = "", 0

    def _push(self, speed_mps, motion, now_ns):
        if self._stage == HELD:
            if self._pushed_ns is None:
                self._pushed_ns = now_ns
            if motion.measured_ns <= self._pushed_ns or speed_mps < SLOW_MPS:
                if now_ns - self._pushed_ns > AGAIN_NS:
                    self._begin_anew()
                return
            self._times += 1
        self._stage, self._since_ns = DRIVEN, now_ns

    def _pull(self, speed_mps, pulled_ns, motion, now_ns):
        if self._stage == DRIVEN:
            recent = now_ns - self._since_ns <= JUST_BEFORE_NS and speed_mps >= MIN_SPEED_MPS
            self._stage = BRAKED if recent else ""
            self._first = speed_mps, motion.measured_ns
        elif self._stage == BRAKED and speed_mps <= SLOW_MPS:
            first_mps, first_ns = self._first
            slowed_mps2 = (first_mps - speed_mps) * NS_PER_S / max(1, motion.measured_ns - first_ns)
            self._stage = SLOWED if SLOWS_MPS2[0] <= slowed_mps2 <= SLOWS_MPS2[1] else ""
            self._since_ns = None
        elif self._stage == SLOWED:
            if not motion.stands(now_ns):
                self._since_ns = None
            elif self._since_ns is None:
                self._since_ns = motion.measured_ns
            elif motion.measured_ns - self._since_ns >= HELD_NS and pulled_ns >= HELD_NS:
                self._stage, self._pushed_ns = HELD, None
