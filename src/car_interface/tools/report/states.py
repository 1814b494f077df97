"""Follows the states that the nodes published: who drove and why, what was cut, and why gamepad and planner failed.

There is one watch for each node's state. It writes numbers to ``traces``, and adds what went wrong to ``faults``.
"""
from __future__ import annotations

import math
from collections import Counter
from typing import Any, NamedTuple

from car_interface.common import causes
from car_interface.common.sources import LOCKED, NEUTRAL, NO_HUMAN, PLANNER, TELEOP
from car_interface.common.units import NS_PER_S, stamp_ns
from car_interface.pca9685.registers import DUTY_PER_COUNT
from car_interface.steering.arbiter import SteeringArbiterConfig
from car_interface.tools.report.downsample import Traces
from car_interface.tools.report.faults import ERROR, MAX_ENTRIES, OK, WARN, Fault, FaultLog

DRIVERS = (LOCKED, NO_HUMAN, NEUTRAL, TELEOP, PLANNER)
UNKNOWN_DRIVER = -1
STEERING_CHANNEL = 0  # as config/turn_arb.yaml has it: where turn_arb's state says none, or was not recorded
NEVER_AFTER_S = 5.0  # a gamepad that sends nothing for so long from the start on is missing
APART_S = 1.0  # a release may be recorded so long before or after turn_arb's state that follows it, on a busy computer
USUAL = ("NEUTRAL", "FORWARD")  # states of the ESC that come and go with the stick: they end no episode
# What the states of turn_arb and planner_interface report, too.
SHARED = causes.INHIBITS | {causes.STEERING_STALE, causes.STEERING_STOPPED, causes.PLANNER_STALE}
PLANNER_FAULTS = causes.LOSSES | {causes.REQUEST_REFUSED}  # the others are reported by those that stop because of them
CUTS = causes.STEERING_CUTS | causes.THROTTLE_CUTS
SAME_AFTER_S = 0.5  # a cut that comes back sooner is the same one
# A request or a state that is older holds no longer: turn_arb's default for a planner, which is throttle_arb's, too.
TIMEOUT_S = SteeringArbiterConfig.planner_timeout_s
CLOCK_SET_S = 0.05  # a change between ROS time and the monotonic clock from one pong to the next
MIN_SPAN_S = 0.5  # over which frames are counted


def is_fresh(received_s: float, time_s: float) -> bool:
    """Return whether a request or a state still holds; −inf = never received."""
    return 0 <= time_s - received_s <= TIMEOUT_S  # the recording's clock may have been set back


class Episode(NamedTuple):
    """A time in which a node's state stayed the same."""

    start_s: float
    end_s: float  # inf = it lasts
    node: str  # whose state it is
    cause: str  # a constant of common.causes
    reason: str  # in words, at its start
    source: int = UNKNOWN_DRIVER  # who drives, else one of DRIVERS
    esc: str = ""  # the ESC's state; empty = one of USUAL
    esc_cause: str = ""

    @property
    def why(self) -> str:
        """Return its cause, the reason where a state gives none."""
        return self.cause or self.reason

    def goes_on(self, later: Episode) -> bool:
        """Return whether the state that begins a later episode is this one's, whatever its reason."""
        return (self.node, self.cause, *self[5:]) == (later.node, later.cause, *later[5:])


class Episodes:
    """Follows one node's state as episodes.

    A watch of a state has ``_judge``, which takes each episode that has ended, and returns it as it is kept, and its
    level as a fault; OK = it is none.
    """

    node = ""  # whose state it is

    def __init__(self, traces: Traces, faults: FaultLog):
        self._traces, self._faults = traces, faults
        self.episodes: list[Episode] = []  # those that have ended, up to MAX_ENTRIES
        self.dropped = 0  # how many more there were
        self.driver, self._state_s = UNKNOWN_DRIVER, -math.inf  # of the newest state
        self._current: Episode | None = None  # the one that lasts; None = there was no state yet

    def driver_at(self, time_s: float) -> int | None:
        """Return who drives by the newest state; ``None`` = unknown."""
        return self.driver if is_fresh(self._state_s, time_s) else None

    def finish(self) -> None:
        """End the last episode at the recording's end."""
        self._end(self._traces.duration_s)

    def _update(self, time_s: float, message: Any, reason: str = "", source: int = UNKNOWN_DRIVER, *esc: str) -> None:
        """Take a state: the episode goes on, or another one begins."""
        self.driver, self._state_s = source if source in DRIVERS else UNKNOWN_DRIVER, time_s
        begun = Episode(time_s, math.inf, self.node, message.cause, reason or message.reason, self.driver, *esc)
        if self._current is None or not self._current.goes_on(begun):
            self._end(time_s)
            self._current = begun

    def _end(self, time_s):
        if self._current is None:
            return
        ended, level = self._judge(self._current._replace(end_s=time_s))
        self._current = None
        if level != OK:
            self._faults.add(Fault(ended.start_s, level, self.node, ended.reason, ended.end_s))
        if len(self.episodes) < MAX_ENTRIES:
            self.episodes.append(ended)
        else:
            self.dropped += 1


class GamepadWatch(Episodes):
    """Follows teleop_logi's state: what was wrong with the gamepad."""

    node = "teleop_logi"

    def __init__(self, traces: Traces, faults: FaultLog):
        super().__init__(traces, faults)
        self._unused_axis: Fault | None = None  # while an axis wasn't seen at its rest
        self._releases: list[Episode] = []  # what ended each time of a held deadman, a loss or not; up to MAX_ENTRIES
        self._was_held = False

    def on_state(self, time_s: float, message: Any) -> None:
        """Take a car_interface/TeleopState."""
        self._update(time_s, message)
        if self._was_held and not message.human_in_loop and len(self._releases) < MAX_ENTRIES:
            self._releases.append(self._current)
        self._was_held = message.human_in_loop
        if causes.NOT_AT_REST not in (message.steering_stick, message.throttle_stick):
            self._end_unused_axis(time_s)
        elif self._unused_axis is None:
            self._unused_axis = Fault(time_s, WARN, self.node, message.reason)

    def loss_at(self, time_s: float) -> Episode | None:
        """Return the loss for which the deadman was false from a time on; ``None`` = none, or it was let go."""
        release = min(self._releases, key=lambda release: abs(release.start_s - time_s), default=None)
        if release is not None and abs(release.start_s - time_s) <= APART_S:
            return release if release.cause in causes.LOSSES else None
        return next((one for one in (*self.episodes, *filter(None, [self._current]))
                     if one.cause in causes.LOSSES and one.start_s <= time_s <= one.end_s), None)

    def finish(self) -> None:
        """End what lasts."""
        super().finish()
        self._end_unused_axis(self._traces.duration_s)

    def _end_unused_axis(self, time_s):
        if self._unused_axis is not None:
            self._faults.add(self._unused_axis._replace(end_s=time_s))
        self._unused_axis = None

    def _judge(self, ended):
        never = ended.cause == causes.JOY_NEVER_RECEIVED and ended.end_s - ended.start_s >= NEVER_AFTER_S
        return ended, (ERROR if ended.cause in causes.JOY_UNUSABLE else
                       WARN if ended.cause in causes.LOSSES or never else OK)


class SteeringWatch(Episodes):
    """Follows turn_arb's state, the requests, and the board's output; ``gamepad`` says why a deadman was false."""

    node = "turn_arb"

    def __init__(self, traces: Traces, faults: FaultLog, gamepad: GamepadWatch):
        super().__init__(traces, faults)
        self._gamepad = gamepad
        self.source_s: Counter = Counter()  # seconds by source
        self.duties = Traces(traces.duration_s)  # by channel, of those that were ever driven
        self.steering_channel = STEERING_CHANNEL  # that carries turn_arb's duty
        self.curvature_per_m: float | None = None  # sent by turn_arb now, left positive; None = unknown
        self.unchanged_since_s = 0.0  # when turn_arb's duty last changed by a step of the board
        self._steady_duty = math.nan  # since then

    def on_state(self, time_s: float, message: Any) -> None:
        """Take a car_interface/SteeringState."""
        self.curvature_per_m = 1 / message.turn_radius if message.turn_radius else math.nan
        self._traces["sent curvature"].add(time_s, self.curvature_per_m)
        # Understeer moves the duty a little with the speed.
        if not (abs(message.duty - self._steady_duty) < DUTY_PER_COUNT and is_fresh(self._state_s, time_s)):
            self._steady_duty, self.unchanged_since_s = message.duty, time_s
        self.steering_channel = getattr(message, "channel", STEERING_CHANNEL)
        self._update(time_s, message, source=message.source)

    def expire(self, time_s: float) -> None:
        """Forget what turn_arb sent if it is silent, or nobody has the car, which may be carried then."""
        if self.driver_at(time_s) in (None, LOCKED, NO_HUMAN):
            self.curvature_per_m = None

    def on_output(self, time_s: float, message: Any) -> None:
        """Take the std_msgs/Int32MultiArray of /servo/output."""
        for channel, duty in enumerate(message.data):
            if duty > 0 or channel in self.duties:
                self.duties[channel].add(time_s, duty)

    def stops(self) -> list[Episode]:
        """Return the episodes in which nobody drove any more."""
        return [episode for before, episode in zip(self.episodes, self.episodes[1:])
                if before.source in (TELEOP, PLANNER) and episode.source in (LOCKED, NO_HUMAN, NEUTRAL)]

    def losses(self) -> list[Episode]:
        """Return those of the stops at which something was lost or locked."""
        return [stop for stop in self.stops() if stop.source == LOCKED or stop.cause in causes.LOSSES]

    def driven_from_s(self) -> float:
        """Return when somebody first drove; inf = never."""
        return min((one.start_s for one in self.episodes if one.source in (TELEOP, PLANNER)), default=math.inf)

    def _judge(self, ended):
        loss = self._gamepad.loss_at(ended.start_s) if ended.cause == causes.HUMAN_ABSENT else None
        if loss is not None:  # the gamepad's own fault is another line of the table of faults
            ended = ended._replace(cause=loss.cause, reason=f"human_in_loop is false: {loss.reason}")
        self.source_s[ended.source] += ended.end_s - ended.start_s
        is_loss = ended.source in (NO_HUMAN, NEUTRAL) and ended.cause in causes.LOSSES and loss is None
        return ended, ERROR if ended.source == LOCKED else WARN if is_loss else OK


class ThrottleWatch(Episodes):
    """Follows throttle_arb's state: who drove the throttle and why, what was asked, and what the ESC was given.

    Of the losses those are faults that turn_arb doesn't report.
    """

    node = "throttle_arb"
    profile = ""  # the ESC's kind; empty: unknown

    def on_state(self, time_s: float, message: Any) -> None:
        """Take a car_interface/ThrottleState."""
        self.profile = message.profile
        self._traces["throttle asked"].add(time_s, message.asked)
        self._traces["throttle granted"].add(time_s, message.granted)
        esc = () if message.esc in USUAL else (message.esc, message.esc_cause)
        reason = f"{message.reason}; {message.esc}: {message.esc_reason}" if esc else message.reason
        self._update(time_s, message, reason, message.source, *esc)

    def losses(self) -> list[Episode]:
        """Return the episodes with a loss of the throttle's own."""
        return [episode for episode in self.episodes if _is_loss(episode)]

    def _judge(self, ended):
        return ended, ERROR if ended.esc_cause == causes.ESC_MOTION else WARN if _is_loss(ended) else OK


def _is_loss(episode):
    return episode.esc_cause == causes.ESC_MOTION or episode.cause in causes.LOSSES - SHARED


class PlannerWatch(Episodes):
    """Follows planner_interface's state: what the planner asked for, and why it wasn't obeyed."""

    node = "planner_interface"
    source = ""  # that was obeyed; empty: unknown
    others = ""  # the sources that weren't, with their messages, at the end; empty: none
    _obeyed_s = -math.inf  # when it was last obeyed

    def on_state(self, time_s: float, message: Any) -> None:
        """Take a car_interface/PlannerState."""
        self.source, self.others = message.source, message.others
        is_obeyed = message.cause == causes.PLANNER
        self._obeyed_s = time_s if is_obeyed else -math.inf
        self._traces["planner's speed"].add(time_s, message.speed if is_obeyed else math.nan)
        self._traces["reference speed"].add(time_s, message.reference_speed if is_obeyed else math.nan)
        self._update(time_s, message)

    def obeyed_at(self, time_s: float) -> str:
        """Return the source that is obeyed; empty = none, or it is unknown."""
        return self.source if is_fresh(self._obeyed_s, time_s) else ""

    def _judge(self, ended):
        return ended, WARN if ended.cause in PLANNER_FAULTS else OK


class LimitsWatch:
    """Follows the limits in the states of turn_arb and throttle_arb: which requests were cut, when, and why."""

    def __init__(self):
        self.episodes: list[Episode] = []  # up to MAX_ENTRIES, by their starts once finished
        self.counts: Counter = Counter()  # by node, how often a request began to be limited, by its own count
        self._current: dict[str, Episode] = {}  # by node, up to when it was last seen
        self._seen: dict[str, int] = {}  # a node's newest count

    def on_state(self, time_s: float, message: Any, node: str) -> None:
        """Take a car_interface/SteeringState or ThrottleState."""
        before = self._seen.get(node, message.cuts)
        self.counts[node] += message.cuts - before if message.cuts >= before else message.cuts  # restarted: from 0
        self._seen[node] = message.cuts
        if message.limit not in CUTS:
            return
        begun, current = Episode(time_s, time_s, node, message.limit, message.limit_reason), self._current.get(node)
        if current is not None and current.goes_on(begun) and time_s - current.end_s <= SAME_AFTER_S:
            begun = current._replace(end_s=time_s)
        elif current is not None and len(self.episodes) < MAX_ENTRIES:
            self.episodes.append(current)
        self._current[node] = begun

    def finish(self) -> None:
        """Keep the last episodes, too."""
        self.episodes = sorted([*self.episodes, *self._current.values()], key=lambda one: one.start_s)[:MAX_ENTRIES]


class TeensyWatch:
    """Follows the hub's link status, the pongs and the Teensy's counters."""

    def __init__(self, traces: Traces, faults: FaultLog):
        self._traces, self._faults = traces, faults
        self.first_link = self.link = None  # the first and a recent LinkStatus; None without any
        self.counters: dict = {}  # (first, last) value by name
        self.pongs = self.pongs_unused = 0  # how many, and how many of them were not used for the clock
        self._link_s = 0.0
        self._monotonic_offset_ns = math.nan  # of ROS time, at the newest pong; NaN = there was none

    def on_link(self, time_s: float, message: Any) -> None:
        """Take a car_interface/LinkStatus."""
        if self.link is None:
            self.first_link, self.link, self._link_s = message, message, time_s
        before, span_s = self.link, time_s - self._link_s
        for name, what in (("reconnects", "the port was opened again"), ("reboots", "the Teensy started anew")):
            if getattr(message, name) > getattr(before, name):
                self._faults.add(Fault(time_s, WARN, "Teensy", what))
        if span_s > MIN_SPAN_S:
            self._traces["frames"].add(time_s, (message.frames - before.frames) / span_s)
            self._traces["bad frames"].add(time_s, (message.bad_frames - before.bad_frames) / span_s)
            self.link, self._link_s = message, time_s
        what = ". ".join(filter(None, (message.words, message.next_step)))
        self._faults.update_condition(time_s, "link", message.level, "Teensy", f"{message.state}: {what}")
        for counter in message.counters:
            self.on_error(time_s, counter)

    def on_clock(self, time_s: float, message: Any) -> None:
        """Take a car_interface/TeensyClock, one for each pong."""
        self.pongs += 1
        self.pongs_unused += not message.used
        self._traces["round trip"].add(time_s, message.round_trip * 1e3)
        if message.converged:
            self._traces["skew"].add(time_s, message.skew)
            self._traces["uncertainty"].add(time_s, message.uncertainty * 1e3)
        offset_ns = stamp_ns(message.stamp) - message.received
        step_s = (offset_ns - self._monotonic_offset_ns) / NS_PER_S
        if abs(step_s) > CLOCK_SET_S:
            self._faults.add(Fault(time_s, WARN, "computer", f"its clock was set by {step_s:+.3f} s"))
        self._monotonic_offset_ns = offset_ns

    def on_error(self, time_s: float, message: Any) -> None:
        """Take a car_interface/Error: the value of a counter."""
        first, _ = self.counters.get(message.name, (message.count, None))
        self.counters[message.name] = (first, message.count)
