"""What teensy_sensor_hub makes of a virtual car's pulses, echoes and ticks, held against where the car really was."""
import math

import pytest
import rospy
from sensor_msgs.msg import Range, Temperature
from std_msgs.msg import Int32MultiArray
from std_srvs.srv import TriggerRequest

from car import config
from car_interface.common.units import stamp_ns
from graph import NS_PER_S, NodeClocks

SONARS = ("front_right", "front_middle", "front_left", "rear_right", "rear_middle", "rear_left")
CENTER, LEFT, NEUTRAL, FORWARD, REVERSE = 5100, 3835, 4915, 5160, 4700
TRUTH, ODOM, CLOCK = "/car_sim/truth", "/odom", "/teensy_clock"
TOPICS = (TRUTH, ODOM, CLOCK, "/tf", "/tf_static", "/joint_states", "/teensy_distance", "/teensy_wheel")


class Driven:
    """A virtual car whose test is the servo board, and its hub on a line with the delays of USB."""

    def __init__(self, car, hub=None, **sim):
        self.graph, self.car = car.graph, car
        car.cable.delay_s, car.cable.frame_s, car.cable.phase_s = 0.0003, 0.001, 0.0007
        self.graph.record(*TOPICS, *(f"/sonar/{name}" for name in SONARS))
        car.sim(follows_board=False, collisions=False, **sim)
        self.graph.run(0.0137)
        car.hub(**(hub or {}))
        self.graph.run(2.0)

    def hold(self, steering, esc):
        self.graph.publish("/servo/output", Int32MultiArray(data=[steering, esc] + 14 * [-1]))

    def drive(self, steering, esc, distance_m):
        """Go so far, then stand still; return how far that was in all."""
        since_ns, start = self.graph.now_ns, self.car.truth().pose.pose.position
        self.hold(steering, esc)
        self.graph.run_until(lambda: math.dist(xy(self.car.truth()), (start.x, start.y)) > distance_m)
        self.hold(CENTER, NEUTRAL)
        self.graph.run_until(lambda: self.car.speed_mps == 0)
        self.graph.run(1.0)
        places = [xy(truth) for truth in self.graph.messages(TRUTH, since_ns)]
        return sum(map(math.dist, places, places[1:]))

    @property
    def odom(self):
        return self.graph.newest(ODOM)

    def off_m(self):
        return math.dist(xy(self.odom), xy(self.car.truth()))


def xy(odometry):
    position = odometry.pose.pose.position
    return position.x, position.y


def yaw_of(rotation):
    return 2 * math.atan2(rotation.z, rotation.w)


def wrapped(angle_rad):
    return math.remainder(angle_rad, 2 * math.pi)


@pytest.mark.once
def test_odometry_is_where_the_car_is_and_knows_how_well(car):
    driven = Driven(car, seed=1)
    distance_m = (driven.drive(CENTER, FORWARD, 1.5) + driven.drive(LEFT, FORWARD, 2.0)
                  + driven.drive(LEFT, REVERSE, 1.0))
    odom, truth = driven.odom, car.truth()
    assert (odom.header.frame_id, odom.child_frame_id) == ("odom", "base_link")
    assert odom.twist.twist.linear.x == 0
    assert driven.off_m() < 0.005 * distance_m + 0.02
    assert abs(wrapped(yaw_of(odom.pose.pose.orientation) - yaw_of(truth.pose.pose.orientation))) < 0.035
    covariance = odom.pose.covariance
    assert driven.off_m() / 3 < math.sqrt(covariance[0] + covariance[7]) < 0.1 * distance_m
    assert covariance[1] == covariance[6] and covariance[5] == covariance[30] and covariance[11] == covariance[31]
    assert [covariance[index] for index in (14, 21, 28)] == [1e6] * 3
    assert odom.twist.covariance[7] == 1e6 and 0 < odom.twist.covariance[0] < 1


def test_odometry_comes_at_its_rate_at_most_and_its_last_word_is_told(car):
    driven = Driven(car)
    since_ns = car.graph.now_ns
    driven.drive(CENTER, FORWARD, 4.0)
    moving = [stamp_ns(odom.header.stamp) for odom in car.graph.messages(ODOM, since_ns)
              if odom.twist.twist.linear.x > 1]
    assert len(moving) <= 50 * (moving[-1] - moving[0]) / NS_PER_S + 2
    assert len(car.graph.messages("/teensy_wheel", since_ns)) > 1.3 * len(car.graph.messages(ODOM, since_ns))
    assert driven.off_m() < 0.04


def test_hub_that_reads_once_in_0_8_s_publishes_odometry_at_its_rate_all_the_same(car):
    driven = Driven(car)
    driven.hold(CENTER, FORWARD)
    car.graph.run_until(lambda: car.speed_mps > 1)
    since_ns = car.graph.now_ns
    for _ in range(4):
        car.graph.nodes["/teensy_sensor_hub"].stall(0.8, frozen=True)
        car.graph.run(0.85)
    odoms = car.graph.messages(ODOM, since_ns)
    stamps = [stamp_ns(odom.header.stamp) for odom in odoms]
    assert len(car.graph.messages("/teensy_wheel", since_ns)) > 4 * 50
    assert 4 * 35 <= len(odoms) <= 50 * (stamps[-1] - stamps[0]) / NS_PER_S + 2
    assert max(after - before for before, after in zip(stamps, stamps[1:])) < NS_PER_S // 20


def test_without_a_rate_odometry_comes_with_each_report(car):
    driven = Driven(car, {"odom_rate": 0})
    since_ns = car.graph.now_ns
    driven.drive(CENTER, FORWARD, 2.0)
    assert len(car.graph.messages(ODOM, since_ns)) == len(car.graph.messages("/teensy_wheel", since_ns))


def test_transform_and_joints_agree_with_odometry(car):
    driven = Driven(car)
    since_ns = car.graph.now_ns
    driven.drive(LEFT, FORWARD, 0.5)
    odoms, joints = car.graph.messages(ODOM, since_ns), car.graph.messages("/joint_states", since_ns)
    transforms = [each for message in car.graph.messages("/tf", since_ns) for each in message.transforms]
    assert len(odoms) == len(transforms) == len(joints) > 20
    for odom, transform, joint in zip(odoms, transforms, joints):
        assert odom.header.stamp == transform.header.stamp == joint.header.stamp
        assert (transform.header.frame_id, transform.child_frame_id) == ("odom", "base_link")
        moved = transform.transform.translation
        assert (moved.x, moved.y, transform.transform.rotation) == (*xy(odom), odom.pose.pose.orientation)
        assert joint.name == ["rear_left_wheel", "rear_right_wheel"]
        assert sum(joint.velocity) / 2 * 0.0475 == pytest.approx(odom.twist.twist.linear.x, abs=0.05)
    places = list(map(xy, odoms))
    rolled_m = sum(after - before for before, after in zip(joints[0].position, joints[-1].position)) / 2 * 0.0475
    assert rolled_m == pytest.approx(sum(map(math.dist, places, places[1:])), rel=0.05)
    assert joints[-1].position[1] - joints[0].position[1] > joints[-1].position[0] - joints[0].position[0]


def test_frames_carry_their_prefix_and_tf_can_be_left_to_another(car):
    driven = Driven(car, {"frame_prefix": "car1/", "publish_tf": False, "base_frame": "base"})
    assert (driven.odom.header.frame_id, driven.odom.child_frame_id) == ("car1/odom", "car1/base")
    assert car.graph.newest("/joint_states").name == ["car1/rear_left_wheel", "car1/rear_right_wheel"]
    assert car.graph.newest("/sonar/rear_left").header.frame_id == "car1/sonar_rear_left"
    assert {each.header.frame_id for each in car.graph.newest("/tf_static").transforms} == {"car1/base"}
    assert not car.graph.publishers["/tf"]


def test_sonars_measure_metres_in_their_frames(car):
    Driven(car)
    mounts = config("sonars.yaml")["sonars"]
    frames = {each.child_frame_id: each for each in car.graph.newest("/tf_static").transforms}
    for index, name in enumerate(SONARS):
        echoes = [raw.distance for raw in car.graph.messages("/teensy_distance") if raw.sensor == index]
        ranges = car.graph.messages(f"/sonar/{name}")
        assert len(ranges) >= len(echoes) - 1 >= 3
        for echo_us, message in zip(echoes[-2:], ranges[-2:]):
            assert (message.header.frame_id, message.radiation_type) == (f"sonar_{name}", Range.ULTRASOUND)
            assert (message.min_range, message.max_range, message.field_of_view) == pytest.approx((0.02, 2.0, 0.5236))
            expected_m = (echo_us + 13) * 343.42 / 2e6  # which the firmware takes off
            assert message.range == pytest.approx(expected_m if expected_m <= 2.0 else math.inf, abs=0.001)
        frame = frames[f"sonar_{name}"]
        x_m, y_m, yaw_rad = mounts[name]
        assert frame.header.frame_id == "base_link"
        assert (frame.transform.translation.x, frame.transform.translation.y) == (x_m, y_m)
        assert wrapped(yaw_of(frame.transform.rotation) - yaw_rad) == pytest.approx(0, abs=1e-9)


@pytest.mark.once
def test_temperature_of_the_air_counts_and_one_that_cannot_be_does_not(car):
    Driven(car, start=[0, 0, 1.57])  # in front of a post
    name = next(name for name in SONARS if car.graph.newest(f"/sonar/{name}").range < 1.9)
    warm_m = car.graph.newest(f"/sonar/{name}").range
    cold_m = warm_m * (331.3 - 12.12) / (331.3 + 12.12)
    for temperature_c in (-20.0, math.nan, 100.0):  # what is no temperature changes nothing
        since_ns = car.graph.now_ns
        car.graph.publish("/temperature", Temperature(temperature=temperature_c))
        car.graph.run(10.5)
        assert car.graph.newest(f"/sonar/{name}").range == pytest.approx(cold_m, rel=0.003)
        lines = car.graph.lines("/teensy_sensor_hub", since_ns, 30)
        assert lines == [] if temperature_c == -20.0 else (
            "temperature" in lines[0] and str(temperature_c) in lines[0])


def test_stamps_are_zero_while_nobody_publishes_the_simulated_clock(car, monkeypatch):
    monkeypatch.setattr(NodeClocks, "ros_now", lambda clocks: rospy.Time())
    Driven(car)
    for topic in (ODOM, "/joint_states", "/sonar/rear_left"):
        assert {message.header.stamp for message in car.graph.messages(topic)} == {rospy.Time()}
    assert any(sync.used for sync in car.graph.messages(CLOCK))
    assert {sync.stamp for sync in car.graph.messages(CLOCK)} == {rospy.Time()}


@pytest.mark.once
def test_clock_is_known_and_its_raw_numbers_are_told_over_its_wrap_too(car):
    Driven(car, clock_drift_ppm=80, clock_start_ms=4294960000)
    car.graph.run(40)
    syncs = car.graph.messages(CLOCK)
    assert syncs[10].converged and all(sync.used for sync in syncs)
    for sync in syncs:
        assert (sync.baud, sync.sent_bytes >= 15, sync.received > sync.sent) == (115200, True, True)
        assert sync.received - sync.sent == pytest.approx(sync.round_trip * 1e9, abs=1)
        assert 0.002 < sync.round_trip < 0.02
    assert syncs[3].tick > 2 ** 32 - 8000 and syncs[-1].tick < 60_000
    assert syncs[-1].skew == pytest.approx(80, abs=20) and syncs[-1].uncertainty < 0.005
    stamp_ns = car.graph.newest(ODOM).header.stamp.to_nsec() - car.graph.ros_ahead_ns
    assert 0 <= car.graph.recorded[ODOM][-1].at_ns - stamp_ns < 0.03e9
    report = car.graph.report("teensy_sensor_hub: Teensy clock")
    assert (report.level, report.message) == (0, "the Teensy's clock is known")
    assert report.values["faster than this computer's"] == f"{syncs[-1].skew:.1f} ppm"


def test_ping_that_is_asked_for_counts_too(car):
    Driven(car)
    syncs = len(car.graph.messages(CLOCK))
    assert car.graph.call("/teensy_sensor_hub/ping", TriggerRequest()).success
    assert len(car.graph.messages(CLOCK)) == syncs + 1


def test_clock_that_nobody_answers_for_is_told(car):
    car.graph.record(ODOM)
    car.sim(corrected_checksum=True)
    car.hub(firmware_checksum="shipped")
    car.graph.run(5)
    report = car.graph.report("teensy_sensor_hub: Teensy clock")
    assert (report.level, report.message) == (1, "no ping was answered yet: times go by when reports arrive")


@pytest.mark.once
def test_records_that_make_no_sense_are_told(car):
    Driven(car)
    report = car.graph.report("teensy_sensor_hub: Teensy records")
    assert (report.level, report.message) == (0, "wheels, sonars and pongs make sense")
    assert int(report.values["accepted"]) > 20
    car.inject("bit_errors", 0.02)  # 1 of 255 gets past the checksum
    car.graph.run(25)
    levels = {(status.level, status.message.partition(" of ")[2]) for array in car.graph.messages("/diagnostics")
              for status in array.status if status.name == "teensy_sensor_hub: Teensy records"}
    assert (1, "the last second's records made no sense") in levels
