"""What each of the sixteen channels should hold: the newest command, or its timeout value once that's too old.

Pure: commands and ``now_ns`` in, counts out. The chip itself is ``board.Board``.
"""
from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple, Sequence

from car_interface.common.errors import ConfigError
from car_interface.common.servo_channels import CHANNELS, MAX_DUTY, UNCHANGED
from car_interface.common.units import NS_PER_MS
from car_interface.pca9685.registers import counts_of_duty


@dataclass(frozen=True)
class ChannelConfig:
    """One channel's limits and failsafe.

    Attributes:
        timeout_ms: silence this long puts the channel to its timeout value; 0 = never.
        timeout_value: duty 0..65535; 0 = off. Not subject to the limits.
        pwm_min, pwm_max: commanded duties are clamped to these, 0 too.
        live_range: the timeout value follows a neutral that is heard, this far at most; 0 = not at all.
    """

    timeout_ms: int = 250
    timeout_value: int = 0
    pwm_min: int = 0
    pwm_max: int = MAX_DUTY
    live_range: int = 0


class Accepted(NamedTuple):
    """What became of one command."""

    channels: Sequence[int]  # the channels that it set
    clamped: Sequence[int]  # of these, the ones whose duty lay beyond pwm_min or pwm_max
    refused: Sequence[int]  # the ones whose value is no duty at all; they keep what they had, and their timeout runs on


class Followed(NamedTuple):
    """What became of one vector of neutrals."""

    changed: dict[int, int]  # the channels whose timeout value is another one now, and which
    refused: Sequence[int]  # those whose neutral is no duty, or beyond live_range: they keep their timeout value


class Channels:
    """Keeps every channel's target. At first, and after a timeout, that is the timeout value.

    Args:
        configs: one for each of the sixteen channels.

    Raises:
        ConfigError: naming the parameter and the channel.
    """

    def __init__(self, configs: Sequence[ChannelConfig]):
        for channel, config in enumerate(configs):
            if config.pwm_min > config.pwm_max:
                raise ConfigError(f"pwm_min[{channel}]", config.pwm_min, f"at most pwm_max[{channel}] {config.pwm_max}")
        self._configs = tuple(configs)
        self.timeout_values = [config.timeout_value for config in configs]
        self._targets = [counts_of_duty(duty) for duty in self.timeout_values]
        self._commanded: set[int] = set()  # the others hold their timeout value
        self._deadlines_ns: dict[int, int] = {}

    def command(self, duties: Sequence[int], now_ns: int) -> Accepted:
        """Take a vector of 16 duties, −1 = leave the channel alone. Each duty renews its channel's timeout.

        Raises:
            ValueError: unless there are exactly 16; then nothing of the command is taken.
        """
        if len(duties) != CHANNELS:
            raise ValueError(f"a command needs {CHANNELS} values and has {len(duties)}")
        given, clamped, refused = [], [], []
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
            if config.timeout_ms:
                self._deadlines_ns[channel] = now_ns + config.timeout_ms * NS_PER_MS
            given.append(channel)
        return Accepted(given, clamped, refused)

    def expire(self, now_ns: int) -> list[int]:
        """Put every channel whose command is too old to its timeout value; which these are."""
        expired = [channel for channel, deadline_ns in self._deadlines_ns.items() if now_ns >= deadline_ns]
        for channel in expired:
            del self._deadlines_ns[channel]
            self._commanded.discard(channel)
            self._targets[channel] = counts_of_duty(self.timeout_values[channel])
        return expired

    def follow(self, neutrals: Sequence[int]) -> Followed:
        """Take a vector of 16 neutrals, −1 = none, as told by those who command the channels, for timeout values.

        A channel whose timeout value at start is 0, off, stays so: its owner wants no pulses there.

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
            if channel not in self._commanded:
                self._targets[channel] = counts_of_duty(duty)
        return Followed(changed, refused)

    def make_safe(self) -> None:
        """Put every channel to its timeout value now."""
        self._deadlines_ns.clear()
        self._commanded.clear()
        self._targets = [counts_of_duty(duty) for duty in self.timeout_values]

    def next_deadline_ns(self) -> float:
        """When ``expire`` will next have something to do; inf = not before the next command."""
        return min(self._deadlines_ns.values(), default=math.inf)

    @property
    def targets(self) -> list[int]:
        """The counts, 0..4096, that each channel should hold."""
        return list(self._targets)


def blocks(changes: dict[int, int], longest: int) -> list[list[int]]:
    """Channels to write, as runs of neighbours no longer than ``longest``: one transfer each."""
    runs: list[list[int]] = []
    for channel in sorted(changes):
        if runs and channel == runs[-1][-1] + 1 and len(runs[-1]) < longest:
            runs[-1].append(channel)
        else:
            runs.append([channel])
    return runs


def differences(held: Sequence[int | None], targets: Sequence[int]) -> dict[int, int]:
    """The channels whose target isn't what the chip holds (``None`` = not known), with their targets."""
    return {channel: target for channel, target in enumerate(targets) if held[channel] != target}
