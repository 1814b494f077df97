"""Decide who drives the throttle, and with what request.

Consumes emergency stop, deadman, turn_arb's state, the servo board's duties, the gamepad's throttle and mode, the
planner's value and gear, and odometry, each with its arrival on the monotonic clock. ``ThrottleArbiter.decide`` returns
an ``Arbitration``: source, cause, reason, and a request or a stop. Pure: ``now_ns`` is passed in.

A request is a fraction of the duty between the ESC's neutral and each end: 1 = full forward, −1 = full brake or
reverse. The ESC's rules (``throttle.esc``) decide whether a negative request brakes, reverses or is withheld.
"""
from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple, Sequence

from car_interface.common import causes, declared
from car_interface.common.causes import HUMAN_DRIVES, MODES, OVERRIDE_HOLD_S
from car_interface.common.measured_speed import MAX_SPEED_MPS
from car_interface.common.sources import LOCKED, NEUTRAL, NO_HUMAN, PLANNER, TELEOP, source_name
from car_interface.common.staleness import TimedInput
from car_interface.common.units import NS_PER_S
from car_interface.interlock.motion_interlock import InterlockConfig, MotionInterlock
from car_interface.throttle.battery import BatteryConfig, BatteryWatch
from car_interface.throttle.board_watch import BoardConfig, BoardWatch, Trouble
from car_interface.throttle.esc_intention import AUTO, DRIVE, REVERSE_GEAR
from car_interface.throttle.stick import Scale, StickConfig, shaped

COAST_GEAR = "neutral"  # the planner's, beside AUTO, DRIVE and REVERSE_GEAR, as planner_interface publishes them
PLANNER_STATE_TIMEOUT_S = 0.5  # five of its periods: it is published at 10 Hz

# The description that five parameters share.
STALE = "age at which turn_arb's state, the gamepad's throttle and mode, the planner's value, and odometry are stale"
# The default timeout of the inputs: an older message would be stale. So a stick's message that arrives this long after
# a planner's mode, or after the deadman's release, was sent after it.
SETTLES_NS = round(0.5 * NS_PER_S)

# ThrottleState.source has the values of SteeringState.source: LOCKED, NO_HUMAN, NEUTRAL, TELEOP, PLANNER.


@dataclass(frozen=True)
class ThrottleArbiterConfig:
    """Configure who drives; without ``board`` the servo board is not checked."""

    stick: StickConfig = declared.group(StickConfig())
    interlock: InterlockConfig = declared.group(InterlockConfig())
    steering_timeout_s: float = declared.timeout("steering_timeout", 0.25, STALE)
    teleop_timeout_s: float = declared.timeout("teleop_timeout", 0.5, STALE)
    mode_timeout_s: float = declared.timeout("mode_timeout", 0.5, STALE)
    command_timeout_s: float = declared.timeout("command_timeout", 0.5, STALE)
    odometry_timeout_s: float = declared.timeout("odometry_timeout", 0.5, STALE)
    board: BoardConfig | None = declared.group(None, config_class=BoardConfig)
    battery: BatteryConfig = declared.group(BatteryConfig(), "battery/")


class Arbitration(NamedTuple):
    """The source that drives, and its request to the ESC."""

    source: int
    cause: str  # one of car_interface.common.causes
    reason: str
    asked: float  # the source's request before scaling, −1..1; 0 without a source
    drive: float  # the request if the ESC drives by it, of the same sign
    brake: float  # the request if the ESC brakes by it, of the same sign
    is_stop: bool  # the car has to stop. False with a request of 0: nobody asks for anything, and it coasts
    gear: str = AUTO
    cruise_mps: float = 0.0  # the speed that the planner wants the car to keep; 0 = none, or unknown


class ThrottleArbiter(MotionInterlock):
    """Decide who drives, from the newest message of each input.

    The first rule that applies decides:

    1. The e-stop, no deadman, a stopped turn_arb, or a servo board that doesn't follow turn_arb: stop.
    2. A mode, or a stick, that was received before and is now stale or invalid, or that was never received while
       teleop_logi runs: stop. The planner doesn't get the throttle then, since the human may believe that they drive.
    3. The human, if the mode gives them the throttle or the stick is beyond its dead band.
    4. The planner, if it has a value, odometry is fresh and the battery isn't empty; else stop, or neutral if no
       planner ever sent a value.

    Where the mode gives the throttle to the planner, a stick beyond its dead band overrides the planner until it has
    been centered for OVERRIDE_HOLD_S. An override has the gear DRIVE, in which no pull ever becomes reverse. A human
    who takes over from the planner has it, too, until the stick was centered SETTLES_NS later: mode and stick arrive on
    different topics, so a pull that arrives earlier may have been sent under the planner's deadman.

    Attributes:
        battery: takes its voltages, and says how it is.
        scale: of driving by hand; takes the gamepad's buttons.
    """

    def __init__(self, config: ThrottleArbiterConfig = ThrottleArbiterConfig()):
        super().__init__(config.interlock)
        self._stick = config.stick
        self.scale = Scale(config.stick)
        self._steering = TimedInput("turn_arb's state", config.steering_timeout_s)
        self._teleop = TimedInput("tele_throt_req", config.teleop_timeout_s)
        self._mode = TimedInput("mode", config.mode_timeout_s)
        self._planner = TimedInput("the planner's value", config.command_timeout_s)
        self._planner_state = TimedInput("planner_interface's state", PLANNER_STATE_TIMEOUT_S)
        self._odometry = TimedInput("odometry", config.odometry_timeout_s)
        self._output = TimedInput("/servo/output", 0.0)
        self._overrode_ns: int | None = None  # when a stick last asked for something under a planner's deadman
        # When a mode last gave the throttle to the planner, or when the deadman was released after that; None: the
        # stick was centered since then.
        self._gave_ns: int | None = None
        self._no_value: Trouble | None = None
        self._board = None if config.board is None else BoardWatch(config.board)
        self.battery = BatteryWatch(config.battery)
        # That the planner asked again after it had no request.
        self._resumed = TimedInput("the planner's return", config.command_timeout_s)

    @property
    def mode(self) -> str:
        """Return the newest mode; empty: none was received."""
        return self._mode.value or ""

    def update_human(self, present: bool, now_ns: int) -> None:
        """Take the deadman: true while a human holds it."""
        super().update_human(present, now_ns)
        if not present:
            self._overrode_ns = None
            if self._gave_ns is not None:  # a teleop sends 0 without a deadman, even for a stick that is pulled
                self._gave_ns = now_ns

    def update_steering(self, source: int, reason: str, now_ns: int) -> None:
        """Take who steers, and why, from turn_arb's state."""
        self._steering.update((source, reason), now_ns)

    def update_steering_command(self, channel: int, duty: int, now_ns: int) -> None:
        """Take the duty that turn_arb commands, and its channel."""
        if self._board is not None:
            self._board.update_command(channel, duty, now_ns)

    def update_output(self, duties: Sequence[int], now_ns: int) -> None:
        """Take the 16 duties that the servo board holds, −1 = never set."""
        self._output.update(duties, now_ns)
        if self._board is not None:
            self._board.update_output(duties, now_ns)

    def update_teleop(self, throttle: float, now_ns: int) -> None:
        """Take the gamepad's throttle: −1 = brake or reverse, 1 = forward; NaN = invalid."""
        self._teleop.update(throttle, now_ns)
        if not math.isfinite(throttle):
            return
        request = shaped(throttle, self._stick.deadband, self._stick.expo)
        if self._is_planners and request:
            self._overrode_ns = now_ns
        elif request >= 0 and self._has_settled(now_ns):
            self._gave_ns = None

    def update_mode(self, mode: str, now_ns: int) -> None:
        """Take who steers and who drives while a deadman is held: one of ``causes.MODES``."""
        was_planners = self._is_planners
        self._mode.update(mode, now_ns)
        if was_planners or self._is_planners:
            self._gave_ns = now_ns
        if not self._is_planners:
            self._overrode_ns = None

    def update_planner(self, value: float, request: float, now_ns: int) -> None:
        """Take the planner's value, and the request that it stands for; both may be NaN or infinite."""
        self._planner.update((value, request), now_ns)

    def update_converter(self, no_value: Trouble | None) -> None:
        """Take the converter's reason for having no value for the newest command; ``None`` = it has one."""
        self._no_value = no_value

    def update_planner_state(self, gear: str, no_request: Trouble | None, now_ns: int, speed_mps: float = 0.0) -> None:
        """Take planner_interface's state: gear, requested speed, and the reason if there is no request.

        When there is a request again, the value from before the pause is stale.
        """
        before = self._planner_state.value
        self._planner_state.update((gear, no_request, speed_mps if math.isfinite(speed_mps) else 0.0), now_ns)
        if no_request is not None:
            self._planner.mark_stale("the planner paused")
        elif before is not None and before[1] is not None:
            self._resumed.update(True, now_ns)

    def update_odometry(self, speed_mps: float, now_ns: int, age_ns: int = 0) -> None:
        """Take the measured speed, forward positive, and its age at arrival; beyond MAX_SPEED_MPS it is infinite."""
        is_no_cars = abs(speed_mps) > MAX_SPEED_MPS
        self._odometry.update(math.copysign(math.inf, speed_mps) if is_no_cars else speed_mps, now_ns, age_ns)

    def mark_stale(self, now_ns: int) -> None:
        """Treat all inputs as stale, since messages were dropped on their way here."""
        self._resumed.mark_stale()
        if self._mode.was_received:
            self._gave_ns = now_ns  # one of them may have been a planner's mode
        super().mark_stale(now_ns)
        for timed in (self._steering, self._teleop, self._mode, self._planner, self._planner_state, self._odometry):
            timed.mark_stale()
        if self._board is not None:
            self._board.mark_stale()

    def is_centered(self, now_ns: int) -> bool:
        """Return whether the gamepad's throttle is within its dead band, or was never received."""
        if not self._teleop.was_received:
            return True
        throttle = self._teleop.value
        return (not self._teleop.is_stale(now_ns) and math.isfinite(throttle)
                and not shaped(throttle, self._stick.deadband, self._stick.expo))

    def speed_mps(self, now_ns: int) -> float:
        """Return the speed by odometry; NaN = unknown."""
        return math.nan if self._odometry.is_stale(now_ns) else self._odometry.value

    def ages_s(self, now_ns: int) -> dict[str, float]:
        """Return the seconds since the last message of each input, by name; inf = never received."""
        timed = (self._e_stop, self._human, self._steering, self._teleop, self._mode, self._planner, self._odometry,
                 self._output)
        return {one.name: one.age_s(now_ns) for one in timed}

    def decide(self, now_ns: int) -> Arbitration:
        """Return who drives at ``now_ns``, with what request, and why."""
        board = self._board and self._board.trouble(now_ns)  # also without a human: agreement takes half a second
        inhibit = self.inhibit(now_ns)
        if inhibit is not None:
            return _stop(LOCKED if inhibit.locked else NO_HUMAN, inhibit.cause, inhibit.reason)
        return (self._steering_trouble(now_ns) or board and _stop(NEUTRAL, *board) or self._mode_trouble(now_ns)
                or self._by_hand(now_ns) or self._by_planner(now_ns))

    def _steering_trouble(self, now_ns):
        """Return a stop if turn_arb doesn't steer, or None: steering and throttle stop together."""
        if self._steering.is_stale(now_ns):
            return _stop(NEUTRAL, causes.STEERING_STALE, self._steering.stale_reason(now_ns))
        source, reason = self._steering.value
        if source in (NEUTRAL, TELEOP, PLANNER):
            return None
        quoted = f": {reason}" if reason else ""
        return _stop(NEUTRAL, causes.STEERING_STOPPED, f"turn_arb says {source_name(source)}{quoted}")

    def _mode_trouble(self, now_ns):
        """Return a stop for a mode that is stale or unknown, or None."""
        if not self._mode.was_received:  # requests from the command line, or from a teleop without modes
            return self._unheard_trouble(causes.MODE_STALE, self._mode)
        if self._mode.is_stale(now_ns):
            return _stop(NEUTRAL, causes.MODE_STALE, self._mode.stale_reason(now_ns))
        if self._mode.value not in MODES:
            return _stop(NEUTRAL, causes.MODE_UNKNOWN,
                         f"mode is {self._mode.value!r}, which is none of {', '.join(MODES)}")
        return None

    def _unheard_trouble(self, cause, timed):
        """Return a stop for an input that was never received, though teleop_logi runs, or None."""
        if self._explanation.was_received:
            return _stop(NEUTRAL, cause, f"{timed.name} was never heard, though teleop_logi runs")
        return None

    def _by_hand(self, now_ns):
        """Return the human's request, a stop if it is stale or invalid, or None if the human leaves the throttle."""
        human_drives = self._mode.value in HUMAN_DRIVES
        if not self._teleop.was_received and not human_drives:
            return self._unheard_trouble(causes.TELEOP_STALE, self._teleop)
        if self._teleop.is_stale(now_ns):
            return _stop(NEUTRAL, causes.TELEOP_STALE, self._teleop.stale_reason(now_ns))
        throttle = self._teleop.value
        if not math.isfinite(throttle):
            explanation = "" if self._explanation.is_stale(now_ns) else f": {self._explanation.value[1]}"
            return _stop(NEUTRAL, causes.TELEOP_NOT_FINITE,
                         f"tele_throt_req is {throttle}, no number to act on{explanation}")
        request = shaped(throttle, self._stick.deadband, self._stick.expo)
        if self._is_planners:
            return self._by_override(throttle, request, now_ns)
        if not (request or human_drives):
            return None
        if self._gave_ns is not None:
            why = ": it only brakes until the stick was centered, since the planner drove before" if request < 0 else ""
            return self._without_reverse(causes.TELEOP, throttle, request, why)
        reason = f"tele_throt_req is {throttle:.3f}, scaled by {self.scale.value:g}"
        return Arbitration(TELEOP, causes.TELEOP, reason, request, request * self.scale.value,
                           request * self._stick.brake_scale, False)

    @property
    def _is_planners(self):
        """Return whether the newest mode gives the throttle to the planner."""
        return self._mode.value in MODES and self._mode.value not in HUMAN_DRIVES

    def _has_settled(self, now_ns):
        """Return whether a stick's message that arrives now was sent under a deadman by which the human drives."""
        return self._gave_ns is None or not self._is_planners and now_ns - self._gave_ns >= SETTLES_NS

    def _without_reverse(self, cause, throttle, request, why):
        """Return a stick's request in the gear DRIVE. Its pull never drives, so it has the brake's scale only."""
        scale = self._stick.brake_scale if request < 0 else self.scale.value
        reason = f"tele_throt_req is {throttle:.3f}, scaled by {scale:g}{why}"
        return Arbitration(TELEOP, cause, reason, request, request * scale, request * self._stick.brake_scale, False,
                           DRIVE)

    def _by_override(self, throttle, request, now_ns):
        """Return a stick's request under a planner's deadman, neutral for a while after it, then None."""
        if request:
            return self._without_reverse(causes.OVERRIDE, throttle, request, ": it overrides the planner")
        if self._overrode_ns is None or now_ns - self._overrode_ns >= OVERRIDE_HOLD_S * NS_PER_S:
            return None
        reason = f"the throttle stick overrode the planner, which waits until it was centered for {OVERRIDE_HOLD_S:g} s"
        return Arbitration(TELEOP, causes.OVERRIDE, reason, 0.0, 0.0, 0.0, False, DRIVE)

    def _by_planner(self, now_ns):
        """Return the planner's request, a stop if there is none, or neutral if no planner ever sent a value."""
        # By AUTO no planner reverses.
        gear, no_request, speed_mps = self._planner_state.fresh(now_ns) or (AUTO, None, 0.0)
        trouble = no_request or self._no_value
        if trouble is None and not self._planner.was_received:
            return Arbitration(NEUTRAL, causes.NO_REQUEST, "neither tele_throt_req nor a planner's value asks for "
                               "anything", 0.0, 0.0, 0.0, False)
        trouble = trouble or self._planner_trouble(now_ns)
        if trouble is not None:
            return _stop(NEUTRAL, *trouble)
        value, request = self._planner.value
        if gear == COAST_GEAR:
            return Arbitration(PLANNER, causes.PLANNER, "the planner's gear is neutral: the car coasts", 0.0, 0.0, 0.0,
                               False, DRIVE)
        return Arbitration(PLANNER, causes.PLANNER, f"the planner's value is {value:.3f}", request, request,
                           request, False, gear if gear in (AUTO, REVERSE_GEAR) else DRIVE, speed_mps)

    def _planner_trouble(self, now_ns):
        """Return why the planner's value can't be followed, or None; without odometry none can."""
        if self._is_awaited(now_ns):
            return Trouble(causes.COMMAND_AWAITED, "the planner asks again: its first value is awaited")
        if self._planner.is_stale(now_ns):
            return Trouble(causes.COMMAND_STALE, self._planner.stale_reason(now_ns))
        (value, _), odometry = self._planner.value, self._odometry
        if not math.isfinite(value):
            return Trouble(causes.COMMAND_NOT_FINITE, f"the planner's value is {value}, no number to act on")
        if odometry.is_stale(now_ns):
            return Trouble(causes.ODOMETRY_STALE, odometry.stale_reason(now_ns))
        if not math.isfinite(odometry.value):
            return Trouble(causes.ODOMETRY_NOT_FINITE, f"the velocity in the odometry is {odometry.value}")
        return Trouble(*self.battery.status(now_ns)) if self.battery.is_empty else None

    def _is_awaited(self, now_ns):
        """Return whether the planner resumed just now: its state arrives before the converter's first value."""
        return self._planner.is_marked_stale and not self._resumed.is_stale(now_ns)


def _stop(source, cause, reason):
    return Arbitration(source, cause, reason, 0.0, 0.0, 0.0, True)
