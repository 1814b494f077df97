"""Stamps rise strictly while the computer's clock is slewed, read late, or set back a little."""
import sys
from types import ModuleType, SimpleNamespace

import pytest

from car_interface.ros.clocks import Clocks, RosClock

MS, S = 1_000_000, 1_000_000_000
START_NS = 1_700_000_000 * S


class Computer(Clocks):
    """Both clocks of a computer, set by the test; each reading of one takes a microsecond."""

    def __init__(self):
        self.monotonic = 1000 * S
        self.ahead_ns = START_NS - self.monotonic  # of ROS time
        self.held_up_ns = 0  # between the readings of the two

    def now_ns(self):
        self.monotonic += 1000
        return self.monotonic

    def ros_now(self):
        return SimpleNamespace(to_nsec=self.ros_ns)

    def ros_ns(self):
        self.monotonic += self.held_up_ns
        return self.monotonic + self.ahead_ns


@pytest.fixture
def computer():
    return Computer()


@pytest.fixture
def clock(computer, monkeypatch):
    """A RosClock; rospy is replaced, since unit tests need no ROS."""
    rospy = ModuleType("rospy")
    rospy.Time = lambda nsecs=0: SimpleNamespace(ns=nsecs)
    monkeypatch.setitem(sys.modules, "rospy", rospy)
    return RosClock(computer)


def stamp_ns(clock, computer, kind="value"):
    """The stamp of a message now, 20 ms after the last."""
    computer.monotonic += 20 * MS
    return clock.stamp(kind, computer.monotonic).ns


@pytest.mark.parametrize("back_ns", [1, 20 * MS, 499 * MS])
def test_stamps_rise_when_the_clock_is_set_back_by_less_than_half_a_second(back_ns, clock, computer):
    stamps = [stamp_ns(clock, computer) for _ in range(3)]
    computer.ahead_ns -= back_ns
    stamps += [stamp_ns(clock, computer) for _ in range(40)]
    assert all(before < after for before, after in zip(stamps, stamps[1:]))
    assert abs(stamps[-1] - computer.ros_ns()) < MS  # and are right again


def test_clock_that_was_set_back_on_purpose_is_followed_and_without_ros_time_the_stamp_is_zero(clock, computer):
    before = stamp_ns(clock, computer)
    computer.ahead_ns -= 10 * S
    assert stamp_ns(clock, computer) < before
    computer.ahead_ns = -computer.monotonic - S
    assert stamp_ns(clock, computer) == 0


def test_two_messages_at_the_same_time_have_different_stamps(clock, computer):
    at_ns = computer.monotonic
    first, second = clock.stamp("value", at_ns).ns, clock.stamp("value", at_ns).ns
    assert second == first + 1
    assert clock.stamp("another", at_ns).ns < second + MS


def test_node_that_is_held_up_between_the_two_clocks_keeps_their_difference(clock, computer):
    before = stamp_ns(clock, computer)
    computer.held_up_ns = 30 * MS
    assert abs(stamp_ns(clock, computer) - before - 20 * MS) < MS


def test_monotonic_time_of_a_stamp_is_the_one_that_it_was_made_of(clock, computer):
    at_ns = computer.monotonic
    stamp = SimpleNamespace(to_nsec=lambda: clock.stamp("value", at_ns).ns)
    assert clock.monotonic_ns(stamp) == at_ns
    computer.ahead_ns += 3600 * S  # set; what was stamped before is an hour off then
    assert abs(clock.monotonic_ns(SimpleNamespace(to_nsec=computer.ros_ns)) - computer.monotonic) < MS
