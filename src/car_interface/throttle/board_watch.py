"""Check that the servo board holds what turn_arb commands: throttle is given only while it does.

Takes turn_arb's command for the steering channel (from its state) and the duties that the board holds (/servo/output),
each with its arrival. ``trouble`` returns why no throttle may be given, or None. Pure: ``now_ns`` is passed in.

The two come on different connections, so a duty's report can arrive before or after the state that commands it. So each
moment is judged MARGIN_NS later: the duty held then must be among the commands in force around it, and the command must
be among the duties held around it. The first detects a second sender on the channel. The second detects a servo that
stands still while the commands sweep through its position, as they do when a driver moves the stick to and fro.

Time of disagreement adds up; agreement reduces it at a quarter of that rate.
"""
from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import NamedTuple, Sequence

from car_interface.common import causes, declared
from car_interface.common.staleness import TimedInput
from car_interface.common.units import CHANNELS, MAX_DUTY, NS_PER_MS, NS_PER_S, UNCHANGED

BOARD_LIMITS = "the servo board's limits, by `pca9685.yaml`: a command that it clamps counts as followed"
# Throttle ends after board and turn_arb have differed for this long, and returns after they have agreed for this long.
# It is the timeout of the arbiters' other inputs.
TOLERANCE_NS = 500 * NS_PER_MS
# A report and a state may arrive this far apart: ten periods of turn_arb. This excuses only a command or a duty that
# the other side takes up or leaves within this time.
MARGIN_NS = 100 * NS_PER_MS
JUDGED_NS = TOLERANCE_NS - MARGIN_NS  # of a tolerance: its last margin can't be judged yet
# The node's timer (50 Hz) triggers a judgement. A message that arrives soon after doesn't, so that a released deadman
# doesn't wait for it.
JUDGE_PERIOD_NS = 15 * NS_PER_MS
RECOVERY_RATIO = 4  # the board must follow for four fifths of the time
ROUNDING_DUTY = 16  # a PCA9685 has 4096 counts for the 65536 duties of a period, and some nodes round down


@dataclass(frozen=True)
class BoardConfig:
    """Configure the check of the servo board."""

    output_required: bool = declared.flag(
        "output_required", True, "false = a board node that has never published `/servo/output` is driven unchecked")
    output_timeout_s: float = declared.timeout("output_timeout", 0.5, "age at which `/servo/output` is stale")
    pwm_min: Sequence[int] = declared.duty_of_each(
        "board/pwm_min", (0,) * CHANNELS, BOARD_LIMITS)
    pwm_max: Sequence[int] = declared.duty_of_each("board/pwm_max", (MAX_DUTY,) * CHANNELS, BOARD_LIMITS)


class Trouble(NamedTuple):
    """What keeps the throttle at neutral."""

    cause: str  # one of car_interface.common.causes
    reason: str


class BoardWatch:
    """Judge whether the board follows turn_arb. At first it doesn't, until both have agreed for TOLERANCE_NS."""

    def __init__(self, config: BoardConfig):
        self._config = config
        self._output = TimedInput("/servo/output", config.output_timeout_s)
        self._channel: int | None = None  # of the steering; None: turn_arb has not named it
        self._commands = _History()  # as the board clamps them
        self._held = _History()
        self._judged_ns: int | None = None
        self._difference_ns = 0
        self._agreement_ns = 0  # without interruption
        self._follows = False

    def update_command(self, channel: int, duty: int, now_ns: int) -> None:
        """Take turn_arb's command: the steering channel, 0..15, and its duty."""
        self._channel = channel
        self._commands.add(max(self._config.pwm_min[channel], min(self._config.pwm_max[channel], duty)), now_ns)

    def update_output(self, duties: Sequence[int], now_ns: int) -> None:
        """Take the 16 duties that the board holds, −1 = never set."""
        self._output.update(duties, now_ns)
        if self._channel is not None:
            self._held.add(duties[self._channel], now_ns)

    def mark_stale(self) -> None:
        """Treat both as unknown, since messages were dropped on their way here."""
        self._output.mark_stale()
        self._commands.clear()
        self._restart()

    def trouble(self, now_ns: int) -> Trouble | None:
        """Return why no throttle may be given at ``now_ns``, or None. It depends on earlier calls."""
        if not self._output.was_received:
            if not self._config.output_required:
                return None
            return Trouble(causes.BOARD_NEVER_RECEIVED,
                                "/servo/output was never heard, so it isn't known whether the servo follows. A board "
                                "node that doesn't publish it takes output_required: false")
        if self._output.is_stale(now_ns):
            self._restart()
            return Trouble(causes.BOARD_STALE, self._output.stale_reason(now_ns))
        if self._judged_ns is None or now_ns - MARGIN_NS - self._judged_ns >= JUDGE_PERIOD_NS:
            self._judge(now_ns)
        return None if self._follows else Trouble(causes.STEERING_NOT_HELD, self._reason())

    def _restart(self):
        """Require a whole agreement again."""
        self._judged_ns = None
        self._difference_ns = self._agreement_ns = 0
        self._follows = False

    def _judge(self, now_ns):
        """Account for the time since the last call, up to a margin ago."""
        end_ns = now_ns - MARGIN_NS
        start_ns = now_ns if self._judged_ns is None else self._judged_ns
        self._judged_ns = max(start_ns, end_ns)
        for history in (self._commands, self._held):
            history.forget(start_ns - MARGIN_NS)
        edges = {edge_ns for history in (self._commands, self._held) for since_ns in history.changes()
                 for edge_ns in (since_ns - MARGIN_NS, since_ns, since_ns + MARGIN_NS) if start_ns < edge_ns < end_ns}
        times_ns = sorted({start_ns, self._judged_ns, *edges})
        for begin_ns, until_ns in zip(times_ns, times_ns[1:]):
            self._account(self._agree((begin_ns + until_ns) // 2), until_ns - begin_ns)

    def _account(self, agree, lasted_ns):
        if agree:
            self._agreement_ns += lasted_ns
            self._difference_ns = max(0, self._difference_ns - lasted_ns // RECOVERY_RATIO)
            self._follows |= self._agreement_ns >= JUDGED_NS
        else:
            self._agreement_ns = 0
            self._difference_ns = min(self._difference_ns + lasted_ns, JUDGED_NS)
            self._follows &= self._difference_ns < JUDGED_NS

    def _agree(self, at_ns):
        """Return whether the command at a time was held around it, and the held duty was commanded around it."""
        return (bool(self._commands) and bool(self._held)
                and self._held.covers(self._commands.at(at_ns), at_ns)
                and self._commands.covers(self._held.at(at_ns), at_ns))

    def _reason(self):
        if not (self._commands and self._held):
            return "turn_arb's command for the steering isn't known"
        commanded, held = self._commands.newest, self._held.newest
        if abs(held - commanded) <= ROUNDING_DUTY:
            return f"the servo board holds turn_arb's command, which must last for {TOLERANCE_NS / NS_PER_S:g} s"
        return (f"the servo board holds {'nothing' if held == UNCHANGED else held} on channel {self._channel}, where "
                f"turn_arb commands {commanded}")


class _History(deque):
    """Keep the duties of the recent past, each as (since when it was in force, duty), oldest first."""

    @property
    def newest(self):
        return self[-1][1]

    def add(self, duty, now_ns):
        """Append a duty, if it differs from the newest one."""
        if not self or self.newest != duty:
            self.append((now_ns, duty))

    def forget(self, before_ns):
        """Drop what was no longer in force then."""
        while len(self) > 1 and self[1][0] <= before_ns:
            self.popleft()

    def changes(self):
        """Return when the duties after the first came into force."""
        return [since_ns for since_ns, _ in self][1:]

    def at(self, at_ns):
        """Return the duty in force at a time; the first one also before it is known."""
        return next((duty for since_ns, duty in reversed(self) if since_ns <= at_ns), self[0][1])

    def covers(self, duty, at_ns):
        """Return whether a duty is among those in force within MARGIN_NS of a time, but for rounding."""
        around = [self.at(at_ns - MARGIN_NS), *(each for since_ns, each in self
                                                if at_ns - MARGIN_NS < since_ns <= at_ns + MARGIN_NS)]
        return min(around) - ROUNDING_DUTY <= duty <= max(around) + ROUNDING_DUTY
