"""Synthetic drives whose value map, slope, battery and delay are known."""
import functools
import math
import random

import numpy as np

from car_interface.tools.calibration.shared import Series
from car_interface.tools.calibration.value_map.fit import Fit, fit
from car_interface.tools.calibration.value_map.recorded import MapConfig, MapDrive
from written_recordings import Written, odometry, output

PULSE_M, STEP_S, NOTHING = 0.0149, 0.005, Series(np.zeros(0), np.zeros(0))
DELAY_S = 0.08


def acceleration(value, speed):
    """The synthetic car's: two slopes, a motor that gets weaker, drag."""
    if isinstance(value, float):  # a step of a drive; numpy takes ten times as long for one number
        return (1.8 * value / (1 + speed / 10) if value > 0 else 1.4 * value) - 0.35 - 0.08 * speed
    return np.where(value > 0, 1.8 * value / (1 + speed / 10), 1.4 * value) - 0.35 - 0.08 * speed


@functools.lru_cache(maxsize=16)
def drive(seed=0, seconds=240.0, uphill=(0.0, 0.0), sag=0.0, turns=True, with_pitch=False, with_imu=False, pulses=True,
          mounting_rad=0.0, map_of=acceleration, there_and_back=False, circles=False):
    """A drive with a random value every second or so, straight on or all round."""
    rng = random.Random(seed)
    count = int(seconds / STEP_S)
    t_s = np.arange(count) * STEP_S
    value, speed, yaw = np.zeros(count), np.zeros(count), np.zeros(count)
    now, until, turn, held, v, heading = 0.0, 0.0, 0.0, [], 1.0, 0.0
    forces = np.zeros(count)
    for index in range(count):
        now_s = index * STEP_S
        if now_s >= until or v < 0.6 and now < 0 or v > 7.0 and now > 0:
            now = rng.uniform(0.5, 3.0) if v < 1.0 else rng.uniform(-4.0, 0.0) if v > 6.0 else rng.uniform(-4.0, 3.0)
            until, turn = now_s + rng.uniform(0.6, 1.6), rng.uniform(-0.4, 0.4) if turns else 0.0
        held.append(now)
        value[index] = now
        acting = held[max(0, index - round(DELAY_S / STEP_S))]
        push = map_of(acting, v)
        coasting = map_of(0.0, v)
        push = coasting + (push - coasting) * (1 + sag * (0.5 - index / count) if acting > 0 else 1.0)
        forces[index] = push
        if circles and now_s % 40 > 30:
            turn, push = 0.7 * v, push - 0.4  # tyres brake
        elif circles:
            turn, heading = 0.0, 2 * math.pi * round(heading / 2 / math.pi)
        change = push - 9.81 * (uphill[0] * math.cos(heading) + uphill[1] * math.sin(heading))
        v = max(0.0, v + change * STEP_S)
        heading = math.pi * (now_s // 20 % 2) if there_and_back else heading + turn * STEP_S
        speed[index], yaw[index] = v, heading
    commanded_s, t_s = t_s, t_s + STEP_S  # what follows from a command is there a step later
    distance_m = np.concatenate(([0.0], np.cumsum((speed[1:] + speed[:-1]) / 2 * STEP_S)))
    wheels = []
    for phase in (0.3, 0.8):
        places = (np.arange(int(distance_m[-1] / PULSE_M) - 1) + phase) * PULSE_M
        ticks = np.floor(np.interp(places, distance_m, t_s) * 1000) / 1000 + 0.0005
        fresh = np.concatenate(([True], np.diff(ticks) > 0))
        wheels.append(Series(ticks[fresh], places[fresh]))
    pitch = -(uphill[0] * np.cos(yaw) + uphill[1] * np.sin(yaw)) + mounting_rad  # nose down is positive
    noise = np.random.default_rng(seed).normal(0.0, 0.1, count)
    every = slice(None, None, 4)
    return MapDrive(Series(commanded_s, value), Series(t_s[every], speed[every]), Series(t_s[every], yaw[every]),
                    wheels if pulses else (),
                    imu=Series(commanded_s[::2], (forces + noise)[::2] + 0.2) if with_imu else None,
                    pitch=Series(t_s[every], pitch[every]) if with_pitch else None)


NAMES = {"odom": "/odom", "value": "/generic/output/value", "output": "/servo/output"}


def value_at(time_s, value=1.0, topic=NAMES["value"]):
    return Written(time_s, topic, "car_interface/Float64Stamped", {"data": value})


def messages_of(seconds, seed=0, names=None, with_imu=False):
    """A drive as it is recorded: odometry; value and duties when they change, and ten times a second; maybe an IMU."""
    one, names, messages = drive(seed, seconds, with_imu=with_imu), names or NAMES, []
    places_m = np.cumsum(one.speed.y * np.exp(1j * one.yaw.y)) * 4 * STEP_S
    for time_s, speed_mps, yaw_rad, place_m in zip(one.speed.t_s, one.speed.y, one.yaw.y, places_m):
        messages.append(odometry(time_s, place_m.real, place_m.imag, yaw_rad, speed_mps, names["odom"]))
    t_s, value = one.value.t_s, one.value.y
    turn_rate = np.interp(t_s, one.yaw.t_s[1:], np.diff(one.yaw.y)) / (4 * STEP_S)
    for index in np.flatnonzero(np.append(True, np.diff(value) != 0) | (np.arange(t_s.size) % 20 == 0)):
        esc = 16 * round(float(np.interp(value[index], (-5, 0, 3), (3277, 4915, 6554))) / 16)
        steering = 16 * round((5100 - 1500 * float(turn_rate[index])) / 16)
        messages += [value_at(t_s[index], value[index], names["value"]),
                     output(t_s[index], steering, esc, topic=names["output"])]
    for time_s, number in zip(one.imu.t_s[::2], one.imu.y[::2]) if with_imu else ():
        messages.append(Written(time_s, "/imu/data", "sensor_msgs/Imu", {
            "orientation_covariance": [-1.0] * 9, "linear_acceleration": {"x": number, "z": 9.81}}))
    return sorted(messages, key=lambda message: message.time_s)


@functools.lru_cache(maxsize=None)
def fitted_mixed():
    return fit([drive(uphill=(0.012, -0.016), sag=0.1)], None, None)


def error(found, map_of=acceleration):
    """RMS over what is supported."""
    truth = map_of(found.values[:, None], found.velocities[None, :])
    assert found.supported.sum() > 0.3 * found.supported.size
    return float(np.sqrt(np.mean((found.accelerations - truth)[found.supported] ** 2)))


def fit_of(supported, sure=None, held_out_mps2=0.0):
    """A fit that is made by hand: a value more is 1 m/s² more, a velocity more 0.1 m/s² less."""
    supported = np.array(supported, bool)
    rows, columns = supported.shape
    accelerations = np.add.outer(np.arange(rows) * 1.0, -0.1 * np.arange(columns))
    return Fit(np.arange(rows) - 1.0, np.arange(columns) * 1.0, accelerations, np.full(supported.shape, 0.05),
               np.ones(supported.shape), supported,
               supported if sure is None else np.array(sure, bool), 0.0, 0.0, (), {}, 0.0, held_out_mps2, 1)


def rejected(one, config=None):
    found = fit([one], None, None, config or MapConfig(delay_s=DELAY_S))
    return {text: number for text, number in found.rejected.items() if number and text != "counted"}


def with_(one, **changes):
    fields = {"value": one.value, "speed": one.speed, "yaw": one.yaw, "wheels": one.wheels}
    return MapDrive(**{**fields, **changes})
