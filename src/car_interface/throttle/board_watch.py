"""Checks that the servo board holds what turn_arb commands: throttle is given only while it does.

Consumes turn_arb's command for the steering channel (from its state) and the duties that the board holds
(/servo/output). These arrive on different connections, so the report of a duty can arrive before or after the state
that commands it. What the board held is therefore compared with every command in force up to MARGIN_NS before and
after.

Differences add up, and agreement takes them away only at a quarter of the pace. Otherwise a servo that does not follow
would pass each time that the commands sweep through its position, as they do when a driver moves the stick to and fro.
"""
from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import NamedTuple, Sequence

from car_interface.common import causes
from car_interface.common.servo_channels import CHANNELS, MAX_DUTY, UNCHANGED
from car_interface.common.staleness import TimedInput
from car_interface.common.units import NS_PER_MS, NS_PER_S

BOARD = "board/"  # namespace of pca9685's parameters, of which only the limits are read
# Throttle ends, at the latest, so long after the board and turn_arb began to differ; it returns after they have agreed
# for so long. It is the timeout of the arbiters' other inputs.
TOLERANCE_NS = 500 * NS_PER_MS
# How late a report or a state may be, relative to the other: five periods of turn_arb. A command that the board does
# not follow is excused for twice that, one margin before and one after.
MARGIN_NS = 50 * NS_PER_MS
MAX_DIFFERENCE_NS = TOLERANCE_NS - 2 * MARGIN_NS
RECOVERY_RATIO = 4  # the board must follow for four fifths of the time
# decide() is called at 20 Hz at least. Of a longer gap it is not known what happened in it.
MAX_STEP_NS = 50 * NS_PER_MS
ROUNDING_DUTY = 16  # a PCA9685 divides the 65536 duties of the period into 4096 counts; some nodes round them down


@dataclass(frozen=True)
class BoardConfig:
    """How the servo board is checked, named as the ROS parameters.

    Attributes:
        output_required: throttle is given only once the board has reported. False: a board node that never reports is
            driven unchecked; one that does is checked.
        output_timeout_s: a report older than this is stale; 0 = never.
        pwm_min, pwm_max: what the board clamps each channel's commands to, in duty.
    """

    output_required: bool = True
    output_timeout_s: float = 0.5
    pwm_min: tuple[int, ...] = (0,) * CHANNELS
    pwm_max: tuple[int, ...] = (MAX_DUTY,) * CHANNELS


def read_board(params) -> BoardConfig:
    """Read the configuration from ~output_required, ~output_timeout, and the board's own ~board/pwm_min and pwm_max.

    Raises:
        ConfigError: naming the parameter.
    """
    default = BoardConfig()
    return BoardConfig(
        output_required=params.flag("output_required", default.output_required),
        output_timeout_s=params.timeout("output_timeout", default.output_timeout_s),
        pwm_min=tuple(params.integers(f"{BOARD}pwm_min", CHANNELS, 0, 0, MAX_DUTY)),
        pwm_max=tuple(params.integers(f"{BOARD}pwm_max", CHANNELS, MAX_DUTY, 0, MAX_DUTY)))


class BoardTrouble(NamedTuple):
    """Why no throttle may be given."""

    cause: str  # one of car_interface.common.causes
    reason: str


class _Command(NamedTuple):
    channel: int
    duty: int


class BoardWatch:
    """Judges whether the board follows turn_arb. It does not until both have agreed for TOLERANCE_NS."""

    def __init__(self, config: BoardConfig):
        self._config = config
        self._output = TimedInput("/servo/output", config.output_timeout_s)
        self._commands: deque[tuple[int, _Command]] = deque()  # since when each is in force, oldest first
        self._outputs: deque[tuple[int, tuple[int, ...]]] = deque()  # likewise what the board held
        self._judged_ns: int | None = None
        self._difference_ns = 0
        self._agreement_ns = 0  # without interruption
        self._follows = False

    def update_command(self, channel: int, duty: int, now_ns: int) -> None:
        """Take turn_arb's command: the steering channel, 0..15, and its duty."""
        _append(self._commands, _Command(channel, duty), now_ns)

    def update_output(self, duties: Sequence[int], now_ns: int) -> None:
        """Take the 16 duties that the board holds, −1 = never set."""
        if self._output.is_stale(now_ns):
            self._outputs.clear()  # it is not known what the board held in between
        self._output.update(tuple(duties), now_ns)
        _append(self._outputs, self._output.value, now_ns)

    def mark_stale(self) -> None:
        """Messages were dropped before they got here."""
        self._output.mark_stale()
        self._commands.clear()
        self._restart()

    def age_s(self, now_ns: int) -> float:
        """Return the seconds since the board's last report; inf = it never reported."""
        return self._output.age_s(now_ns)

    def trouble(self, now_ns: int) -> BoardTrouble | None:
        """Return why no throttle may be given at ``now_ns``, or None. It depends on the calls before."""
        if not self._output.was_received:
            if not self._config.output_required:
                return None
            return BoardTrouble(causes.BOARD_NEVER_RECEIVED,
                                "/servo/output was never heard, so it isn't known whether the servo follows. A board "
                                "node that doesn't publish it takes output_required: false")
        if self._output.is_stale(now_ns):
            self._restart()
            return BoardTrouble(causes.BOARD_STALE, self._output.stale_reason(now_ns))
        self._judge(now_ns)
        return None if self._follows else BoardTrouble(causes.STEERING_NOT_HELD, self._reason())

    def _restart(self):
        """Require a whole agreement again."""
        self._judged_ns = None
        self._difference_ns = self._agreement_ns = 0
        self._follows = False

    def _judge(self, now_ns):
        elapsed_ns = 0 if self._judged_ns is None else min(max(0, now_ns - self._judged_ns), MAX_STEP_NS)
        self._judged_ns = now_ns
        if self._agrees(now_ns - MARGIN_NS):
            self._agreement_ns += elapsed_ns
            self._difference_ns = max(0, self._difference_ns - elapsed_ns // RECOVERY_RATIO)
            if self._agreement_ns >= TOLERANCE_NS:
                self._follows, self._difference_ns = True, 0
        else:
            self._agreement_ns = 0
            self._difference_ns = min(self._difference_ns + elapsed_ns, MAX_DIFFERENCE_NS)
            if self._difference_ns >= MAX_DIFFERENCE_NS:
                self._follows = False

    def _agrees(self, at_ns):
        """Whether the board held at ``at_ns`` what turn_arb commanded about then."""
        _forget(self._outputs, at_ns)
        _forget(self._commands, at_ns - MARGIN_NS)
        if not self._commands:
            return False
        duties = self._outputs[0][1]
        return any(self._holds(duties, command) for since_ns, command in self._commands
                   if since_ns <= at_ns + MARGIN_NS)

    def _holds(self, duties, command):
        held = duties[command.channel]
        return held != UNCHANGED and abs(held - self._allowed(command)) <= ROUNDING_DUTY

    def _allowed(self, command):
        """The duty that the board makes of a command."""
        return max(self._config.pwm_min[command.channel], min(self._config.pwm_max[command.channel], command.duty))

    def _reason(self):
        if not self._commands:
            return "turn_arb's command for the steering isn't known"
        command, duties = self._commands[-1][1], self._outputs[-1][1]
        if self._holds(duties, command):
            return (f"the servo board has held turn_arb's command for {self._agreement_ns / NS_PER_S:.2f} of "
                    f"{TOLERANCE_NS / NS_PER_S:g} s")
        held = duties[command.channel]
        return (f"the servo board holds {'nothing' if held == UNCHANGED else held} on channel {command.channel}, where "
                f"turn_arb commands {self._allowed(command)}")


def _append(history, value, now_ns):
    """Append a value that differs from the newest one."""
    if not history or history[-1][1] != value:
        history.append((now_ns, value))


def _forget(history, at_ns):
    """Drop the values that were no longer in force at ``at_ns``."""
    while len(history) > 1 and history[1][0] <= at_ns:
        history.popleft()
