"""Drive a hobby ESC so that a brake never becomes reverse: the state machine between a request and the pulse.

``Esc.step`` takes a ``Request`` (fraction −1..1, gear, stop) and returns an ``EscDecision``: the fraction that the ESC
gets now, the state, the cause and the reason. It decides by

* ``esc_config``: the ESC's kind (``esc/profile``), and whether calibrate_esc has measured it,
* ``esc_history``: the pulses that the ESC has had, and what they make of the next pull,
* ``esc_motion``: the car's measured speed, and whether a hill drives it,
* ``esc_proof``: whether the ESC has shown on the road that its brake doesn't become reverse,
* ``esc_intention``: whether a person's pull means reverse.

The rules, in the order of ``step``: arming comes first, then a stop (``_stop``), then a request (``_drive``). A pull is
given if it brakes for certain (``_brakes``), weakly if that ends before the car stands (``_weak_pull``), or as a step
of the way into reverse (``_reverse``); else the ESC gets neutral. A stop brakes by stricter rules (``_stop_brakes``).
Nothing blocks: where an ESC needs time in neutral, ``step`` returns neutral until it has passed. Pure: ``now_ns`` is
passed in.

The rules can't see

* an ESC that is switched on or recalibrated later than the board: it has forgotten the pulses before, and its first
  pull may be reverse,
* a hill on which the car hasn't rolled in neutral,
* a board that stopped its pulses and hasn't reported it yet,
* a person's pull that drives the car backward, with a wrong profile and without a speed.
"""
from __future__ import annotations

import math
from typing import NamedTuple

from car_interface.common import causes
from car_interface.common.staleness import STARTED
from car_interface.common.units import NS_PER_S
from car_interface.throttle.esc_config import BRAKE_THEN_REVERSE, FORWARD_ONLY, UNVERIFIED, EscConfig
from car_interface.throttle.esc_history import EscHistory
from car_interface.throttle.esc_intention import AUTO, DRIVE, REVERSE_GEAR, Pulls, Request
from car_interface.throttle.esc_motion import (
    ACTUATION_NS,
    HELD_PULL_NS,
    MOTOR_LAG_NS,
    PULL_NS,
    STANDSTILL_MPS,
    HillWatch,
    MeasuredMotion,
    MotionCheck,
)
from car_interface.throttle.esc_proof import BrakeProof

# The states, as ThrottleState.esc has them.
ARMING, NEUTRAL, FORWARD, BRAKING, HOLD, REVERSE = "ARMING", "NEUTRAL", "FORWARD", "BRAKING", "HOLD", "REVERSE"

NO_PULSE = "the servo board gave no pulse"
NO_BRAKE = "no brake"  # before the reason, in the log
PASSES = "calibration drive: the ESC gets the stick as it is, and a brake may become reverse"
# After this time in neutral a stop no longer trusts the ESC to remember that it drove forward, whatever
# reverse_after_neutral is. No ESC is known to forget within a second (a figure of light controllers for cheap ESCs).
STOP_MEMORY_NS = round(0.5 * NS_PER_S)
BEGINS_OVER_MPS = NEAR_MPS = 0.1  # m/s around esc/brake_margin: a brake begins above, and ends below
# A pull that begins within this time of the last speed is judged by that speed: the largest esc/speed_timeout.
LOST_NS = round(0.5 * NS_PER_S)
# The age that a speed without a stamp may have at its arrival. Chosen; test_esc.py fails with 0.1 s.
HIDDEN_NS = round(0.35 * NS_PER_S)
SAME_BRAKE = 0.05  # brakes that differ by no more than this fraction slow the car alike
# A full pull slows no car by more than this: half of it gives the 8 m/s² at which the strongest car's wheels lock on
# dry asphalt (MAX_DECELERATION_MPS2).
SLOWS_MPS2 = 16.0
LETS_GO = 1.5  # a weak pull follows once the motor's lag leaves no more than this many times as much of a stronger one
# A stop still brakes for this time after odometry's standstill, which is below 0.1 m/s, if the brake is certain. So the
# car comes to rest: a brake of 1 m/s² takes 0.1 s, and the motor's lag as much. On a hill it would roll off from there.
REST_NS = round(0.2 * NS_PER_S)
WEAKLY = "as much of a brake as certainly ends before it stands"
# The strength of the pull before reverse: some ESCs reverse by it at once, and nothing corrects that for esc/dwell.
FIRST_PULL = 0.15
# Such a push slows a car that rolls backward by less than 1.5 m/s² (a quarter of a Slash's 5.6 m/s²), which doesn't
# turn it round between two reports of the speed.
GENTLE = 0.25
PULSE_S = 0.02  # the period of the ESC's pulses


class EscDecision(NamedTuple):
    """The fraction for the ESC, with its reason, and the deceleration that a stop would have now."""

    fraction: float  # −1..1
    state: str  # one of ARMING to REVERSE
    cause: str  # one of car_interface.common.causes
    reason: str
    stop_mps2: float  # the deceleration that is certain, down to standstill, if the car stops now


class Esc:
    """Apply the rules to one ESC.

    It starts in ARMING, and leaves that after neutral for esc/arming_time, with the stick centered and the deadman seen
    released. A board without pulses, and motion against the state, lead back to ARMING.
    """

    def __init__(self, config: EscConfig):
        self.config = config
        self._history = EscHistory(config)
        self._motion = MeasuredMotion(config)
        self._check = MotionCheck(config)
        self._pulls = Pulls(config.dead_band_forward, config.dead_band_reverse)
        self._state = ARMING
        self._arming_cause, self._arming_reason = causes.ESC_ARMING, STARTED
        self._was_released = False  # whether the deadman was, since arming began
        self._armed_after_ns: int | None = None  # neutral counts from here on
        self._fraction = 0.0
        self._stop_began_ns: int | None = None
        self._rolled_ns = -math.inf  # until then the car wasn't known to stand
        self._is_measured = config.profile_measured  # until the car moves against the ESC's state
        self._proof = BrakeProof(config.stop_brake)
        self._hill = HillWatch()
        self._saw_speed_in_reverse = False
        self._brakes_since_ns = 0  # when the present strength of the brake began
        self._owed_s = 0.0  # for how long the least push is due, by the mean that was asked for
        self._lagging_pull, self._finished_ns = 0.0, 0  # the fraction by which a lagging motor still brakes, and when

    @property
    def state(self) -> str:
        """Return the state of the last step."""
        return self._state

    def update_held(self, fraction: float | None, now_ns: int) -> None:
        """Take what the servo board holds; ``None`` = no pulse: switched off, never set, or without power."""
        self._history.update_held(fraction, now_ns)

    def update_speed(self, speed_mps: float, now_ns: int, age_ns: int, sigma_mps: float = 0.0) -> None:
        """Take the measured speed, forward positive, its age at arrival, and its standard deviation."""
        self._motion.update(speed_mps, now_ns, age_ns, sigma_mps)

    def mark_stale(self) -> None:
        """Treat board and speed as unknown, since messages were dropped on their way here."""
        self._history.mark_unknown()
        self._motion.mark_stale()

    def step(self, request: Request, now_ns: int) -> EscDecision:
        """Return what the ESC gets from now on. Call it on every change, and at 20 Hz at least."""
        passes = self.config.calibration_drive and request.is_human and request.gear != DRIVE
        value = self._value_of(request, passes, now_ns)
        if self._history.resume(now_ns):
            self._brakes_since_ns = now_ns
        if self._state == REVERSE and self._fraction < 0:
            self._motion.update_reverse(now_ns)
        if self._motion.may_roll_backward(now_ns):
            self._history.mark_backward(now_ns)
        if not self._motion.stands(now_ns):
            self._rolled_ns = now_ns
        self._pulls.update(request, now_ns)
        self._update_arming(request, now_ns)
        if self._state == ARMING:  # earlier pulls don't count
            self._pulls = Pulls(self.config.dead_band_forward, self.config.dead_band_reverse)
            answer = (0.0, ARMING, self._arming_cause, self._arming_text(request, now_ns))
        elif request.is_stop:
            answer = self._stop(now_ns)
        elif not math.isfinite(request.value):
            answer = self._stop(now_ns, causes.REQUEST_NOT_FINITE, f"the request is {request.value}; ")
        else:
            self._stop_began_ns = None
            answer = self._pass(value, now_ns) if passes else self._drive(value, request, now_ns)
        return self._finish(answer, now_ns)

    # --- arming ---

    def _update_arming(self, request, now_ns):
        """Enter ARMING without pulses and after motion against the state; leave it once nothing is missing."""
        if self._history.had_no_pulse():
            self._disarm(causes.ESC_ARMING, NO_PULSE, now_ns)
        wants_backward = request.cruise_mps < 0 and request.gear == REVERSE_GEAR and not request.is_stop
        against = self._check.check(self._motion, self._state == REVERSE, now_ns, wants_backward)
        if against and self._state != ARMING:
            self._disarm(causes.ESC_MOTION, f"{against}: esc/profile is wrong, or this is a hill", now_ns)
        if self._state != ARMING:
            return
        if self._armed_after_ns is None:
            self._armed_after_ns = now_ns
        self._was_released = self._was_released or request.is_released
        if self._was_released and request.is_centered and not self._neutral_missing_ns(now_ns):
            self._state = NEUTRAL

    def _disarm(self, cause, reason, now_ns):
        self._state = ARMING
        self._arming_cause, self._arming_reason = cause, reason
        self._armed_after_ns, self._was_released = now_ns, False
        self._check = MotionCheck(self.config)
        self._is_measured = self._is_measured and cause != causes.ESC_MOTION
        self._proof.doubt()

    def _neutral_missing_ns(self, now_ns):
        lasts_ns = min(self._history.neutral_ns(now_ns), now_ns - self._armed_after_ns)
        return max(0, round(self.config.arming_time_s * NS_PER_S) - lasts_ns)

    def _arming_text(self, request, now_ns):
        missing_ns = self._neutral_missing_ns(now_ns)
        todo = [] if self._was_released else ["let go of the deadman"]
        todo += [] if request.is_centered else ["center the stick"]
        todo += [f"{missing_ns / NS_PER_S:.1f} s of neutral to go"] if missing_ns else []
        return f"{self._arming_reason}; {', '.join(todo)}"

    # --- requests ---

    def _value_of(self, request, keeps_small, now_ns):
        """Return the request's value, clamped to −1..1; in the dead band 0, or what ``_pulsed`` makes of it.

        With ``keeps_small`` such values pass, so that a calibration drive finds where the car sets off.
        """
        value = max(-1.0, min(1.0, request.value))
        is_beyond = value >= self.config.dead_band_forward or value <= -self.config.dead_band_reverse
        return value if is_beyond or keeps_small else self._pulsed(value, request, now_ns)

    def _pulsed(self, value, request, now_ns):
        """Return the least push or neutral, so often that their mean is a value in the dead band.

        That is for a planner that keeps the speed of a car that rolls; else it is neutral. With a drag brake neutral
        slows the car and the least push drives it. Odometry is late at a crawl: if the speed control changed between
        both only as it sees the speed, the speed would swing by 15 %.
        """
        keeps_speed = value * request.cruise_mps > 0 and not request.is_human and not request.is_stop
        if not (keeps_speed and self._keeps_driving(value, now_ns)):
            self._owed_s = 0.0
            return 0.0
        least = self.config.dead_band_forward if value > 0 else -self.config.dead_band_reverse
        elapsed_s = (now_ns - self._finished_ns) / NS_PER_S
        # What was asked for, less what the ESC had since the last step.
        owed_s = self._owed_s + (value - self._fraction) / least * elapsed_s
        self._owed_s = max(-PULSE_S, min(PULSE_S, owed_s))
        return least if self._owed_s > 0.0 else 0.0

    def _keeps_driving(self, value, now_ns):
        """Return whether the car rolls, and a push that follows neutral drives it on at once."""
        if not self._motion.is_fresh(now_ns):
            return False
        if value > 0:
            return self._motion.rolls_forward(now_ns)
        return (self._motion.rolls_backward(now_ns) and self.config.profile in (BRAKE_THEN_REVERSE, UNVERIFIED)
                and self._history.is_unlocked(now_ns))

    def _pass(self, value, now_ns):
        """Return a person's request as it is, for a calibration drive."""
        state = NEUTRAL
        if value > 0:
            state = BRAKING if self._motion.rolls_backward(now_ns) else FORWARD
        elif value < 0:
            state = BRAKING if self._motion.rolls_forward(now_ns) else REVERSE
        return value, state, causes.CALIBRATION_DRIVE, PASSES

    def _drive(self, value, request, now_ns):
        if value > 0:
            return self._push(value, request, now_ns)
        if value < 0:
            return self._pull(value, request, now_ns)
        return 0.0, NEUTRAL, causes.NO_THROTTLE, "neutral is requested"

    def _push(self, value, request, now_ns):
        """Return the answer to a positive value: it drives forward, or brakes a car that rolls backward."""
        backward = self._motion.rolls_backward(now_ns)
        if request.gear == REVERSE_GEAR:
            if self._rolls_too_fast_backward(request, now_ns):
                return min(value, GENTLE), BRAKING, causes.BRAKING, "it rolls backward faster than is asked for"
            return self._brake_in_reverse(value, "a brake in reverse gear doesn't drive forward", now_ns)
        if backward:
            return value, BRAKING, causes.BRAKING, "it rolls backward"
        return value, FORWARD, causes.DRIVING, f"{value:.2f} is requested{_clamped(request)}"

    def _rolls_too_fast_backward(self, request, now_ns):
        """Return whether a hill drives it faster backward than requested, and too fast for a gentle push to turn it."""
        speed_mps = self._motion.speed_mps(now_ns)
        return (self._hill.drives_the_car and request.cruise_mps < 0 and self._motion.is_fresh(now_ns)
                and speed_mps < min(request.cruise_mps, -2 * STANDSTILL_MPS))

    def _brake_in_reverse(self, value, withheld, now_ns):
        """Return a push as a brake if the car rolls backward above the margin; below that it would drive it forward."""
        if self._motion.rolls_backward(now_ns) and self._is_fast_enough(value, now_ns):
            return value, BRAKING, causes.BRAKING, "it rolls backward"
        return 0.0, NEUTRAL, causes.AT_STANDSTILL, withheld

    def _pull(self, value, request, now_ns):
        """Return the answer to a negative value: reverse, a brake, a weak brake, or neutral."""
        if request.is_human and request.gear == DRIVE and self._motion.rolls_backward(now_ns):
            return self._brake_in_reverse(-value, "it rolls backward, too slowly for a brake that is sure to end in "
                                          "time: it coasts", now_ns)
        means_reverse = self._means_reverse(request, now_ns)
        if means_reverse and self._may_reverse(request, now_ns):
            return self._reverse(value, now_ns)
        brake = self._brake(value, means_reverse, now_ns)
        if brake is not None or self._rolled_forward_in_pull(now_ns):
            self._pulls.mark_brake()
        return brake or (0.0, NEUTRAL, *self._withheld(means_reverse, now_ns))

    def _means_reverse(self, request, now_ns):
        """Return whether a pull means reverse: by the gear, or as a person's second pull."""
        # If the speed is lost while the car rolls, the pull that is held stays a brake.
        is_lost = self._motion.speed_mps(now_ns) is None
        if is_lost and self._motion.rolled_forward_since(self._pulls.began_ns - LOST_NS):
            self._pulls.mark_brake()
        return request.gear == REVERSE_GEAR or request.gear == AUTO and self._pulls.means_reverse

    def _rolled_forward_in_pull(self, now_ns):
        """Return whether a speed that was measured during this pull shows that it is a brake."""
        speed_mps = self._motion.speed_mps(now_ns) or 0.0
        began_ns = self._pulls.began_ns + (0 if self._motion.is_stamped else HIDDEN_NS)
        return speed_mps >= STANDSTILL_MPS and self._motion.measured_ns >= began_ns

    def _brake(self, value, means_reverse, now_ns):
        """Return the answer to a pull that brakes, whole or weakly; None: it may not brake."""
        if self._brakes(value, now_ns):
            if not self._motion.stands(now_ns):
                return value, BRAKING, causes.BRAKING, "it rolls forward, or its speed is unknown"
            if means_reverse and self.config.profile == FORWARD_ONLY:
                return value, HOLD, causes.REVERSE_REFUSED, "this ESC has no reverse (esc/profile: forward_only)"
            return value, HOLD, causes.HOLDING, "it stands, and the brake holds it"
        weak = self._weak_pull(value, now_ns)
        return (weak, BRAKING, causes.BRAKING, WEAKLY) if weak else None

    def _brakes(self, value, now_ns):
        """Return whether a pull slows the car for certain.

        After forward a ``brake_then_reverse`` brakes until it gets neutral, and a ``forward_only`` always brakes. Any
        other ESC may drive backward. That slows a car that rolls forward, too, if the pull ends before the car stands.
        """
        if self._motion.rolls_backward(now_ns):
            return False
        if self.config.profile == FORWARD_ONLY:
            return True
        if self.config.profile == BRAKE_THEN_REVERSE and self._history.brake_is_certain(now_ns):
            return True
        return self._is_fast(value, now_ns)

    def _is_fast(self, value, now_ns):
        return self._motion.rolls_forward(now_ns) and self._is_fast_enough(value, now_ns)

    def _is_fast_enough(self, value, now_ns):
        """Return whether the car is faster than esc/brake_margin, and rolls until a pull that is given now has ended.

        To begin a brake takes BEGINS_OVER_MPS more. It takes twice the margin where the speed has no stamp, since its
        age is unknown, and backward, since the way back into reverse takes long.
        """
        margin_mps, motion = self.config.brake_margin_mps, self._motion
        is_sure = motion.is_stamped and not motion.rolls_backward(now_ns)
        if self._state == BRAKING and is_sure:
            # A weaker brake's deceleration doesn't show what a stronger one does.
            since_ns = self._brakes_since_ns if self._fraction - value <= SAME_BRAKE else None
            return motion.outlasts_a_pull(now_ns, margin_mps - NEAR_MPS, since_ns)
        if self._state != BRAKING:
            margin_mps += BEGINS_OVER_MPS if is_sure else margin_mps
        return motion.least_speed_mps(now_ns) > margin_mps and motion.outlasts_a_pull(now_ns)

    def _weak_pull(self, value, now_ns, pull_ns=PULL_NS):
        """Return the part of a pull that ends before the car stands, whatever the ESC makes of it; 0 = none.

        Nothing else slows a car downhill whose ESC isn't certain to brake. The speed's age decides how much is safe, so
        this takes odometry that is fresh and has a stamp.
        """
        motion = self._motion
        if not (self._hill.drives_the_car and motion.is_stamped and motion.is_fresh(now_ns)
                and motion.rolls_forward(now_ns)):
            return 0.0  # an old speed doesn't show the effect of later pulls
        weak = max(value, -motion.mps2_to_outlast_a_pull(now_ns, pull_ns) / SLOWS_MPS2)
        is_let_go = self._lagging_pull <= LETS_GO * -weak
        return weak if weak <= -self.config.dead_band_reverse and is_let_go else 0.0

    def _withheld(self, means_reverse, now_ns):
        """Return cause and reason for neutral instead of a pull."""
        if self._motion.speed_mps(now_ns) is None:
            if means_reverse:
                return causes.REVERSE_REFUSED, f"no reverse without speed: {self._motion.unknown_reason(now_ns)}"
            return causes.BRAKE_UNCERTAIN, ("the ESC could take this pull for reverse, and the speed is unknown: "
                                            "center the stick and pull again for reverse")
        if self._motion.rolls_backward(now_ns):
            return causes.AT_STANDSTILL, "it rolls backward: this would drive it on"
        if self._motion.stands(now_ns):
            return causes.AT_STANDSTILL, "it stands: a brake doesn't become reverse"
        return causes.BRAKE_UNCERTAIN, (f"below {self.config.brake_margin_mps:g} m/s the ESC could take this pull for "
                                        "reverse before it is over: it coasts")

    # --- reverse ---

    def _may_reverse(self, request, now_ns):
        """Return whether a pull that means reverse may drive the car backward: at standstill, or while it rolls back.

        Without a speed a person's pull may, since the person sees the car.
        """
        if self.config.profile == FORWARD_ONLY:
            return False
        if self._motion.speed_mps(now_ns) is None:
            # An ESC that takes this pull for a brake needs neutral and another pull before it reverses.
            certain = self.config.profile == BRAKE_THEN_REVERSE and self._history.brake_is_certain(now_ns)
            return request.is_human and not (certain and self._state != REVERSE)
        if self._state == REVERSE and self._saw_speed_in_reverse:
            return True  # MotionCheck judges a car that rolls forward now
        return self._motion.stands(now_ns) or self._motion.rolls_backward(now_ns)

    def _reverse(self, value, now_ns):
        """Return the next step of the way into reverse: a first pull, neutral, the pull that reverses."""
        history = self._history
        if self.config.profile in (BRAKE_THEN_REVERSE, UNVERIFIED):
            if not history.has_braked(now_ns):
                first = max(value, -max(FIRST_PULL, self.config.dead_band_reverse))
                return first, REVERSE, causes.REVERSE_PENDING, "the ESC needs a brake before reverse"
            if not history.is_unlocked(now_ns):
                return 0.0, REVERSE, causes.REVERSE_PENDING, "the ESC needs neutral before reverse"
        elif self._fraction >= 0 and history.neutral_ns(now_ns) < self.config.dwell_s * NS_PER_S:
            return 0.0, REVERSE, causes.REVERSE_PENDING, "the ESC needs neutral before reverse"
        return value, REVERSE, causes.REVERSING, f"{value:.2f} is requested"

    # --- stop ---

    def _stop(self, now_ns, cause=causes.STOPPING, prefix=""):
        """Return the answer to a stop: hold on a hill, brake, brake weakly, or neutral; never a push."""
        if self._stop_began_ns is None:
            self._stop_began_ns = now_ns
        if self._holds_on_a_hill(now_ns):
            return -self.config.stop_brake, HOLD, cause, f"{prefix}it stands on a hill, and the brake holds it"
        if self._state == REVERSE or not self._stop_brakes(now_ns):
            weak = self._weak_stop(now_ns)
            return (weak, BRAKING, cause, prefix + WEAKLY) if weak else (
                0.0, NEUTRAL, cause, f"{prefix}it stops in neutral")
        lasts_ns = now_ns - self._stop_began_ns
        rolls = self._motion.rolls_forward(now_ns) or self._comes_to_rest(now_ns)
        if lasts_ns > self.config.stop_brake_time_s * NS_PER_S and not rolls:
            return 0.0, NEUTRAL, cause, f"{prefix}it has braked for {self.config.stop_brake_time_s:g} s"
        return -self.config.stop_brake, BRAKING, cause, f"{prefix}it brakes"

    def _weak_stop(self, now_ns):
        """Return the weak pull of a stop that isn't certain to brake; 0 = neutral."""
        if self._state == REVERSE or self.config.profile == UNVERIFIED or not self._history.is_known(now_ns):
            return 0.0
        held_ns = HELD_PULL_NS if self.config.profile == BRAKE_THEN_REVERSE else PULL_NS
        return self._weak_pull(-self.config.stop_brake, now_ns, held_ns)

    def _holds_on_a_hill(self, now_ns):
        """Return whether a stop holds the brake at standstill: on a known hill, if it began while the car rolled."""
        return (self._hill.drives_the_car and self._state in (BRAKING, HOLD) and self._motion.stands(now_ns)
                and self.config.stop_brake > 0 and self._stop_is_certain(now_ns))

    def _stop_brakes(self, now_ns):
        """Return whether a stop brakes: only where that can't become reverse, even if esc/profile is wrong.

        So a profile that nobody has measured is trusted only once the ESC has proved its kind (``esc_proof``). Without
        that a stop brakes while the car is known to be faster than esc/brake_margin.
        """
        if self.config.profile == UNVERIFIED or not self.config.stop_brake or not self._history.is_known(now_ns):
            return False
        if self._motion.rolls_backward(now_ns) or self._motion.stands(now_ns) and not self._comes_to_rest(now_ns):
            return False
        return self._stop_is_certain(now_ns) or self._is_fast(-self.config.stop_brake, now_ns)

    def _comes_to_rest(self, now_ns):
        """Return whether the brake has only just brought the car to odometry's standstill: it may still roll."""
        return self._state == BRAKING and self._motion.stands(now_ns) and now_ns - self._rolled_ns <= REST_NS

    def _stop_is_certain(self, now_ns):
        """Return whether the ESC takes a stop's pull for a brake down to standstill, by its kind and its history."""
        if not (self._is_measured or self._proof.is_given):
            return False
        if self.config.profile == FORWARD_ONLY and self._is_measured:
            return True
        # The proof shows a brake after forward only: after neutral this ESC may still reverse.
        return (self.config.profile in (BRAKE_THEN_REVERSE, FORWARD_ONLY) and self._history.brake_is_certain(now_ns)
                and self._history.coasted_ns(now_ns) <= STOP_MEMORY_NS)

    # --- what follows from the answer ---

    def _finish(self, answer, now_ns):
        """Return an answer as a decision, and record it for the next steps."""
        fraction, state, cause, reason = answer
        self._update_lagging_pull(now_ns)
        if state == REVERSE and self._state != REVERSE:
            self._saw_speed_in_reverse = False
        if state == REVERSE and (self._motion.stands(now_ns) or self._motion.rolls_backward(now_ns)):
            self._saw_speed_in_reverse = True
        if not (state == BRAKING and self._state == BRAKING and abs(fraction - self._fraction) <= SAME_BRAKE):
            self._brakes_since_ns = now_ns
        if state == BRAKING:
            self._motion.update_brake(now_ns)
        # By the state until now: with this speed no pull is given any more.
        if self._state in (BRAKING, HOLD) and self._fraction < 0 and self._motion.rolls_backward(now_ns):
            self._proof.doubt()
        self._fraction, self._state = fraction, state
        self._history.update_sent(fraction, now_ns)
        self._hill.step(fraction, self._motion, now_ns)
        self._proof.step(fraction, state == FORWARD, self._history.pulled_ns(now_ns), self._motion, now_ns)
        return EscDecision(fraction, state, cause, reason, self._stop_mps2(now_ns))

    def _update_lagging_pull(self, now_ns):
        keeps = math.exp((self._finished_ns - now_ns) / (MOTOR_LAG_NS + ACTUATION_NS))
        self._lagging_pull = keeps * self._lagging_pull + (1.0 - keeps) * max(0.0, -self._fraction)
        self._finished_ns = now_ns

    def _stop_mps2(self, now_ns):
        """Return the deceleration of a stop down to standstill: the brake's if it is certain, else drag's."""
        if (self._state in (ARMING, REVERSE) or not self._stop_brakes(now_ns) or not self._stop_is_certain(now_ns)):
            return self.config.drag_deceleration_mps2
        return self.config.stop_brake * self.config.brake_deceleration_mps2


def _clamped(request):
    return "" if abs(request.value) <= 1 else f" ({request.value:g}, clamped)"
