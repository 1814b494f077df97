"""Starts a node whose parameters may be refused.

Started by hand, such a node ends with exit code 1 and one line. Under roslaunch's respawn that would repeat for ever,
every 2.5 s. There it stays registered, says on /diagnostics what it refuses, and reads its parameters again.

roslaunch doesn't tell a node that it is respawned. So the launch files of this package set RESPAWN_VARIABLE wherever
they have respawn="true".
"""
from __future__ import annotations

import os
from typing import Any, Callable

import rospy

from car_interface.common import causes
from car_interface.common.errors import ConfigError
from car_interface.common.refusal import RefusedParameters
from car_interface.ros.diagnostics import ERROR, OK, Diagnostics
from car_interface.ros.inbox import Inbox

RESPAWN_VARIABLE = "CAR_INTERFACE_RESPAWN"
REPORT = "parameters"


def build_node(build: Callable[[], Any], inbox: Inbox) -> Any:
    """Build a node; under respawn as soon as its parameters are accepted. ``None``: it was ended before.

    Args:
        build: reads the parameters and builds the node. It has touched nothing else when it raises a ConfigError.

    Raises:
        ConfigError: a parameter is refused, and nobody would start the node again.
    """
    refused = None
    while not inbox.ending:
        try:
            node = build()
        except ConfigError as error:
            if not is_respawned():
                raise
            refused = refused or _RefusedStart(inbox)
            refused.wait(error)
        except OSError:
            if refused is None:
                raise
            refused.wait(refused.error)  # the master, which has the parameters, is gone
        else:
            if refused is not None:
                refused.report_acceptance()
            return node
    return None


def is_respawned() -> bool:
    """Whether whoever started this process starts it again when it ends."""
    return os.environ.get(RESPAWN_VARIABLE, "").lower() in ("1", "true")


class _RefusedStart:
    def __init__(self, inbox):
        self._inbox = inbox
        self._refused = RefusedParameters()
        self.error = None  # None: the parameters were accepted
        self._diagnostics = Diagnostics(inbox, "none", {REPORT: self._report}, self._inbox.clocks.now_ns())

    def wait(self, error):
        """Log and report an error until the parameters are to be read again, or the node is ended."""
        self.error = error
        line = self._refused.update(str(error), self._inbox.clocks.now_ns())
        if line:
            rospy.logfatal("%s", line)
        while not self._inbox.ending and self._inbox.clocks.now_ns() < self._refused.due_ns:
            self._inbox.wait_until(min(self._refused.due_ns, self._diagnostics.due_ns))
            self._diagnostics.step(self._inbox.clocks.now_ns())

    def report_acceptance(self):
        self.error = None
        rospy.loginfo("the parameters are accepted now")
        self._diagnostics.force()

    def _report(self, status):
        if self.error is None:
            status.summary(OK, "accepted")
            return status
        status.summary(ERROR, f"this node doesn't run, as it refuses a parameter: {self.error}")
        status.add("cause", causes.PARAMETER_REFUSED)
        status.add("parameter", self.error.name)
        return status
