"""What each of the sixteen channels should hold, and when it goes to its timeout value. Time is passed in."""
from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from car_interface.common.errors import ConfigError
from car_interface.pca9685.channels import ChannelConfig, Channels, TimedOut, blocks, differences

MS = 1_000_000
NOW = 5_000 * MS
LEAVE = -1
CENTER_COUNTS = 319  # of a duty of 5100


def channels(**settings):
    """Sixteen channels alike; by default with a timeout of 250 ms and a timeout value of 5100."""
    settings.setdefault("timeout_value", 5100)
    return Channels([ChannelConfig(**settings)] * 16)


def vector(duties):
    return [duties.get(channel, LEAVE) for channel in range(16)]


def test_channels_before_any_command_hold_their_timeout_values():
    assert channels().targets == [CENTER_COUNTS] * 16
    assert channels().next_deadline_ns() == math.inf
    assert channels().expire(NOW) == []


def test_channel_config_by_default_is_250_ms_off_and_unlimited():
    assert ChannelConfig() == ChannelConfig(timeout_ms=250, timeout_value=0, pwm_min=0, pwm_max=65535)


def test_command_sets_the_channels_that_it_names_and_leaves_the_others():
    board = channels()
    accepted = board.command(vector({0: 3800, 5: 65535, 15: 0}), NOW)
    assert accepted == ([0, 5, 15], [], [])
    expected = [CENTER_COUNTS] * 16
    expected[0], expected[5], expected[15] = 238, 4096, 0
    assert board.targets == expected


@pytest.mark.parametrize("length", [0, 1, 15, 17, 1000])
def test_command_of_another_length_than_16_is_refused_whole(length):
    board = channels()
    with pytest.raises(ValueError, match=f"a command needs 16 values and has {length}$"):
        board.command([3800] * length, NOW)
    assert board.targets == [CENTER_COUNTS] * 16
    assert board.next_deadline_ns() == math.inf


@pytest.mark.parametrize("value", [-2, 65536, 2 ** 31 - 1, -2 ** 31])
def test_value_that_is_no_duty_is_refused_alone_and_renews_nothing(value):
    board = channels()
    board.command(vector({3: 6700}), NOW)
    accepted = board.command(vector({3: value, 4: 3800}), NOW + 200 * MS)
    assert accepted == ([4], [], [3])
    assert board.targets[3:5] == [419, 238]
    assert board.expire(NOW + 250 * MS) == [3]


@pytest.mark.parametrize("duty, counts, clamped", [
    pytest.param(2800, 175, [], id="the_lower_limit_is_allowed"),
    pytest.param(2799, 175, [0], id="below_it_is_clamped"),
    pytest.param(0, 175, [0], id="zero_is_clamped_too"),
    pytest.param(7600, 475, [], id="the_upper_limit_is_allowed"),
    pytest.param(7601, 475, [0], id="above_it_is_clamped"),
    pytest.param(65535, 475, [0], id="full_on_is_clamped"),
])
def test_duty_beyond_the_channel_s_limits_is_clamped_and_said_so(duty, counts, clamped):
    board = channels(pwm_min=2800, pwm_max=7600)
    assert board.command(vector({0: duty}), NOW) == ([0], clamped, [])
    assert board.targets[0] == counts


def test_timeout_value_beyond_the_limits_is_not_clamped():
    assert channels(timeout_value=0, pwm_min=2800).targets == [0] * 16


def test_minus_1_is_no_duty_to_be_clamped():
    board = channels(pwm_min=2800)
    assert board.command([LEAVE] * 16, NOW) == ([], [], [])


def test_channel_silent_for_its_timeout_goes_to_its_timeout_value_once():
    board = channels()
    board.command(vector({0: 3800}), NOW)
    assert board.next_deadline_ns() == NOW + 250 * MS
    assert board.expire(NOW + 250 * MS - 1) == []
    assert board.targets[0] == 238
    assert board.expire(NOW + 250 * MS) == [0]
    assert board.targets[0] == CENTER_COUNTS
    assert board.expire(NOW + 1000 * MS) == []
    assert board.next_deadline_ns() == math.inf


def test_unchanged_command_renews_the_timeout():
    board = channels()
    for step in range(100):
        board.command(vector({0: 3800}), NOW + 200 * step * MS)
        assert board.expire(NOW + 200 * step * MS) == []
    assert board.targets[0] == 238


def test_command_to_one_channel_does_not_renew_the_others():
    board = channels()
    board.command(vector({0: 3800, 1: 3800}), NOW)
    board.command(vector({0: 3800}), NOW + 200 * MS)
    assert board.expire(NOW + 300 * MS) == [1]
    assert board.targets[:2] == [238, CENTER_COUNTS]


def test_channel_with_timeout_0_keeps_its_command_for_ever():
    board = channels(timeout_ms=0)
    board.command(vector({0: 3800}), NOW)
    assert board.next_deadline_ns() == math.inf
    assert board.expire(NOW + 10 ** 9 * MS) == []
    assert board.targets[0] == 238


def test_channel_after_a_timeout_obeys_the_next_command():
    board = channels()
    board.command(vector({0: 3800}), NOW)
    board.expire(NOW + 300 * MS)
    board.command(vector({0: 6700}), NOW + 400 * MS)
    assert board.targets[0] == 419


def test_channels_each_have_their_own_timeout_and_value():
    board = Channels([ChannelConfig(timeout_ms=100 + channel, timeout_value=16 * channel) for channel in range(16)])
    board.command([5100] * 16, NOW)
    assert board.next_deadline_ns() == NOW + 100 * MS
    assert board.expire(NOW + 107 * MS) == list(range(8))
    assert board.targets == [*range(8), *[CENTER_COUNTS] * 8]
    assert board.next_deadline_ns() == NOW + 108 * MS


def test_made_safe_every_channel_holds_its_timeout_value_and_no_deadline():
    board = channels()
    board.command([3800] * 16, NOW)
    board.make_safe(NOW)
    assert board.targets == [CENTER_COUNTS] * 16
    assert board.next_deadline_ns() == math.inf


def test_channel_that_was_never_commanded_has_not_timed_out():
    board = channels()
    board.command(vector({0: 3800}), NOW)
    board.make_safe(NOW)
    board.expire(NOW + 10_000 * MS)
    assert list(board.timed_out(NOW + 10_000 * MS)) == [0]


def test_channel_has_timed_out_since_its_deadline_and_until_its_next_command():
    board = channels()
    board.command(vector({0: 3800, 1: 4000}), NOW)
    assert board.timed_out(NOW + 249 * MS) == {}
    board.expire(NOW + 300 * MS)
    assert board.timed_out(NOW + 9000 * MS) == {channel: TimedOut(NOW + 250 * MS, False) for channel in (0, 1)}
    board.command(vector({1: 4000}), NOW + 9000 * MS)
    assert list(board.timed_out(NOW + 9000 * MS)) == [0]
    board.expire(NOW + 9250 * MS)
    assert board.timed_out(NOW + 9250 * MS)[1].since_ns == NOW + 9250 * MS


def test_value_that_is_refused_does_not_end_a_timeout():
    board = channels()
    board.command(vector({0: 3800}), NOW)
    board.expire(NOW + 250 * MS)
    board.command(vector({0: 65536}), NOW + 300 * MS)
    assert list(board.timed_out(NOW + 300 * MS)) == [0]


def test_channel_that_was_made_safe_has_timed_out_once_no_command_came_in_its_timeout():
    board = channels()
    board.command(vector({0: 3800, 1: 4000}), NOW)
    board.make_safe(NOW + 100 * MS)
    board.make_safe(NOW + 200 * MS)
    board.command(vector({1: 4000}), NOW + 200 * MS)
    assert board.timed_out(NOW + 349 * MS) == {}
    assert board.timed_out(NOW + 350 * MS) == {0: TimedOut(NOW + 100 * MS, True)}


def test_channel_that_had_timed_out_before_it_was_made_safe_has_since_then():
    board = channels()
    board.command(vector({0: 3800}), NOW)
    board.expire(NOW + 250 * MS)
    board.make_safe(NOW + 500 * MS)
    assert board.timed_out(NOW + 500 * MS) == {0: TimedOut(NOW + 250 * MS, False)}


def test_channel_without_a_timeout_has_timed_out_only_when_it_was_made_safe():
    board = channels(timeout_ms=0)
    board.command(vector({0: 3800}), NOW)
    board.expire(NOW + 10_000 * MS)
    assert board.timed_out(NOW + 10_000 * MS) == {}
    board.make_safe(NOW + 10_000 * MS)
    assert board.timed_out(NOW + 10_000 * MS) == {0: TimedOut(NOW + 10_000 * MS, True)}


def test_limits_that_meet_leave_one_duty():
    board = channels(pwm_min=5100, pwm_max=5100)
    board.command([0] * 8 + [65535] * 8, NOW)
    assert board.targets == [CENTER_COUNTS] * 16


def test_limits_the_wrong_way_round_are_refused_naming_the_channel():
    configs = [ChannelConfig()] * 15 + [ChannelConfig(pwm_min=7600, pwm_max=2800)]
    with pytest.raises(ConfigError, match=r"pwm_min\[15\] is 7600; accepted: at most pwm_max\[15\] 2800"):
        Channels(configs)


@pytest.mark.parametrize("changed, runs", [
    pytest.param([], [], id="nothing_needs_no_transfer"),
    pytest.param([0], [[0]], id="one_channel_is_one_run"),
    pytest.param([3, 4, 5], [[3, 4, 5]], id="neighbours_go_together"),
    pytest.param([5, 3, 4], [[3, 4, 5]], id="whatever_their_order"),
    pytest.param([0, 2, 3, 15], [[0], [2, 3], [15]], id="gaps_part_runs"),
    pytest.param(range(16), [list(range(8)), list(range(8, 16))], id="a_run_is_split_at_the_maximum"),
    pytest.param(range(9), [list(range(8)), [8]], id="what_is_left_over_is_a_run"),
])
def test_blocks_of_changes_are_runs_of_neighbours(changed, runs):
    assert blocks(dict.fromkeys(changed, 0), 8) == runs


@given(st.sets(st.integers(0, 15)), st.integers(1, 16))
def test_blocks_of_any_changes_hold_each_once_in_order_and_none_too_long(changed, max_length):
    runs = blocks(dict.fromkeys(changed, 0), max_length)
    assert [channel for run in runs for channel in run] == sorted(changed)
    assert all(run == list(range(run[0], run[0] + len(run))) and len(run) <= max_length for run in runs)


def test_differences_are_the_channels_that_hold_something_else_or_nobody_knows_what():
    held = [None, 0, 319, 238] + [0] * 12
    targets = [0, 0, 319, 319] + [0] * 12
    assert differences(held, targets) == {0: 0, 3: 319}
    assert differences(targets, targets) == {}


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


# --- neutrals of those who command the channels ---


def neutrals(**by_channel):
    """The vector of neutrals with ``c0=5150`` and the like; −1 elsewhere."""
    return [by_channel.get(f"c{channel}", -1) for channel in range(16)]


def following(timeout_value=5100, live_range=500):
    return Channels([ChannelConfig(timeout_value=timeout_value, live_range=live_range)] * 16)


def test_timeout_value_follows_a_neutral_and_holds_at_the_next_timeout():
    channels = following()
    channels.command([4000] + [-1] * 15, 0)
    assert channels.follow(neutrals(c0=5152)) == ({0: 5152}, [])
    assert channels.targets[0] == 4000 // 16
    assert channels.expire(250_000_000) == [0]
    assert channels.targets[0] == 5152 // 16 and channels.targets[1] == CENTER_COUNTS


def test_channel_at_its_timeout_value_goes_to_the_new_one_at_once():
    channels = following()
    channels.follow(neutrals(c3=5152))
    assert channels.targets[3] == 5152 // 16
    channels.command([-1, 4000] + [-1] * 14, 0)
    channels.expire(250_000_000)
    channels.follow(neutrals(c1=5168))
    assert channels.targets[1] == 5168 // 16


def test_channel_that_never_times_out_keeps_what_it_was_commanded():
    channels = Channels([ChannelConfig(timeout_ms=0, timeout_value=5100, live_range=500)] * 16)
    channels.command([5100] * 16, 0)
    channels.follow(neutrals(c0=5152))
    assert channels.targets[0] == CENTER_COUNTS


def test_channels_made_safe_hold_the_neutral_that_was_heard():
    channels = following()
    channels.command([4000] * 16, 0)
    channels.follow(neutrals(c0=5152))
    channels.make_safe(0)
    assert channels.targets == [5152 // 16] + [CENTER_COUNTS] * 15
    channels.follow(neutrals(c1=5152))
    assert channels.targets[1] == 5152 // 16


@pytest.mark.parametrize("duty, live_range, timeout_value, followed", [
    pytest.param(5600, 500, 5100, ({0: 5600}, []), id="as_far_as_it_may"),
    pytest.param(5601, 500, 5100, ({}, [0]), id="too_far"),
    pytest.param(4599, 500, 5100, ({}, [0]), id="too_far_down"),
    pytest.param(0, 6000, 5100, ({}, [0]), id="off_is_no_neutral"),
    pytest.param(-2, 65535, 5100, ({}, [0]), id="below_every_duty"),
    pytest.param(65536, 65535, 5100, ({}, [0]), id="above_every_duty"),
    pytest.param(5150, 0, 5100, ({}, []), id="channel_that_does_not_follow"),
    pytest.param(100, 500, 0, ({}, []), id="channel_that_is_off_at_rest_stays_off"),
    pytest.param(5100, 500, 5100, ({}, []), id="same_as_ever"),
])
def test_neutral_is_followed_only_so_far(duty, live_range, timeout_value, followed):
    assert following(timeout_value, live_range).follow(neutrals(c0=duty)) == followed


def test_reach_is_measured_from_the_start_however_often_a_neutral_moves():
    channels = following()
    assert channels.follow(neutrals(c0=5500)).changed and channels.follow(neutrals(c0=5900)).refused == [0]
    assert channels.timeout_values[0] == 5500
    assert channels.follow(neutrals(c0=5100)).changed == {0: 5100}


@pytest.mark.parametrize("length", [0, 15, 17])
def test_vector_of_neutrals_of_another_length_is_refused(length):
    with pytest.raises(ValueError, match=f"a vector of neutrals needs 16 values and has {length}"):
        following().follow([5150] * length)
