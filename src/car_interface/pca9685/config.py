"""The configuration of the pca9685 node, from its parameters. Pure."""
from __future__ import annotations

from dataclasses import dataclass

from car_interface.common.errors import ConfigError
from car_interface.common.units import CHANNELS, MAX_DUTY, NS_PER_S
from car_interface.pca9685.channels import ChannelConfig, Channels
from car_interface.pca9685.registers import PRESCALE_MAX, PRESCALE_MIN, prescale_for

MAX_TIMEOUT_MS = 3_600_000
VIRTUAL = "virtual"
LIVE_RANGE, THROTTLE_LIVE_RANGE = 500, 100  # duty, as those of turn_arb and generic_value_converter
NO_CHANNEL = -1
# An ESC of this kind, if calibrate_esc saw it, goes on braking however long a pull is held, and neutral in between lets
# it reverse. Any other may take a pull that is held for reverse.
BRAKES_FIRST = "brake_then_reverse"
GUARD_OFF_AFTER_S = 10.0  # roslaunch has started a node again by then
MIN_OFF_AFTER_S, MAX_OFF_AFTER_S = 0.5, 3600.0


@dataclass(frozen=True)
class Pca9685Config:
    """The node's configuration.

    Attributes:
        device: the bus's path, or ``VIRTUAL``.
        address: the chip's, 0x40..0x7f.
        prescale: the chip's register, 3..255.
        oscillator_hz: the chip's clock.
        channels: limits and failsafe of each of the sixteen.
        required: end when the board can't be used at start.
        virtual_chip: the virtual chip's socket; ``None`` = the default.
        virtual_log: the virtual chip's log; ``None`` = none.
        guard: whether a guard acts when the node dies or hangs.
        guard_off_after_ns: how long after that it switches everything off.
    """

    device: str
    address: int
    prescale: int
    oscillator_hz: float
    channels: tuple[ChannelConfig, ...]
    required: bool
    virtual_chip: str | None
    virtual_log: str | None
    guard: bool
    guard_off_after_ns: int


def read_config(params) -> Pca9685Config:
    """Read the node's configuration from its parameters, without side effects.

    Raises:
        ConfigError: naming the parameter.
    """
    device = params.text_or_integer("device", "/dev/i2c-1")
    frequency_hz = params.number("frequency", 50.0, above=0.0)
    oscillator_hz = params.number("oscillator_hz", 25e6, low=1e6, high=50e6)
    prescale = params.integer("prescale", None, low=PRESCALE_MIN, high=PRESCALE_MAX)
    config = Pca9685Config(
        device=f"/dev/i2c-{device}" if isinstance(device, int) else device,
        address=params.integer("address", 0x40, low=0x40, high=0x7F),
        prescale=prescale_for(frequency_hz, oscillator_hz) if prescale is None else prescale,
        oscillator_hz=oscillator_hz,
        channels=_read_channels(params),
        required=params.flag("required", False),
        virtual_chip=params.path("virtual_chip", None) if device == VIRTUAL else None,
        virtual_log=params.path("virtual_log", None) if device == VIRTUAL else None,
        guard=params.flag("guard", True),
        guard_off_after_ns=round(NS_PER_S * params.number(
            "guard_off_after", GUARD_OFF_AFTER_S, low=MIN_OFF_AFTER_S, high=MAX_OFF_AFTER_S)))
    params.finish(ignored_namespaces=("steering", "esc"))
    Channels(config.channels)  # checks the limits
    return config


def _read_channels(params):
    """Limits and failsafe of each of the sixteen."""
    timeouts_ms = params.integers("timeout", CHANNELS, 250, 0, MAX_TIMEOUT_MS)
    timeout_values = params.integers("timeout_value", CHANNELS, 0, 0, MAX_DUTY)
    live_ranges = [0] * CHANNELS
    for channel, neutral, live_range in _read_neutrals(params):
        timeout_values[channel], live_ranges[channel] = neutral, live_range
    pwm_min = params.integers("pwm_min", CHANNELS, 0, 0, MAX_DUTY)
    pwm_max = params.integers("pwm_max", CHANNELS, MAX_DUTY, 0, MAX_DUTY)
    esc, pulls = _read_pulls(params)
    return tuple(ChannelConfig(*settings, **(pulls if channel == esc else {})) for channel, settings in enumerate(
        zip(timeouts_ms, timeout_values, pwm_min, pwm_max, live_ranges)))


def _read_pulls(params):
    """The ESC's channel, and what its pulls are; ``None`` = there is none."""
    channel = params.integer("esc/servo/channel", NO_CHANNEL, NO_CHANNEL, CHANNELS - 1)
    neutral = params.integer("esc/servo/neutral", None, 0, MAX_DUTY)
    table = params.numbers("esc/servo/duty_table", [], 0, MAX_DUTY)
    profile, is_measured = params.text("esc/esc/profile", "unverified"), params.flag("esc/esc/profile_measured", False)
    forgets_s = params.number("esc/esc/reverse_after_neutral", 0.0, low=0.0, high=60.0)
    if channel == NO_CHANNEL or neutral is None or not table:
        return None, {}
    return channel, {"pulls": -1 if table[0] < table[-1] else 1,
                     "brakes_first": profile == BRAKES_FIRST and is_measured, "forgets_ms": round(1000 * forgets_s)}


def _read_neutrals(params):
    """Channel, neutral duty and live range of the steering and of the ESC, where they are given."""
    steering = params.integer("steering/servo_channel", None, 0, CHANNELS - 1)
    center = params.integer("steering/servo_center", None, 0, MAX_DUTY)
    esc = params.integer("esc/servo/channel", NO_CHANNEL, NO_CHANNEL, CHANNELS - 1)
    neutral = params.integer("esc/servo/neutral", None, 0, MAX_DUTY)
    given = [(steering, center, params.integer("live_range", LIVE_RANGE, 0, MAX_DUTY)),
             (esc, neutral, params.integer("throttle_live_range", THROTTLE_LIVE_RANGE, 0, MAX_DUTY))]
    given = [each for each in given if each[0] not in (None, NO_CHANNEL) and each[1] is not None]
    if len(given) == 2 and steering == esc:
        raise ConfigError("esc/servo/channel", esc, "a channel other than steering/servo_channel")
    return given
