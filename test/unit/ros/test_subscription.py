"""Which messages are old after a node stood still."""
from types import SimpleNamespace

import pytest

pytest.importorskip("rospy")

from car_interface.ros.topics import Subscription

MS = 1_000_000
START = 1000 * 1000 * MS


class Node:
    """A node with one subscription, whose connections are replaced as it renews them at 0."""

    def __init__(self, takes_latched=None):
        self.now_ns, self.fails, self.retired, self.replaced, self.obeyed = 0, False, [], [], []
        graph = SimpleNamespace(clocks=SimpleNamespace(now_ns=lambda: self.now_ns), replace_connections=self.replace)
        inbox = SimpleNamespace(graph=graph)
        self.subscription = Subscription(inbox) if takes_latched is None else Subscription(inbox, takes_latched)
        self.subscription.subscriber = "subscriber"
        self._handle = self.subscription.without_old(lambda message, arrival_ns: self.obeyed.append(arrival_ns))

    def replace(self, subscriber):
        if self.fails:
            raise RuntimeError("another rospy")
        self.replaced.append(subscriber)
        return lambda header: any(header is each for each in self.retired)

    def obeys(self, arrival_ns, header=None):
        """Whether a message is obeyed; those that aren't are counted."""
        before = len(self.obeyed), self.subscription.dropped
        self._handle(SimpleNamespace(_connection_header=header), arrival_ns)
        after = len(self.obeyed), self.subscription.dropped
        assert sum(after) == sum(before) + 1
        return after[0] > before[0]


def latching():
    """The header of a new connection to a publisher that latches."""
    return {"latching": "1"}


def test_before_connections_are_renewed_each_message_is_obeyed():
    node = Node()
    assert node.obeys(0) and node.obeys(5, latching()) and node.obeyed == [0, 5]
    assert node.subscription.dropped == 0


def test_what_arrived_until_connections_were_renewed_is_old_and_what_still_comes_over_the_old_ones():
    node, old, new = Node(), {"latching": "0"}, {"latching": "0"}
    node.retired = [old]
    node.subscription.renew()
    assert node.replaced == ["subscriber"]
    assert not node.obeys(0) and node.obeys(1) and node.obeys(1, new) and node.obeys(1, {})
    assert not node.obeys(5 * START, old)
    assert node.subscription.dropped == 2


@pytest.mark.parametrize("takes_latched", [None, False, True])
def test_the_first_message_of_a_latching_publisher_s_new_connection_is_its_last_word(takes_latched):
    node, first, second = Node(takes_latched), latching(), latching()
    node.subscription.renew()
    assert node.obeys(0, first) == node.obeys(1, second) == bool(takes_latched)
    assert node.obeys(2, first) and node.obeys(2, second) and not node.obeys(0, first)
    node.retired = [first]
    node.subscription.renew()
    assert not node.obeys(3, first)
    assert node.obeys(3, second) == bool(takes_latched)


def test_where_connections_can_never_be_replaced_each_message_is_obeyed_again_after_a_second():
    node = Node()
    node.fails = True
    node.subscription.renew()
    assert not node.obeys(1000 * MS) and node.obeys(1000 * MS + 1)


def test_where_connections_can_not_be_replaced_nothing_is_obeyed_for_a_second(caplog):
    node = Node(takes_latched=True)
    node.subscription.renew()
    node.fails, node.now_ns = True, START
    node.subscription.renew()
    assert "RuntimeError: another rospy" in caplog.text
    assert not node.obeys(START + 1000 * MS) and not node.obeys(START + 1000 * MS, latching())
    assert node.obeys(START + 1000 * MS + 1)
    node.fails = False
    node.subscription.renew()
    assert node.obeys(START, latching())


def test_topic_is_opened_under_the_node_s_own_name_renewed_with_the_others_and_ended_with_the_node():
    made, closing = [], []
    subscriber = SimpleNamespace(unregister=lambda: None)

    def subscribe(*arguments):
        made.append(arguments)
        return subscriber
    inbox = SimpleNamespace(graph=SimpleNamespace(subscriber=subscribe), own_name="/car/{}".format, subscriptions=[],
                            on_close=closing.append)
    subscription = Subscription(inbox)
    subscription.open("e_stop", "a type", print)
    assert made == [("/car/e_stop", "a type", print, 10)]
    assert subscription.subscriber is subscriber
    assert inbox.subscriptions == [subscription] and closing == [subscriber.unregister]
