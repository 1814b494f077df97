"""Which nodes command each channel: several nodes are normal, two on one channel are not."""
from __future__ import annotations

from car_interface.common.servo_channels import CHANNELS, UNCHANGED
from car_interface.common.units import NS_PER_S
from car_interface.pca9685.senders import ChannelSenders


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
