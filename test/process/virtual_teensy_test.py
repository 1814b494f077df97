#!/usr/bin/env python3
"""The hub against the virtual Teensy: pings, commands and odometers, answered as the firmware answers."""
from __future__ import annotations

import tempfile
import unittest

import rospy
import rostest
from car_interface.msg import Distance, Error, LinkStatus, Pong, Wheel, WheelDirection
from car_interface.srv import InjectFault, SetSonarSequence, SetSonarWait
from std_msgs.msg import Int32MultiArray
from std_srvs.srv import Trigger

from waiting import Sender, Topic, eventually, start_node

PINGS = 100
STEERING, ESC = 5100, 5700  # gently forward
ESC_NEUTRAL = 4915


def outputs(esc):
    return Int32MultiArray(data=[STEERING, esc] + [-1] * 14)


class HubAgainstTheVirtualTeensy(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.pongs = Topic("/teensy_pong", Pong).connected()
        cls.wheels = Topic("/teensy_wheel", Wheel).connected()
        cls.sonars = Topic("/teensy_distance", Distance).connected()
        cls.errors = Topic("/teensy_error", Error).connected()
        cls.links = Topic("/teensy_sensor_hub/link", LinkStatus).connected()
        cls.output = Sender("/servo/output", Int32MultiArray)

    def call(self, name, service_type, *arguments):
        path = f"/teensy_sensor_hub/{name}"
        rospy.wait_for_service(path, 10)
        return rospy.ServiceProxy(path, service_type)(*arguments)

    def test_a_hundred_pings_get_a_hundred_pongs(self):
        pongs = self.pongs.wait_for_count(PINGS)
        link = self.links.wait_for(lambda status: status.pings > PINGS).what
        self.assertLessEqual(link.pings - link.pongs, 1)  # the newest may be on its way
        self.assertEqual(link.bad_frames + link.malformed_frames, 0)
        self.assertEqual(link.firmware_checksum, "shipped")
        self.assertLess(link.round_trip, 0.5)
        stamps = [pong.timestamp1 for pong in pongs]
        self.assertEqual(len(set(stamps)), len(stamps))

    def test_timestamp1_is_ros_time_in_milliseconds_modulo_two_to_the_32(self):
        newest = self.pongs.wait_for(lambda pong: True, self.pongs.mark()).what
        now_ms = rospy.Time.now().to_nsec() // 1_000_000 % 2 ** 32
        self.assertLess((now_ms - newest.timestamp1) % 2 ** 32, 5000)

    def test_ping_service_tells_the_round_trip(self):
        answer = self.call("ping", Trigger)
        self.assertTrue(answer.success, answer.message)
        self.assertRegex(answer.message, r"pong after \d+\.\d ms")

    def test_sonar_sequence_decides_who_fires(self):
        self.assertTrue(self.call("set_sonar_sequence", SetSonarSequence, [0, 1, 5]).success)
        self.addCleanup(self.call, "set_sonar_sequence", SetSonarSequence, [0, 1, 2, 3, 4, 5])

        def newest_are_of_the_sequence():
            newest = [report.sensor for report in self.sonars.since()[-9:]]
            return len(newest) == 9 and set(newest) == {0, 1, 5}
        eventually(newest_are_of_the_sequence, "only sonars 0, 1 and 5")

    def test_sonar_stop_and_start(self):
        self.assertTrue(self.call("sonar_stop", Trigger).success)
        self.wheels.wait_for_count(2, self.wheels.mark())  # whatever was under way has arrived
        mark = self.sonars.mark()
        self.wheels.wait_for_count(5, self.wheels.mark())  # at least every 0.2 s: twenty sonar reports' time
        self.assertLessEqual(len(self.sonars.since(mark)), 1)
        self.assertTrue(self.call("sonar_start", Trigger).success)
        self.sonars.wait_for_count(6, self.sonars.mark())

    def inject(self, fault, value):
        rospy.wait_for_service("/car_sim/inject_fault", 10)
        return rospy.ServiceProxy("/car_sim/inject_fault", InjectFault)(fault, value)

    def newest_sensors(self):
        return {report.sensor for report in self.sonars.since()[-12:]}

    def test_sonar_that_is_missing_is_skipped_until_it_is_fine_again(self):
        eventually(lambda: self.newest_sensors() == set(range(6)), "reports of all six sonars")
        self.assertTrue(self.inject("sonar_missing", 3).success)
        self.addCleanup(self.inject, "sonar_fine", 3)
        eventually(lambda: self.newest_sensors() == {0, 1, 2, 4, 5}, "none of the sonar that isn't there")
        self.assertTrue(self.inject("sonar_fine", 3).success)
        eventually(lambda: self.newest_sensors() == set(range(6)), "reports of all six sonars again")

    def test_sonar_that_does_not_exist_cannot_be_made_to_fail(self):
        answer = self.inject("sonar_stuck", 6)
        self.assertFalse(answer.success)
        self.assertIn("accepted: a sensor from 0 to 5", answer.message)

    def test_sonar_wait_slows_the_sonars_down(self):
        self.assertTrue(self.call("set_sonar_wait", SetSonarWait, 400).success)
        self.addCleanup(self.call, "set_sonar_wait", SetSonarWait, 50)

        def newest_are_400_ms_apart():
            newest = self.sonars.since()[-3:]
            return len(newest) == 3 and all(b.when - a.when >= 400 for a, b in zip(newest, newest[1:]))
        eventually(newest_are_400_ms_apart, "sonar reports 400 ms apart")

    def test_wheel_reset_zeroes_both_odometers(self):
        self.output.publish(outputs(ESC))
        self.wheels.wait_for(lambda wheel: wheel.left.dist_abs > 20 and wheel.right.dist_abs > 20)
        self.output.publish(outputs(ESC_NEUTRAL))
        rolling = self.wheels.wait_for(lambda wheel: wheel.left.speed == 0 and wheel.right.speed == 0,
                                       self.wheels.mark()).what
        self.assertEqual(rolling.left.direction, WheelDirection.FORWARD)
        self.assertTrue(self.call("wheel_reset", Trigger).success)
        reset = self.wheels.wait_for(lambda wheel: wheel.left.dist_abs == 0, self.wheels.mark()).what
        self.assertEqual((reset.right.dist_abs, reset.left.dist, reset.right.dist), (0, 0, 0))
        self.assertEqual((reset.left.direction, reset.right.direction), (WheelDirection.NONE, WheelDirection.NONE))

    def test_counters_come_once_a_second_at_most(self):
        eventually(lambda: self.call("get_counters", Trigger).success, "a request that isn't too early")
        self.errors.wait_for(lambda error: error.name == "rxPackets" and error.count > 0)
        refused = self.call("get_counters", Trigger)
        self.assertFalse(refused.success)
        self.assertIn("less than a second", refused.message)


class HubWhoseSonarsFail(unittest.TestCase):
    def test_stuck_sonar_that_silences_all_others_is_named_and_left_out_and_they_report_again(self):
        """A Teensy that has run for long waits for such a sonar for ever."""
        with tempfile.TemporaryDirectory() as folder:
            port = f"_port:={folder}/teensy"
            start_node(self, "car_sim", "__ns:=stuck", port, "_clock_start_ms:=200000")
            start_node(self, "teensy_sensor_hub", "__ns:=stuck", port, "_publish_tf:=false")
            links = Topic("/stuck/teensy_sensor_hub/link", LinkStatus).connected()
            sonars = Topic("/stuck/teensy_distance", Distance).connected()
            eventually(lambda: {report.sensor for report in sonars.since()[-12:]} == set(range(6)), "all six sonars")
            rospy.wait_for_service("/stuck/car_sim/inject_fault", 10)
            self.assertTrue(rospy.ServiceProxy("/stuck/car_sim/inject_fault", InjectFault)("sonar_stuck", 2).success)
            named = links.wait_for(lambda status: "front_left" in status.words, within_s=10).what
            self.assertEqual((named.state, named.level), ("sonar fault", LinkStatus.WARN))
            self.assertIn("Check its echo wire", named.next_step)
            dropped = links.wait_for(lambda status: status.dropped_sonars, within_s=20).what
            self.assertEqual(list(dropped.dropped_sonars), [2])
            self.assertGreaterEqual(dropped.sonar_starts, 1)
            mark = sonars.mark()
            others = {report.sensor for report in sonars.wait_for_count(15, mark)}
            self.assertEqual(others, {0, 1, 3, 4, 5})

    def test_first_sonar_that_is_missing_at_power_up_costs_only_itself(self):
        with tempfile.TemporaryDirectory() as folder:
            port = f"_port:={folder}/teensy"
            start_node(self, "car_sim", "__ns:=missing", port)
            start_node(self, "teensy_sensor_hub", "__ns:=missing", port, "_publish_tf:=false")
            links = Topic("/missing/teensy_sensor_hub/link", LinkStatus).connected()
            sonars = Topic("/missing/teensy_distance", Distance).connected()
            sonars.wait_for_count(6)
            rospy.wait_for_service("/missing/car_sim/inject_fault", 10)
            inject = rospy.ServiceProxy("/missing/car_sim/inject_fault", InjectFault)
            self.assertTrue(inject("sonar_missing", 0).success)
            self.assertTrue(inject("reboot", 0).success)
            links.wait_for(lambda status: status.sonar_starts == 1, within_s=10)
            links.wait_for(lambda status: "front_right does not report" in status.words, within_s=10)
            self.assertEqual({report.sensor for report in sonars.wait_for_count(15, sonars.mark())}, {1, 2, 3, 4, 5})


class HubAgainstARepairedTeensy(unittest.TestCase):
    def test_auto_changes_to_the_corrected_checksum_and_the_clock_may_wrap(self):
        links = Topic("/repaired/teensy_sensor_hub/link", LinkStatus)
        pongs = Topic("/repaired/teensy_pong", Pong)
        link = links.wait_for(
            lambda status: status.pongs > 2 and status.firmware_checksum == "corrected", within_s=40).what
        self.assertTrue(link.open)
        pongs.wait_for(lambda pong: pong.timestamp2 < 1_000_000)
        self.assertEqual(link.bad_frames + link.malformed_frames, 0)


if __name__ == "__main__":
    rospy.init_node("virtual_teensy_test")
    rostest.rosrun("car_interface", "virtual_teensy_test", "__main__")
