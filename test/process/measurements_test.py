#!/usr/bin/env python3
"""What teensy_sensor_hub makes of a virtual car's pulses, echoes and ticks, held against where the car really was."""
from __future__ import annotations

import math
import tempfile
import time
import unittest

import rospkg
import rospy
import rostest
import yaml
from car_interface.msg import Distance, SteeringState, TeensyClock, Wheel
from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Odometry
from rosgraph_msgs.msg import Log
from sensor_msgs.msg import JointState, Range, Temperature
from std_msgs.msg import Int32MultiArray
from std_srvs.srv import Trigger
from tf2_msgs.msg import TFMessage

from car_interface.common.errors import ConfigError
from car_interface.common.params import Params
from car_interface.ros.measurement_publisher import read_settings
from car_interface.teensy.link.pinging import Answer
from car_interface.teensy.link.protocol import Pong
from car_interface.teensy.sensing.measurements import Measurements
from waiting import Repeater, Sender, Topic, eventually, set_params, start_node

SONARS = ("front_right", "front_middle", "front_left", "rear_right", "rear_middle", "rear_left")
CENTER, LEFT, NEUTRAL, FORWARD, REVERSE = 5100, 3835, 4915, 5160, 4700
WHEEL_RADIUS_M = 0.095 / 2


def yaw_of(pose):
    return 2 * math.atan2(pose.orientation.z, pose.orientation.w)


class MeasurementsTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.output = Sender("/servo/output", Int32MultiArray)
        cls.truth = Topic("/car_sim/truth", Odometry).connected()
        cls.odom = Topic("/odom", Odometry).connected()
        cls.tf = Topic("/tf", TFMessage).connected()
        cls.static = Topic("/tf_static", TFMessage).connected()
        cls.joints = Topic("/joint_states", JointState).connected()
        cls.clock = Topic("/teensy_clock", TeensyClock).connected()
        cls.raw = Topic("/teensy_distance", Distance).connected()
        cls.ranges = {name: Topic(f"/sonar/{name}", Range).connected() for name in SONARS}
        cls.diagnostics = Topic("/diagnostics", DiagnosticArray).connected()

    def setUp(self):
        self.addCleanup(self.stop)

    def hold(self, steering, esc):
        self.output.publish(Int32MultiArray(data=[steering, esc] + 14 * [-1]))

    def stop(self):
        """The brake, until it stands."""
        self.hold(CENTER, NEUTRAL)
        self.truth.wait_for(lambda truth: truth.twist.twist.linear.x == 0.0, self.truth.mark())

    def drive(self, steering, esc, distance_m):
        """Go so far, then stand still; how far that was in all."""
        mark = self.truth.mark()
        start = self.truth.wait_for(lambda _: True, mark).what.pose.pose.position
        self.hold(steering, esc)
        self.truth.wait_for(lambda truth: math.hypot(
            truth.pose.pose.position.x - start.x, truth.pose.pose.position.y - start.y) > distance_m, mark)
        self.stop()
        positions = [truth.pose.pose.position for truth in self.truth.since(mark)]
        return sum(math.hypot(b.x - a.x, b.y - a.y) for a, b in zip(positions, positions[1:]))

    def status(self, name, since=0):
        """The newest status of that name."""
        suffix = f": {name}"
        heard = self.diagnostics.wait_for(
            lambda array: any(status.name.endswith(suffix) for status in array.status), since).what
        return next(status for status in heard.status if status.name.endswith(suffix))

    def at_rest(self):
        """Odometry and truth, both of a car that stands."""
        eventually(lambda: self.odom.since(-1)[-1].twist.twist.linear.x == 0.0, "odometry to see that it stands")
        return self.odom.since(-1)[-1], self.truth.since(-1)[-1]

    def test_odometry_is_where_the_car_is(self):
        distance_m = self.drive(CENTER, FORWARD, 1.5)
        distance_m += self.drive(LEFT, FORWARD, 3.0)
        distance_m += self.drive(LEFT, REVERSE, 1.0)
        odom, truth = self.at_rest()
        self.assertEqual((odom.header.frame_id, odom.child_frame_id), ("odom", "base_link"))
        seen, real = odom.pose.pose.position, truth.pose.pose.position
        self.assertLess(math.hypot(seen.x - real.x, seen.y - real.y), 0.01 * distance_m + 0.02)
        self.assertLess(abs(math.remainder(yaw_of(odom.pose.pose) - yaw_of(truth.pose.pose), 2 * math.pi)), 0.035)
        sigma_m = math.sqrt(odom.pose.covariance[0] + odom.pose.covariance[7])
        self.assertGreater(sigma_m, 0)
        self.assertLess(sigma_m, 0.1 * distance_m)

    def test_pose_belongs_to_its_stamp(self):
        mark = self.odom.mark()
        truth_mark = self.truth.mark()
        offset = self.offset()
        self.drive(CENTER, FORWARD, 3.0)
        truths = [(truth.header.stamp.to_sec(), truth.pose.pose.position) for truth in self.truth.since(truth_mark)]
        odoms = [odom for odom in self.odom.since(mark) if odom.twist.twist.linear.x > 0.5]
        self.assertGreater(len(odoms), 50)
        stamps = [odom.header.stamp.to_sec() for odom in odoms]
        self.assertEqual(stamps, sorted(stamps))
        errors_m = []
        for odom in odoms:
            at_s, position = odom.header.stamp.to_sec(), odom.pose.pose.position
            before = max((truth for truth in truths if truth[0] <= at_s), key=lambda truth: truth[0], default=None)
            after = min((truth for truth in truths if truth[0] > at_s), key=lambda truth: truth[0], default=None)
            if before is None or after is None:
                continue
            share = (at_s - before[0]) / (after[0] - before[0])
            x = before[1].x + share * (after[1].x - before[1].x)
            y = before[1].y + share * (after[1].y - before[1].y)
            errors_m.append(math.hypot(position.x - offset[0] - x, position.y - offset[1] - y))
        errors_m.sort()
        self.assertLess(errors_m[len(errors_m) // 2], 0.03)

    def test_odometry_comes_at_its_rate_at_most_and_its_last_word_is_told(self):
        wheels = Topic("/teensy_wheel", Wheel).connected()
        wheels_mark, mark = wheels.mark(), self.odom.mark()
        begun_s = time.monotonic()
        self.drive(CENTER, FORWARD, 4.0)
        odoms, reports = len(self.odom.since(mark)), len(wheels.since(wheels_mark))
        self.assertLess(odoms, 50 * (time.monotonic() - begun_s) + 5)
        self.assertGreater(reports, 1.3 * odoms)
        odom, truth = self.at_rest()
        self.assertLess(abs(odom.pose.pose.position.x - truth.pose.pose.position.x), 0.1)

    def test_without_a_rate_odometry_comes_with_each_report(self):
        with tempfile.TemporaryDirectory() as folder:
            port = f"_port:={folder}/teensy"
            start_node(self, "car_sim", "__ns:=each", port, "_collisions:=false")
            start_node(self, "teensy_sensor_hub", "__ns:=each", port, "_publish_tf:=false", "_odom_rate:=0")
            wheels, odom = Topic("/each/teensy_wheel", Wheel).connected(), Topic("/each/odom", Odometry).connected()
            clock = Topic("/each/teensy_clock", TeensyClock).connected()
            clock.wait_for(lambda sync: sync.used)  # before the first tick there is no odometry
            wheels_mark, mark = wheels.mark(), odom.mark()
            self.drive(CENTER, FORWARD, 2.0)
            self.assertGreater(len(odom.since(mark)), 0.9 * len(wheels.since(wheels_mark)))

    def offset(self):
        """What odometry and truth differ by already."""
        odom, truth = self.at_rest()
        return (odom.pose.pose.position.x - truth.pose.pose.position.x,
                odom.pose.pose.position.y - truth.pose.pose.position.y)

    def test_transform_and_joints_agree_with_odometry(self):
        mark, tf_mark, joint_mark = self.odom.mark(), self.tf.mark(), self.joints.mark()
        self.drive(CENTER, FORWARD, 0.5)
        odoms = {odom.header.stamp: odom.pose.pose.position for odom in self.odom.since(mark)}
        transforms = [transform for message in self.tf.since(tf_mark) for transform in message.transforms
                      if transform.header.stamp in odoms]
        self.assertGreater(len(transforms), 20)
        for transform in transforms:
            self.assertEqual((transform.header.frame_id, transform.child_frame_id), ("odom", "base_link"))
            self.assertEqual(transform.transform.translation.x, odoms[transform.header.stamp].x)
        first, last = self.joints.since(joint_mark)[0], self.joints.since(joint_mark)[-1]
        self.assertEqual(list(first.name), ["rear_left_wheel", "rear_right_wheel"])
        stamps = sorted(odoms)
        moved_m = odoms[stamps[-1]].x - odoms[stamps[0]].x, odoms[stamps[-1]].y - odoms[stamps[0]].y
        for before, after in zip(first.position, last.position):
            self.assertAlmostEqual((after - before) * WHEEL_RADIUS_M, math.hypot(*moved_m), delta=0.06)

    def test_sonars_measure_metres_in_their_frames(self):
        with open(f"{rospkg.RosPack().get_path('car_interface')}/config/sonars.yaml", encoding="utf-8") as file:
            mounts = yaml.safe_load(file)["sonars"]
        frames = {transform.child_frame_id: transform for message in self.static.since()
                  for transform in message.transforms}
        mark = self.raw.mark()
        marks = {name: topic.mark() for name, topic in self.ranges.items()}
        for index, name in enumerate(SONARS):
            echo = self.raw.wait_for(lambda raw, index=index: raw.sensor == index, mark).what.distance
            message = self.ranges[name].wait_for(lambda _: True, marks[name]).what
            self.assertEqual(message.header.frame_id, f"sonar_{name}")
            self.assertEqual((message.radiation_type, round(message.max_range, 3)), (Range.ULTRASOUND, 2.0))
            expected = (echo + 13) * 343.42 / 2e6  # which the firmware takes off
            if expected <= 2.0:
                self.assertAlmostEqual(message.range, expected, delta=0.01)
            else:
                self.assertEqual(message.range, math.inf)
            frame = frames[f"sonar_{name}"]
            self.assertEqual(frame.header.frame_id, "base_link")
            x_m, y_m, yaw_rad = mounts[name]
            self.assertAlmostEqual(frame.transform.translation.x, x_m)
            self.assertAlmostEqual(frame.transform.translation.y, y_m)
            self.assertAlmostEqual(math.remainder(
                2 * math.atan2(frame.transform.rotation.z, frame.transform.rotation.w) - yaw_rad, 2 * math.pi), 0.0)

    def test_temperature_of_the_air_counts_and_one_that_cannot_be_does_not(self):
        """On a car of its own, which stands in front of a post."""
        log = Topic("/rosout", Log).connected()
        with tempfile.TemporaryDirectory() as folder:
            port = f"_port:={folder}/teensy"
            start_node(self, "car_sim", "__ns:=other", port, "_start:=[0, 0, 1.57]")
            start_node(self, "teensy_sensor_hub", "__ns:=other", port, "_publish_tf:=false")
            ranges = {name: Topic(f"/other/sonar/{name}", Range) for name in SONARS}
            sender = Sender("/other/temperature", Temperature)
            seen = eventually(lambda: [topic for topic in ranges.values() if any(
                message.range < 1.9 for message in topic.since())], "a sonar that sees something")[0]
            warm_m = seen.since()[0].range
            sender.publish(Temperature(temperature=-20.0))
            cold = (331.3 - 12.12) / (331.3 + 12.12)
            seen.wait_for(lambda message: abs(message.range / warm_m - cold) < 0.005)
            sender.publish(Temperature(temperature=math.nan))
            log.wait_for(lambda entry: "temperature" in entry.msg and "nan" in entry.msg)

    def test_stamps_are_zero_while_nobody_publishes_the_simulated_clock(self):
        set_params(self, "/", {"use_sim_time": True})
        with tempfile.TemporaryDirectory() as folder:
            port = f"_port:={folder}/teensy"
            start_node(self, "car_sim", "__ns:=timeless", port)
            hub = start_node(self, "teensy_sensor_hub", "__ns:=timeless", port, "_publish_tf:=false")
            for name, kind in (("odom", Odometry), ("joint_states", JointState), ("sonar/rear_left", Range)):
                message = Topic(f"/timeless/{name}", kind).wait_for(lambda _: True).what
                self.assertEqual(message.header.stamp, rospy.Time(0))
            sync = Topic("/timeless/teensy_clock", TeensyClock).wait_for(lambda sync: sync.used).what
            self.assertEqual(sync.stamp, rospy.Time(0))
            self.assertTrue(hub.runs())

    def test_clock_is_known_and_its_raw_numbers_are_told(self):
        sync = self.clock.wait_for(lambda sync: sync.converged and sync.used).what
        self.assertEqual(sync.baud, 115200)
        self.assertGreaterEqual(sync.sent_bytes, 15)
        self.assertLess(sync.sent, sync.received)
        self.assertLess(abs(sync.received - sync.sent - sync.round_trip * 1e9), 1e3)
        sync = self.clock.wait_for(lambda sync: abs(sync.skew - 80) < 40 and sync.uncertainty < 0.01).what
        # Over the wrap, too, times stay what they are: stamps near now.
        wrapped = self.clock.wait_for(lambda sync: sync.tick < 4294960000 and sync.converged).what
        self.assertLess(wrapped.uncertainty, 0.02)
        age_s = (rospy.Time.now() - self.odom.wait_for(lambda _: True, self.odom.mark()).what.header.stamp).to_sec()
        self.assertLess(abs(age_s), 1.0)

    def test_ping_that_is_asked_for_counts_too(self):
        mark = self.clock.mark()
        self.assertTrue(rospy.ServiceProxy("/teensy_sensor_hub/ping", Trigger)().success)
        self.clock.wait_for(lambda _: True, mark)

    def test_car_that_turns_against_its_steering_is_told(self):
        inputs = Repeater()
        self.addCleanup(inputs.end)
        state = Sender("/turn_arb/state", SteeringState)
        self.addCleanup(state.close)
        inputs.hold(state, SteeringState(turn_radius=-1.5))  # to the right
        self.hold(LEFT, FORWARD)
        self.diagnostics.wait_for(lambda array: any(
            status.name.endswith("steering by the wheels") and "steering calibration?" in status.message
            for status in array.status), self.diagnostics.mark())

    def test_diagnostics_tell_clock_and_records(self):
        self.clock.wait_for(lambda sync: sync.converged)
        mark = self.diagnostics.mark()
        self.assertIn("known", self.status("Teensy clock", mark).message)
        self.assertEqual(self.status("Teensy records", mark).level, 0)


class PingPeriod(unittest.TestCase):
    """With the sonars stopped pongs are all that tells the Teensy's ticks."""

    def used(self, period_s, pongs):
        """How many of so many pongs are used, of which every third is lost."""
        measurements = Measurements(read_settings(Params({"ping_period": period_s}), 115200).config)
        syncs = []
        for index in range(pongs):
            sent_ns = round(index * period_s * 1e9)
            if index % 3 != 2:
                received_ns = sent_ns + 4_000_000
                syncs.append(measurements.pong(Pong(index, 5000 + received_ns // 1_000_000),
                                               Answer(sent_ns, 4_000_000, 15), received_ns))
        return sum(sync is not None and sync.used for sync in syncs)

    def test_every_pong_counts_whatever_the_period(self):
        periods_s = (0.01, 1.0, 1.5, 3.0, 60, 3600)
        self.assertEqual({period_s: self.used(period_s, 30) for period_s in periods_s}, dict.fromkeys(periods_s, 20))


class BadParameters(unittest.TestCase):
    def test_size_and_rate_that_cannot_be_are_refused_by_name(self):
        for name, value, accepted in (
                ("odom_rate", "1e-310", "0, or a number from 0.1 to 1000"), ("odom_rate", 0.05, "0, or a number"),
                ("odom_rate", -1, "a number from 0.0 to 1000"), ("track", "1e-300", "a number from 0.001 to 10"),
                ("wheelbase", 1e-9, "a number from 0.001"), ("wheel_diameter", 0.0009, "a number from 0.001")):
            pattern = f"^{name} is .*; accepted: {accepted}"
            with self.subTest(name, value=value), self.assertRaisesRegex(ConfigError, pattern):
                read_settings(Params({name: value}), 115200)

    def test_slowest_rate_and_smallest_car_are_taken(self):
        least = {"odom_rate": 0.1, "track": 0.001, "wheelbase": 0.001, "wheel_diameter": 0.001}
        settings = read_settings(Params(least), 115200)
        self.assertEqual((settings.odom_rate_hz, settings.config.odometry.track_m), (0.1, 0.001))

    def test_bad_parameter_ends_the_node_with_one_line(self):
        for number, (parameter, named) in enumerate((
                ("sonars/front_left:=[1, 2]", "sonars/front_left"), ("track:=0", "track"), ("no_echo:=nan", "no_echo"),
                ("temperature:=99", "temperature"), ("min_range:=3", "max_range"), ("odom_rate:=1e-310", "odom_rate"),
                ("pulses_per_revolution:=0", "pulses_per_revolution"))):
            with self.subTest(parameter):
                process = start_node(self, "teensy_sensor_hub", f"_{parameter}", name=f"bad_hub_{number}")
                self.assertEqual(process.wait_for_exit(), 1)
                line, = [line for line in process.stderr.since() if line.strip()]
                self.assertIn(f"{named} is ", line)


if __name__ == "__main__":
    rospy.init_node("measurements_test")
    rostest.rosrun("car_interface", "measurements_test", "__main__")
