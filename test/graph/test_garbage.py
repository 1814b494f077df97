"""When garbage may be collected: the runtime's word on each step, by which ``ros.garbage`` decides."""
from __future__ import annotations

from car_interface.common.standstill import MAX_WAIT_NS
from car_interface.nodes import car_nodes
from car_interface.ros import garbage, runtime
from car_interface.ros.clocks import SYSTEM
from car_interface.ros.inbox import Inbox


class NoGraph:
    clocks = SYSTEM

    def parameter(self, name, default):
        return default


class Watched(Inbox):
    """Ends its node after three waits, and notes what happens."""

    def __init__(self, events):
        super().__init__("/node", graph=NoGraph())
        self.events = events

    def wait_until(self, deadline_ns):
        self.events.append(("wait", deadline_ns, [each.is_stepping for each in garbage.ACTIVITIES]))
        self.ending = len(self.events) >= 9


class Stepping:
    def __init__(self, params, inbox):
        self._inbox = inbox

    def step(self, now_ns):
        self._inbox.events.append(("step", now_ns, [each.is_stepping for each in garbage.ACTIVITIES]))
        return now_ns + MAX_WAIT_NS

    def shut_down(self):
        self._inbox.events.append(("shut down", 0, len(garbage.ACTIVITIES)))


class Collector:
    """Stands in for ``IdleCollector``, and asks to be called again soon."""

    def __init__(self, events):
        self._events = events

    def begin_step(self):
        self._events.append(("begin", 0, []))

    def end_step(self, now_ns, idle_until_ns):
        self._events.append(("end", idle_until_ns, []))
        return now_ns + 1


def test_collector_of_the_process_is_told_of_each_step_and_how_long_the_node_is_idle_after_it():
    events = []
    runtime.spin(Stepping, Watched(events), Collector(events))
    assert [event[0] for event in events] == 3 * ["begin", "step", "end", "wait"] + ["shut down"]
    for step, end, wait in zip(events[1::4], events[2::4], events[3::4]):
        assert step[1] + MAX_WAIT_NS == end[1]
        assert wait[1] < end[1]  # the collector wants to be called before


def test_node_with_waiting_messages_is_not_idle():
    events = []

    class Busy(Stepping):
        def step(self, now_ns):
            self._inbox.put(lambda item, at_ns: None, None)
            return super().step(now_ns)
    runtime.spin(Busy, Watched(events), Collector(events))
    assert all(end[1] - step[1] < MAX_WAIT_NS for step, end in zip(events[1::4], events[2::4]))


def test_node_that_shares_its_process_is_known_as_stepping_in_each_step_and_gone_with_its_end():
    events = []
    runtime.spin(Stepping, Watched(events))
    assert {event[0]: event[2] for event in events} == {"step": [True], "wait": [False], "shut down": 0}


def test_node_of_car_nodes_has_no_collector_of_its_own(monkeypatch):
    used: list = []
    monkeypatch.setattr(car_nodes, "spin", lambda *arguments, **named: used.append(arguments[2:3]))
    car_nodes.Part("turn_arb", Stepping, lambda part: None).join(60.0)
    assert used == [()]
