"""What each of the sixteen channels should hold, and when it goes to its timeout value. Time is passed in."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from car_interface.common.errors import ConfigError
from car_interface.pca9685.channels import ChannelConfig, Channels, TimedOut

MS, S = 1_000_000, 1_000_000_000
NOW = 5_000 * MS
LEAVE = -1
CENTER_COUNTS = 319  # of a duty of 5100


def channels(**settings):
    """Sixteen channels alike; by default with a timeout of 250 ms and a timeout value of 5100."""
    settings.setdefault("timeout_value", 5100)
    return Channels([ChannelConfig(**settings)] * 16)


def vector(duties):
    return [duties.get(channel, LEAVE) for channel in range(16)]


def test_channel_that_nobody_configured_is_off_after_250_ms_unlimited_and_no_esc_s():
    assert ChannelConfig() == ChannelConfig(timeout_ms=250, timeout_value=0, pwm_min=0, pwm_max=65535, live_range=0,
                                            pulls=0, brakes_first=False, forgets_ms=0)


def test_channels_before_any_command_hold_their_timeout_values_whatever_the_limits():
    board = channels(pwm_min=5200)
    assert board.targets == [CENTER_COUNTS] * 16
    assert board.next_deadline_ns() == math.inf
    assert board.expire(NOW) == []


@pytest.mark.parametrize("value", [-2, 65536, -2 ** 31])
def test_value_that_is_no_duty_is_refused_alone_and_renews_nothing(value):
    board = channels()
    board.command(vector({3: 6700}), NOW)
    assert board.command(vector({3: value, 4: 0, 5: 65535}), NOW + 200 * MS) == ([], [3])
    assert board.targets[3:6] == [419, 0, 4096]
    assert board.expire(NOW + 250 * MS) == [3]
    board.command(vector({3: value}), NOW + 300 * MS)
    assert list(board.timed_out(NOW + 300 * MS)) == [3]


@pytest.mark.parametrize("duty, counts, clamped", [
    (2800, 175, []), (2799, 175, [0]), (0, 175, [0]), (7600, 475, []), (7601, 475, [0]), (65535, 475, [0])])
def test_duty_beyond_the_channel_s_limits_is_clamped_and_said_so_and_minus_1_is_no_duty(duty, counts, clamped):
    board = channels(pwm_min=2800, pwm_max=7600)
    assert board.command(vector({0: duty}), NOW) == (clamped, [])
    assert board.targets[:2] == [counts, CENTER_COUNTS]


@pytest.mark.once
@given(st.lists(st.tuples(st.integers(0, 400), st.dictionaries(st.integers(0, 15), st.integers(-3, 65540)))))
def test_channels_after_any_commands_hold_the_newest_that_is_young_enough(commands):
    """A second, naive bookkeeping: for each channel the time and counts of its newest duty."""
    board = channels()
    newest = {}
    now_ns = NOW
    for pause_ms, duties in commands:
        now_ns += pause_ms * MS
        board.expire(now_ns)
        board.command(vector(duties), now_ns)
        newest.update({channel: (now_ns, (duty + 8) // 16) for channel, duty in duties.items() if 0 <= duty <= 65535})
        young = {channel: counts for channel, (at_ns, counts) in newest.items() if now_ns - at_ns < 250 * MS}
        assert board.targets == [young.get(channel, CENTER_COUNTS) for channel in range(16)]


def test_limits_the_wrong_way_round_are_refused_naming_the_channel_and_limits_that_meet_leave_one_duty():
    configs = [ChannelConfig()] * 15 + [ChannelConfig(pwm_min=7600, pwm_max=2800)]
    with pytest.raises(ConfigError, match=r"pwm_min\[15\] is 7600; accepted: at most pwm_max\[15\] 2800"):
        Channels(configs)
    board = channels(pwm_min=5100, pwm_max=5100)
    board.command([0] * 8 + [65535] * 8, NOW)
    assert board.targets == [CENTER_COUNTS] * 16


def test_channel_has_timed_out_since_its_deadline_and_until_its_next_command():
    board = channels()
    board.command(vector({0: 3800, 1: 4000}), NOW)
    assert board.timed_out(NOW + 249 * MS) == {}
    board.expire(NOW + 300 * MS)
    board.make_safe(NOW + 500 * MS)  # afterwards
    assert board.timed_out(NOW + 9000 * MS) == {channel: TimedOut(NOW + 250 * MS, False) for channel in (0, 1)}
    board.command(vector({1: 4000}), NOW + 9000 * MS)
    assert list(board.timed_out(NOW + 9000 * MS)) == [0]
    board.expire(NOW + 9250 * MS)
    assert board.timed_out(NOW + 9250 * MS)[1].since_ns == NOW + 9250 * MS


def test_channel_that_was_made_safe_has_timed_out_once_no_command_came_in_its_timeout():
    board = channels()
    board.command(vector({0: 3800, 1: 4000}), NOW)
    board.make_safe(NOW + 100 * MS)
    board.make_safe(NOW + 200 * MS)
    assert board.targets == [CENTER_COUNTS] * 16 and board.next_deadline_ns() == math.inf
    board.command(vector({1: 4000}), NOW + 200 * MS)
    assert board.timed_out(NOW + 349 * MS) == {}
    assert board.timed_out(NOW + 350 * MS) == {0: TimedOut(NOW + 100 * MS, True)}


def test_channel_without_a_timeout_has_timed_out_only_when_it_was_made_safe():
    board = channels(timeout_ms=0)
    board.command(vector({0: 3800}), NOW)
    board.expire(NOW + 10_000 * MS)
    assert board.timed_out(NOW + 10_000 * MS) == {}
    board.make_safe(NOW + 10_000 * MS)
    assert board.timed_out(NOW + 10_000 * MS) == {0: TimedOut(NOW + 10_000 * MS, True)}


def test_timeout_value_follows_a_neutral_at_once_or_for_a_commanded_channel_at_its_next_timeout():
    board = channels(live_range=500)
    board.command(vector({0: 4000, 1: 4000}), NOW)
    assert board.follow(vector({0: 5152, 3: 5168})) == ({0: 5152, 3: 5168}, [])
    assert board.targets == [250, 250, CENTER_COUNTS, 323] + [CENTER_COUNTS] * 12
    board.expire(NOW + 250 * MS)
    assert board.targets[:2] == [322, CENTER_COUNTS]
    board.command([4000] * 16, NOW + 300 * MS)
    board.make_safe(NOW + 300 * MS)
    assert board.targets[:4] == [322, CENTER_COUNTS, CENTER_COUNTS, 323]
    board.follow(vector({1: 5152}))
    assert board.targets[1] == 322


@pytest.mark.parametrize("duty, live_range, timeout_value, followed", [
    (5600, 500, 5100, ({0: 5600}, [])), (65535, 65535, 5100, ({0: 65535}, [])),
    (5601, 500, 5100, ({}, [0])), (4599, 500, 5100, ({}, [0])), (65536, 65535, 5100, ({}, [0])),
    (0, 6000, 5100, ({}, [0])), (1, 6000, 5100, ({0: 1}, [])),  # off is no neutral
    (5150, 0, 5100, ({}, [])),  # a channel that doesn't follow
    (100, 500, 0, ({}, [])),  # one that is off at rest stays off
    (5100, 500, 5100, ({}, [])),  # the same as ever
])
def test_neutral_is_followed_only_so_far(duty, live_range, timeout_value, followed):
    assert channels(timeout_value=timeout_value, live_range=live_range).follow(vector({0: duty})) == followed


def test_reach_is_measured_from_the_start_however_often_a_neutral_moves():
    board = channels(live_range=500)
    assert board.follow(vector({0: 5500}))[0] and board.follow(vector({0: 5900})) == ({}, [0])
    assert board.timeout_values[0] == 5500
    assert board.follow(vector({0: 5100})) == ({0: 5100}, [])


@pytest.mark.parametrize("pulls, pull, push", [(-1, 4000, 6000), (1, 6000, 4000)])
@pytest.mark.parametrize("timeout_ms, lasts_ms", [(250, 80), (30, 30), (0, 80)])
def test_a_pull_that_may_become_reverse_is_held_for_80_ms_and_a_push_as_long_as_any_command(
        pulls, pull, push, timeout_ms, lasts_ms):
    board = channels(pulls=pulls, timeout_ms=timeout_ms)
    board.command(vector({3: push}), NOW)
    assert board.next_deadline_ns() == (NOW + timeout_ms * MS if timeout_ms else math.inf)
    board.command(vector({3: pull}), NOW)
    assert board.expire(NOW + lasts_ms * MS - 1) == [] and board.expire(NOW + lasts_ms * MS) == [3]
    assert board.targets[3] == CENTER_COUNTS
    board.command(vector({3: pull}), NOW + S)
    board.command(vector({3: 5100}), NOW + S + MS)  # neutral is none
    assert board.next_deadline_ns() == (NOW + S + MS + timeout_ms * MS if timeout_ms else math.inf)


@pytest.mark.parametrize("story, lasts_ms", [
    ([(5200, 450), (5000, 300)], 250), ([(5200, 440), (5000, 300)], 80), ([(5000, 100)], 80),
    ([(5200, 450), (5100, 1400), (5000, 300)], 250), ([(5200, 450), (5100, 1500), (5000, 300)], 80),
    ([(5200, 450), (5000, 300), (4900, 300)], 250),  # one pull, which gets stronger
    ([(5200, 450), (5000, 300), (5100, 20), (5000, 300)], 80), ([(5200, 450), (5000, 300), (5200, 440), (5000, 9)], 80),
    ([(5200, 450), (5000, 300), (5200, 450), (5000, 9)], 250), ([(5200, 450), (5000, 300), (None, 0), (5000, 9)], 80),
], ids=["after_a_push", "after_a_short_push", "without_a_push", "after_neutral", "forgotten", "stronger", "second",
        "second_after_a_short_push", "after_another_push", "made_safe"])
def test_pull_of_an_esc_that_brakes_first_is_held_as_long_as_any_command_while_it_is_a_brake(story, lasts_ms):
    board, now_ns = channels(pulls=-1, brakes_first=True, forgets_ms=1500), NOW
    for duty, held_ms in story:
        if duty is None:
            board.make_safe(now_ns)
            continue
        for _ in range(max(1, held_ms // 10)):
            board.command(vector({3: duty}), now_ns)
            deadline_ns, now_ns = board.next_deadline_ns(), now_ns + 10 * MS
    assert deadline_ns - (now_ns - 10 * MS) == lasts_ms * MS


def test_pull_after_one_that_timed_out_may_be_reverse():
    board = channels(pulls=-1, brakes_first=True)
    board.command(vector({3: 5200}), NOW)
    board.command(vector({3: 5000}), NOW + S)
    assert board.expire(NOW + S + 249 * MS) == [] and board.expire(NOW + S + 250 * MS) == [3]
    board.command(vector({3: 5000}), NOW + 2 * S)
    assert board.next_deadline_ns() == NOW + 2 * S + 80 * MS


def test_what_is_a_pull_follows_the_neutral():
    board = channels(pulls=-1, live_range=500)
    board.follow([5200] * 16)
    board.command(vector({0: 5199, 1: 5200}), NOW)
    assert board.expire(NOW + 80 * MS) == [0]


@pytest.mark.parametrize("count", [0, 15, 17])
def test_vector_of_another_length_is_refused_as_a_whole(count):
    board = channels()
    for take in (lambda: board.command([6700] * count, NOW), lambda: board.follow([6700] * count)):
        with pytest.raises(ValueError, match=f"needs 16 values and has {count}"):
            take()
    assert board.targets == [CENTER_COUNTS] * 16 and board.next_deadline_ns() == math.inf
