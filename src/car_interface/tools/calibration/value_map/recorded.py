"""Reads a recording as the drive that the fit of a value map takes."""
from __future__ import annotations

from dataclasses import dataclass, field
from typing import Mapping, NamedTuple, Sequence

import numpy as np

from car_interface.common.errors import ConfigError
from car_interface.common.lookup_table import LookupTable
from car_interface.common.params import Params
from car_interface.common.units import CHANNELS, MAX_DUTY
from car_interface.common.yaml_file import load_yaml
from car_interface.pca9685.registers import DUTY_PER_COUNT
from car_interface.throttle.arbiter import PLANNER, TELEOP
from car_interface.tools.calibration.shared import MAX_PULSE, MIN_PULSE, RecordedDrive
from car_interface.tools.calibration.value_map.acceleration import MapDrive, Series
from car_interface.tools.recordings import recording, roles, signals
from car_interface.tools.recordings.columns import Output, Pulses
from car_interface.tools.recordings.recording import NoRecording
from car_interface.tools.recordings.replay import WHEEL_TOPIC

ESC_CHANNEL = 1  # of the ESC, as in config/throttle.yaml
BY_PULSES, BY_ODOM, BY_IMU = "pulses", "odom", "imu"  # what accelerations are measured by
SETTLED_S = 0.15  # from a value to its duty on the board
MIN_PULSES = 200  # from which the length of one is known
GAP_S = 0.3  # odometry comes at least every 0.2 s


class ThrottleTable(NamedTuple):
    """The values that an ESC's duties stand for."""

    value_of_duty: LookupTable
    neutral: float  # value
    path: str
    channel: int  # of the servo board

    def values(self, duty: np.ndarray) -> np.ndarray:
        """Return the value of each duty (N,); NaN for one that no value makes, by more than the board's rounding."""
        duties = self.value_of_duty.axis
        is_inside = (duty >= duties[0] - DUTY_PER_COUNT) & (duty <= duties[-1] + DUTY_PER_COUNT)
        return np.where(is_inside, np.interp(duty, duties, self.value_of_duty.values), np.nan)


def load_throttle_table(path: str) -> ThrottleTable:
    """Invert the table in a file with the converter's parameters.

    Raises:
        ConfigError: naming the file, and what in it is no table, or none that can be inverted.
    """
    params = Params(load_yaml(path))
    try:
        duties = params.numbers("servo/duty_table", low=0, high=MAX_DUTY)
        values = LookupTable(params.numbers("servo/value_axis"), duties, "servo/value_axis", "servo/duty_table").axis
        neutral = params.integer("servo/neutral", low=0, high=MAX_DUTY)
        channel = params.integer("servo/channel", ESC_CHANNEL, low=0, high=CHANNELS - 1)
        steps = np.diff(duties)
        if not (np.all(steps > 0) or np.all(steps < 0)):
            raise ConfigError("servo/duty_table", duties, "duties that only rise, or only fall: each is a value's")
        if not min(duties) <= neutral <= max(duties):
            raise ConfigError("servo/neutral", neutral, "a duty within the range of servo/duty_table")
    except ConfigError as error:
        raise error.within(path) from error
    value_of_duty = LookupTable(*zip(*sorted(zip(duties, values))))
    return ThrottleTable(value_of_duty, value_of_duty(neutral), path, channel)


@dataclass(frozen=True)
class MapSource:
    """Where a recording's value and accelerations come from."""

    # named by the user, by role: see ``signals.load``. That of the value is not used with a duty channel.
    topics: Mapping[str, str] = field(default_factory=dict)
    # of the servo board, 0..15, whose duty stands for the value; ``None`` = there is a topic
    duty_channel: int | None = None
    throttle: ThrottleTable | None = None  # by which a duty is a value; with a duty channel
    neutral: float = 0.0  # the value at which the car coasts
    # BY_PULSES, BY_ODOM or BY_IMU; ``None`` = pulses where they were recorded, else odometry
    measured_by: str | None = None
    namespace: str = "/"  # the car's
    # of the servo board, 0..15, shows whether a value reached the ESC; ``None`` = unknown
    esc_channel: int | None = None
    esc_neutral_duty: float = 0.0  # the duty of that channel when nobody drives

    @property
    def value_topic(self) -> str:
        """The topic of the commanded value."""
        return self.topics.get(roles.VALUE.name, roles.VALUE.topics[0])


def load_map_drive(path: str, source: MapSource, progress: bool = False) -> RecordedDrive:
    """Read one recording.

    Raises:
        NoRecording: it can't be read, or lacks what is needed.
    """
    by_duty = source.duty_channel is not None
    wanted, optional = [roles.ODOM.name, roles.OUTPUT.name if by_duty else roles.VALUE.name], []
    if source.measured_by == BY_PULSES:
        wanted.append(signals.PULSES)
    elif source.measured_by is None:
        optional.append(signals.PULSES)
    if not by_duty and source.esc_channel is not None:
        optional.append(roles.OUTPUT.name)
    found = signals.load(path, wanted, optional=optional, namespace=source.namespace, progress=progress,
                         **source.topics)
    speed, notes, driven = Series(found.odom.t_s, found.odom.speed_mps), found.notes, None
    wheels = wheel_distances(found.pulses or (), speed)
    if source.measured_by == BY_PULSES and not wheels:
        raise NoRecording(f"{path} has too few pulses of the wheels on {WHEEL_TOPIC}: "
                          f"try --acceleration {BY_ODOM}")
    if by_duty:
        value, more_notes = _value_by_duty(found.output, source)
        notes += more_notes
    else:
        value = Series(found.value.t_s, found.value.value)
        if found.output is not None and source.esc_channel is not None:
            driven = reached_esc(value, Series(found.output.t_s, found.output.duties[:, source.esc_channel]),
                                 source.neutral, source.esc_neutral_duty)
    imu = pitch = None
    if found.imu is not None:
        imu = Series(found.imu.t_s, found.imu.acceleration_mps2)
        if np.isfinite(found.imu.pitch_rad).all():
            pitch = Series(found.imu.t_s, found.imu.pitch_rad)
    drive = MapDrive(value, speed, Series(found.odom.t_s, found.odom.yaw_rad), wheels, imu, pitch, driven)
    return RecordedDrive(path, drive, notes, found.duration_s, signals.trail(found))


def is_by_hand(path: str, value_topic: str, namespace: str = "/") -> bool:
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
    if not count(value_topic):
        return True
    by_hand = by_planner = 0
    for one in recording.read(path, roles.THROTTLE_STATE, namespace):
        by_hand += one.message.source == TELEOP and bool(one.message.asked)
        by_planner += one.message.source == PLANNER
    return by_hand > by_planner


def wheel_distances(pulses: Sequence[Pulses], speed: Series) -> tuple[Series, ...]:
    """Return the distance of each wheel in m at its pulses; the length of a pulse is by odometry's speed in m/s.

    Returns:
        Nothing, unless both wheels made enough pulses.
    """
    if len(pulses) != 2 or speed.t_s.size < 2:
        return ()
    steps_s = np.diff(speed.t_s)
    distance_m = np.concatenate(([0.0], np.cumsum(steps_s * (speed.y[1:] + speed.y[:-1]) / 2)))
    in_gaps_s = np.concatenate(([0.0], np.cumsum(np.where(steps_s > GAP_S, steps_s, 0.0))))
    counts = []
    for wheel in pulses:
        t_s, count = np.asarray(wheel.t_s, float), np.asarray(wheel.count, float)
        if t_s.size < 2:
            return ()
        is_new = np.concatenate(([True], np.diff(count) != 0))  # a report without a new pulse repeats the last time
        counts.append(Series(t_s[is_new], count[is_new]))
    if min(count.t_s.size for count in counts) < MIN_PULSES:
        return ()
    rolled_m = counted = 0.0
    for count in counts:
        # In a gap of odometry the distance is unknown, while pulses are counted on.
        is_known = np.diff(np.interp(count.t_s, speed.t_s, in_gaps_s)) == 0
        rolled_m += np.abs(np.diff(np.interp(count.t_s, speed.t_s, distance_m)))[is_known].sum()
        counted += np.abs(np.diff(count.y))[is_known].sum()
    if rolled_m <= 0 or counted < MIN_PULSES:
        return ()
    pulse_m = rolled_m / counted
    return tuple(Series(count.t_s, count.y * pulse_m) for count in counts)


def reached_esc(value: Series, duty: Series, neutral: float, neutral_duty: float) -> Series | None:
    """Return whether the value was what the ESC got, at the times of ``duty``: 0 while only the ESC was at neutral,
    else 1. ``None`` where the duty never changes: nobody drives that channel.
    """
    if duty.t_s.size == 0 or value.t_s.size == 0 or np.ptp(duty.y) <= DUTY_PER_COUNT:
        return None
    is_driving = np.abs(value.y - neutral) > 0.05 * max(np.ptp(value.y), 1e-9)
    last = np.maximum(np.searchsorted(value.t_s, duty.t_s, side="right") - 1, 0)
    earlier = np.maximum(np.searchsorted(value.t_s, duty.t_s - SETTLED_S, side="right") - 1, 0)
    is_idle = np.abs(duty.y - neutral_duty) <= DUTY_PER_COUNT
    return Series(duty.t_s, np.where(is_idle & is_driving[last] & is_driving[earlier], 0.0, 1.0))


def _value_by_duty(output: Output, source: MapSource):
    """Return (the value by a channel's duty, a note of duties that no value makes)."""
    throttle, duty = source.throttle, output.duties[:, source.duty_channel]
    is_pulse = (duty >= MIN_PULSE) & (duty <= MAX_PULSE)
    value = Series(output.t_s, np.where(is_pulse, throttle.values(duty), np.nan))
    beyond = int((is_pulse & np.isnan(value.y)).sum())
    low, high = throttle.value_of_duty.axis[0], throttle.value_of_duty.axis[-1]
    note = (f"{beyond} of {value.y.size} duties lie beyond {low:g} to {high:g}, where {throttle.path} has no value: "
            "left out")
    return value, (note,) if beyond else ()
