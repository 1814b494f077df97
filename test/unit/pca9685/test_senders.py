"""Which nodes command each channel: several nodes are normal, two on one channel are not."""

import pytest

from car_interface.common import causes
from car_interface.common.publishers import CommandTopic, Publisher
from car_interface.common.units import CHANNELS, NS_PER_S, UNCHANGED
from car_interface.pca9685.channels import TimedOut
from car_interface.pca9685.senders import ChannelSenders

TURN_ARB = Publisher("/turn_arb", "127.0.0.1", "std_msgs/Int32MultiArray")
NOW = 1000 * NS_PER_S


def senders_of(*commands):
    """A bookkeeping that was given these: node, channels, and when. 0 is a command, too."""
    senders = ChannelSenders()
    for node, channels, at_ns in commands:
        senders.update(node, [0 if channel in channels else UNCHANGED for channel in range(CHANNELS)], at_ns)
    return senders


@pytest.mark.parametrize("commands, conflicts", [
    ([("/turn_arb", [0], 0), ("/converter", [1], 0), ("/lamp", range(2, 16), 0)], {}),
    ([("/car_nodes", range(16), 0), ("/car_nodes", range(16), 1)], {}),
    ([("/turn_arb", [0], 0), ("/rostopic", [0, 1, 2], 1), ("/converter", [1], 2)],
     {("/rostopic", "/turn_arb"): [0], ("/converter", "/rostopic"): [1]}),
    ([("/a", [0, 3], 0), ("/b", [0, 3], 0)], {("/a", "/b"): [0, 3]}),
], ids=["channels_of_their_own", "one_node", "two_on_one_channel", "same_nodes_on_two_channels"])
def test_nodes_on_one_channel_conflict_there(commands, conflicts):
    assert senders_of(*commands).conflicts(2) == conflicts


def test_node_that_stopped_commanding_is_forgotten_after_a_second_but_not_as_the_last_commander():
    senders = senders_of(("/a", [0, 1], 0), ("/b", [0], NS_PER_S // 2))
    assert senders.conflicts(NS_PER_S - 1) == {("/a", "/b"): [0]}
    assert senders.conflicts(NS_PER_S) == {}
    assert senders.conflicts(0) == {}  # forgotten, not hidden
    assert [senders.last(channel) for channel in (0, 1, 2)] == ["/b", "/a", ""]


def topics(*publishers):
    return [CommandTopic("/servo/cmdVector", "std_msgs/Int32MultiArray", publishers, True)]


def timeout_faults(timed_out, known, **commanders):
    """The faults of channels that timed out; ``commanders`` are the nodes that commanded c0, c1 … last."""
    senders = senders_of(*((node, [int(channel[1:])], 0) for channel, node in commanders.items()))
    return senders.timeout_faults(timed_out, NOW, known, "/pca9685")


SILENT = "; /turn_arb on 127.0.0.1, which commanded it last, publishes, but commands nothing there"
PING = "See its report on /diagnostics and whether it hangs: rosnode ping /turn_arb"
RESTART = ("Start /turn_arb again; or, where nobody is to command channel 0 any more, start this node again: rosnode "
           "kill /pca9685")


@pytest.mark.parametrize("known, was_made_safe, commanders, reason, remedy", [
    (topics(), False, {"c0": "/turn_arb"}, "; /turn_arb, which commanded it last, is gone", RESTART),
    (topics(TURN_ARB), False, {"c0": "/turn_arb"}, SILENT, PING),
    ([], False, {"c0": "/turn_arb"}, "; /turn_arb, which commanded it last, no longer commands", PING),
    (topics(TURN_ARB), True, {"c0": "/turn_arb"},
     f", since this node stood still or lost messages: no command has come after that{SILENT}", PING),
    (topics(TURN_ARB), False, {}, "", "See which node should command it"),
], ids=["gone", "publishes", "publishers_unknown", "made_safe", "commander_unknown"])
def test_fault_says_who_commanded_the_channel_last_since_when_it_does_not_and_what_to_do(
        known, was_made_safe, commanders, reason, remedy):
    fault, = timeout_faults({0: TimedOut(NOW - 12 * NS_PER_S, was_made_safe)}, known, **commanders)
    assert (fault.reason, fault.remedy) == (f"channel timed out: channel 0, for 12.0 s{reason}", remedy)


def test_channels_of_one_commander_are_one_fault_since_the_first_of_them():
    since = {channel: TimedOut(NOW - (1 + channel) * NS_PER_S, False) for channel in range(3)}
    found = timeout_faults(since, topics(), c0="/a", c1="/b", c2="/a")
    assert [fault.reason for fault in found] == [
        "channel timed out: channels 0, 2, for 3.0 s; /a, which commanded them last, is gone",
        "channel timed out: channel 1, for 2.0 s; /b, which commanded it last, is gone"]


def test_conflict_is_a_fault_with_the_machines_of_its_nodes():
    fault, = senders_of(("/turn_arb", [0], 0), ("/other", [0], 0)).conflict_faults(0, topics(TURN_ARB))
    assert (fault.cause, fault.subject) == (causes.SECOND_PUBLISHER, "channel 0")
    assert fault.reason.startswith("2 nodes command channel 0, /other on an unknown machine and /turn_arb on 127.0.0.1")
