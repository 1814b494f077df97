"""Reads a recording as the drive that the fit of an ESC takes."""
from __future__ import annotations

from collections import Counter
from typing import Mapping, Sequence

import numpy as np

from car_interface.common import causes
from car_interface.common.errors import CarInterfaceError
from car_interface.pca9685.registers import DUTY_PER_COUNT
from car_interface.throttle.calibration import ThrottleCalibration, trimmed
from car_interface.tools.calibration.esc.pulls import EscDrive
from car_interface.tools.calibration.shared import MAX_PULSE, MIN_PULSE, RecordedDrive
from car_interface.tools.recordings import recording, roles, signals

MAX_TUNED_RATIO = 0.05  # of a drive that may have had another neutral, without spoiling what the rest shows
MAX_ODOM_GAP_S, MAX_OUTPUT_GAP_S = 0.5, 2.5  # odometry comes each 0.2 s at least, the board's output each second
MIN_PULSES = 200  # of a wheel, from which the length of one is known
JOIN_S = 5.0  # between two recordings

CALIBRATION_DRIVE = "roslaunch car_interface car.launch throttle:=true calibration_drive:=true"


def load_esc_drive(path: str, calibration: ThrottleCalibration, topics: Mapping[str, str] | None = None,
                   namespace: str = "/") -> RecordedDrive:
    """Read one recording.

    Args:
        calibration: the ESC's channel and duties in the drive; its neutral may have been another one, which
            throttle_arb's state tells.
        topics: named by the user, by role: ``odom`` and ``output``.

    Returns:
        The drive; where an ESC takes a shorter pulse for forward, its duties are mirrored at neutral.

    Raises:
        NoRecording: it can't be read, or lacks what is needed.
        CarInterfaceError: it is no drive that shows an ESC.
    """
    topics = topics or {}
    recording.require(path, {topics.get(roles.OUTPUT.name, roles.OUTPUT.topics[0]): roles.DUTY_TYPES}, namespace,
                      "which says what the ESC got", f"; name another by --map TOPIC={roles.OUTPUT.name}")
    found = signals.load(path, (roles.ODOM.name, roles.OUTPUT.name), optional=(signals.PULSES,), namespace=namespace,
                         progress=True, **topics)
    neutral, notes = _drive_s_neutral(path, namespace, calibration)
    used = trimmed(calibration, neutral)
    ends = used.duty_table[-1], used.duty_table[0]
    if neutral in ends:
        raise CarInterfaceError(f"{path}: servo/neutral {neutral} is an end of servo/duty_table: give the file of this "
                                "drive by --base")
    duty = found.output.duties[:, calibration.channel].astype(float)
    is_pulse = (duty >= MIN_PULSE) & (duty <= MAX_PULSE)
    if not is_pulse.any():
        raise CarInterfaceError(f"{path}: channel {calibration.channel} of the servo board never had a pulse: is the "
                                "ESC on another one (--channel)?")
    if ends[0] < neutral:
        duty, ends = 2.0 * neutral - duty, (2 * neutral - ends[0], 2 * neutral - ends[1])
    duty_s, duty = _without_gaps(found.output.t_s, np.where(is_pulse, duty, 0.0), found.odom.t_s)
    drive = EscDrive(duty_s, duty, found.odom.t_s, found.odom.speed_mps, float(neutral), float(ends[0]), float(ends[1]),
                     _wheels(found.pulses or (), found.odom))
    return RecordedDrive(path, drive, (*notes, *found.notes), found.duration_s, signals.trail(found))


def joined(drives: Sequence[EscDrive]) -> EscDrive:
    """Several drives of one car, with the same neutral and ends, as one; between them nothing is known of the ESC."""
    columns: tuple[list, ...] = ([], [], [], [])
    wheels = []
    begin_s = 0.0
    for drive in drives:
        shift_s = begin_s - min(drive.duty_s[0], drive.speed_s[0])
        end_s = max(drive.duty_s[-1], drive.speed_s[-1]) + shift_s
        for column, values in zip(columns, (np.r_[drive.duty_s + shift_s, end_s + 0.1], np.r_[drive.duty, 0.0],
                                            drive.speed_s + shift_s, drive.speed_mps)):
            column.append(values)
        wheels += [(t_s + shift_s, distance_m) for t_s, distance_m in drive.wheels]
        begin_s = end_s + JOIN_S
    first = drives[0]
    return EscDrive(*map(np.concatenate, columns), first.neutral, first.full_forward, first.full_reverse, tuple(wheels))


def _wheels(pulses, odom):
    """Return (times, distances in m) at each wheel's pulses; the length of one is by odometry."""
    rolled_m = float(np.sum(np.diff(odom.t_s) * np.abs(odom.speed_mps[1:] + odom.speed_mps[:-1]) / 2))
    wheels = []
    for wheel in pulses:
        is_new = np.concatenate(([True], np.diff(wheel.count) != 0)) if len(wheel.count) else np.zeros(0, bool)
        t_s, count = wheel.t_s[is_new], wheel.count[is_new].astype(float)
        counted = np.abs(np.diff(count)).sum()
        if counted >= MIN_PULSES:
            wheels.append((t_s, count * rolled_m / counted))
    return tuple(wheels)


def _drive_s_neutral(path, namespace, calibration):
    """Return (the neutral in the drive, notes).

    Raises:
        CarInterfaceError: throttle_arb withheld the pulls, or its neutral was tuned.
    """
    neutrals: Counter = Counter()
    states = passed = 0
    for recorded in recording.read(path, roles.THROTTLE_STATE, namespace):
        message = recorded.message
        try:
            states += 1
            passed += message.esc_cause == causes.CALIBRATION_DRIVE
            if not message.granted:
                neutrals[message.duty] += 1
        except AttributeError as error:
            raise recording.other_version(path, recorded) from error
    if not states:
        return calibration.neutral, (f"{path} has no throttle_arb/state: who drove, and whether by hand, isn't known",)
    if not passed:
        raise CarInterfaceError(f"{path} was driven without calibration_drive, so that throttle_arb withheld the pulls "
                                f"that would show what the ESC makes of them: {CALIBRATION_DRIVE}, and drive again")
    if not neutrals:
        return calibration.neutral, ()
    neutral, _ = neutrals.most_common(1)[0]
    others = sum(count for duty, count in neutrals.items() if abs(duty - neutral) > DUTY_PER_COUNT / 2)
    if others > MAX_TUNED_RATIO * sum(neutrals.values()):
        raise CarInterfaceError(f"{path}: servo/neutral was tuned during the drive (it was "
                                f"{min(neutrals)} to {max(neutrals)}): drive again, and leave it as it is")
    return neutral, ()


def _without_gaps(duty_s, duty, odom_s):
    """Return the duties, with no pulse where odometry or the board's output has a gap: nothing is known there."""
    gaps, silent = np.diff(odom_s) > MAX_ODOM_GAP_S, np.diff(duty_s) > MAX_OUTPUT_GAP_S
    begins_s, ends_s, silent_s = odom_s[:-1][gaps], odom_s[1:][gaps], duty_s[:-1][silent] + MAX_OUTPUT_GAP_S
    resumed = duty[np.maximum(0, np.searchsorted(duty_s, ends_s, side="right") - 1)]
    times = np.concatenate([duty_s, begins_s, ends_s, silent_s])
    order = np.argsort(times, kind="stable")
    times = times[order]
    duties = np.concatenate([duty, np.zeros(len(begins_s)), resumed, np.zeros(len(silent_s))])[order]
    for begin_s, end_s in zip(begins_s, ends_s):
        duties[(times >= begin_s) & (times < end_s)] = 0.0
    return times, duties
