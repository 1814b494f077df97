"""The target of each of the sixteen channels: the newest command, or the timeout value when that is too old.

Pure: commands and ``now_ns`` in, counts out. ``board.Board`` writes them to the chip.
"""
from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Iterable, NamedTuple, Sequence

from car_interface.common.errors import ConfigError
from car_interface.common.units import CHANNELS, MAX_DUTY, NS_PER_MS, UNCHANGED
from car_interface.pca9685.registers import counts_of_duty

# An ESC may take a pull, which was a brake, for reverse once the car stands. Whoever commands it sees to it that the
# car rolls for as long as this after each command, and repeats it within half of that.
PULL_TIMEOUT_MS = 80
# An ESC that was pushed for so long takes the next pull for a brake, if it is a kind that brakes first. A little less
# than the half second of throttle_arb's rules (``throttle.esc_history``): messages take different times.
DROVE_NS = 450 * NS_PER_MS


@dataclass(frozen=True)
class ChannelConfig:
    """One channel's limits and failsafe."""

    timeout_ms: int = 250  # without a command for this long the channel goes to its timeout value; 0 = never
    timeout_value: int = 0  # duty 0..65535; 0 = off. Not subject to the limits
    pwm_min: int = 0  # commanded duties are clamped to these two, 0 too
    pwm_max: int = MAX_DUTY
    live_range: int = 0  # the largest change of the timeout value by ``follow``, in duty; 0 = none
    # On which side of the timeout value a duty is a pull of an ESC's that may become reverse: −1 below it, 1 above; 0 =
    # none. A pull's timeout is PULL_TIMEOUT_MS at most.
    pulls: int = 0
    # The ESC is known to take a pull after DROVE_NS of push for a brake, until the pull ends. That pull is held for
    # ``timeout_ms``: a gap of neutral would make the rest of it reverse.
    brakes_first: bool = False
    forgets_ms: int = 0  # so much neutral after a push, and it takes no pull for a brake any more; 0 = never


class TimedOut(NamedTuple):
    """The reason why a channel that was commanded is at its timeout value."""

    since_ns: int  # when its timeout had passed, or when ``make_safe`` was called
    was_made_safe: bool  # by ``make_safe``, and no command has come since


class Channels:
    """The targets of all channels. At first, and after a timeout, a target is the timeout value.

    Raises:
        ConfigError: naming the parameter and the channel.
    """

    def __init__(self, configs: Sequence[ChannelConfig]):
        for channel, config in enumerate(configs):
            if config.pwm_min > config.pwm_max:
                raise ConfigError(f"pwm_min[{channel}]", config.pwm_min, f"at most pwm_max[{channel}] {config.pwm_max}")
        self._configs = tuple(configs)
        self.timeout_values = [config.timeout_value for config in configs]
        self.timeout_counts = [counts_of_duty(duty) for duty in self.timeout_values]
        self._targets = list(self.timeout_counts)
        self._commanded: set[int] = set()  # the others are at their timeout value
        self._deadlines_ns: dict[int, int] = {}
        self._timed_out: dict[int, TimedOut] = {}  # until the next command
        self._sides: dict[int, tuple[int, int]] = {}  # 1 = a pull, −1 = a push, 0 = neither; since when
        self._brakes: set[int] = set()  # the next pull, or the present one, is a brake

    def command(self, duties: Sequence[int], now_ns: int) -> tuple[list[int], list[int]]:
        """Set targets by a vector of 16 duties, −1 = unchanged. Each duty restarts its channel's timeout.

        Returns:
            The channels whose duty was beyond pwm_min or pwm_max and is clamped, and those whose value is not a duty:
            they keep their target, and their timeout runs on.

        Raises:
            ValueError: unless there are exactly 16; then nothing changes.
        """
        if len(duties) != CHANNELS:
            raise ValueError(f"a command needs {CHANNELS} values and has {len(duties)}")
        clamped, refused = [], []
        for channel, duty in enumerate(duties):
            if duty == UNCHANGED:
                continue
            if not 0 <= duty <= MAX_DUTY:
                refused.append(channel)
                continue
            config = self._configs[channel]
            allowed = max(config.pwm_min, min(config.pwm_max, duty))
            if allowed != duty:
                clamped.append(channel)
            self._targets[channel] = counts_of_duty(allowed)
            self._commanded.add(channel)
            self._timed_out.pop(channel, None)
            self._follow_side(channel, allowed, now_ns)
            timeout_ms = self._timeout_ms(channel, allowed)
            if timeout_ms:
                self._deadlines_ns[channel] = now_ns + timeout_ms * NS_PER_MS
            else:
                self._deadlines_ns.pop(channel, None)
        return clamped, refused

    def _timeout_ms(self, channel, duty):
        config = self._configs[channel]
        if self._side(channel, duty) > 0 and channel not in self._brakes:
            return min(config.timeout_ms or PULL_TIMEOUT_MS, PULL_TIMEOUT_MS)
        return config.timeout_ms

    def _side(self, channel, duty):
        beyond = (duty - self.timeout_values[channel]) * self._configs[channel].pulls
        return (beyond > 0) - (beyond < 0)

    def _follow_side(self, channel, duty, now_ns):
        """Notice by its pulses what the ESC makes of the next pull."""
        config, side = self._configs[channel], self._side(channel, duty)
        before, since_ns = self._sides.get(channel, (0, now_ns))
        if not config.brakes_first or side == before:
            return
        if before < 0 and now_ns - since_ns >= DROVE_NS:
            self._brakes.add(channel)
        elif before > 0 or not before and config.forgets_ms and now_ns - since_ns >= config.forgets_ms * NS_PER_MS:
            self._brakes.discard(channel)
        self._sides[channel] = side, now_ns

    def expire(self, now_ns: int) -> list[int]:
        """Set every channel whose command is too old to its timeout value, and return these channels."""
        expired = [channel for channel, deadline_ns in self._deadlines_ns.items() if now_ns >= deadline_ns]
        for channel in expired:
            self._timed_out[channel] = TimedOut(self._deadlines_ns.pop(channel), False)
            self._commanded.discard(channel)
            self._targets[channel] = self.timeout_counts[channel]
            self._follow_side(channel, self.timeout_values[channel], now_ns)
        return expired

    def follow(self, neutrals: Sequence[int]) -> tuple[dict[int, int], list[int]]:
        """Set timeout values by a vector of 16 neutrals, −1 = none, from the nodes that command the channels.

        A channel whose timeout value at start is 0 (off) stays off.

        Returns:
            The new timeout values by channel, and the channels whose neutral is not a duty or beyond live_range: they
            keep their timeout value.

        Raises:
            ValueError: unless there are exactly 16.
        """
        if len(neutrals) != CHANNELS:
            raise ValueError(f"a vector of neutrals needs {CHANNELS} values and has {len(neutrals)}")
        changed, refused = {}, []
        for channel, duty in enumerate(neutrals):
            config = self._configs[channel]
            if duty in (UNCHANGED, self.timeout_values[channel]) or not (config.timeout_value and config.live_range):
                continue
            if not 0 < duty <= MAX_DUTY or abs(duty - config.timeout_value) > config.live_range:
                refused.append(channel)
                continue
            changed[channel] = self.timeout_values[channel] = duty
            self.timeout_counts[channel] = counts_of_duty(duty)
            if channel not in self._commanded:
                self._targets[channel] = self.timeout_counts[channel]
        return changed, refused

    def make_safe(self, now_ns: int) -> None:
        self._timed_out.update((channel, TimedOut(now_ns, True)) for channel in self._commanded)
        for channel in self._commanded:
            self._follow_side(channel, self.timeout_values[channel], now_ns)
        self._deadlines_ns.clear()
        self._commanded.clear()
        self._targets = list(self.timeout_counts)

    def timed_out(self, now_ns: int) -> dict[int, TimedOut]:
        """Return the channels that were commanded, are no longer, and are at their timeout values for that.

        A channel that was made safe is among them once its timeout has passed without a command: whoever commands it
        has done nothing wrong before.
        """
        return {channel: each for channel, each in sorted(self._timed_out.items()) if not each.was_made_safe
                or now_ns - each.since_ns >= self._configs[channel].timeout_ms * NS_PER_MS}

    def next_deadline_ns(self) -> float:
        """Return when the next command expires; inf = none will."""
        return min(self._deadlines_ns.values(), default=math.inf)

    @property
    def targets(self) -> list[int]:
        """Return the counts, 0..4096, that each channel should hold."""
        return list(self._targets)


def blocks(channels: Iterable[int], max_length: int) -> list[list[int]]:
    """Return channels, each once, as runs of at most ``max_length`` neighbours: one transfer each."""
    runs: list[list[int]] = []
    for channel in sorted(channels):
        if runs and channel == runs[-1][-1] + 1 and len(runs[-1]) < max_length:
            runs[-1].append(channel)
        else:
            runs.append([channel])
    return runs


def differences(held: Sequence[int | None], targets: Sequence[int]) -> dict[int, int]:
    """Return the targets of those channels whose registers (``None`` = unknown) differ from them."""
    return {channel: target for channel, target in enumerate(targets) if held[channel] != target}
