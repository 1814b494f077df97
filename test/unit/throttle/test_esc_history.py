"""What is known of the pulses that an ESC has had."""

from dataclasses import replace

import pytest

from car_interface.throttle.esc_config import EscConfig
from car_interface.throttle.esc_history import EscHistory

MS = 1_000_000
CONFIG = EscConfig(profile="brake_then_reverse", dwell_s=0.3)
DROVE = [("both", 0.4, 500)]
BRAKES = [("both", 0.4, 250), ("both", 0.4, 250), ("both", -0.5, 200), ("both", -0.5, 200)]


def played(steps, config=CONFIG):
    """A history after steps of (sent, held or both; fraction; milliseconds until the next), and the time then."""
    history, now_ns = EscHistory(config), 0
    for what, fraction, lasts_ms in steps:
        if what in ("sent", "both"):
            history.update_sent(fraction, now_ns)
        if what in ("held", "both"):
            history.update_held(fraction, now_ns)
        if what == "lost":
            history.mark_unknown()
        for _ in range(lasts_ms // 10):
            now_ns += 10 * MS
            history.brake_is_certain(now_ns)  # asked at each step, as the state machine does
    return history, now_ns


@pytest.mark.parametrize("steps, certain", [
    pytest.param([], False, id="not_at_the_start"),
    pytest.param(DROVE, True, id="after_forward"),
    pytest.param([("lost", 0, 20), *DROVE], True, id="after_forward_also_when_messages_were_dropped_before_any_came"),
    pytest.param([("both", 0.4, 490)], False, id="not_after_forward_for_less_than_half_a_second"),
    pytest.param([("both", 0.07, 500)], False, id="not_after_one_within_the_dead_band"),
    pytest.param([("both", 0.071, 500)], True, id="after_one_just_beyond_it"),
    pytest.param([*DROVE, ("both", 0.05, 20), ("both", 0.0, 20)], True, id="also_after_a_push_within_the_dead_band"),
    pytest.param([*DROVE, ("both", -0.01, 20), ("both", 0.0, 20)], True, id="also_after_what_rounds_to_neutral"),
    pytest.param([("sent", 0.4, 500)], False, id="not_where_the_board_never_said_so"),
    pytest.param([("both", 0.0, 10), ("sent", 0.4, 500)], False, id="not_while_the_board_holds_neutral"),
    pytest.param([*DROVE, ("both", 0.0, 5000), ("held", 0.0, 10)], False, id="not_while_the_board_is_silent_for_long"),
    pytest.param([*DROVE, ("both", 0.0, 1000), ("held", 0.0, 1000)], True, id="neutral_changes_nothing"),
    pytest.param(BRAKES, True, id="while_it_brakes"),
    pytest.param([*BRAKES, ("both", -0.5, 250)], True, id="also_if_the_board_is_silent_for_250_ms"),
    pytest.param([*BRAKES, ("both", -0.5, 260), ("both", -0.5, 20)], False, id="not_after_more_as_its_guard_lets_go"),
    pytest.param([*DROVE, ("sent", -0.5, 20)], False, id="nor_for_a_pull_that_begins_after_so_long"),
    pytest.param([*DROVE, ("both", 0.0, 900)], True, id="though_without_a_pull_there_is_none_to_let_go_of"),
    pytest.param([*BRAKES, ("both", 0.0, 20)], False, id="not_after_neutral"),
    pytest.param([*BRAKES, ("both", 0.0, 20), ("both", -0.5, 20)], False, id="nor_when_it_is_pulled_again"),
    pytest.param([*BRAKES, ("held", 0.0, 20), ("held", -0.5, 20)], False, id="nor_after_a_guard_s_neutral"),
    pytest.param([*BRAKES, ("sent", 0.0, 20), ("sent", -0.5, 20)], False, id="nor_after_one_that_is_on_its_way"),
    pytest.param([*BRAKES, ("both", -0.05, 20)], False, id="nor_once_the_brake_is_within_the_dead_band"),
    pytest.param([*DROVE, ("both", -0.05, 20), ("both", 0.0, 20)], False, id="nor_after_a_pull_within_the_dead_band"),
    pytest.param([*BRAKES, ("both", 0.0, 20), ("both", 0.4, 500)], True, id="until_it_drove_forward_again"),
    pytest.param([*DROVE, ("held", None, 20), ("held", 0.0, 20)], False, id="not_after_a_loss_of_pulses"),
    pytest.param([*DROVE, ("lost", 0, 20)], False, id="not_after_messages_were_dropped"),
])
def test_brake_is_certain(steps, certain):
    history, now_ns = played(steps)
    assert history.brake_is_certain(now_ns) == certain


def test_esc_that_forgets_is_not_certain_to_brake_after_its_time():
    config = EscConfig(profile="brake_then_reverse", dwell_s=0.3, reverse_after_neutral_s=1.0)
    for lasts_ms, certain in ((900, True), (1000, False)):
        history, now_ns = played([*DROVE, ("both", 0.0, lasts_ms)], config)
        assert history.brake_is_certain(now_ns) == certain


@pytest.mark.parametrize("steps, unlocked", [
    pytest.param([*BRAKES, ("both", 0.0, 300)], True, id="brake_and_neutral"),
    pytest.param([*BRAKES, ("both", 0.0, 200)], False, id="neutral_too_short"),
    pytest.param([*DROVE, ("both", -0.07, 400), ("both", 0.0, 300)], False, id="brake_within_the_dead_band"),
    pytest.param([*DROVE, ("both", -0.071, 400), ("both", 0.0, 300)], True, id="brake_just_beyond_it"),
    pytest.param([*DROVE, ("both", -0.5, 200), ("both", 0.0, 400)], False, id="brake_too_short"),
    pytest.param([*BRAKES, ("both", 0.0, 300), ("both", -0.5, 900), ("both", 0.0, 20), ("both", -0.5, 20)], True,
                 id="again_and_again"),
    pytest.param([*BRAKES, ("both", 0.0, 100), ("both", -0.5, 50), ("both", 0.0, 400)], False, id="a_short_pull"),
    pytest.param([*BRAKES, ("both", 0.0, 100), ("sent", -0.5, 0), ("sent", 0.0, 400)], False, id="one_of_a_moment"),
    pytest.param([*BRAKES, ("both", 0.0, 100), ("both", -0.04, 50), ("both", 0.0, 400)], False, id="a_faint_one"),
    pytest.param([*DROVE, ("both", -0.5, 250), ("sent", 0.0, 20), ("sent", -0.5, 100), ("both", 0.0, 400)], False,
                 id="a_gap_that_the_board_did_not_report"),
    pytest.param([*BRAKES, ("both", 0.0, 300), ("both", 0.4, 20)], False, id="not_after_forward"),
    pytest.param([*BRAKES, ("both", 0.0, 300), ("held", None, 20), ("held", 0.0, 500)], False, id="nor_a_loss"),
    pytest.param([("sent", -0.5, 400), ("sent", 0.0, 300)], True, id="by_what_was_sent_if_the_board_said_nothing"),
])
def test_reverse_is_unlocked(steps, unlocked):
    history, now_ns = played(steps)
    assert history.is_unlocked(now_ns) == unlocked


@pytest.mark.parametrize("steps, has_braked", [
    pytest.param(BRAKES, True, id="while_it_is_pulled"),
    pytest.param([*BRAKES, ("held", 0.0, 20)], True, id="though_a_guard_let_go"),
    pytest.param([*BRAKES, ("both", 0.0, 100), ("both", -0.5, 20)], False, id="not_by_a_new_pull"),
    pytest.param([*BRAKES, ("both", 0.0, 300), ("both", -0.5, 20)], True, id="by_a_pull_that_reverses"),
    pytest.param([*BRAKES, ("both", 0.4, 20)], False, id="not_since_a_push"),
])
def test_esc_has_had_the_brake_before_reverse(steps, has_braked):
    history, now_ns = played(steps)
    assert history.has_braked(now_ns) == has_braked


@pytest.mark.parametrize("is_measured, steps, still_ms, certain", [
    (True, BRAKES, 200, True), (True, BRAKES, 210, False), (False, BRAKES, 60, True), (False, BRAKES, 70, False),
    (False, DROVE, 400, True), (True, [*DROVE, ("both", 0.0, 100)], 400, True)])
def test_node_that_stood_still_while_the_board_held_a_pull_reckons_with_its_neutral(
        is_measured, steps, still_ms, certain):
    history, now_ns = EscHistory(replace(CONFIG, profile_measured=is_measured)), 0
    for _, fraction, lasts_ms in steps:
        for _ in range(lasts_ms // 10):
            now_ns += 10 * MS
            history.update_sent(fraction, now_ns)
            history.update_held(fraction, now_ns)
    now_ns += still_ms * MS
    history.resume(now_ns)
    assert history.brake_is_certain(now_ns) == certain


def test_push_that_the_board_held_until_its_next_message_counts_to_its_end():
    history = EscHistory(CONFIG)
    for at_ms in (0, 150, 300, 450):
        history.update_sent(0.4, at_ms * MS)
        history.update_held(0.4, at_ms * MS)
    history.update_held(0.0, 500 * MS)
    assert history.brake_is_certain(500 * MS)


def test_push_of_a_car_that_may_roll_backward_counts_from_when_that_is_over():
    history, now_ns = played(DROVE)
    history.mark_backward(now_ns)
    for lasts_ms, certain in ((0, False), (490, False), (10, True)):
        for _ in range(lasts_ms // 10):
            now_ns += 10 * MS
            history.update_sent(0.4, now_ns)
            history.update_held(0.4, now_ns)
        assert history.brake_is_certain(now_ns) == certain


def test_pull_and_neutral_have_lasted_for_the_dwell_also_between_two_messages():
    history = EscHistory(CONFIG)
    for at_ms, fraction in ((0, -0.5), (50, -0.5), (250, -0.5), (300, 0.0), (450, 0.0), (590, 0.0)):
        for update in (history.update_sent, history.update_held):
            update(fraction, at_ms * MS)
        if at_ms == 250:
            assert not history.has_braked(299 * MS) and history.has_braked(300 * MS)
    assert not history.is_unlocked(599 * MS) and history.is_unlocked(600 * MS)


def test_what_the_board_holds_is_known_for_two_and_a_half_seconds_and_counts_for_nothing_afterwards():
    history, now_ns = played([*BRAKES, ("both", 0.0, 0)])
    history.update_sent(0.0, now_ns + 2500 * MS)
    assert history.is_known(now_ns + 2500 * MS) and not history.is_known(now_ns + 2500 * MS + 1)
    assert history.neutral_ns(now_ns + 2500 * MS) == 2500 * MS
    assert history.neutral_ns(now_ns + 2500 * MS + 1) == 0


def test_pull_is_timed_while_it_is_known_and_ends_the_coasting_after_a_push():
    history, now_ns = played(BRAKES)
    assert (history.pulled_ns(now_ns), history.coasted_ns(now_ns)) == (400 * MS, 0)
    assert history.pulled_ns(now_ns + 2501 * MS) == 0
    assert played([*BRAKES, ("both", 0.0, 100)])[0].coasted_ns(now_ns + 100 * MS) == 0
    assert played([*DROVE, ("both", 0.0, 100)])[0].coasted_ns(600 * MS) == 100 * MS


def test_board_that_let_go_during_a_pause_has_had_neutral_since_then():
    history, _ = played([("sent", 0.4, 0), ("held", 0.0, 0)])
    history.resume(500 * MS)
    assert history.neutral_ns(500 * MS) == 300 * MS


@pytest.mark.parametrize("profile, is_measured, holds", [
    ("brake_then_reverse", True, True), ("brake_then_reverse", False, False), ("brake_becomes_reverse", True, False)])
def test_board_holds_the_pulls_of_an_esc_that_was_measured_to_brake_first(profile, is_measured, holds):
    history, now_ns = played([("sent", -0.5, 0)], EscConfig(profile=profile, profile_measured=is_measured))
    assert history.resume(now_ns + 100 * MS) is not holds


def test_neutral_counts_where_it_is_sent_and_held():
    history, now_ns = played([("both", 0.0, 100), ("sent", 0.2, 50), ("sent", 0.0, 300), ("held", 0.01, 200)])
    assert history.neutral_ns(now_ns) == 500 * MS
    history.update_held(0.02, now_ns)
    assert history.neutral_ns(now_ns) == 0


def test_loss_of_pulses_that_is_over_is_told_once():
    history, _ = played([("held", None, 10), ("held", 0.0, 10)])
    assert history.had_no_pulse() and not history.had_no_pulse()
    history.update_held(None, 10**9)
    assert history.had_no_pulse() and history.had_no_pulse()


def test_what_the_board_held_during_a_pause_and_is_heard_after_it_proves_no_push():
    history, now_ns = played([("both", 0.5, 300)])
    now_ns += 400 * MS
    history.update_held(0.5, now_ns)  # as it was soon after the pause began
    assert not history.brake_is_certain(now_ns)
    assert history.resume(now_ns)
