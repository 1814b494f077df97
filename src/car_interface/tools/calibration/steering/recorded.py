"""Reads a recording as the drive that the fit of a steering curve takes."""
from __future__ import annotations

import math
from typing import Mapping

import numpy as np

from car_interface.pca9685.registers import counts_of_duty, duty_of_counts
from car_interface.steering.calibration import SteeringCalibration
from car_interface.tools.calibration.shared import RecordedDrive, has_gap, integral, recorded_duty
from car_interface.tools.calibration.steering.drive import SteeringDrive, distance_m
from car_interface.tools.recordings import roles, signals
from car_interface.tools.recordings.columns import Imu, Odom
from car_interface.tools.recordings.recording import NoRecording

STRAIGHT_RAD = 1e-6
IMU_GAP_S = 0.1
# A VESC makes pulses of 1 to 2 ms, 50 a second, of its servo's positions 0 to 1: SERVO_OUT_PULSE_MIN_US and …_MAX_US in
# its firmware. 65536 / 20 ms · 1 ms is 3277.
POSITION_0_DUTY, POSITION_1_DUTY = 65536 / 20, 2 * 65536 / 20
MIN_IMU_RATIO = 0.95  # of a drive that an IMU must cover to be used
MAX_YAW_DIFFERENCE = 0.03  # of odometry's and the IMU's yaw, as a ratio, without a note


def load_steering_drive(path: str, channel: int, topics: Mapping[str, str] | None = None, use_imu: bool = True,
                        namespace: str = "/", base: SteeringCalibration | None = None,
                        wheelbase_m: float | None = None) -> RecordedDrive:
    """Read one recording.

    Args:
        channel: of the steering servo, 0..15.
        topics: named by the user, by role: see ``signals.load``.
        use_imu: whether the heading may come from an IMU.
        base, wheelbase_m: make duties of the angles that a planner asked for, where no duties were recorded; without a
            wheelbase such a recording is refused.

    Raises:
        NoRecording: it can't be read, or lacks what is needed.
        CarInterfaceError: the channel never had a pulse.
    """
    optional = [roles.OUTPUT.name, roles.SERVO.name, roles.ACKERMANN.name, *([roles.IMU.name] if use_imu else [])]
    found = signals.load(path, (roles.ODOM.name,), optional=optional, namespace=namespace,
                         **{role: topic for role, topic in (topics or {}).items() if use_imu or role != roles.IMU.name})
    odom, notes = found.odom, [note for note in found.notes
                               if found.output is None and found.servo is None or not _is_on_angles(note)]
    yaw_rad, heading = odom.yaw_rad, None if found.imu is None else imu_heading(odom, found.imu)
    if found.imu is not None and heading is None:
        notes.append(f"{found.topics[roles.IMU.name]} covers too little of the drive, or doesn't follow the "
                     "car's turning: not used")
    if heading is not None:
        yaw_rad, ratio = heading
        if abs(ratio - 1) > MAX_YAW_DIFFERENCE:
            notes.append(f"odometry turns {abs(ratio - 1):.0%} {'more' if ratio > 1 else 'less'} than the IMU: measure "
                         "track and wheel_diameter")
    duty_s, duty = (recorded_duty(found, channel, "servo") if found.output else
                    _position_duties(found, notes) if found.servo else _asked_duties(found, base, wheelbase_m, notes))
    drive = SteeringDrive(odom.t_s, distance_m(odom), yaw_rad, duty_s, duty)
    return RecordedDrive(path, drive, tuple(notes), found.duration_s, signals.trail(found),
                         uses_imu=heading is not None)


def _is_on_angles(note):
    """Return whether a note is on what was taken for a planner's angles, which aren't used beside duties."""
    return note.startswith(f"{roles.ACKERMANN.name}: ")


def _position_duties(found, notes):
    """Return (times, duties) by the positions of a VESC's servo; NaN for one that there isn't."""
    position = found.servo.value
    notes.append(f"no duties of the servo were recorded: the positions 0 to 1 on {found.topics[roles.SERVO.name]} "
                 f"count as {POSITION_0_DUTY:.0f} to {POSITION_1_DUTY:.0f}, the pulses of 1 to 2 ms that a VESC makes "
                 "of them")
    duty = POSITION_0_DUTY + (POSITION_1_DUTY - POSITION_0_DUTY) * position
    return found.servo.t_s, np.where((position >= 0) & (position <= 1), duty, np.nan)


def _asked_duties(found, base, wheelbase_m, notes):
    """Return (times, duties) by the angles that a planner asked for."""
    commands = " or ".join(roles.COMMAND.topics)
    lacks = f"{found.path} has no topic {roles.OUTPUT.topics[0]}, nor {commands}: the servo's duties can't be told"
    if found.ackermann is None and any(map(_is_on_angles, found.notes)):
        raise NoRecording(f"{lacks}. {next(filter(_is_on_angles, found.notes))}")
    if found.ackermann is None:
        raise NoRecording(f"{lacks}, and no {roles.ACKERMANN.types[0]} that could stand for them. Name a topic of "
                          "another name by --map TOPIC=output")
    topic = found.topics[roles.ACKERMANN.name]
    if wheelbase_m is None:
        raise NoRecording(f"{lacks}. The angles that were asked for are on {topic}: with --wheelbase M, and the --base "
                          "that made duties of them on that drive, they are taken")
    notes.append(f"no duties of the servo were recorded: the angles on {topic} count as the duties that --base has for "
                 f"them with a wheelbase of {wheelbase_m:g} m. What this recording can't tell: whether "
                 "--base was the table on this drive, and whether anything else steered (a gamepad, a trim, a limit)")
    return found.ackermann.t_s, np.array([duty_of_angle(base, wheelbase_m, angle_rad)
                                          for angle_rad in found.ackermann.value.tolist()], float)


def duty_of_angle(base: SteeringCalibration, wheelbase_m: float, angle_rad: float) -> int:
    """Return what the servo board outputs for an angle of the front wheels, left positive."""
    radius_m = math.inf if abs(angle_rad) < STRAIGHT_RAD else wheelbase_m / math.tan(angle_rad)
    return duty_of_counts(counts_of_duty(base.planner_duty(radius_m)))


def imu_heading(odom: Odom, imu: Imu) -> tuple[np.ndarray, float] | None:
    """Integrate the IMU's yaw rate, less its offset; ``None`` when it covers too little or is unrelated.

    Returns:
        The yaw at odometry's times in rad (N,), and odometry's change of yaw as a ratio of it.
    """
    covered = ((odom.t_s[:-1] >= imu.t_s[0]) & (odom.t_s[1:] <= imu.t_s[-1])
               & ~has_gap(imu.t_s, odom.t_s[:-1], odom.t_s[1:], IMU_GAP_S))
    if len(imu.t_s) < 100 or np.mean(covered) < MIN_IMU_RATIO:
        return None
    by_rate_rad = np.interp(odom.t_s, imu.t_s, integral(imu.t_s, imu.yaw_rate_radps))
    # Ratio and offset by a straight line through the changes of yaw in each second, twice without its outliers.
    at_s = np.arange(odom.t_s[0], odom.t_s[-1], 1.0)
    by_odom, by_imu = (np.diff(np.interp(at_s, odom.t_s, yaw)) for yaw in (odom.yaw_rad, by_rate_rad))
    used = np.ones(len(by_odom), bool)
    for _ in range(3):
        if used.sum() < 10 or np.ptp(by_imu[used]) < 0.2:
            return None
        ratio, offset = np.polyfit(by_imu[used], by_odom[used], 1)
        off = np.abs(by_odom - ratio * by_imu - offset)
        used = off <= 4 * 1.4826 * np.median(off) + 1e-9
    if not 0.7 < ratio < 1.4:
        return None
    return by_rate_rad + offset / ratio * (odom.t_s - odom.t_s[0]), float(ratio)
