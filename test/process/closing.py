"""What tests of several processes share: what they make ends with them; asking nodes and the master."""
import os
import re
import shutil
import tempfile
import time
import unittest
from typing import ClassVar
from xmlrpc.client import ServerProxy

import rosgraph
import rospy
from sensor_msgs.msg import Joy

from waiting import NodeProcess, Repeater, Sender, Topic, eventually

LAUNCH_S = 60
TABLE = os.environ.get("CAR_INTERFACE_TABLE")
# Holds a port, and reads from it.
HOLDER = """
import fcntl, os, sys
port = os.open(sys.argv[1], os.O_RDWR | os.O_NOCTTY)
fcntl.flock(port, fcntl.LOCK_EX)
print("open", flush=True)
while True: os.read(port, 1)
"""
PARTS = ("turn_arb", "pca9685", "teensy_sensor_hub", "generic_value_converter", "throttle_arb")


def ask(node, method, *arguments):
    """What a node answers; ``None`` without the node."""
    try:
        return getattr(ServerProxy(rosgraph.Master("/test").lookupNode(node)), method)("/test", *arguments)[2]
    except (rosgraph.MasterException, OSError):
        return None


def pid_of(node):
    return ask(node, "getPid")


def graph_of(namespace, nodes):
    """What nodes have on the ROS graph: topics that they publish and hear, and services; without the namespace."""
    paths = {f"{namespace}/{node}" for node in nodes}
    found = []
    for names in rospy.get_master().getSystemState()[2]:
        ours = {name for name, users in names if paths & set(users)}
        found.append({name[len(namespace):] if name.startswith(f"{namespace}/") else name for name in ours
                      if not re.search("/rosout$|/get_loggers$|/set_logger_level$", name)})
    return found


def joy(held):
    """The stick to the left with the manual deadman, or all let go."""
    return Joy(axes=[float(held)] + [0.0] * 7, buttons=[int(held and index == 4) for index in range(11)])


def output_of(process):
    return process.stdout.since() + process.stderr.since()


class Measured(unittest.TestCase):
    """Prints rows of measured times, and appends them to the file that $CAR_INTERFACE_TABLE names."""

    rows: ClassVar[list] = []

    @classmethod
    def tearDownClass(cls):
        if TABLE and cls.rows:
            with open(TABLE, "a", encoding="utf-8") as file:
                file.write("\n".join(cls.rows) + "\n")
            cls.rows.clear()

    def add_row(self, row):
        print(row, flush=True)
        self.rows.append(row)


class Closing(unittest.TestCase):
    """What a test makes ends with it."""

    def setUp(self):
        self.folder = tempfile.mkdtemp()
        self.addCleanup(shutil.rmtree, self.folder, ignore_errors=True)
        self.repeater = Repeater(0.02)

    def tearDown(self):
        self.repeater.end()  # before its senders are closed

    def topic(self, name, message_type):
        topic = Topic(name, message_type)
        self.addCleanup(topic.close)
        return topic

    def sender(self, name, message_type):
        sender = Sender(name, message_type)
        self.addCleanup(sender.close)
        return sender

    def launch(self, *arguments, env=None):
        process = NodeProcess("roslaunch", "car_interface", *arguments, env=env)
        self.addCleanup(lambda: process.runs() and process.end())  # with its nodes
        return process

    def wait_s(self, seconds):
        began_s = time.monotonic()
        eventually(lambda: time.monotonic() - began_s > seconds, f"{seconds} s")
