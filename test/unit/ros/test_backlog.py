"""When a thread has stood still, where a busy computer's delays don't count; and which messages are old then."""
from types import SimpleNamespace

import pytest

pytest.importorskip("rospy")

from car_interface.ros.backlog import STANDSTILL_NS, Backlog, StandstillWatch

MS = 1_000_000
START = 1000 * 1000 * MS


def standstills(*steps):
    """For how long, ms, the thread has stood still before each of its steps.

    Args:
        steps: (waits, lasts, due): ms from the end of the step before to this one's begin, ms that it lasts, and ms
            from its end to when the next one is due.
    """
    now_ns, watch, found = START, StandstillWatch(START), []
    for waits, lasts, due in steps:
        now_ns += round(waits * MS)
        found.append(watch.begin_step(now_ns) // MS)
        now_ns += round(lasts * MS)
        watch.end_step(now_ns, now_ns + due * MS)
    return found


@pytest.mark.parametrize("steps, expected", [
    ([(0, 0.1, 10)] + [(10, 0.1, 10)] * 99, [0] * 100),
    ([(0, 0.1, 10), (0.2, 0.1, 10), (0, 0.1, 10)], [0, 0, 0]),
    ([(0, 0.1, 10), (3010, 0.1, 10), (10, 0.1, 10)], [0, 3000, 0]),
    ([(0, 0.1, 10), (10, 3000, 10), (0, 0.1, 10), (10, 0.1, 10)], [0, 0, 3000, 0]),
    ([(0, 0.1, 10), (10, 500, 10), (0, 0.1, 10), (10, 0.1, 10)], [0, 0, 500, 0]),
    ([(0, 0.1, 10), (310, 0.1, 10), (10, 300, 10), (310, 0.1, 10)], [0, 0, 0, 0]),
    ([(0, 0.1, 10), (509, 0.1, 10), (510, 0.1, 10)], [0, 0, 500]),
    ([(0, 0.1, 10), (10, 400, 10), (400, 400, 10), (400, 0.1, 10)], [0] * 4),
    ([(0, 0.1, float("inf")), (1000, 0.1, 60_000), (1000, 0.1, 10)], [0, 0, 0]),
    ([(0, 0.1, 60_000), (4000, 0.1, 10)], [0, 3000]),
    ([(0, 0.1, -700), (1, 0.1, -700), (1, 0.1, 10)], [0, 0, 0]),
    ([(700, 0.1, 10)], [700]),
])
def test_standstill(steps, expected):
    assert standstills(*steps) == expected


def test_a_step_on_time_has_stood_still_for_0_ns():
    assert StandstillWatch(START).begin_step(START) == 0


def test_limit_is_the_timeout_of_the_arbiters_inputs():
    from car_interface.interlock.motion_interlock import InterlockConfig
    assert round(InterlockConfig.human_timeout_s * 1e9) == STANDSTILL_NS


class Node:
    """A node with one subscription, whose connections are replaced as it renews them at 0."""

    def __init__(self, takes_latched=None):
        self.now_ns, self.fails, self.retired, self.replaced, self.obeyed = 0, False, [], [], []
        graph = SimpleNamespace(clocks=SimpleNamespace(now_ns=lambda: self.now_ns), replace_connections=self.replace)
        self.backlog = Backlog(graph) if takes_latched is None else Backlog(graph, takes_latched)
        self.backlog.subscriber = "subscriber"
        self._handle = self.backlog.without_old(lambda message, arrival_ns: self.obeyed.append(arrival_ns))

    def replace(self, subscriber):
        if self.fails:
            raise RuntimeError("another rospy")
        self.replaced.append(subscriber)
        return lambda header: any(header is each for each in self.retired)

    def obeys(self, arrival_ns, header=None):
        """Whether a message is obeyed; those that aren't are counted."""
        before = len(self.obeyed), self.backlog.dropped
        self._handle(SimpleNamespace(_connection_header=header), arrival_ns)
        after = len(self.obeyed), self.backlog.dropped
        assert sum(after) == sum(before) + 1
        return after[0] > before[0]


def latching():
    """The header of a new connection to a publisher that latches."""
    return {"latching": "1"}


def test_before_connections_are_renewed_each_message_is_obeyed():
    node = Node()
    assert node.obeys(0) and node.obeys(5, latching()) and node.obeyed == [0, 5]


def test_what_arrived_until_connections_were_renewed_is_old_and_what_still_comes_over_the_old_ones():
    node, old, new = Node(), {"latching": "0"}, {"latching": "0"}
    node.retired = [old]
    node.backlog.renew()
    assert node.replaced == ["subscriber"]
    assert not node.obeys(0) and node.obeys(1) and node.obeys(1, new) and node.obeys(1, {})
    assert not node.obeys(5 * START, old)


@pytest.mark.parametrize("takes_latched", [None, False, True])
def test_the_first_message_of_a_latching_publisher_s_new_connection_is_its_last_word(takes_latched):
    node, first, second = Node(takes_latched), latching(), latching()
    node.backlog.renew()
    assert node.obeys(0, first) == node.obeys(1, second) == bool(takes_latched)
    assert node.obeys(2, first) and node.obeys(2, second) and not node.obeys(0, first)
    node.retired = [first]
    node.backlog.renew()
    assert not node.obeys(3, first)
    assert node.obeys(3, second) == bool(takes_latched)


def test_where_connections_can_not_be_replaced_nothing_is_obeyed_for_a_second(caplog):
    node = Node(takes_latched=True)
    node.backlog.renew()
    node.fails, node.now_ns = True, START
    node.backlog.renew()
    assert "RuntimeError: another rospy" in caplog.text
    assert not node.obeys(START + 1000 * MS) and not node.obeys(START + 1000 * MS, latching())
    assert node.obeys(START + 1000 * MS + 1)
    node.fails = False
    node.backlog.renew()
    assert node.obeys(START, latching())
