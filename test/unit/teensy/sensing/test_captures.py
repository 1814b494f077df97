"""The host's side against captures of the original firmware: no record is refused, and the car is where it is.

The truth comes with the captures (test/data/firmware): no code of this package had a part in it. What the hub
publishes is held in test/graph: test_teensy_sensor_hub.py, of a capture's bytes, and test_measurements.py.
"""
import math
import os
from collections import Counter
from statistics import median
from typing import NamedTuple

import pytest

from captures import NAMES, NS_PER_US, load, replay
from car_interface.teensy.link.protocol import SonarStatus
from car_interface.teensy.sensing import plausibility
from car_interface.teensy.sensing.clock import ClockLines, Sync
from car_interface.teensy.sensing.measurements import MotionMeasurement
from car_interface.teensy.sensing.ranging import DISTRUSTED, HELD, MICROS_WRAP, STUCK, UNKNOWN

pytestmark = pytest.mark.once
S_US = 1_000_000
LISTENS_US = math.inf if os.environ.get("CAR_INTERFACE_ALL") else 40 * S_US  # one capture has 300 s
SPEED_OF_SOUND_MPS = 343.42
MAX_RANGE_M = 2.0
# Reports after these gaps wait until others confirm them: an unplugged port, or no sonar by whose tick a boot shows.
WAITING = ("dark_turnround", "dark_curve", "dark_reboot_unplug", "reboot_missing", "reboot_no_sonars",
           "reboot_missing_started")
DARK = ("dark_turnround", "dark_curve", "dark_reboot", "dark_reboot_unplug")
REBOOTS = ("reboot_rolling", "reboot_slalom", "reboot_missing", "reboot_no_sonars", "reboot_missing_started")
WORTH_A_WORD = {plausibility.FIRST, plausibility.ODOMETERS_RESET, plausibility.CLOCK_RESTARTED}


class Error(NamedTuple):
    """One odometry against the truth at its stamp."""

    received_us: int
    stamp_ns: int
    position_m: float
    yaw_deg: float
    sigmas: float  # the worst of x, y and yaw
    speed_sigmas: float


def motions(moments):
    return [moment for moment in moments if isinstance(moment.result, MotionMeasurement)]


def errors(capture, moments):
    """Odometry is counted from the place and heading at its first message."""
    found = motions(moments)
    start = capture.truth_at(found[0].result.stamp.time_ns / NS_PER_US)
    cos, sin = math.cos(start.yaw_rad), math.sin(start.yaw_rad)
    result = []
    for moment in found:
        stamp, motion = moment.result
        truth = capture.truth_at(stamp.time_ns / NS_PER_US)
        dx, dy = truth.x_m - start.x_m, truth.y_m - start.y_m
        off = (motion.x_m - (cos * dx + sin * dy), motion.y_m - (cos * dy - sin * dx),
               motion.yaw_rad - (truth.yaw_rad - start.yaw_rad))
        sigmas = max(abs(value) / math.sqrt(motion.pose_covariance[axis][axis]) for axis, value in enumerate(off))
        result.append(Error(moment.received_us, stamp.time_ns, math.hypot(*off[:2]), math.degrees(off[2]), sigmas,
                            abs(motion.speed_mps - truth.speed_mps) / math.sqrt(motion.speed_variance)))
    return result


@pytest.fixture(scope="module")
def replayed():
    done, admit = {}, ClockLines.admit

    def get(name):
        def spy(lines, earliest, latest):
            is_admitted = admit(lines, earliest, latest)
            get.refused_ticks[name] += earliest is None and not is_admitted
            return is_admitted

        if name not in done:
            capture = load(name)
            with pytest.MonkeyPatch.context() as patch:
                patch.setattr(ClockLines, "admit", spy)
                moments, measurements = replay(capture, until_us=LISTENS_US)
            done[name] = capture, moments, measurements, errors(capture, moments)
        return done[name]
    get.refused_ticks = Counter()
    return get


@pytest.mark.parametrize("name", NAMES)
def test_no_record_of_a_healthy_firmware_is_refused_but_for_the_few_that_wait_after_a_gap(replayed, name):
    capture, moments, measurements, _ = replayed(name)
    gaps = sum(event["event"] in ("reboot", "unplug") for event in capture.events) if name in WAITING else 0
    assert measurements.gates.refused <= 4 * gaps, "two of the wheels, and two ticks"
    if not gaps:
        assert set(measurements.gates.counts) <= WORTH_A_WORD and not replayed.refused_ticks[name]
        assert not any(moment.result.reason for moment in moments if isinstance(moment.result, Sync))


def test_heading_at_the_end_is_mostly_right_to_half_a_pulse(replayed):
    assert median(abs(replayed(name)[3][-1].yaw_deg) for name in NAMES) <= 1.5


@pytest.mark.parametrize("name", [name for name in NAMES if name not in (*DARK, *REBOOTS)])
def test_car_ends_where_it_is(replayed, name):
    capture, _, _, found = replayed(name)
    assert found[-1].position_m <= max(0.03, 0.005 * capture.distance_m(LISTENS_US))
    assert abs(found[-1].yaw_deg) <= 3.0


@pytest.mark.parametrize("name", NAMES)
def test_truth_lies_within_three_sigma_from_the_first_message_on(replayed, name):
    found = replayed(name)[3]
    assert sum(error.sigmas <= 3 and error.speed_sigmas <= 3 for error in found) >= 0.99 * len(found)


@pytest.mark.parametrize("name", REBOOTS)
def test_reboots_in_mid_drive_leave_heading_and_place_with_sonars_or_without(replayed, name):
    capture, _, measurements, found = replayed(name)
    assert measurements.gates.counts[plausibility.CLOCK_RESTARTED] == sum(event["event"] == "reboot"
                                                                      for event in capture.events)
    assert abs(found[-1].yaw_deg) <= 3.0 and found[-1].position_m <= 0.2
    boots_us = [event["t_us"] for event in capture.events if event["event"] == "power up"]
    found_again = [error for error in found if not any(0 <= error.received_us - at_us < S_US / 2 for at_us in boots_us)]
    assert all(abs(error.yaw_deg) <= 6.0 for error in found_again)


@pytest.mark.parametrize("name, begin_s, end_s, position_m, sigma_m", [
    ("wrap", 4.0, 6.0, 0.04, 0.19), ("wrap", 4.0, 9.0, 0.05, 0.24), ("drive_reverse", 10.9, 15.2, 0.25, 0.55),
    ("stop_go", 15.3, 21.0, 0.01, 0.1), ("drive", 12.2, 16.0, 0.06, 0.1), ("reboot_slalom", 3.5, 6.5, 1.5, 0.95),
], ids=["straight", "straight_for_long", "straight_then_a_curve", "stopped_and_off_the_other_way_in_a_curve",
        "off_for_the_first_time", "slalom"])
def test_unplugged_cable_costs_what_the_counts_leave_open(name, begin_s, end_s, position_m, sigma_m):
    capture = load(name)
    moments, _ = replay(capture, until_us=(end_s + 5) * S_US, unplugged_us=(begin_s * S_US, end_s * S_US))
    found = errors(capture, moments)
    covariance = motions(moments)[-1].result.motion.pose_covariance
    assert found[-1].position_m <= position_m
    assert math.sqrt(covariance[0][0] + covariance[1][1]) <= sigma_m
    assert all(error.sigmas <= 3 for error in found)


@pytest.mark.parametrize("name", NAMES)
def test_stamps_rise_strictly_and_are_as_good_as_they_claim(replayed, name):
    capture, moments, _, found = replayed(name)
    stamps = [error.stamp_ns for error in found]
    assert all(earlier < later for earlier, later in zip(stamps, stamps[1:]))
    per_sensor = {}
    for moment in moments:
        if isinstance(moment.record, SonarStatus) and moment.result is not None:
            assert moment.result.stamp.time_ns > per_sensor.get(moment.record.sensor, 0)
            per_sensor[moment.record.sensor] = moment.result.stamp.time_ns
            truth = capture.truth_at(moment.result.stamp.time_ns / NS_PER_US)
            # A wrap lies between two rows of truth, or it ends before the last frame.
            if truth.millis <= capture.truth_at(moment.received_us).millis and truth.t_us < capture.truth[-1].t_us:
                off_ms = truth.millis - moment.record.when - 0.5
                if abs(off_ms) < 1000:
                    assert abs(off_ms) <= moment.result.stamp.uncertainty_ns / 1e6 + 0.01


@pytest.mark.parametrize("name, begin_s", [
    ("drive_reverse", 12.35), ("wrap", 9.6), ("missing_sonars", 5.1), ("reboot_rolling", 12.2),
], ids=["rolling_backward", "a_second_before_all_counters_wrap", "rolling_with_all_sonars_silent",
        "a_moment_before_the_teensy_reboots"])
def test_host_that_begins_to_listen_later_has_odometry_at_once(name, begin_s):
    capture = load(name)
    moments, measurements = replay(capture, skip_us=round(begin_s * S_US))
    found = errors(capture, moments)
    assert found[0].received_us <= (begin_s + 0.35) * S_US
    assert measurements.gates.refused == 0
    assert found[-1].position_m <= max(0.05, 0.005 * capture.distance_m())
    assert abs(found[-1].yaw_deg) <= 3.0


def ranges(capture, moments):
    """(measured, truth) of each report; ``None`` as measured: no range was made of it. Truth inf: nothing in range."""
    result = []
    for moment in moments:
        if isinstance(moment.record, SonarStatus):
            pulse_us = capture.pulse_us(moment.record.sensor, moment.received_us)
            truth_m = math.inf if pulse_us is None else pulse_us * 1e-6 * SPEED_OF_SOUND_MPS / 2
            result.append((moment.result and moment.result.range_m, truth_m if truth_m <= MAX_RANGE_M else math.inf))
    return result


@pytest.mark.parametrize("name, reason, at_least, at_most", [
    ("stuck_sonar", STUCK, 1, 4), ("wrap", MICROS_WRAP, 1, 10), ("sonar_blink", HELD, 6, 6),
    ("clone_200ms", HELD, 2, 2),
    ("sonar_start", DISTRUSTED, 10, 30)])  # three reports for each of ten SONAR_STARTs at most
def test_false_echoes_make_no_range_and_are_counted(replayed, name, reason, at_least, at_most):
    capture, moments, measurements, _ = replayed(name)
    found = ranges(capture, moments)[is_running(moments):]
    refused = sum(measured is None for measured, _ in found)
    assert measurements.ranging.counts - Counter({UNKNOWN: is_running(moments)}) == {reason: refused}
    assert at_least <= refused <= at_most


def is_running(moments):
    """Return whether the stream begins after the boot: then the first echo's length is unknown."""
    return next(moment.record.when for moment in moments if isinstance(moment.record, SonarStatus)) > 400


def test_clone_that_ends_its_pulse_after_200_ms_is_found(replayed):
    assert replayed("clone_200ms")[2].ranging.clones == {2: pytest.approx(200, abs=0.1)}


@pytest.mark.parametrize("name", NAMES)
def test_no_range_is_false_and_each_echo_of_healthy_sonars_makes_one(replayed, name):
    capture, moments, _, _ = replayed(name)
    found = ranges(capture, moments)
    assert all(measured in (None, pytest.approx(truth, abs=0.005)) for measured, truth in found)
    if name not in ("stuck_sonar", "wrap", "sonar_start", "missing_sonars", "stuck_old", "sonar_blink", "clone_200ms",
                    *WAITING):
        assert None not in [measured for measured, _ in found[is_running(moments):]]
