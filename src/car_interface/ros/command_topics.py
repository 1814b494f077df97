"""A node's report on who publishes on the topics that it obeys: on /diagnostics and, if it lasts, in the log."""
from __future__ import annotations

from types import MappingProxyType
from typing import Callable, Mapping

import rospy

from car_interface.common.publishers import REPORT, CommandTopic, Fault, FaultLog, find_faults
from car_interface.ros.diagnostics import ERROR, OK, WARN
from car_interface.ros.inbox import Inbox
from car_interface.ros.master_watch import MasterWatch

# No command, but a report: of pca9685, and of its guard while that acts in its place.
REPORTS = ("/servo/output",)


class CommandTopics:
    """Watches the publishers of all topics that a node subscribes to.

    Args:
        inbox: the node's.
        shared: topics on which several nodes may publish.
        types: of topics that it subscribes to with any type, those that it takes.
        more_faults: what else the node finds, called with ``now_ns`` and the topics.
    """

    def __init__(self, inbox: Inbox, shared: tuple[str, ...] = (),
                 more_faults: Callable[[int, list[CommandTopic]], list[Fault]] | None = None,
                 types: Mapping[str, tuple[str, ...]] = MappingProxyType({})):
        self._inbox = inbox
        self._shared = shared
        self._types = types
        self._more_faults = more_faults or (lambda now_ns, topics: [])
        self.topics: list[CommandTopic] = []  # as they were found last; none = not yet
        self._log = FaultLog()
        self.reports = {REPORT: self._report}

    def start(self, report_now: Callable[[], None], on_fault: Callable[[str, int], None] | None = None) -> None:
        """Begin, once the node has subscribed to its topics.

        Args:
            report_now: has the node's reports published at once.
            on_fault: as ``MasterWatch`` takes it.
        """
        def on_topics(topics, now_ns):
            self.topics = topics
            report_now()
        MasterWatch(self._inbox, on_fault, on_topics, (*self._shared, *REPORTS), self._types)

    def _report(self, status):
        """For /diagnostics: each fault with its remedy, and all publishers."""
        now_ns = self._inbox.clocks.now_ns()
        faults = [fault for topic in self.topics for fault in find_faults(topic)]
        faults += self._more_faults(now_ns, self.topics)
        for fault in self._log.update(faults, now_ns):
            rospy.logwarn("%s", fault.text)
        status.summary(OK, "each has the publishers that it should have" if self.topics else "not looked at yet")
        for fault in faults:
            status.mergeSummary(ERROR if self._log.is_lasting(fault, now_ns) else WARN, fault.reason)
        status.add("cause", ", ".join(dict.fromkeys(fault.cause for fault in faults)))
        status.add("remedy", ". ".join(dict.fromkeys(fault.remedy for fault in faults)))
        for topic in self.topics:
            status.add(topic.name, ", ".join(map(str, topic.publishers)) or "no publisher")
        return status
