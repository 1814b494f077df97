"""Wheel pulses → where the car is: what magnets, directions, resets and gaps do to pose, speed and covariance."""

import math

import pytest
from accuracy import odometry as odometry_accuracy
from hypothesis import example, given, settings
from hypothesis import strategies as st

from car_interface.common.errors import ConfigError
from car_interface.teensy.link.protocol import BACKWARD, FORWARD, NO_DIRECTION, Wheel, WheelStatus
from car_interface.teensy.sensing.odometry import Odometry, OdometryConfig
from car_interface.teensy.sensing.plausibility import Verdict
from car_interface.teensy.sensing.pose import Pose, reversed_path

PULSE_M = math.pi * 0.095 / 20
TRACK_M = 0.296
UNKNOWN_MS = (-math.inf, -math.inf)


class Axle:
    """Two wheels rolled by hand, and the odometry that gets their reports."""

    def __init__(self, phases=(0.5, 0.5), **config):
        self.odometry = Odometry(OdometryConfig(**config))
        self.way = list(phases)  # pulses
        self.wheels = [Wheel(0, NO_DIRECTION, 0, 0, 0), Wheel(0, NO_DIRECTION, 0, 0, 0)]
        self.ms = 1000.0
        self.motion = self.report((0, 0))

    def report(self, pulses, restarted=False, at_ms=None):
        left, right = self.wheels
        self.motion = self.odometry.report(WheelStatus(left, right), Verdict(True, "", pulses, restarted),
                                           (left.when, right.when), self.ms if at_ms is None else at_ms)
        return self.motion

    def reboot(self, after_ms):
        """Lose all counts: the first report is that of wheels that have made no pulse yet."""
        self.ms += after_ms
        self.wheels = [Wheel(0, NO_DIRECTION, 0, 0, 0)] * 2
        self.motion = self.odometry.report(WheelStatus(*self.wheels), Verdict(True, "", restarted=True), UNKNOWN_MS,
                                           self.ms)
        return self.motion

    def roll(self, speeds_mps, duration_s, step_ms=1.0):
        """Each wheel at its speed; a report with each pulse, and every 200 ms without."""
        last_ms = self.ms
        for _ in range(round(duration_s * 1000 / step_ms)):
            self.ms += step_ms
            pulses = [self._advance(side, speed * step_ms / 1000 / PULSE_M) for side, speed in enumerate(speeds_mps)]
            if any(pulses):
                self.report(pulses, at_ms=max(wheel.when for wheel in self.wheels) + 0.5)
                last_ms = self.ms
            elif self.ms - last_ms >= 200:
                self.report((0, 0))
                last_ms = self.ms
        return self.motion

    def _advance(self, side, by):
        before = math.floor(self.way[side])
        self.way[side] += by
        pulses = math.floor(self.way[side]) - before
        if pulses:
            direction = FORWARD if pulses > 0 else BACKWARD
            wheel = self.wheels[side]
            count = wheel.dist_abs + abs(pulses)
            dist = wheel.dist if direction == wheel.direction else wheel.dist_abs + 1
            self.wheels[side] = Wheel(0, direction, math.floor(self.ms), dist, count)
        return pulses


@pytest.mark.once
def test_virtual_car_that_crawls_is_where_odometry_says():
    score = odometry_accuracy.run("crawl 0.05 m/s", (0.3, 0.9), 1)
    assert score.position_m <= 0.01 * score.distance_m
    assert score.yaw_deg <= 2.0
    assert odometry_accuracy.percentile(score.crawl, 0.95) <= 0.1
    assert score.inside / score.reports >= 0.99


@pytest.mark.parametrize("phases", ((0.5, 0.5), (0.01, 0.99), (0.99, 0.01)))
def test_straight_way_is_straight_wherever_the_magnets_stood(phases):
    axle = Axle(phases)
    motion = axle.motion
    assert (motion.x_m, motion.y_m, motion.yaw_rad, motion.speed_mps, motion.distance_m) == (0, 0, 0, 0, 0)
    motion = axle.roll((1.0, 1.0), 5.0)
    assert motion.x_m == pytest.approx(5.0, abs=0.02)
    assert motion.y_m == pytest.approx(0.0, abs=0.05)
    assert motion.yaw_rad == pytest.approx(0.0, abs=math.radians(0.5))
    assert motion.speed_mps == pytest.approx(1.0, rel=0.02)
    assert all(wheel.first_pulses is None for wheel in axle.odometry._wheels), "none is kept that nobody needs"


@pytest.mark.once
@settings(max_examples=25, deadline=None)
@given(st.lists(st.tuples(st.floats(-2, 2), st.floats(-2, 2), st.floats(0.05, 1.0)), max_size=6),
       st.floats(0, 0.999), st.floats(0, 0.999))
@example([(0.0, 1.0, 1.0), (0.5, 0.0, 0.0546875)], 0.0, 0.0)
@example([(0.0, 0.0, 2.0), (0.0, 1e-05, 1.0), (-0.0625, 1.0, 0.05), (-0.271, 0.0, 0.0559)], 0.0, 0.5)
def test_whatever_the_wheels_do_each_stays_within_its_pulse_and_a_tick_and_nothing_is_infinite(moves, left, right):
    axle = Axle((left, right))
    for left_mps, right_mps, duration_s in moves:
        motion = axle.roll((left_mps, right_mps), duration_s, step_ms=3.0)
        assert all(math.isfinite(value) for value in (motion.x_m, motion.y_m, motion.yaw_rad, motion.speed_mps))
        for angle_rad, speed_radps, way in zip(motion.wheel_angles_rad, motion.wheel_speeds_radps, axle.way):
            at_pulses, tick = angle_rad * 0.0475 / PULSE_M, abs(speed_radps) * 0.0475 / PULSE_M * 1e-3
            assert math.floor(way) - tick - 1e-6 <= at_pulses <= math.floor(way) + 1 + tick + 1e-6
        for index in range(3):
            assert motion.pose_covariance[index][index] > 0


def test_pulses_of_unknown_time_after_a_restart_leave_every_number_finite():
    axle = Axle()
    for count in (2, 4, 6, 8):
        axle.ms += 900.0
        axle.wheels = [Wheel(0, FORWARD, 0, count, count)] * 2
        axle.motion = axle.odometry.report(WheelStatus(*axle.wheels), Verdict(True, "", (2, 2), count == 2), UNKNOWN_MS,
                                           axle.ms)
        assert all(map(math.isfinite, (axle.motion.x_m, axle.motion.speed_mps, axle.motion.speed_variance)))
    assert math.isfinite(axle.roll((1.0, 1.0), 1.0).x_m)


def test_speed_is_open_by_2_mps2_for_all_of_the_time_without_counts():
    axle = Axle()
    axle.roll((1.0, 1.0), 2.0)
    axle.roll((0, 0), 2.0)
    assert 3 * math.sqrt(axle.reboot(1500).speed_variance) == pytest.approx(2.0 * 1.5, rel=0.01), "both wheels alike"


def test_turn_on_the_way_without_counts_is_open_as_if_the_curvature_changed_anywhere_on_it():
    """By a mean curvature with a third of the variance of one that is unknown, 0.5 (1/m)², over the way's square."""
    axle = Axle(distance_sigma=0.0, heading_sigma=0.0)
    start_m = axle.roll((1.0, 1.0), 2.0).x_m
    motion = axle.reboot(1000)
    way_m, turn = motion.x_m - start_m, motion.pose_covariance[2][2]
    along = motion.pose_covariance[0][0] - turn * way_m ** 2 / 4  # what the turn adds is half of it times the way
    assert way_m == pytest.approx(1.0, abs=0.01)
    assert turn == pytest.approx(0.5 / 3 * (way_m ** 2 + along), rel=0.01)


def test_places_that_are_only_predicted_align_no_wheels():
    axle = Axle()
    axle.roll((0.5, 0.4), 0.15)
    assert axle.motion.yaw_rad == 0.0, "not aligned yet"
    assert axle.reboot(1200).yaw_rad == 0.0


def test_reversals_after_a_boot_are_uncertain_behind_the_part_without_counts():
    ends = []
    for unsplit in ((0, 0), (10, 14)):
        axle = Axle()
        axle.roll((1.0, 1.0), 2.0)
        axle.reboot(1000)
        for count in range(1, 10):
            axle.ms += 15.0
            axle.wheels = [Wheel(0, FORWARD, round(axle.ms), 1, count)] * 2
            unproven = (int(count <= 2),) * 2
            verdict = Verdict(True, "", (1 - unproven[0],) * 2, False, unproven, unsplit if count == 4 else (0, 0))
            axle.motion = axle.odometry.report(WheelStatus(*axle.wheels), verdict, (axle.ms,) * 2, axle.ms + 0.5)
        ends.append(axle.motion)
    path = reversed_path(12 * PULSE_M, 4 * PULSE_M / TRACK_M, False)
    across = ends[1].pose_covariance[1][1] - ends[0].pose_covariance[1][1]
    rest_m = 10 * PULSE_M
    assert path.across_variance < across < path.across_variance + path.heading_variance * rest_m ** 2 * 1.1


@pytest.mark.parametrize("unsplit, is_open", [((2, 2), True), ((1, 2), False), ((2, 1), False)])
def test_from_two_pulses_of_each_wheel_on_it_is_open_how_they_were_made(unsplit, is_open):
    axle = Axle()
    axle.roll((1.0, 1.0), 2.0)
    axle.ms += 100.0
    axle.wheels = [Wheel(0, FORWARD, round(axle.ms), wheel.dist_abs + 4, wheel.dist_abs + 5) for wheel in axle.wheels]
    before = axle.motion.pose_covariance[0][0]
    axle.motion = axle.odometry.report(WheelStatus(*axle.wheels), Verdict(True, "", (1, 1), unsplit=unsplit),
                                       (axle.ms,) * 2, axle.ms + 0.5)
    assert (axle.motion.pose_covariance[0][0] - before > (2 * PULSE_M) ** 2 / 8) == is_open


def test_car_that_drove_backward_in_a_curve_unseen_and_then_forward_is_where_both_led():
    axle, pose = Axle(), Pose(0.0, 0.0)
    axle.roll((-1.0, -1.0), 2.0)
    pose.x_m, pose.y_m, pose.yaw_rad = axle.motion[1:4]
    pose.move(-72 * PULSE_M, -24 * PULSE_M / TRACK_M)  # the right wheel went farther back
    pose.move(20 * PULSE_M, 0.0)
    axle.ms += 3000.0
    axle.wheels = [Wheel(0, FORWARD, round(axle.ms), wheel.dist_abs + back + 1, wheel.dist_abs + back + 20)
                   for wheel, back in zip(axle.wheels, (60, 84))]
    axle.motion = axle.odometry.report(WheelStatus(*axle.wheels), Verdict(True, "", (-40, -64), unsplit=(60, 84)),
                                       (axle.ms,) * 2, axle.ms + 0.5)
    assert axle.motion[1:4] == pytest.approx((pose.x_m, pose.y_m, pose.yaw_rad), abs=0.05)


@pytest.mark.parametrize("silent_ms, is_open", [(440, False), (460, True)])
def test_where_on_the_way_a_car_began_to_turn_is_open_if_no_report_came_for_450_ms(silent_ms, is_open):
    """A way S that turns by m S, after a straight part u of it, ends m S² (1 − u) / 2 aside; u is in 0 .. 1 − m / 2."""
    across, count = [], round(silent_ms / 1000 / PULSE_M)
    for more in (0, 10):  # pulses of the right wheel
        axle = Axle(distance_sigma=0.0, heading_sigma=0.0)
        axle.roll((1.0, 1.0), 2.0)
        axle.ms += silent_ms
        axle.wheels = [Wheel(0, FORWARD, round(axle.ms), 1, wheel.dist_abs + pulses)
                       for wheel, pulses in zip(axle.wheels, (count, count + more))]
        across.append(axle.report((count, count + more), at_ms=axle.ms + 0.5).pose_covariance[1][1])
    way_m, turned_rad = (count + 5) * PULSE_M, 10 * PULSE_M / TRACK_M
    expected = (turned_rad * way_m / 2) ** 2 * (1 - turned_rad / way_m / 2) ** 2 / 12
    assert across[1] - across[0] == pytest.approx(expected if is_open else 0.0, rel=0.15, abs=2e-5)


def test_acceleration_is_that_of_both_wheels_backward_negative():
    for sign in (1, -1):
        axle = Axle()
        for hundredth in range(100):
            axle.roll((sign * hundredth / 100,) * 2, 0.01)
        assert axle.odometry.acceleration_mps2 == pytest.approx(sign * 1.0, rel=0.2)


def test_heading_of_a_car_that_has_not_moved_is_open_by_where_each_wheel_stands_now_and_stood_at_the_start():
    """Each is somewhere between two magnets, variance 1/12 pulse²: a place is the mean of two, an angle has four."""
    stands = Wheel(0, FORWARD, 900, 1, 9)
    motion = Odometry().report(WheelStatus(stands, stands), Verdict(True, "", restarted=True), (900, 900), 1000.0)
    (xx, _, _), (_, yy, _), (_, _, aa) = motion.pose_covariance
    assert xx == yy == pytest.approx(2 / 12 / 4 * PULSE_M ** 2 + 0.001 ** 2)
    assert aa == pytest.approx(4 / 12 * (PULSE_M / TRACK_M) ** 2, rel=0.01)


def test_variances_of_speed_and_yaw_rate_are_those_of_the_wheels_sum_and_difference():
    """Each wheel's speed v has the same variance: (v + v) / 2 a quarter of their sum's, (v − v) / track all of it."""
    motion = Axle().roll((1.0, 1.0), 2.0)
    assert motion.yaw_rate_variance * TRACK_M ** 2 == pytest.approx(4 * motion.speed_variance, rel=0.05)


def test_wheels_in_opposite_directions_turn_the_car_where_it_stands():
    motion = Axle().roll((-0.5, 0.5), 2.0)
    assert motion.yaw_rad == pytest.approx(2 * 1.0 / TRACK_M, abs=0.1)
    assert math.hypot(motion.x_m, motion.y_m) < 0.02
    assert motion.yaw_rate_radps == pytest.approx(1.0 / TRACK_M, rel=0.1)


def test_speed_sinks_when_pulses_fail_to_come_and_is_zero_after_a_second():
    axle = Axle()
    axle.roll((1.0, 1.0), 2.0)
    at_m = axle.motion.x_m
    slower = axle.roll((0, 0), 0.25)
    assert 0 < slower.speed_mps <= PULSE_M / 0.2 + 1e-9
    standing = axle.roll((0, 0), 1.2)
    assert (standing.speed_mps, standing.yaw_rate_radps, standing.wheel_speeds_radps) == (0, 0, (0, 0))
    assert standing.x_m == pytest.approx(at_m, abs=PULSE_M + 0.0005)  # and half a tick's way


@pytest.mark.parametrize("pause_ms, pulse_ms, count, pulses, x_m, error_m", [
    pytest.param(300, 3300, 1, 0, 2.3, 0.05, id="those_lost_with_a_reboot_are_made_up_for_by_the_speed"),
    pytest.param(60_000, 63_000, 90_000, 0, 2.0, 0.1, id="but_a_jump_after_a_long_silence_does_not_throw_the_car"),
    pytest.param(500, 3500, None, 33, 2.0 + 33 * PULSE_M, 0.03, id="those_after_lost_reports_count"),
    pytest.param(30, 12, None, 2, 2.03, 0.03, id="those_from_a_time_that_cannot_be_too"),
])
def test_pulses_after_a_gap(pause_ms, pulse_ms, count, pulses, x_m, error_m):
    axle = Axle()
    axle.roll((1.0, 1.0), 2.0)
    axle.ms += pause_ms
    axle.wheels = [Wheel(0, FORWARD, pulse_ms, 1, count or wheel.dist_abs + pulses) for wheel in axle.wheels]
    motion = axle.report((pulses, pulses), restarted=count is not None, at_ms=axle.ms + 0.5)
    assert motion.x_m == pytest.approx(x_m, abs=error_m) and motion.pose_covariance[0][0] > 0
    assert motion.speed_mps == pytest.approx(0.0 if count == 90_000 else 1.0, rel=0.1)


def test_steering_fills_the_gap_between_pulses_only_when_it_is_used():
    curvature = 0.8
    half = curvature * TRACK_M / 2
    headings = []
    for used in (False, True):
        axle = Axle((0.3, 0.6), use_steering=used)
        axle.odometry.steer(curvature)
        headings.append(axle.roll((0.3 * (1 - half), 0.3 * (1 + half)), 3.0).yaw_rad)
        assert headings[-1] == pytest.approx(0.3 * 3.0 * curvature, abs=math.radians(2.5))
    assert headings[0] != headings[1]
    for unknown in (math.nan, math.inf):
        axle.odometry.steer(unknown)
        assert math.isfinite(axle.roll((1.0, 1.0), 0.5).yaw_rad)


@pytest.mark.parametrize("changes", (
    {"track_m": 0}, {"wheel_diameter_m": -1}, {"pulses_per_revolution": 0}, {"wheelbase_m": math.nan},
    {"distance_sigma": -1}, {"heading_sigma": math.inf}, {"track_m": 1e-300}))
def test_car_that_cannot_be_is_refused_by_name(changes):
    with pytest.raises(ConfigError, match=next(iter(changes)).replace("_m", "")):
        OdometryConfig(**changes)
