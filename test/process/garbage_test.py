#!/usr/bin/env python3
"""No garbage is collected between a message and its command, and none stays for ever."""
from __future__ import annotations

import os
import sys
import tempfile
import time
import unittest
from typing import NamedTuple

import rospy
import rostest
from car_interface.msg import Control, Float64Stamped, SteeringState
from nav_msgs.msg import Odometry
from std_msgs.msg import Bool, Float32, Int32MultiArray, String

from virtual_car import HERE, PACKAGE
from waiting import Repeater, Sender, config, eventually, one_process_params, set_params, start

WATCHER = os.path.join(HERE, "garbage_watcher.py")
COLLECTIONS = 10  # one a second
SETTLED = 4  # collections after which connections are made
MAX_GROWTH = 200  # objects in the seconds after that
MAX_MS = 10  # of the shortest: one with all modules' objects takes more; a busy machine may delay any one of them


class Collection(NamedTuple):
    """A line of the watcher."""

    in_step: bool
    took_ms: float
    objects: int

    @classmethod
    def of(cls, line):
        _, where, took_ms, objects = line.split()
        return cls(where == "step", float(took_ms), int(objects))


class Garbage(unittest.TestCase):
    def setUp(self):
        self.repeater = Repeater(0.01)
        self.addCleanup(self.repeater.end)

    def watch(self, node, inputs):
        """A node's collections while its inputs arrive at 100 Hz and the deadman changes ten times a second."""
        process = start(self, sys.executable, WATCHER, node)
        senders = {}
        for topic, message in inputs.items():
            senders[topic] = Sender(topic, type(message))
            self.addCleanup(senders[topic].close)
            self.repeater.hold(senders[topic], message)
        human = Sender("/teleop_logi/human_in_loop", Bool) if "_arb" in node or "car_nodes" in node else None

        def collected():
            if human is not None:
                human.publish(Bool(int(10 * time.monotonic()) % 2 == 0))
            return len([line for line in process.stdout.since() if line.startswith("collection")]) >= COLLECTIONS
        eventually(collected, f"{COLLECTIONS} collections of {node}", 4 * COLLECTIONS)
        self.assertEqual(process.end(), 0)
        return [Collection.of(line) for line in process.stdout.since() if line.startswith("collection")]

    def check(self, node, inputs):
        """They are made between steps, are short, and leave nothing."""
        collections = self.watch(node, inputs)
        print(f"{node}: shortest {min(each.took_ms for each in collections):.2f} ms, longest "
              f"{max(each.took_ms for each in collections):.2f} ms, {collections[-1].objects} objects", flush=True)
        self.assertEqual([each for each in collections if each.in_step], [])
        self.assertLess(min(each.took_ms for each in collections), MAX_MS)
        objects = [each.objects for each in collections[SETTLED:COLLECTIONS]]
        self.assertLess(objects[-1] - objects[0], MAX_GROWTH, objects)

    def test_turn_arb(self):
        set_params(self, "/turn_arb", config("turn_arb.yaml"))
        self.check("turn_arb:TurnArb", {"/teleop_logi/tele_steer_req": Float32(0.5), "/av_turnrad_req": Float32(2.0)})

    def test_pca9685(self):
        set_params(self, "/pca9685", {"device": "virtual"})
        self.check("pca9685:Pca9685", {"/servo/cmdVector": Int32MultiArray(data=[5000] * 16)})

    def test_generic_value_converter(self):
        set_params(self, "/generic_value_converter", {**config("generic_value_converter.yaml"),
                                                      "csv_path_value_map": f"{PACKAGE}/config/value_map.csv"})
        name = "/generic_value_converter/input"
        self.check("generic_value_converter:GenericValueConverter", {
            f"{name}/control_cmd": Control(), f"{name}/odometry": Odometry()})

    def test_throttle_arb(self):
        set_params(self, "/throttle_arb", config("throttle.yaml"))
        name = "/throttle_arb/input"
        self.check("throttle_arb:ThrottleArb", {
            f"{name}/value": Float64Stamped(data=1.0), f"{name}/odometry": Odometry(),
            "/teleop_logi/tele_throt_req": Float32(0.5), "/teleop_logi/mode": String("manual"),
            "/servo/output": Int32MultiArray(data=[4912] * 16),
            "/turn_arb/state": SteeringState(source=SteeringState.TELEOP)})

    def test_car_nodes_collects_between_the_steps_of_all_its_nodes(self):
        absent = os.path.join(tempfile.gettempdir(), "absent")
        for node, values in {**one_process_params(absent), "car_nodes": {"throttle": True}}.items():
            set_params(self, f"/{node}", values)
        name = "/generic_value_converter/input"
        self.check("car_nodes:CarNodes", {
            "/teleop_logi/tele_steer_req": Float32(0.5), "/av_turnrad_req": Float32(2.0),
            f"{name}/control_cmd": Control(), f"{name}/odometry": Odometry()})

    def test_teensy_sensor_hub_without_its_teensy(self):
        set_params(self, "/teensy_sensor_hub", {**config("teensy_sensor_hub.yaml", "sonars.yaml"),
                                                "port": os.path.join(tempfile.gettempdir(), "absent")})
        process = start(self, sys.executable, WATCHER, "teensy_sensor_hub:TeensySensorHub")
        eventually(lambda: sum(line.startswith("collection") for line in process.stdout.since()) >= 3, "collections")
        self.assertFalse([line for line in process.stdout.since() if "collection step" in line])


if __name__ == "__main__":
    rospy.init_node("garbage_test")
    rostest.rosrun("car_interface", "garbage_test", "__main__")
