"""The configuration of the node pca9685."""
from __future__ import annotations

from dataclasses import dataclass, field
from typing import Sequence

from car_interface.common import declared
from car_interface.common.errors import ConfigError
from car_interface.common.units import CHANNELS, MAX_DUTY, NS_PER_S
from car_interface.pca9685.channels import ChannelConfig, Channels
from car_interface.pca9685.registers import PRESCALE_MAX, PRESCALE_MIN, prescale_for

MAX_TIMEOUT_MS = 3_600_000
VIRTUAL, AUTO = "virtual", "auto"
NO_CHANNEL = -1
# An ESC of this kind, if calibrate_esc saw it, goes on braking however long a pull is held, and neutral in between lets
# it reverse. Any other may take a pull that is held for reverse.
BRAKES_FIRST = "brake_then_reverse"
STEERING_FILE, ESC_FILE = "by `turn_arb.yaml`", "by `throttle.yaml`"


@dataclass(frozen=True)
class Pca9685Config:
    """The bus, the chip, and the channels' limits and failsafe."""

    device: str = declared.text_or_integer(
        "device", "/dev/i2c-1", f"the I²C bus; `{AUTO}` = [the header's](install.md#the-servo-boards-bus); `{VIRTUAL}` "
                                "= a PCA9685 in software, register by register")
    auto_device: str | None = declared.path(
        "auto_device", None, f"the bus that `device: {AUTO}` has found, to keep it at a restart; the node sets it",
        default_text="none yet")
    address: int = declared.integer(
        "address", 0x40, "I²C address, 0x40..0x7f", low=0x40, high=0x7F, default_text="0x40")
    frequency_hz: float = declared.number("frequency", 50.0, "PWM frequency", "Hz", above=0.0)
    oscillator_hz: float = declared.number(
        "oscillator_hz", 25e6, "real oscillators are at 24 to 27 MHz: measure a pulse and scale", "Hz", low=1e6,
        high=50e6)
    prescale: int = declared.integer(
        "prescale", None, "overrides both; 122 is what ros-pwm-pca9685 makes of 50 Hz, for a table that was measured "
                          "with it", low=PRESCALE_MIN, high=PRESCALE_MAX)
    timeouts_ms: Sequence[int] = declared.integers(
        "timeout", (250,) * CHANNELS, "time without a duty after which a channel goes to its timeout value; 0 = never",
        "ms", length=CHANNELS, low=0, high=MAX_TIMEOUT_MS)
    timeout_values: Sequence[int] = declared.duty_of_each(
        "timeout_value", (0,) * CHANNELS, "the failsafe duty; 0 = off")
    pwm_min: Sequence[int] = declared.duty_of_each(
        "pwm_min", (0,) * CHANNELS, "commanded duties, 0 too, are clamped to these")
    pwm_max: Sequence[int] = declared.duty_of_each(
        "pwm_max", (MAX_DUTY,) * CHANNELS, "commanded duties, 0 too, are clamped to these")
    steering_channel: int | None = declared.channel(
        "steering/servo_channel", None, "the steering's channel", default_text=STEERING_FILE)
    steering_center: int | None = declared.duty(
        "steering/servo_center", None, "its timeout value", default_text=STEERING_FILE)
    esc_channel: int = declared.integer(
        "esc/servo/channel", NO_CHANNEL, "the ESC's channel; −1 = none", low=NO_CHANNEL,
        high=CHANNELS - 1, default_text=ESC_FILE)
    esc_neutral: int | None = declared.duty("esc/servo/neutral", None, "its timeout value", default_text=ESC_FILE)
    esc_duties: Sequence[float] = declared.duties(
        "esc/servo/duty_table", (), "a pull, on its first side of neutral, may be held "
                                    "[less long](safety.md#a-channel-that-nobody-commands-any-more) than `timeout`",
        default_text=ESC_FILE)
    esc_profile: str = declared.text(
        "esc/esc/profile", "unverified", "the [kind of ESC](throttle.md#the-kind-of-esc)", default_text=ESC_FILE)
    is_esc_measured: bool = declared.flag(
        "esc/esc/profile_measured", False, "whether calibrate_esc saw it", default_text=ESC_FILE)
    esc_forgets_s: float = declared.number(
        "esc/esc/reverse_after_neutral", 0.0, "after so long in neutral the first pull reverses, too; 0 = never", "s",
        low=0.0, high=60.0, default_text=ESC_FILE)
    live_range: int = declared.duty(
        "live_range", 500, "how far the steering's timeout value may follow `servo/neutral`; 0 = not at all")
    throttle_live_range: int = declared.duty("throttle_live_range", 100, "the same of the ESC's")
    required: bool = declared.flag("required", False, "true = exit code 1 when the board can't be used at start")
    guard: bool = declared.flag(
        "guard", True, "false = no [guard](safety.md#the-guard-of-the-servo-board): the board goes on pulsing if the "
                       "node dies or hangs")
    # roslaunch has started a node again by then.
    guard_off_after_s: float = declared.number(
        "guard_off_after", 10.0, "so long after the guard began to act it switches every output off", "s", low=0.5,
        high=3600.0)
    virtual_chip: str | None = declared.path(
        "virtual_chip", None, "only with `device: virtual`: the socket of the chip",
        default_text="by user, master and node")
    virtual_log: str | None = declared.path(
        "virtual_log", None, "only with `device: virtual`: a log of the chip's register writes; your own file")

    channels: Sequence[ChannelConfig] = field(init=False)

    SHARED = ("steering", "esc")  # the rest of the two files is not read

    def __post_init__(self):
        for name, value in (("virtual_chip", self.virtual_chip), ("virtual_log", self.virtual_log)):
            if value is not None and self.device != VIRTUAL:
                raise ConfigError(f"unknown parameter {name}", value, f"none, unless device is {VIRTUAL}")
        if self.device == AUTO and self.auto_device is not None:
            object.__setattr__(self, "device", self.auto_device)
        if isinstance(self.device, int):
            object.__setattr__(self, "device", f"/dev/i2c-{self.device}")
        if self.prescale is None:
            object.__setattr__(self, "prescale", prescale_for(self.frequency_hz, self.oscillator_hz))
        object.__setattr__(self, "channels", self._channels())
        Channels(self.channels)  # checks the limits

    @property
    def guard_off_after_ns(self) -> int:
        """Return how long after it began to act the guard switches every output off."""
        return round(NS_PER_S * self.guard_off_after_s)

    def _channels(self):
        timeout_values, live_ranges, pulls = list(self.timeout_values), [0] * CHANNELS, {}
        for channel, neutral, live_range in self._neutrals():
            timeout_values[channel], live_ranges[channel] = neutral, live_range
        if self.esc_channel != NO_CHANNEL and self.esc_neutral is not None and self.esc_duties:
            pulls = {"pulls": -1 if self.esc_duties[0] < self.esc_duties[-1] else 1,
                     "brakes_first": self.esc_profile == BRAKES_FIRST and self.is_esc_measured,
                     "forgets_ms": round(1000 * self.esc_forgets_s)}
        settings = zip(self.timeouts_ms, timeout_values, self.pwm_min, self.pwm_max, live_ranges)
        return tuple(ChannelConfig(*each, **(pulls if channel == self.esc_channel else {}))
                     for channel, each in enumerate(settings))

    def _neutrals(self):
        """Return channel, neutral duty and live range of the steering and of the ESC, where they are given."""
        given = [each for each in ((self.steering_channel, self.steering_center, self.live_range),
                                   (self.esc_channel, self.esc_neutral, self.throttle_live_range))
                 if each[0] not in (None, NO_CHANNEL) and each[1] is not None]
        if len(given) == 2 and self.steering_channel == self.esc_channel:
            raise ConfigError("esc/servo/channel", self.esc_channel, "a channel other than steering/servo_channel")
        return given
