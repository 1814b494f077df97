"""What a graph carried, as a recording."""
from __future__ import annotations

import logging

import pytest
import rospy
from rosgraph_msgs.msg import Log

from graph import Graph

LEVELS = {logging.DEBUG: Log.DEBUG, logging.INFO: Log.INFO, logging.WARNING: Log.WARN, logging.ERROR: Log.ERROR,
          logging.CRITICAL: Log.FATAL}


def write_bag(graph: Graph, path, since_ns: int = 0) -> str:
    """Write the recorded topics, and the log, to a bag; return its path. A Python without rosbag skips the test."""
    rosbag = pytest.importorskip("rosbag")
    found = [(record.at_ns, topic, record.message) for topic, records in graph.recorded.items() for record in records]
    found += [(line.at_ns, "/rosout", Log(name=line.node, level=LEVELS[line.level], msg=line.text))
              for line in graph.log]
    with rosbag.Bag(str(path), "w") as bag:
        for at_ns, topic, message in sorted(found, key=lambda each: each[0]):
            stamp = rospy.Time(nsecs=at_ns + graph.ros_ahead_ns)
            if topic == "/rosout":
                message.header.stamp = stamp
            if at_ns >= since_ns:
                bag.write(topic, message, stamp)
    return str(path)
