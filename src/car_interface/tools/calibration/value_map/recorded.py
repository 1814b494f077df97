"""Reads a recording as the drive that the fit of a value map takes."""
from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType
from typing import Mapping, NamedTuple, Sequence

import numpy as np

from car_interface.common.errors import require, within
from car_interface.common.params import Params
from car_interface.common.units import CHANNELS, MAX_DUTY
from car_interface.common.yaml_file import load_yaml
from car_interface.pca9685.registers import DUTY_PER_COUNT
from car_interface.throttle.arbiter import PLANNER, TELEOP
from car_interface.throttle.calibration import ThrottleCalibration
from car_interface.tools.calibration.shared import RecordedDrive, Series, held, is_pulse, wheel_distances
from car_interface.tools.recordings import recording, roles, signals
from car_interface.tools.recordings.recording import NoRecording
from car_interface.tools.recordings.replay import WHEEL_TOPIC

ESC_CHANNEL = 1  # of the ESC, as in config/throttle.yaml
DUTY = "duty:"
BY_PULSES, BY_ODOM, BY_IMU = "pulses", "odom", "imu"  # what accelerations are measured by
SETTLED_S = 0.15  # from a value to its duty on the board


class ThrottleTable(NamedTuple):
    """The values that an ESC's duties stand for."""

    duties: tuple[float, ...]  # rising
    values: tuple[float, ...]  # of each of them
    neutral: float  # value
    path: str
    channel: int  # of the servo board, whose duties they are

    def value_of(self, duty: np.ndarray) -> np.ndarray:
        """Return the value of each duty (N,); NaN for one that no value makes, by more than the board's rounding."""
        is_inside = (duty >= self.duties[0] - DUTY_PER_COUNT) & (duty <= self.duties[-1] + DUTY_PER_COUNT)
        return np.where(is_inside, np.interp(duty, self.duties, self.values), np.nan)


def load_throttle_table(path: str) -> ThrottleTable:
    """Invert the table in a file with the converter's parameters.

    Raises:
        ConfigError: naming the file, and what in it is no table, or none that can be inverted.
    """
    params = Params(load_yaml(path))
    with within(path):
        table = ThrottleCalibration(
            params.integer("servo/channel", ESC_CHANNEL, low=0, high=CHANNELS - 1), params.numbers("servo/value_axis"),
            params.numbers("servo/duty_table", low=0, high=MAX_DUTY),
            params.integer("servo/neutral", low=0, high=MAX_DUTY))
        require(0 not in np.diff(table.duty_table), "servo/duty_table", table.duty_table,
                "duties that only rise, or only fall: each is a value's")
    duties, values = zip(*sorted(zip(table.duty_table, table.value_axis)))
    return ThrottleTable(duties, values, float(np.interp(table.neutral, duties, values)), path, table.channel)


class MapConfig(NamedTuple):
    """Where a recording's value and accelerations come from, which driving counts, and what a map is fitted by."""

    topics: Mapping[str, str] = MappingProxyType({})  # named by the user, by role: see ``signals.load``
    # by which a duty of its channel is the value, whatever the topic of a value; ``None`` = there is a topic
    throttle: ThrottleTable | None = None
    # BY_PULSES, BY_ODOM or BY_IMU (the wheels only give its bias); ``None`` = pulses if recorded, else odometry
    measured_by: str | None = None
    namespace: str = "/"  # the car's
    esc_channel: int | None = None  # of the board, 0..15, shows whether a value reached the ESC; ``None`` = unknown
    esc_neutral_duty: float = 0.0  # the duty of that channel when nobody drives
    min_speed_mps: float = 0.3  # a window with a lower speed is a stop, in which an ESC holds, reverses or waits
    max_curvature_per_m: float = 0.6  # tyres in a turn brake
    max_lateral_mps2: float = 2.5  # the same
    neutral: float = 0.0  # the value at which the actuator neither drives nor brakes; the map may bend there
    value_timeout_s: float = 0.5  # a value counts for no longer than this
    delay_s: float | None = None  # from value to acceleration; None = estimated

    @property
    def value_name(self) -> str:
        """The topic of the value, or the duty that stands for it."""
        if self.throttle is not None:
            return f"{DUTY}{self.throttle.channel}"
        return self.topics.get(roles.VALUE.name, roles.VALUE.topics[0])


DEFAULTS = MapConfig()


@dataclass(frozen=True)
class MapDrive:
    """One recording, on one scale of seconds."""

    value: Series  # the actuator's commanded value, each sample until the next one
    speed: Series  # m/s, backward negative
    yaw: Series  # rad, unwrapped
    # signed distance of each wheel in m at its pulses; empty = unknown, then the speed is differentiated
    wheels: Sequence[Series] = ()
    # forward specific force in m/s², with gravity's part on a slope, as accelerometers measure it
    imu: Series | None = None
    pitch: Series | None = None  # rad, nose down positive (REP-103)
    # 1 where the value reached the actuator, each sample until the next; ``None`` = always
    driven: Series | None = None


def load_map_drive(path: str, config: MapConfig) -> RecordedDrive:
    """Read one recording.

    Raises:
        NoRecording: it can't be read, or lacks what is needed.
    """
    by_duty = config.throttle is not None
    wanted = [roles.ODOM.name, roles.OUTPUT.name if by_duty else roles.VALUE.name,
              *[signals.PULSES] * (config.measured_by == BY_PULSES)]
    optional = [*[signals.PULSES] * (config.measured_by is None),
                *[roles.OUTPUT.name] * (config.esc_channel is not None)]
    found = signals.load(path, wanted, optional=optional, namespace=config.namespace, **config.topics)
    speed, notes, driven = Series(found.odom.t_s, found.odom.speed_mps), found.notes, None
    wheels = wheel_distances(found.pulses or (), speed)
    if len(wheels) < 2:
        wheels = ()
    if config.measured_by == BY_PULSES and not wheels:
        raise NoRecording(f"{path} has too few pulses of the wheels on {WHEEL_TOPIC}: "
                          f"try --acceleration {BY_ODOM}")
    if by_duty:
        throttle = config.throttle
        duty = found.output.duties[:, throttle.channel]
        value = Series(found.output.t_s, np.where(is_pulse(duty), throttle.value_of(duty), np.nan))
        beyond = int((is_pulse(duty) & np.isnan(value.y)).sum())
        if beyond:
            notes = (*notes, (f"{beyond} of {value.y.size} duties lie beyond {throttle.duties[0]:g} to "
                              f"{throttle.duties[-1]:g}, where {throttle.path} has no value: left out"))
    else:
        value = Series(found.value.t_s, found.value.value)
        if found.output is not None and config.esc_channel is not None:
            driven = reached_esc(value, Series(found.output.t_s, found.output.duties[:, config.esc_channel]),
                                 config.neutral, config.esc_neutral_duty)
    imu = pitch = None
    if found.imu is not None:
        imu = Series(found.imu.t_s, found.imu.acceleration_mps2)
        if np.isfinite(found.imu.pitch_rad).all():
            pitch = Series(found.imu.t_s, found.imu.pitch_rad)
    drive = MapDrive(value, speed, Series(found.odom.t_s, found.odom.yaw_rad), wheels, imu, pitch, driven)
    return RecordedDrive(path, drive, notes, found.duration_s, signals.trail(found))


def is_by_hand(path: str, namespace: str = "/") -> bool:
    """Return whether the duty of the ESC's channel shows what drove the car, and the value of a planner does not.

    So it is where no value was recorded but the board's output was, and where throttle_arb obeyed the gamepad more
    often than the planner: a converter goes on converting meanwhile.

    Raises:
        NoRecording: it can't be read.
    """
    recorded = recording.contents(path).topics

    def count(topic):
        return sum(recorded[name].count for name in recording.absolute_names(recorded, [topic], namespace))
    if not count(roles.OUTPUT.topics[0]):
        return False
    if not count(roles.VALUE.topics[0]):
        return True
    by_hand = by_planner = 0
    for one in recording.read(path, roles.THROTTLE_STATE, namespace):
        by_hand += one.message.source == TELEOP and bool(one.message.asked)
        by_planner += one.message.source == PLANNER
    return by_hand > by_planner


def reached_esc(value: Series, duty: Series, neutral: float, neutral_duty: float) -> Series | None:
    """Return whether the value was what the ESC got, at the times of ``duty``: 0 while only the ESC was at neutral,
    else 1. ``None`` where the duty never changes: nobody drives that channel.
    """
    if np.ptp(duty.y) <= DUTY_PER_COUNT:
        return None
    is_driving = np.abs(value.y - neutral) > 0.05 * max(np.ptp(value.y), 1e-9)
    is_lost = (np.abs(duty.y - neutral_duty) <= DUTY_PER_COUNT) & held(value.t_s, is_driving, duty.t_s)
    return Series(duty.t_s, np.where(is_lost & held(value.t_s, is_driving, duty.t_s - SETTLED_S), 0.0, 1.0))
