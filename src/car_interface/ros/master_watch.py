"""Watches the ROS master. Without it connected topics keep working, but no node can join."""
from __future__ import annotations

import threading
import time
import xmlrpc.client
from typing import Callable

import rosgraph
import rospy

from car_interface.ros.inbox import Inbox
from car_interface.ros.xmlrpc_calls import TimeoutTransport

POLL_S = 2.0
GONE = ("the ROS master is gone: what is connected goes on, but no node that starts now can join, and one that ends is "
        "not replaced. Stop the car, then start the launch file again")
ANOTHER = ("there is another ROS master now, which doesn't know these nodes. Stop the car, then start the launch file "
           "again")


class MasterWatch:
    """Asks the master for its process id every 2 s, in a separate thread, as a dead one blocks its callers.

    Args:
        inbox: the node's.
        handler: called in the node's thread with a line about the fault, or an empty one while there is none.
    """

    def __init__(self, inbox: Inbox, handler: Callable[[str, int], None]):
        self._inbox = inbox
        self._handler = handler
        self._master = xmlrpc.client.ServerProxy(rosgraph.get_master_uri(), transport=TimeoutTransport())
        self._pid = None
        threading.Thread(target=self._watch, name="master watch", daemon=True).start()

    def _watch(self):
        while not (rospy.is_shutdown() or self._inbox.ending):
            self._inbox.put(self._handler, self._fault())
            time.sleep(POLL_S)

    def _fault(self):
        try:
            pid = self._master.getPid(rospy.get_name())[2]
        except Exception:  # no usable answer, for whatever reason
            return GONE
        self._pid = self._pid or pid
        return "" if pid == self._pid else ANOTHER
