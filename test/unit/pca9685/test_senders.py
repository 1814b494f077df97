"""Which nodes command each channel: several nodes are normal, two on one channel are not."""
from __future__ import annotations

from car_interface.common import causes
from car_interface.common.publishers import CommandTopic, FaultLog, Publisher
from car_interface.common.servo_channels import CHANNELS, UNCHANGED
from car_interface.common.units import NS_PER_S
from car_interface.pca9685.channels import TimedOut
from car_interface.pca9685.senders import ChannelSenders

TURN_ARB = Publisher("/turn_arb", "127.0.0.1", "std_msgs/Int32MultiArray")
NOW = 1000 * NS_PER_S


def duties(*channels):
    return [5000 if channel in channels else UNCHANGED for channel in range(CHANNELS)]


def test_nodes_with_channels_of_their_own_do_not_conflict():
    senders = ChannelSenders()
    senders.update("/turn_arb", duties(0), 0)
    senders.update("/generic_value_converter", duties(1), 0)
    senders.update("/lamp", duties(*range(2, 16)), 0)
    assert senders.conflicts(0) == {}


def test_one_node_that_commands_all_channels_conflicts_with_nobody():
    senders = ChannelSenders()
    senders.update("/car_nodes", duties(*range(16)), 0)
    assert senders.conflicts(0) == {}


def test_two_nodes_on_one_channel_conflict_there():
    senders = ChannelSenders()
    senders.update("/turn_arb", duties(0), 0)
    senders.update("/rostopic", duties(0, 1, 2), 1)
    senders.update("/converter", duties(1), 2)
    assert senders.conflicts(2) == {("/rostopic", "/turn_arb"): [0], ("/converter", "/rostopic"): [1]}


def test_channels_of_the_same_nodes_are_told_together():
    senders = ChannelSenders()
    senders.update("/a", duties(0, 3), 0)
    senders.update("/b", duties(0, 3), 0)
    assert senders.conflicts(0) == {("/a", "/b"): [0, 3]}


def test_duty_of_zero_commands_and_minus_one_does_not():
    senders = ChannelSenders()
    senders.update("/a", [0] + [UNCHANGED] * 15, 0)
    senders.update("/b", [0] + [UNCHANGED] * 15, 0)
    assert senders.conflicts(0) == {("/a", "/b"): [0]}


def test_node_that_stopped_commanding_is_forgotten_after_a_second():
    senders = ChannelSenders()
    senders.update("/a", duties(0), 0)
    senders.update("/b", duties(0), NS_PER_S // 2)
    assert senders.conflicts(NS_PER_S - 1) == {("/a", "/b"): [0]}
    assert senders.conflicts(NS_PER_S) == {}


def topics(*publishers):
    return [CommandTopic("/servo/cmdVector", "std_msgs/Int32MultiArray", publishers, True)]


def timeout_faults(timed_out, known, **commanders):
    """The faults of channels that timed out; ``commanders`` are the nodes that commanded c0, c1 … last."""
    senders = ChannelSenders()
    for channel, node in commanders.items():
        senders.update(node, duties(int(channel[1:])), 0)
    return senders.timeout_faults(timed_out, NOW, known, "/pca9685")


def test_last_commander_of_a_channel_is_known_however_long_ago():
    senders = ChannelSenders()
    senders.update("/a", duties(0, 1), 0)
    senders.update("/b", duties(1), 1)
    senders.conflicts(NOW)
    assert [senders.last(channel) for channel in (0, 1, 2)] == ["/a", "/b", ""]


def test_channel_that_timed_out_is_a_fault_with_who_commanded_it_last_since_when_and_what_to_do():
    fault, = timeout_faults({0: TimedOut(NOW - 12 * NS_PER_S, False)}, topics(), c0="/turn_arb")
    assert (fault.cause, fault.subject) == (causes.CHANNEL_TIMED_OUT, "channel 0")
    assert fault.reason == "channel timed out: channel 0, for 12.0 s; /turn_arb, which commanded it last, is gone"
    assert fault.remedy == ("Start /turn_arb again; or, where nobody is to command channel 0 any more, start this node "
                            "again: rosnode kill /pca9685")


def test_commander_that_still_publishes_is_told_with_its_machine_and_how_to_look_at_it():
    fault, = timeout_faults({0: TimedOut(NOW - NS_PER_S // 2, False)}, topics(TURN_ARB), c0="/turn_arb")
    assert fault.reason == ("channel timed out: channel 0, for 0.5 s; /turn_arb on 127.0.0.1, which commanded it last, "
                            "publishes, but commands nothing there")
    assert fault.remedy == "See its report on /diagnostics and whether it hangs: rosnode ping /turn_arb"


def test_nobody_is_said_to_be_gone_before_the_publishers_are_known():
    fault, = timeout_faults({0: TimedOut(NOW, False)}, [], c0="/turn_arb")
    assert fault.reason.endswith("; /turn_arb, which commanded it last, no longer commands")
    assert "rosnode ping /turn_arb" in fault.remedy


def test_channels_of_one_commander_are_one_fault_since_the_first_of_them():
    since = {0: TimedOut(NOW - NS_PER_S, False), 1: TimedOut(NOW - 2 * NS_PER_S, False),
             2: TimedOut(NOW - 3 * NS_PER_S, False)}
    found = timeout_faults(since, topics(), c0="/a", c1="/b", c2="/a")
    assert [fault.reason for fault in found] == [
        "channel timed out: channels 0, 2, for 3.0 s; /a, which commanded them last, is gone",
        "channel timed out: channel 1, for 2.0 s; /b, which commanded it last, is gone"]


def test_channel_that_this_node_made_safe_is_told_so():
    fault, = timeout_faults({0: TimedOut(NOW - NS_PER_S, True)}, topics(TURN_ARB), c0="/turn_arb")
    assert fault.reason.startswith("channel timed out: channel 0, for 1.0 s, since this node stood still or lost "
                                   "messages: no command has come after that; /turn_arb on 127.0.0.1, which")


def test_commander_without_a_name_is_not_told():
    fault, = timeout_faults({0: TimedOut(NOW, False)}, topics(TURN_ARB))
    assert fault.reason == "channel timed out: channel 0, for 0.0 s"
    assert fault.remedy == "See which node should command it"


def test_timed_out_channel_is_an_error_and_due_for_the_log_at_once():
    faults = timeout_faults({0: TimedOut(NOW, False)}, topics(TURN_ARB), c0="/turn_arb")
    log = FaultLog()
    assert log.update(faults, NOW) == faults
    assert log.is_lasting(faults[0], NOW)


def test_no_channel_that_timed_out_is_no_fault():
    assert timeout_faults({}, topics(TURN_ARB), c0="/turn_arb") == []


def test_conflict_is_a_fault_with_the_machines_of_its_nodes():
    senders = ChannelSenders()
    senders.update("/turn_arb", duties(0), 0)
    senders.update("/other", duties(0), 0)
    fault, = senders.conflict_faults(0, topics(TURN_ARB))
    assert (fault.cause, fault.subject) == (causes.SECOND_PUBLISHER, "channel 0")
    assert fault.reason.startswith("2 nodes command channel 0, /other on an unknown machine and /turn_arb on 127.0.0.1")
